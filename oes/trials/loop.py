"""One trial of model predictive control in the simulator (paper 3.3, 4.2 and appendix C.3).

At every step the planner gets one RGB-D image from a random camera of the rig, the goals and the
initial positions, but never the true state. An object that is not detected keeps the position that
the world model predicted.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from oes.episode import FIRST_OBJECT, ROBOT, Camera, Floats, Step
from oes.mpc.sampler import PlannerConfig
from oes.mpc.search import Plan, PlanError
from oes.sim.arm import ReachError
from oes.sim.pushing import PushWorld
from oes.trials.planner import CameraObservation, Planner
from oes.trials.task import Task, TrialScenario
from oes.trials.world_models import StateEstimate

COLLIDED = "collision with an obstacle"


@dataclass(frozen=True)
class StepRecord:
    """Observation, state estimate and plan (None: no push) of one step, kept for the video."""

    rgb_HW3: NDArray[np.uint8]
    camera: Camera
    estimate: StateEstimate
    plan: Plan | None


@dataclass(frozen=True)
class TrialResult:
    """True initial, true final and estimated final distances G to the goals (metres).

    ``failure``: reason of an early end, or "".
    """

    initial_G: Floats
    final_G: Floats
    estimated_G: Floats
    steps_used: int
    failure: str
    steps: tuple[StepRecord, ...]


def run_trial(
    env: PushWorld,
    sensor: Callable[[Step, Camera], CameraObservation],
    planner: Planner,
    task: Task,
    scenario: TrialScenario,
    planner_cfg: PlannerConfig,
    rngs: tuple[np.random.Generator, np.random.Generator],
) -> TrialResult:
    """Perceive, plan and push, up to ``max_steps`` times or until all estimates are at the goals.

    ``rngs`` sample cameras and plans. A step without a plan that lowers the cost counts as a push.
    The trial fails if an object falls or touches an obstacle, or if no push is feasible.
    """
    camera_rng, plan_rng = rngs
    env.reset(task.bodies, task.world_T_obj_N44, task.tip_xy_m)
    state, steps = env.step_now(camera_rng), list[StepRecord]()
    initial_G = _goal_distance(state.center_N3, task.goal_G3)
    center_N3 = task.center_N3
    size_N3 = np.full_like(center_N3, planner.cfg.track.unseen_size_m)
    for steps_used in range(scenario.max_steps + 1):
        camera = state.cameras[camera_rng.integers(len(state.cameras))]
        observation = sensor(state, camera)
        estimate = planner.perceive(observation, center_N3, size_N3)
        estimated_G = _goal_distance(estimate.center_N3, task.goal_G3)
        steps.append(StepRecord(observation.frames.rgb_VHW3[0], camera, estimate, None))
        failure = _failure_reason(state, len(task.goal_G3))
        is_done = steps_used == scenario.max_steps or estimated_G.max() < scenario.stop_m
        if failure or is_done:
            break
        try:
            plan = planner.plan(estimate, task.goal_G3, planner_cfg, plan_rng)
            if plan is None:
                state = env.step_now(camera_rng)
            else:
                tip_3, action_3 = (x.double().numpy() for x in (plan.tip_3, plan.actions_T3[0]))
                state = env.push(tip_3[:2], action_3, camera_rng)
        except (PlanError, ReachError) as error:
            failure = str(error)
            break
        steps[-1] = replace(steps[-1], plan=plan)
        # The next detections are matched to where the model predicts the objects.
        center_N3 = plan.position_TN3[0].double().numpy() if plan else estimate.center_N3
        size_N3 = estimate.size_N3
    final_G = _goal_distance(state.center_N3, task.goal_G3)
    return TrialResult(initial_G, final_G, estimated_G, steps_used, failure, tuple(steps))


def _failure_reason(state: Step, num_goals: int) -> str:
    """Why a state ends the trial, or ""; objects after the first ``num_goals`` are obstacles."""
    if (state.center_N3[:, 2] < 0).any():
        return "an object fell off the table"
    obstacle = FIRST_OBJECT + num_goals
    return COLLIDED if state.contact_AA[ROBOT:obstacle, obstacle:].any() else ""


def _goal_distance(position_N3: Floats, goal_G3: Floats) -> Floats:
    return np.asarray(np.linalg.norm(position_N3[: len(goal_G3)] - goal_G3, axis=1))
