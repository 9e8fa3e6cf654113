"""One trial of model predictive control in the simulator (paper 3.3, 4.2 and appendix C.3).

The planner sees one new photograph a step, from one random camera of the rig, and the goals; the
true state sets up the trial and measures its end, nothing else. An object that perception misses
keeps the position that the model forecast.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from oes.episode import Body, Camera, Floats, Step
from oes.mpc.sampler import PlannerConfig
from oes.mpc.search import Plan, PlanError
from oes.sim.arm import ReachError
from oes.sim.world import FIRST_OBJECT, ROBOT
from oes.trials.planner import Observation, Planner, SceneT
from oes.trials.task import Task, TrialScenario
from oes.trials.world_models import StateEstimate

COLLIDED = "an obstacle was touched"


class PushEnv(Protocol):
    """A world that a trial can run in; ``oes.sim.pushing.PushWorld`` is one."""

    def reset(self, bodies: Sequence[Body], world_T_obj_N44: Floats, tip_xy_m: Floats) -> None:
        """Set the scene."""

    def push(self, tip_start_xy_m: Floats, action_3: Floats, rng: np.random.Generator) -> Step:
        """Push once; the settled state."""

    def step_now(self, rng: np.random.Generator) -> Step:
        """The state now, with fresh cameras."""


@dataclass(frozen=True)
class StepRecord:
    """One step of a trial, kept for its film: the photograph, what was made of it, and the push
    chosen (or none).
    """

    rgb_HW3: NDArray[np.uint8]
    camera: Camera
    belief: StateEstimate
    chosen: Plan | None


@dataclass(frozen=True)
class TrialResult:
    """How a trial went; distances G in metres. ``failure`` says why it broke off, empty if it did
    not.
    """

    initial_G: Floats
    final_G: Floats
    believed_G: Floats
    steps_used: int
    failure: str
    moments: tuple[StepRecord, ...]


def run_trial(
    world: PushEnv,
    photograph: Callable[[Step, Camera], Observation],
    planner: Planner[SceneT],
    task: Task,
    cfg: TrialScenario,
    search_cfg: PlannerConfig,
    rngs: tuple[np.random.Generator, np.random.Generator],
) -> TrialResult:
    """Perceive, plan, push, until all seems done or the pushes are used up. ``rngs``: of cameras
    and of proposals.

    A step whose plan would not improve matters is spent standing still. What breaks a trial off (an
    object off the table, an obstacle touched, no free start, a start out of reach) is its
    ``failure``; the final distances are those at that moment.
    """
    camera_rng, plan_rng = rngs
    world.reset(task.bodies, task.world_T_obj_N44, task.tip_xy_m)
    step, moments = world.step_now(camera_rng), list[StepRecord]()
    initial_G = believed_G = _distance(step.center_N3, task.goal_G3)
    center_N3, size_N3 = (
        task.center_N3,
        np.full_like(task.center_N3, planner.cfg.track.unseen_size_m),
    )
    for steps_used in range(cfg.max_steps + 1):
        camera = step.cameras[camera_rng.integers(len(step.cameras))]
        photos = photograph(step, camera)
        belief = planner.perceive(photos, center_N3, size_N3)
        believed_G = _distance(belief.center_N3, task.goal_G3)
        moments.append(StepRecord(photos.frames.rgb_VHW3[0], camera, belief, None))
        failure = _mishap(step, len(task.goal_G3))
        if failure or steps_used == cfg.max_steps or believed_G.max() < cfg.stop_m:
            break
        try:
            chosen = planner.choose(belief, task.goal_G3, search_cfg, plan_rng)
            step = _push(world, chosen, camera_rng) if chosen else world.step_now(camera_rng)
        except (PlanError, ReachError) as error:
            failure = str(error)
            break
        moments[-1] = replace(moments[-1], chosen=chosen)
        center_N3 = chosen.position_TN3[0].double().numpy() if chosen else belief.center_N3
        size_N3 = belief.size_N3
    return TrialResult(
        initial_G,
        _distance(step.center_N3, task.goal_G3),
        believed_G,
        steps_used,
        failure,
        tuple(moments),
    )


def _mishap(step: Step, num_moved: int) -> str:
    """What has gone wrong, if anything; obstacles are the objects after the first ``num_moved``."""
    if (step.center_N3[:, 2] < 0).any():
        return "an object fell off the table"
    obstacle = FIRST_OBJECT + num_moved
    return COLLIDED if step.contact_AA[ROBOT:obstacle, obstacle:].any() else ""


def _push(world: PushEnv, chosen: Plan, rng: np.random.Generator) -> Step:
    return world.push(chosen.tip_3[:2].double().numpy(), chosen.actions_T3[0].double().numpy(), rng)


def _distance(position_N3: Floats, goal_G3: Floats) -> Floats:
    """Metres from the goals of the objects that have one, which come first."""
    return np.asarray(np.linalg.norm(position_N3[: len(goal_G3)] - goal_G3, axis=1))
