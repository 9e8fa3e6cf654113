"""The planner of a trial: observations in, pushes out. It has no access to the simulator."""

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
    """``gate_m``: largest distance of a detection from the predicted position of its object.

    ``unseen_size_m``: side of the cube that stands for an object never detected.
    ``mask_threshold``: occupancy probability above which a voxel belongs to the footprint.
    """

    gate_m: float
    unseen_size_m: float
    mask_threshold: float


@params
class PlanningConfig:
    """Settings shared by all planners; ``risk_weight``: see ``oes.mpc.search.RiskConfig``."""

    push: PushConfig
    avoid: AvoidConfig
    track: TrackConfig
    risk_weight: float


@dataclass(frozen=True)
class CameraObservation:
    """RGB-D frames of one camera (V = 1), and an overhead image for models that use one."""

    frames: Frames
    camera: Camera
    overhead_HW3: NDArray[np.uint8] | None = None


class Perception(Protocol[SceneT]):
    """The part of ``oes.perception.perceiver.Perceiver`` that a planner uses."""

    def encode(self, frames: Frames, cameras: Sequence[Camera]) -> SceneT:
        """Scene features of the images."""

    def detect(self, scene: SceneT) -> tuple[Tensor, Tensor, Tensor]:
        """Centres P3, sizes P3 and scores P of the detected boxes."""

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
    """Perception, tracking, world model and search."""

    def __init__(
        self,
        perception: Perception[SceneT],
        voxel_m: float,
        world_model: WorldModel,
        rod: Rod,
        half_m: float,
        cfg: PlanningConfig,
    ) -> None:
        """``voxel_m``: voxel side of the object crops; ``half_m``: half width of the table."""
        self.perception, self.voxel_m, self.world_model = perception, voxel_m, world_model
        self.rod, self.half_m, self.cfg = rod, half_m, cfg

    def perceive(
        self, observation: CameraObservation, center_N3: Floats, size_N3: Floats
    ) -> StateEstimate:
        """Update predicted box centres and sizes with the detections of an observation."""
        frames, cameras = observation.frames, [observation.camera]
        scene = self.perception.encode(frames, cameras)
        detected_center_P3, detected_size_P3, _ = (
            values.double().cpu().numpy() for values in self.perception.detect(scene)
        )
        center_N3, size_N3, is_detected_N = update_tracks(
            center_N3, size_N3, detected_center_P3, detected_size_P3, self.cfg.track.gate_m
        )
        center, size, score = (
            torch.from_numpy(x).float() for x in (center_N3, size_N3, is_detected_N)
        )
        objects = self.perception.objects(scene, center, size, score, frames, cameras)
        return StateEstimate(objects, center_N3, size_N3, is_detected_N, observation.overhead_HW3)

    def plan(
        self, estimate: StateEstimate, goal_G3: Floats, cfg: PlannerConfig, rng: np.random.Generator
    ) -> Plan | None:
        """The cheapest plan for the first G objects, or None if not moving is as cheap.

        The other objects are obstacles. Raises PlanError if no plan is feasible.
        """
        cost = GoalCost(self._planning_scene(estimate, len(goal_G3)), goal_G3, self.cfg.avoid)
        scene, headings_G = cost.scene, cost.headings()
        sampler = PushSampler(scene.moved, scene.obstacles, self.rod, self.cfg.push, rng)
        risk = None
        if self.world_model.is_stochastic and cfg.num_samples > 1:
            risk = RiskConfig(cfg.num_reranked, cfg.num_samples, self.cfg.risk_weight)
        plan = search(
            lambda elites_SC: sampler(cfg, headings_G, elites_SC),
            lambda candidates, num_samples: self.world_model.predict(
                estimate, goal_G3, candidates, num_samples
            ),
            cost,
            cfg.iterations,
            cfg.num_elites,
            risk,
        )
        # Image-based models predict costs on a scale of their own, without one for no motion.
        has_own_cost = self.world_model.view is not None
        return plan if has_own_cost or plan.cost < cost.initial() else None

    def _planning_scene(self, estimate: StateEstimate, num_goals: int) -> PlanningScene:
        occupancy_NXYZ = estimate.objects.crop_NCXYZ[:, 0].float().cpu().numpy()
        boxes = zip(estimate.center_N3, estimate.size_N3, occupancy_NXYZ, strict=True)
        threshold = self.cfg.track.mask_threshold
        shapes = [object_footprint(*box, self.voxel_m, threshold) for box in boxes]
        return PlanningScene(shapes[:num_goals], shapes[num_goals:], self.rod, self.half_m)
