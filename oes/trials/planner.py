"""The planner of a trial: photographs in, pushes out. It knows what perception sees, and has no
access to a world.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.config import params
from oes.episode import Camera, Floats, Frames
from oes.mpc.cost import AvoidConfig, GoalCost, PlanningScene
from oes.mpc.sampler import PlannerConfig, PushConfig, PushSampler, Rod, object_footprint
from oes.mpc.search import Plan, RiskConfig, search
from oes.mpc.tracking import update_tracks
from oes.objects import Objects
from oes.trials.world_models import StateEstimate, WorldModel

SceneT = TypeVar("SceneT")


@params
class TrackConfig:
    """How detections become the objects of the task.

    A detection belongs to an object at most ``gate_m`` from where that is expected; an object
    never detected counts as a cube of ``unseen_size_m``; mask voxels above ``mask`` (0..1) make up
    its footprint.
    """

    gate_m: float
    unseen_size_m: float
    mask: float


@params
class PlanningConfig:
    """What every planner has in common: which pushes it may propose, what it avoids, how it follows
    the objects, and how many standard deviations of a plan's cost count beside its mean, where
    several futures of it are imagined.
    """

    push: PushConfig
    avoid: AvoidConfig
    track: TrackConfig
    risk_weight: float


@dataclass(frozen=True)
class Observation:
    """What is photographed at one step: RGB-D from one camera (V = 1) and, for those who want it,
    RGB from above.
    """

    frames: Frames
    camera: Camera
    overhead_HW3: NDArray[np.uint8] | None = None


class Perception(Protocol[SceneT]):
    """Perception as a trial uses it; ``oes.perception.perceiver.Perceiver`` is one."""

    def encode(self, frames: Frames, cameras: Sequence[Camera]) -> SceneT:
        """Whatever the other methods need of the images."""

    def detect(self, scene: SceneT) -> tuple[Tensor, Tensor, Tensor]:
        """Boxes: centres D3, sizes D3, scores D."""

    def objects(
        self,
        scene: SceneT,
        centers_N3: Tensor,
        sizes_N3: Tensor,
        scores_N: Tensor,
        frames: Frames,
        cameras: Sequence[Camera],
    ) -> Objects:
        """The objects in given boxes, unbatched."""


class Planner(Generic[SceneT]):
    """Perception, model and goals together: photographs in, pushes out. It has no access to the
    simulator.
    """

    def __init__(
        self,
        eyes: Perception[SceneT],
        voxel_m: float,
        mind: WorldModel,
        rod: Rod,
        half_m: float,
        cfg: PlanningConfig,
    ) -> None:
        """``voxel_m``: the side of the voxels of the crops that ``eyes`` gives; ``half_m``: the
        table's half width.
        """
        self.eyes, self.voxel_m, self.mind = eyes, voxel_m, mind
        self.rod, self.half_m, self.cfg = rod, half_m, cfg

    def perceive(self, photos: Observation, center_N3: Floats, size_N3: Floats) -> StateEstimate:
        """The objects expected at ``center_N3`` with sizes ``size_N3``, as now seen (or as
        expected, if not seen).
        """
        frames, cameras = photos.frames, [photos.camera]
        scene = self.eyes.encode(frames, cameras)
        seen_center_D3, seen_size_D3, _ = (
            values.double().cpu().numpy() for values in self.eyes.detect(scene)
        )
        center_N3, size_N3, is_seen_N = update_tracks(
            center_N3, size_N3, seen_center_D3, seen_size_D3, self.cfg.track.gate_m
        )
        center, size, score = (
            torch.from_numpy(values).float() for values in (center_N3, size_N3, is_seen_N)
        )
        objects = self.eyes.objects(scene, center, size, score, frames, cameras)
        return StateEstimate(objects, center_N3, size_N3, is_seen_N, photos.overhead_HW3)

    def choose(
        self,
        belief: StateEstimate,
        goal_G3: Floats,
        search_cfg: PlannerConfig,
        rng: np.random.Generator,
    ) -> Plan | None:
        """The best push found for the first G objects, or None where none betters standing still.

        The other objects are obstacles. Raises PlanError when there is nothing to choose from.
        """
        occupancy_NXYZ = belief.objects.crop_NCXYZ[:, 0].float().cpu().numpy()
        shapes = [
            object_footprint(center, size, occupancy, self.voxel_m, self.cfg.track.mask)
            for center, size, occupancy in zip(
                belief.center_N3, belief.size_N3, occupancy_NXYZ, strict=True
            )
        ]
        scene = PlanningScene(shapes[: len(goal_G3)], shapes[len(goal_G3) :], self.rod, self.half_m)
        cost = GoalCost(scene, goal_G3, self.cfg.avoid)
        sampler, headings_G = (
            PushSampler(scene.moved, scene.obstacles, self.rod, self.cfg.push, rng),
            cost.headings(),
        )
        asks_again = self.mind.draws_futures and search_cfg.num_samples > 1
        found = search(
            lambda elites: sampler(search_cfg, headings_G, elites),
            lambda proposals, futures: self.mind.imagine(belief, goal_G3, proposals, futures),
            cost,
            search_cfg.iterations,
            search_cfg.num_elites,
            RiskConfig(search_cfg.num_reranked, search_cfg.num_samples, self.cfg.risk_weight)
            if asks_again
            else None,
        )
        judges_itself = self.mind.view is not None  # then its cost is on a scale of its own
        return found if judges_itself or found.cost < cost.initial() else None
