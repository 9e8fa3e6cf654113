"""World models of the planner: an object graph, Visual Foresight or PlaNet.

``predict`` gives the outcomes of candidate plans, in up to ``num_samples`` futures each if the
model ``is_stochastic``; the first G objects have goals. ``view`` is the overhead camera of an
image-based model, else None. Image-based models get images without the arm. Their candidate plans
start from the same detections, which PlaNet does not use otherwise; Visual Foresight designates the
pixels of the detected centres.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.baselines import visual_foresight as foresight
from oes.baselines.overhead_camera import OverheadCamera, OverheadView
from oes.baselines.planet import PlaNet, unroll_latent
from oes.baselines.train import is_baseline, load_baseline
from oes.dynamics.checkpoint import load_model
from oes.dynamics.unroll import DynamicsModel, initial_state, unroll_samples
from oes.episode import Floats
from oes.mpc.search import Candidates, Rollouts
from oes.objects import Objects, map_tensors


@dataclass(frozen=True)
class StateEstimate:
    """Perceived objects and boxes, which were detected in the last image, and an overhead image."""

    objects: Objects
    center_N3: Floats
    size_N3: Floats
    is_detected_N: NDArray[np.bool_]
    overhead_HW3: NDArray[np.uint8] | None


@dataclass(frozen=True)
class GraphWorldModel:
    """A graph network over the perceived objects."""

    model: DynamicsModel
    view: None = None

    @property
    def is_stochastic(self) -> bool:
        """Whether the network samples futures."""
        return self.model.num_samples > 1

    @torch.inference_mode()
    def predict(
        self, estimate: StateEstimate, goal_G3: Floats, candidates: Candidates, num_samples: int = 1
    ) -> Rollouts:
        """All plans see the same samples of the objects; the first is the mean estimate."""
        batched = map_tensors(estimate.objects, lambda x: x[None])
        num_samples, num_plans = min(self.model.num_samples, num_samples), len(candidates.tip_S3)
        # Encoded once: appearance does not depend on the plan.
        appearance = self.model.appearance(batched)
        if num_samples > 1:
            appearance = self.model.sample(appearance)[:num_samples]
        boxes = (batched.center_N3, batched.valid_N)
        state = initial_state(*(x.expand(num_samples * num_plans, *x.shape[1:]) for x in boxes))
        rollout = unroll_samples(
            self.model,
            appearance.repeat_interleave(num_plans, 0),
            state,
            candidates.tip_S3.repeat(num_samples, 1),
            candidates.actions_ST3.repeat(num_samples, 1, 1),
        )
        position = estimate.objects.center_N3 + rollout.translation_BTN3
        tip = _tip_path(candidates).repeat(num_samples, 1, 1)
        return Rollouts(tip, position, rollout.rotation_BTN33, num_samples=num_samples)


@dataclass(frozen=True)
class ForesightWorldModel:
    """Visual Foresight with one designated pixel per object.

    Cost: expected distance of the designated pixels to the goals' pixels (metres).
    """

    net: foresight.VisualForesight
    view: OverheadView
    is_stochastic: bool = False

    @torch.inference_mode()
    def predict(
        self, estimate: StateEstimate, goal_G3: Floats, candidates: Candidates, num_samples: int = 1
    ) -> Rollouts:
        """Objects keep their height and orientation."""
        camera, image, pushes = _image_inputs(self.view, estimate, candidates)
        start_N2 = torch.from_numpy(camera.project(estimate.center_N3)).float()
        _, maps_STNHW = foresight.unroll_pixels(self.net, image, start_N2, *pushes)
        pixels = [foresight.expected_pixel(maps_SNHW) for maps_SNHW in maps_STNHW.unbind(1)]
        pixel_STN2 = torch.stack(pixels, 1).double().numpy()
        z_STN = np.broadcast_to(estimate.center_N3[:, 2], pixel_STN2.shape[:-1])
        xy_STN2 = camera.unproject(pixel_STN2, z_STN)
        position = torch.from_numpy(np.concatenate([xy_STN2, z_STN[..., None]], -1)).float()
        goal_G2 = torch.from_numpy(camera.project(goal_G3)).float()
        height, width = maps_STNHW.shape[-2:]
        offset_GHW2 = foresight.pixel_grid(height, width, maps_STNHW) - goal_G2[:, None, None]
        moved_STGHW = maps_STNHW[:, :, : len(goal_G3)]
        distance_STG = (moved_STGHW * offset_GHW2.norm(dim=-1)).sum((-2, -1))
        cost_ST = distance_STG.mean(-1) * self.view.half_m
        return Rollouts(_tip_path(candidates), position, _no_rotation(position), cost_ST)


@dataclass(frozen=True)
class PlanetWorldModel:
    """PlaNet; the cost is minus the predicted reward (metres). Objects are reported as static."""

    net: PlaNet
    view: OverheadView
    is_stochastic: bool = False

    @torch.inference_mode()
    def predict(
        self, estimate: StateEstimate, goal_G3: Floats, candidates: Candidates, num_samples: int = 1
    ) -> Rollouts:
        """Goals are ordered as in training: by the image x of their objects."""
        camera, image, pushes = _image_inputs(self.view, estimate, candidates)
        max_goals = self.net.cfg.max_goals
        start_G2 = camera.project(estimate.center_N3[: len(goal_G3)])
        order = np.argsort(start_G2[:, 0])[:max_goals]
        goals = torch.zeros(max_goals, 3)
        pixel_G2 = camera.project(goal_G3[order])
        goals[: len(order)] = torch.from_numpy(np.column_stack([pixel_G2, np.ones(len(order))]))
        _, rewards_ST = unroll_latent(self.net, image, goals, *pushes)
        position = estimate.objects.center_N3.expand(*rewards_ST.shape, -1, -1)
        cost_ST = -rewards_ST * self.view.half_m
        return Rollouts(_tip_path(candidates), position, _no_rotation(position), cost_ST)


def _tip_path(candidates: Candidates) -> Tensor:
    """World positions SI3 of the rod's tip."""
    tip_S13 = candidates.tip_S3[:, None]
    return torch.cat([tip_S13, tip_S13 + candidates.actions_ST3.cumsum(1)], 1)


def _no_rotation(position_STN3: Tensor) -> Tensor:
    return torch.eye(3).expand(*position_STN3.shape, 3)


def _image_inputs(
    view: OverheadView, estimate: StateEstimate, candidates: Candidates
) -> tuple[OverheadCamera, Tensor, tuple[Tensor, Tensor]]:
    """The camera, its image 3HW (0 to 1), and start S2 and actions ST2 of the rod in the image."""
    assert estimate.overhead_HW3 is not None, "the observation has no overhead image"
    camera = OverheadCamera(view)
    tip_SI2 = torch.from_numpy(camera.project(_tip_path(candidates).double().numpy())).float()
    image_3HW = torch.from_numpy(estimate.overhead_HW3).permute(2, 0, 1).float() / 255
    return camera, image_3HW, (tip_SI2[:, 0], tip_SI2.diff(dim=1))


WorldModel = GraphWorldModel | ForesightWorldModel | PlanetWorldModel


def load_world_model(folder: Path) -> WorldModel:
    """The model in ``folder``. Raises as ``load_model`` and ``load_baseline``."""
    if not is_baseline(folder):
        return GraphWorldModel(load_model(folder))
    net, view = load_baseline(folder)
    if isinstance(net, foresight.VisualForesight):
        return ForesightWorldModel(net, view)
    return PlanetWorldModel(net, view)
