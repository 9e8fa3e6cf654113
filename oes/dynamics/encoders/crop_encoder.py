"""Encoder of pushed objects: crops averaged into horizontal slabs, resampled in the action's axes.

An object's motion depends on where the tip passes its side; features pooled over the whole crop
lose this position. The first frame's crop therefore moves with the object, and every step resamples
it from above in three windows: around the object, around the tip's path, and midway between
two objects. Only rotations about the vertical are followed.
"""

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.dynamics import graph
from oes.dynamics.graph import GraphFeatures, ObjectState, TipMotion

BEHIND_CELLS = 5  # of the path window; the rest lies ahead of the tip
MAX_PATH_DISTANCE_M = 0.07
PATH_CHANNELS = 2

Slabs = tuple[Tensor, Tensor, Tensor]  # slabs BNCXY at t = 0, centres BN3, yaws since then BN


@params
class CropConfig:
    """How crops are encoded.

    ``encoder``: ``slabs`` where objects are pushed, ``heightmap`` where they fall (see
    ``oes.dynamics.encoders.heightmap_encoder``). Slabs use the first ``num_channels`` channels (the
    mask is the first), averaged into ``num_slabs`` of the height. ``channels``: of the stride-2
    convolutions; ``width``: of the two layers after them. ``cell_m``: cell size of the windows
    around and between objects; ``path_cell_m``: around the tip's path.
    """

    encoder: Literal["slabs", "heightmap"]
    num_channels: int
    num_slabs: int
    channels: tuple[int, ...]
    width: int
    cell_m: float
    path_cell_m: float


def fold(crop_BNCXYZ: Tensor, num_slabs: int) -> Tensor:
    """Slabs of crops, BN(C x num_slabs)XY: means over equal parts of the height."""
    slabs_BNCXYS = torch.unflatten(crop_BNCXYZ, -1, (num_slabs, -1)).mean(-1)
    return slabs_BNCXYS.movedim(-1, 3).flatten(2, 3)


class WindowNet(nn.Module):
    """CNN from window images ...CXY to features ...C."""

    def __init__(self, inputs: int, cfg: CropConfig, side: int) -> None:
        super().__init__()
        self.convs = graph.conv_encoder(inputs, cfg.channels, kernel_px=4)
        self.head = graph.mlp(cfg.channels[-1] * (side >> len(cfg.channels)) ** 2, cfg.width, 2)

    def forward(self, image_CXY: Tensor) -> Tensor:
        """Features of images with any leading axes."""
        features_PC: Tensor = self.head(self.convs(image_CXY.flatten(0, -4)))
        return features_PC.reshape(*image_CXY.shape[:-3], features_PC.shape[-1])


class CropEncoder(nn.Module):
    """Graph features of one step from slabs. No gradient flows through the windows' positions."""

    window_P3: Tensor
    path_window_P3: Tensor

    def __init__(self, cfg: CropConfig, channels: int, side: int, crop_m: float) -> None:
        super().__init__()
        self.side, self.crop_m = side, crop_m
        self.node = WindowNet(channels, cfg, side)
        self.agent = WindowNet(channels + PATH_CHANNELS, cfg, side)
        self.edge = WindowNet(2 * channels, cfg, side)
        centered = window(side, cfg.cell_m, (side / 2, side / 2))
        ahead = window(side, cfg.path_cell_m, (BEHIND_CELLS, side / 2))
        self.register_buffer("window_P3", centered, persistent=False)
        self.register_buffer("path_window_P3", ahead, persistent=False)

    def forward(self, slabs_BNCXY: Tensor, state: ObjectState, tip: TipMotion) -> GraphFeatures:
        """Features in the action's axes; ``slabs_BNCXY`` as at t = 0."""
        slabs = (slabs_BNCXY, state.center_BN3.detach(), graph.yaw(state.rotation_BN33.detach()))
        num, axes_B33 = slabs_BNCXY.shape[1], tip.axes_B33()
        window_B1P3 = (self.window_P3 @ axes_B33.mT)[:, None]
        node = self.sample(slabs, slabs[1][:, :, None] + window_B1P3)
        path_BP3 = tip.finite_start_B3()[:, None] + self.path_window_P3 @ axes_B33.mT
        near_path = self.sample(slabs, path_BP3[:, None].expand(-1, num, -1, -1))
        path = self._path_image(tip.action_B3)[:, None].expand(-1, num, -1, -1, -1)
        ends: list[Slabs] = [
            (slabs[0][:, i_E], slabs[1][:, i_E], slabs[2][:, i_E])
            for i_E in graph.pair_indices(num, axes_B33.device)
        ]
        between_BEP3 = ((ends[0][1] + ends[1][1]) / 2)[:, :, None] + window_B1P3
        edge = torch.cat([self.sample(end, between_BEP3) for end in ends], 2)
        return GraphFeatures(
            node_BNC=self.node(node),
            agent_BNC=self.agent(torch.cat([near_path, path], 2)),
            edge_BNNC=graph.scatter_pairs(self.edge(edge), num),
        )

    def sample(self, slabs: Slabs, points_BNP3: Tensor) -> Tensor:
        """Slabs BNCXY, moved with the objects, at world points (the cells of one window each).

        Points outside an object's crop are 0.
        """
        slabs_BNCXY, center_BN3, yaw_BN = slabs
        x_BNP, y_BNP, _ = (points_BNP3 - center_BN3[:, :, None]).unbind(-1)
        # Inverse rotation: from the current pose back to t = 0, where the slabs are given.
        cos, sin = yaw_BN.cos()[..., None], yaw_BN.sin()[..., None]
        first_BNP2 = torch.stack([cos * x_BNP + sin * y_BNP, cos * y_BNP - sin * x_BNP], -1)
        # grid_sample wants (last axis, second to last axis), in units of half the crop.
        grid = (first_BNP2 * (2 / self.crop_m)).flip(-1).reshape(-1, self.side, self.side, 2)
        sampled = F.grid_sample(slabs_BNCXY.flatten(0, 1), grid, align_corners=False)
        return sampled.reshape(slabs_BNCXY.shape)

    def _path_image(self, action_B3: Tensor) -> Tensor:
        """Scaled distances B2XY of the path window's cells from the tip's path and its start."""
        length_B1 = action_B3[:, :2].norm(dim=-1, keepdim=True)
        along_P, across_P = self.path_window_P3[:, 0], self.path_window_P3[:, 1]
        beyond_BP = along_P - along_P.clamp(min=0).minimum(length_B1)
        from_path_BP = torch.hypot(beyond_BP, across_P)
        from_start_BP = torch.hypot(along_P, across_P).expand_as(from_path_BP)
        distance_B2P = torch.stack([from_path_BP, from_start_BP], 1)
        # Inputs of about [-0.5, 1.2]: distances beyond MAX_PATH_DISTANCE_M all look alike.
        scaled_B2P = distance_B2P.clamp(max=MAX_PATH_DISTANCE_M) / 0.04 - 0.5
        return scaled_B2P.reshape(-1, PATH_CHANNELS, self.side, self.side)


def window(side: int, cell_m: float, origin: tuple[float, float]) -> Tensor:
    """Centres P3 of side x side horizontal cells; ``origin``: position of (0, 0), in cells."""
    lines = [(torch.arange(side) + 0.5 - first) * cell_m for first in origin]
    x, y = torch.meshgrid(*lines, indexing="ij")
    return torch.stack([x, y, torch.zeros_like(x)], -1).reshape(-1, 3)
