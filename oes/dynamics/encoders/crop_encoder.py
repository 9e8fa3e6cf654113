"""Shapes at the moment of contact: crops folded into horizontal slabs and read in windows that the
action places.

Where the tip passes an object's side decides how it moves and turns, and a feature pooled over the
whole crop blurs just that. So the crop of the first frame is carried along with the object and
looked at anew at every step, from above, in axes turned so that the action points along x: around
the object, around the tip's path, and between two objects. Only turns about the vertical are
followed.
"""

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.dynamics.graph import (
    GraphFeatures,
    ObjectState,
    action_axes,
    conv_encoder,
    distinct_pairs,
    mlp,
    yaw,
)

BEHIND_CELLS = 5  # of the window around the tip's path; the rest lies ahead
FAR_M = 0.07
NOWHERE_M = 1e3  # where the path of an absent tip is
PATH = 2

SlabGrid = tuple[
    Tensor, Tensor, Tensor
]  # slabs BNKXY at t = 0, where the objects are BN3, their turn since BN (radians)


@params
class CropConfig:
    """How crops are read. ``sight`` is ``slabs`` (what is pushed: turns about the vertical, around
    the tip's path) or ``relief`` (what falls: the mask alone, any turn;
    ``oes.dynamics.encoders.heightmap_encoder``). Slabs read so many channels (the mask is the
    first), folded into ``slabs`` of height. Then: output channels of the 2D convolutions (stride 2
    each) and the width of the two layers after them; the size of a cell of the windows around an
    object and between two (as many cells as the crop has), and around the tip's path.
    """

    sight: Literal["slabs", "relief"]
    read: int
    slabs: int
    channels: tuple[int, ...]
    width: int
    cell_m: float
    path_cell_m: float


def fold(crop_BNCXYZ: Tensor, slabs: int) -> Tensor:
    """Slabs BNKXY of crops, K = C x ``slabs``: means over equal parts of the height."""
    return (
        crop_BNCXYZ.reshape(*crop_BNCXYZ.shape[:-1], slabs, -1)
        .mean(-1)
        .movedim(-1, 3)
        .flatten(2, 3)
    )


class SlabNet(nn.Module):
    """Window images PKXY to features PC: 2D convolutions, then two fully connected layers."""

    def __init__(self, inputs: int, cfg: CropConfig, side: int) -> None:
        super().__init__()
        self.convs = conv_encoder(inputs, cfg.channels, kernel_px=4)
        self.join = mlp(cfg.channels[-1] * (side >> len(cfg.channels)) ** 2, cfg.width, 2)

    def forward(self, image_PKXY: Tensor) -> Tensor:
        """Features PC."""
        features: Tensor = self.join(self.convs(image_PKXY))
        return features


