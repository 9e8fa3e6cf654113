"""The planner of a trial: from observations to pushes, without access to the simulator."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from oes.config import params
from oes.episode import Camera, Floats, Frames
from oes.mpc.cost import AvoidConfig, GoalCost
from oes.mpc.sampler import PlannerConfig, PushConfig, PushSampler
from oes.mpc.scene import PlanningScene, Rod, object_footprint
from oes.mpc.search import Plan, RiskConfig, search
from oes.mpc.tracking import update_tracks
from oes.perception.perceiver import Perceiver
from oes.trials.world_models import StateEstimate, WorldModel


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


@dataclass
class Planner:
    """Perception, tracking, world model and search.

    ``voxel_m``: voxel side of the object crops; ``half_m``: half width of the table.
    """

    perceiver: Perceiver
    voxel_m: float
    world_model: WorldModel
    rod: Rod
    half_m: float
    cfg: PlanningConfig

    def perceive(
        self, observation: CameraObservation, center_N3: Floats, size_N3: Floats
    ) -> StateEstimate:
        """Update predicted box centres and sizes with the detections of an observation."""
        views = observation.frames, [observation.camera]
        scene = self.perceiver.encode(*views)
        center_P3, size_P3, _ = (x.double().cpu().numpy() for x in self.perceiver.detect(scene))
        gate_m = self.cfg.track.gate_m
        tracks = update_tracks(center_N3, size_N3, center_P3, size_P3, gate_m)
        center, size, is_detected = (torch.from_numpy(x).float() for x in tracks)
        # A box that was not detected has the score 0.
        objects = self.perceiver.objects(scene, (center, size, is_detected), *views)
        return StateEstimate(objects, *tracks, observation.overhead_HW3)

    def plan(
        self, estimate: StateEstimate, goal_G3: Floats, cfg: PlannerConfig, rng: np.random.Generator
    ) -> Plan | None:
        """The cheapest plan for the first G objects, or None if not moving is as cheap.

        The other objects are obstacles. Raises PlanError if no plan is feasible.
        """
        occupancy_NXYZ = estimate.objects.crop_NCXYZ[:, 0].float().cpu().numpy()
        boxes = zip(estimate.center_N3, estimate.size_N3, occupancy_NXYZ, strict=True)
        threshold, num_goals = self.cfg.track.mask_threshold, len(goal_G3)
        shapes = [object_footprint(*box, self.voxel_m, threshold) for box in boxes]
        scene = PlanningScene(shapes[:num_goals], shapes[num_goals:], self.rod, self.half_m)
        cost = GoalCost(scene, goal_G3, self.cfg.avoid)
        sampler, headings_G = PushSampler(scene, self.cfg.push, rng), cost.headings()
        risk = None
        if self.world_model.is_stochastic and cfg.num_samples > 1:
            risk = RiskConfig(cfg.num_reranked, cfg.num_samples, self.cfg.risk_weight)
        propose = partial(sampler, cfg, headings_G)
        unroll = partial(self.world_model.predict, estimate, goal_G3)
        plan = search(propose, unroll, cost, cfg.iterations, cfg.num_elites, risk)
        # Costs of image-based models are not comparable to the initial cost.
        is_image_based = self.world_model.view is not None
        return plan if is_image_based or plan.cost < cost.initial() else None
