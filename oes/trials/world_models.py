"""What a planner imagines with: an object graph, Visual Foresight or PlaNet; each tells what a set
of pushes would do.

The pictures from above that the last two look at are taken without the arm. Both know what is
pushed, and where, from the same detections as the others; nothing else of those reaches PlaNet, and
Visual Foresight designates their centres' pixels.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.baselines.overhead_camera import OverheadCamera, OverheadView
from oes.baselines.planet import PlaNet, unroll_latent
from oes.baselines.train import is_baseline, load_baseline
from oes.baselines.visual_foresight import (
    VisualForesight,
    expected_pixel,
    pixel_grid,
    unroll_pixels,
)
from oes.dynamics.checkpoint import load_model
from oes.dynamics.unroll import DynamicsModel, initial_state, unroll_samples
from oes.episode import Floats
from oes.mpc.search import Candidates, Rollouts
from oes.objects import Objects


@dataclass(frozen=True)
class StateEstimate:
    """The task's objects as perceived; the same centres and sizes as arrays; which were seen just
    now; the picture from above, for those who look at it.
    """

    objects: Objects
    center_N3: Floats
    size_N3: Floats
    is_seen_N: NDArray[np.bool_]
    overhead_HW3: NDArray[np.uint8] | None


class WorldModel(Protocol):
    """A model as a planner uses it. ``view``: the picture from above that it wants, if any;
    ``draws_futures``: whether it imagines more than one of a plan.
    """

    @property
    def view(self) -> OverheadView | None: ...

    @property
    def draws_futures(self) -> bool: ...

    def imagine(
        self, belief: StateEstimate, goal_G3: Floats, proposals: Candidates, futures: int = 1
    ) -> Rollouts:
        """What the proposals would do, in up to so many futures each; the goals are those of the
        first G objects.
        """


@dataclass(frozen=True)
class GraphWorldModel:
    """A graph network over the perceived objects."""

    model: DynamicsModel
    view: None = None

    @property
    def draws_futures(self) -> bool:
        """Whether the model does."""
        return self.model.num_samples > 1

    @torch.inference_mode()
    def imagine(
        self, belief: StateEstimate, goal_G3: Floats, proposals: Candidates, futures: int = 1
    ) -> Rollouts:
        """Appearance is read once; every plan meets the same draws of it, the one of what is seen
        first.
        """
        samples, objects = len(proposals.actions_ST3), belief.objects
        batched = Objects(**{name: value[None] for name, value in vars(objects).items()})
        draws = min(self.model.num_samples, futures)
        appearance_1NC = self.model.appearance(batched)
        appearance_DNC = self.model.sample(appearance_1NC)[:draws] if draws > 1 else appearance_1NC
        appearance_FNC = appearance_DNC.repeat_interleave(samples, 0)
        tip_F3, actions_FH3 = (
            proposals.tip_S3.repeat(draws, 1),
            proposals.actions_ST3.repeat(draws, 1, 1),
        )
        state = initial_state(
            *(x.expand(draws * samples, *x.shape[1:]) for x in (batched.center_N3, batched.valid_N))
        )
        found = unroll_samples(self.model, appearance_FNC, state, tip_F3, actions_FH3)
        position_FHN3 = objects.center_N3 + found.translation_BTN3
        return Rollouts(
            _path(proposals).repeat(draws, 1, 1),
            position_FHN3,
            found.rotation_BTN33,
            num_samples=draws,
        )


@dataclass(frozen=True)
class ForesightWorldModel:
    """Moves designated pixels, one an object; a plan costs their expected distance to the goals'
    pixels.
    """

    net: VisualForesight
    view: OverheadView
    draws_futures: bool = False

    @torch.inference_mode()
    def imagine(
        self, belief: StateEstimate, goal_G3: Floats, proposals: Candidates, futures: int = 1
    ) -> Rollouts:
        """Turns are not foreseen."""
        above = OverheadCamera(self.view)
        place_N2 = torch.from_numpy(above.project(belief.center_N3)).float()
        _, maps_SHNYX = unroll_pixels(
            self.net, _picture(belief), place_N2, *_pushes(above, proposals)
        )
        samples, horizon, count, height, width = maps_SHNYX.shape
        place_SHN2 = (
            torch.stack([expected_pixel(maps) for maps in maps_SHNYX.unbind(1)], 1).double().numpy()
        )
        height_SHN = np.broadcast_to(belief.center_N3[:, 2], place_SHN2.shape[:-1])
        position = np.concatenate([above.unproject(place_SHN2, height_SHN), height_SHN[..., None]], -1)
        goal_G2 = torch.from_numpy(above.project(goal_G3)).float()
        away_GYX = (pixel_grid(height, width, maps_SHNYX) - goal_G2[:, None, None]).norm(dim=-1)
        cost_ST = (maps_SHNYX[:, :, : len(goal_G3)] * away_GYX).sum((-2, -1)).mean(
            -1
        ) * self.view.half_m
        turned = torch.eye(3).expand(samples, horizon, count, 3, 3)
        return Rollouts(_path(proposals), torch.from_numpy(position).float(), turned, cost_ST)


@dataclass(frozen=True)
class PlanetWorldModel:
    """Foretells rewards in a latent space; a plan costs minus its reward. It places no object:
    those seem to stay.
    """

    net: PlaNet
    view: OverheadView
    draws_futures: bool = False

    @torch.inference_mode()
    def imagine(
        self, belief: StateEstimate, goal_G3: Floats, proposals: Candidates, futures: int = 1
    ) -> Rollouts:
        """Goals are told in the order of their objects from left to right, as in training."""
        above = OverheadCamera(self.view)
        order = np.argsort(above.project(belief.center_N3[: len(goal_G3)])[:, 0])[
            : self.net.cfg.max_goals
        ]
        goals = torch.zeros(self.net.cfg.max_goals, 3)
        goals[: len(order)] = torch.from_numpy(
            np.column_stack([above.project(goal_G3[order]), np.ones(len(order))])
        )
        _, rewards_SH = unroll_latent(self.net, _picture(belief), goals, *_pushes(above, proposals))
        position = belief.objects.center_N3.expand(*rewards_SH.shape, -1, -1)
        turned = torch.eye(3).expand(*position.shape, 3)
        return Rollouts(_path(proposals), position, turned, -rewards_SH * self.view.half_m)


def _path(proposals: Candidates) -> Tensor:
    """The rod's places, SI3."""
    tip_S13 = proposals.tip_S3[:, None]
    return torch.cat([tip_S13, tip_S13 + proposals.actions_ST3.cumsum(1)], 1)


def _pushes(above: OverheadCamera, proposals: Candidates) -> tuple[Tensor, Tensor]:
    """Where the rod starts, S2, and its displacements, SH2, as seen from above."""
    place_SI2 = torch.from_numpy(above.project(_path(proposals).double().numpy())).float()
    return place_SI2[:, 0], place_SI2.diff(dim=1)


def _picture(belief: StateEstimate) -> Tensor:
    """3HW, 0 to 1."""
    assert belief.overhead_HW3 is not None, "no picture from above was taken"
    return torch.from_numpy(belief.overhead_HW3).permute(2, 0, 1).float() / 255


def load_world_model(folder: Path) -> WorldModel:
    """The model in ``folder``, of whichever kind. Raises as ``load_model`` and
    ``load_baseline``.
    """
    if is_baseline(folder):
        net, view = load_baseline(folder)
        return (
            ForesightWorldModel(net, view)
            if isinstance(net, VisualForesight)
            else PlanetWorldModel(net, view)
        )
    return GraphWorldModel(load_model(folder))
