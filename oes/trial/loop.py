"""One trial of model predictive control in the simulator (paper 3.3, 4.2 and appendix C.3).

The planner sees one new photograph a step, from one random camera of the rig, and the goals; the true state sets up the
trial and measures its end, nothing else. An object that perception misses keeps the position that the model forecast.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.config import params
from oes.control.cost import Avoid, GoalCost, Scene
from oes.control.plan import Imagined, Plan, PlanError, Proposals, search
from oes.control.proposals import Push, PushSampler, Rod, Search, footprint
from oes.control.track import update
from oes.dynamics.unroll import Model, at_rest, unroll_from
from oes.episode import Body, Camera, Floats, Frames, Step
from oes.objects import Objects
from oes.sim.arm import ReachError
from oes.sim.world import FIRST_OBJECT, ROBOT
from oes.trial.task import Scenario, Task

Seen = TypeVar("Seen")
TOUCHED = "an obstacle was touched"


@params
class Track:
    """How detections become the objects of the task.

    A detection belongs to an object at most ``match_m`` from where that is expected; an object never detected counts as
    a cube of ``unseen_size_m``; mask voxels above ``mask`` (0..1) make up its footprint.
    """

    match_m: float
    unseen_size_m: float
    mask: float


@params
class Planning:
    """What every planner has in common: which pushes it may propose, what it avoids, how it follows the objects."""

    push: Push
    avoid: Avoid
    track: Track


class Eyes(Protocol[Seen]):
    """Perception as a trial uses it; ``oes.percept.perceiver.Perceiver`` is one."""

    def encode(self, frames: Frames, cameras: Sequence[Camera]) -> Seen:
        """Whatever the other methods need of the images."""

    def detect(self, scene: Seen) -> tuple[Tensor, Tensor, Tensor]:
        """Boxes: centres D3, sizes D3, scores D."""

    def objects(
        self,
        scene: Seen,
        centers_N3: Tensor,
        sizes_N3: Tensor,
        scores_N: Tensor,
        frames: Frames,
        cameras: Sequence[Camera],
    ) -> Objects:
        """The objects in given boxes, unbatched."""


class Workbench(Protocol):
    """A world that a trial can run in; ``oes.sim.pushing.PushWorld`` is one."""

    def reset(self, bodies: Sequence[Body], world_T_obj_N44: Floats, tip_xy_m: Floats) -> None:
        """Set the scene."""

    def push(self, tip_start_xy_m: Floats, action_3: Floats, rng: np.random.Generator) -> Step:
        """Push once; the settled state."""

    def step_now(self, rng: np.random.Generator) -> Step:
        """The state now, with fresh cameras."""


@dataclass(frozen=True)
class Belief:
    """The task's objects as perceived; the same centres and sizes as arrays; which were seen just now."""

    objects: Objects
    center_N3: Floats
    size_N3: Floats
    is_seen_N: NDArray[np.bool_]


@dataclass(frozen=True)
class Moment:
    """One step of a trial, kept for its film: the photograph, what was made of it, and the push chosen (or none)."""

    rgb_HW3: NDArray[np.uint8]
    camera: Camera
    belief: Belief
    chosen: Plan | None


@dataclass(frozen=True)
class Outcome:
    """How a trial went; distances G in metres. ``failure`` says why it broke off, empty if it did not."""

    initial_G: Floats
    final_G: Floats
    believed_G: Floats
    steps_used: int
    failure: str
    moments: tuple[Moment, ...]


class Planner(Generic[Seen]):
    """Perception, model and goals together: photographs in, pushes out. It has no access to the simulator."""

    def __init__(self, eyes: Eyes[Seen], voxel_m: float, model: Model, rod: Rod, half_m: float, cfg: Planning) -> None:
        """``voxel_m``: the side of the voxels of the crops that ``eyes`` gives; ``half_m``: the table's half width."""
        self.eyes, self.voxel_m, self.model = eyes, voxel_m, model
        self.rod, self.half_m, self.cfg, self.track = rod, half_m, cfg, cfg.track

    def perceive(self, frames: Frames, cameras: Sequence[Camera], center_N3: Floats, size_N3: Floats) -> Belief:
        """The objects expected at ``center_N3`` with sizes ``size_N3``, as now seen (or as expected, if not seen)."""
        scene = self.eyes.encode(frames, cameras)
        seen_center_D3, seen_size_D3, _ = (values.double().cpu().numpy() for values in self.eyes.detect(scene))
        center_N3, size_N3, is_seen_N = update(center_N3, size_N3, seen_center_D3, seen_size_D3, self.track.match_m)
        center, size, score = (torch.from_numpy(values).float() for values in (center_N3, size_N3, is_seen_N))
        objects = self.eyes.objects(scene, center, size, score, frames, cameras)
        return Belief(objects, center_N3, size_N3, is_seen_N)

    def choose(self, belief: Belief, goal_G3: Floats, search_cfg: Search, rng: np.random.Generator) -> Plan | None:
        """The best push found for the first G objects, or None where none betters standing still.

        The other objects are obstacles. Raises PlanError when there is nothing to choose from.
        """
        occupancy_NXYZ = belief.objects.crop_NCXYZ[:, 0].float().cpu().numpy()
        shapes = [
            footprint(center, size, occupancy, self.voxel_m, self.track.mask)
            for center, size, occupancy in zip(belief.center_N3, belief.size_N3, occupancy_NXYZ, strict=True)
        ]
        scene = Scene(shapes[: len(goal_G3)], shapes[len(goal_G3) :], self.rod, self.half_m)
        cost = GoalCost(scene, goal_G3, self.cfg.avoid)
        sampler, headings_G = PushSampler(scene.moved, scene.obstacles, self.rod, self.cfg.push, rng), cost.headings()
        found = search(
            lambda elites: sampler(search_cfg, headings_G, elites),
            lambda proposals: imagine(self.model, belief.objects, proposals),
            cost,
            search_cfg.rounds,
            search_cfg.elites,
        )
        return found if found.cost < cost.at_rest() else None