class CropEncoder(nn.Module):
    """The three readings of one step. No gradient runs back through where the windows lie."""

    here_P3: Tensor
    path_P3: Tensor

    def __init__(self, cfg: CropConfig, channels: int, side: int, crop_m: float) -> None:
        super().__init__()
        self.side, self.crop_m = side, crop_m
        self.own = SlabNet(channels, cfg, side)
        self.path = SlabNet(channels + PATH, cfg, side)
        self.pair = SlabNet(2 * channels, cfg, side)
        half = side / 2
        self.register_buffer("here_P3", window(side, cfg.cell_m, (half, half)), persistent=False)
        self.register_buffer(
            "path_P3", window(side, cfg.path_cell_m, (BEHIND_CELLS, half)), persistent=False
        )

    def forward(
        self, slabs_BNKXY: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> GraphFeatures:
        """``slabs_BNKXY`` as at t = 0; the tip goes from ``tip_world_B3`` by ``action_B3``
        (metres).
        """
        axes_B33 = action_axes(action_B3)
        shapes = (slabs_BNKXY, state.center_BN3.detach(), yaw(state.turned_BN33.detach()))
        here_BP3 = self.here_P3 @ axes_B33.mT
        path_BP3 = tip_world_B3.nan_to_num(nan=NOWHERE_M)[:, None] + self.path_P3 @ axes_B33.mT
        return GraphFeatures(
            own_BNC=_each(self.own, self._look(shapes, shapes[1][:, :, None] + here_BP3[:, None])),
            path_BNC=_each(self.path, self._path(shapes, path_BP3, action_B3)),
            pair_BNNC=self._pairs(shapes, here_BP3),
        )

    def _path(self, shapes: SlabGrid, path_BP3: Tensor, action_B3: Tensor) -> Tensor:
        """Shapes in the window around the tip's path, and the path itself, BNKXY."""
        num = shapes[0].shape[1]
        seen_BNKXY = self._look(shapes, path_BP3[:, None].expand(-1, num, -1, -1))
        return torch.cat(
            [seen_BNKXY, self._swept(action_B3)[:, None].expand(-1, num, -1, -1, -1)], 2
        )

    def _pairs(self, shapes: SlabGrid, here_BP3: Tensor) -> Tensor:
        """Features BNNC of both shapes in the window midway between a receiver (first N) and a
        sender; 0 to itself.
        """
        slabs_BNKXY, center_BN3, turned_BN = shapes
        num = center_BN3.shape[1]
        receivers, senders = distinct_pairs(num, center_BN3.device).nonzero().unbind(1)
        ends = [
            (slabs_BNKXY[:, i], center_BN3[:, i], turned_BN[:, i]) for i in (receivers, senders)
        ]
        between_BEP3 = ((ends[0][1] + ends[1][1]) / 2)[:, :, None] + here_BP3[:, None]
        found_BEC = _each(self.pair, torch.cat([self._look(end, between_BEP3) for end in ends], 2))
        pair_BNNC = found_BEC.new_zeros(len(found_BEC), num, num, found_BEC.shape[-1])
        pair_BNNC[:, receivers, senders] = found_BEC
        return pair_BNNC

    def _look(self, shapes: SlabGrid, points_BNP3: Tensor) -> Tensor:
        """Slabs BNKXY as they are now at world points BNP3 (a window's cells); zero outside the
        crop.
        """
        slabs_BNKXY, center_BN3, turned_BN = shapes
        x_BNP, y_BNP, _ = (points_BNP3 - center_BN3[:, :, None]).unbind(-1)
        cos, sin = turned_BN.cos()[..., None], turned_BN.sin()[..., None]
        first_BNP2 = torch.stack([cos * x_BNP + sin * y_BNP, cos * y_BNP - sin * x_BNP], -1)
        unit = (first_BNP2 * (2 / self.crop_m)).flip(-1).reshape(-1, self.side, self.side, 2)
        seen = F.grid_sample(slabs_BNKXY.flatten(0, 1), unit, align_corners=False)
        return seen.reshape(slabs_BNKXY.shape)

    def _swept(self, action_B3: Tensor) -> Tensor:
        """Distances of the path window's cells from the tip's path and from its start, B2XY, about
        [-0.5, 1.2].
        """
        length_B1 = action_B3[:, :2].norm(dim=-1, keepdim=True)
        along_P, aside_P = self.path_P3[:, 0], self.path_P3[:, 1]
        past_BP = along_P - along_P.clamp(min=0).minimum(length_B1)
        path_BP = torch.hypot(past_BP, aside_P)
        start_BP = torch.hypot(along_P, aside_P).expand_as(path_BP)
        near = torch.stack([path_BP, start_BP], 1).clamp(max=FAR_M) / 0.04 - 0.5
        return near.reshape(-1, PATH, self.side, self.side)


def _each(net: nn.Module, image_BNKXY: Tensor) -> Tensor:
    """Features BNC of every window image."""
    features: Tensor = net(image_BNKXY.flatten(0, 1))
    return features.reshape(*image_BNKXY.shape[:2], features.shape[-1])


def window(side: int, cell_m: float, origin: tuple[float, float]) -> Tensor:
    """Centres P3 of side x side horizontal cells; ``origin`` is where (0, 0) lies, counted in
    cells.
    """
    lines = [(torch.arange(side) + 0.5 - first) * cell_m for first in origin]
    x, y = torch.meshgrid(*lines, indexing="ij")
    return torch.stack([x, y, torch.zeros_like(x)], -1).reshape(-1, 3)