@torch.inference_mode()
def imagine(model: Model, objects: Objects, proposals: Proposals) -> Imagined:
    """What the model forecasts for unbatched objects under each proposal; appearance is read once."""
    samples = len(proposals.tip_S3)
    batched = Objects(**{name: value[None] for name, value in vars(objects).items()})
    appearance_1NC = model.appearance(batched)
    state = at_rest(batched.center_N3.expand(samples, -1, -1), batched.valid_N.expand(samples, -1))
    appearance_SNC = appearance_1NC.expand(samples, -1, -1)
    unrolled = unroll_from(model, appearance_SNC, state, proposals.tip_S3, proposals.actions_SH3)
    tip_S13 = proposals.tip_S3[:, None]
    tip_SI3 = torch.cat([tip_S13, tip_S13 + proposals.actions_SH3.cumsum(1)], 1)
    return Imagined(tip_SI3, objects.center_N3 + unrolled.translation_BTN3, unrolled.rotation_BTN33)


def run_trial(
    world: Workbench,
    photograph: Callable[[Step, Camera], Frames],
    planner: Planner[Seen],
    task: Task,
    cfg: Scenario,
    search_cfg: Search,
    rngs: tuple[np.random.Generator, np.random.Generator],
) -> Outcome:
    """Perceive, plan, push, until all seems done or the pushes are used up. ``rngs``: of cameras and of proposals.

    A step whose plan would not improve matters is spent standing still. What breaks a trial off (an object off the
    table, an obstacle touched, no free start, a start out of reach) is its ``failure``; the final distances are those
    at that moment.
    """
    camera_rng, plan_rng = rngs
    world.reset(task.bodies, task.world_T_obj_N44, task.tip_xy_m)
    step, moments = world.step_now(camera_rng), list[Moment]()
    initial_G = believed_G = _distance(step.center_N3, task.goal_G3)
    center_N3, size_N3 = task.center_N3, np.full_like(task.center_N3, planner.cfg.track.unseen_size_m)
    for steps_used in range(cfg.max_steps + 1):
        if failure := _mishap(step, len(task.goal_G3)):
            break
        camera = step.cameras[camera_rng.integers(len(step.cameras))]
        frames = photograph(step, camera)
        belief = planner.perceive(frames, [camera], center_N3, size_N3)
        believed_G = _distance(belief.center_N3, task.goal_G3)
        moments.append(Moment(frames.rgb_VHW3[0], camera, belief, None))
        if steps_used == cfg.max_steps or believed_G.max() < cfg.stop_m:
            break
        try:
            chosen = planner.choose(belief, task.goal_G3, search_cfg, plan_rng)
            step = _push(world, chosen, camera_rng) if chosen else world.step_now(camera_rng)
        except (PlanError, ReachError) as error:
            failure = str(error)
            break
        moments[-1] = replace(moments[-1], chosen=chosen)
        center_N3 = chosen.position_HN3[0].double().numpy() if chosen else belief.center_N3
        size_N3 = belief.size_N3
    return Outcome(initial_G, _distance(step.center_N3, task.goal_G3), believed_G, steps_used, failure, tuple(moments))


def _mishap(step: Step, num_moved: int) -> str:
    """What has gone wrong, if anything; obstacles are the objects after the first ``num_moved``."""
    if (step.center_N3[:, 2] < 0).any():
        return "an object fell off the table"
    obstacle = FIRST_OBJECT + num_moved
    return TOUCHED if step.touched_MM[ROBOT:obstacle, obstacle:].any() else ""


def _push(world: Workbench, chosen: Plan, rng: np.random.Generator) -> Step:
    return world.push(chosen.tip_3[:2].double().numpy(), chosen.actions_H3[0].double().numpy(), rng)


def _distance(position_N3: Floats, goal_G3: Floats) -> Floats:
    """Metres from the goals of the objects that have one, which come first."""
    return np.asarray(np.linalg.norm(position_N3[: len(goal_G3)] - goal_G3, axis=1))
