"""Shapes in free motion: the undersides and tops of objects as they lie now, as height maps.

What falls comes to rest on what is beneath it: the height of its underside above the table and
above the others' tops decides when and where it is stopped, and how that makes it turn. So the
first frame's mask is carried along with the object, turned as it has turned (about any axis), and
seen as two height maps: its underside from below, its top from above. A window of them is read by
convolutions; the place where two surfaces are closest, and how they slope there, is given as
numbers too.
"""

from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.dynamics.encoders.crop_encoder import CropConfig, SlabNet, window
from oes.dynamics.graph import GraphFeatures, ObjectState, action_axes, valid_pairs

OWN, PAIR = 4, 8  # channels of the two kinds of window
SPOT = 4  # numbers about the place where two surfaces are closest
SLOPES = 2  # of a surface there, along x and along y
HEIGHTMAP_NODE_CHANNELS, HEIGHTMAP_EDGE_CHANNELS = (
    SPOT,
    4 * (SPOT + SLOPES),
)  # how much wider than what the convolutions give
CLOSE_M, AROUND_M = (
    0.003,
    0.006,
)  # what is farther than the closest place by so much counts for less: its place, slope
STEEP = 3.0
SOLID = 0.5

Ends = tuple[Tensor, Tensor]
HeightMaps = tuple[
    Tensor, Tensor, Tensor
]  # PXY: covered (0 to 1), covered x underside, covered x top (metres from centre)


class HeightmapEncoder(nn.Module):
    """Readings of one step, in the action's axes; of the tip nothing is read. No gradient runs back
    through how the objects lie. P counts the objects that exist in all scenes, Q the pairs of them
    (receiver, sender).
    """

    points_V3: Tensor
    window_W2: Tensor

    def __init__(self, cfg: CropConfig, side: int, voxel_m: float, unit_m: float) -> None:
        """``unit_m`` is the height that counts as 1."""
        super().__init__()
        self.side, self.crop_m, self.cell_m, self.unit_m = side, side * voxel_m, cfg.cell_m, unit_m
        self.own = SlabNet(OWN, cfg, side)
        self.pair = SlabNet(PAIR, cfg, side)
        line = (torch.arange(side) + 0.5 - side / 2) * voxel_m
        self.register_buffer("points_V3", torch.cartesian_prod(line, line, line), persistent=False)
        self.register_buffer(
            "window_W2", window(side, cfg.cell_m, (side / 2, side / 2))[:, :2], persistent=False
        )

    def forward(self, mask_BNXYZ: Tensor, state: ObjectState, action_B3: Tensor) -> GraphFeatures:
        """``mask_BNXYZ``: probabilities at t = 0, centred at the objects, in world axes."""
        valid_BN, both_BNN = state.valid_BN, valid_pairs(state.valid_BN)
        with torch.no_grad():
            axes_B33 = action_axes(action_B3)
            center_P3 = (state.center_BN3 @ axes_B33)[valid_BN]
            maps = self.maps(
                mask_BNXYZ[valid_BN], (axes_B33.mT[:, None] @ state.turned_BN33)[valid_BN]
            )
            ends = _ends(valid_BN, both_BNN)
            own_P4XY, pair_Q8XY = (
                self.own_windows(maps, center_P3),
                self.pair_windows(maps, center_P3, ends),
            )
            lowest_PC, closest_QC = self.lowest(own_P4XY), self.closest(pair_Q8XY, center_P3, ends)
        own_PC = torch.cat([self.own(own_P4XY), lowest_PC], -1)
        pair_QC = torch.cat([self.pair(pair_Q8XY), closest_QC], -1)
        own_BNC = own_PC.new_zeros(*valid_BN.shape, own_PC.shape[-1]).index_put((valid_BN,), own_PC)
        pair_BNNC = pair_QC.new_zeros(*both_BNN.shape, pair_QC.shape[-1]).index_put(
            (both_BNN,), pair_QC
        )
        return GraphFeatures(own_BNC, torch.zeros_like(pair_BNNC[:, :, 0]), pair_BNNC)

    def maps(self, mask_PXYZ: Tensor, turned_P33: Tensor) -> HeightMaps:
        """Height maps, from each object's centre, of the masks turned by ``turned_P33``."""
        first_PV3 = self.points_V3 @ turned_P33
        grid = (
            (first_PV3 * (2 / self.crop_m)).flip(-1).reshape(-1, self.side, self.side, self.side, 3)
        )
        now_PXYZ = F.grid_sample(mask_PXYZ[:, None], grid, align_corners=False)[:, 0]
        height_Z = self.points_V3[: self.side, 2]
        under, top = _first(now_PXYZ) @ height_Z, _first(now_PXYZ.flip(-1)) @ height_Z.flip(0)
        return 1 - (1 - now_PXYZ).prod(-1), under, top

    def own_windows(self, maps: HeightMaps, center_P3: Tensor) -> Tensor:
        """P4XY: covered; underside above the table; underside and top from the centre."""
        covered, under, top = maps
        above_table = under + covered * center_P3[:, 2, None, None]
        return torch.stack([covered, *(x / self.unit_m for x in (above_table, under, top))], 1)

    def pair_windows(self, maps: HeightMaps, center_P3: Tensor, ends: Ends) -> Tensor:
        """Q8XY, midway between receivers and senders: both objects' maps, heights from the
        receiver's centre; the gap from the receiver's underside down to the sender's top, and the
        other way round.
        """
        middle_Q2 = (center_P3[ends[0], :2] + center_P3[ends[1], :2]) / 2
        maps_P3XY = torch.stack(maps, 1)
        covered, under, top = zip(
            *(self._look(maps_P3XY, center_P3, end, middle_Q2) for end in ends), strict=True
        )
        lift_Q = (center_P3[ends[1], 2] - center_P3[ends[0], 2])[:, None, None]
        under, top = (
            (under[0], under[1] + covered[1] * lift_Q),
            (top[0], top[1] + covered[1] * lift_Q),
        )
        gaps = [
            under[0] * covered[1] - top[1] * covered[0],
            under[1] * covered[0] - top[0] * covered[1],
        ]
        return torch.stack([*covered, *(x / self.unit_m for x in (*under, *top, *gaps))], 1)

    def lowest(self, own_P4XY: Tensor) -> Tensor:
        """Where an object's underside is closest to the table, PC, from its centre."""
        covered, above_table = own_P4XY[:, 0], own_P4XY[:, 1]
        gap = above_table / covered.clamp(min=SOLID)
        return self._spots(gap, covered > SOLID, torch.zeros_like(covered[:, 0, :2]))

    def closest(self, pair_Q8XY: Tensor, center_P3: Tensor, ends: Ends) -> Tensor:
        """Where the receiver's underside is closest to the sender's top, and the reverse, from both
        centres, and how those two surfaces slope there: QC.
        """
        half_Q2 = (center_P3[ends[1], :2] - center_P3[ends[0], :2]) / 2
        covered, under, top, gaps = pair_Q8XY.reshape(-1, 4, 2, self.side, self.side).unbind(1)
        both = covered.prod(1)
        is_there = both > SOLID**2
        found = []
        for above, below in ((0, 1), (1, 0)):
            gap = gaps[:, above] / both.clamp(min=SOLID**2)
            found.append(self._spots(gap, is_there, half_Q2, -half_Q2))
            found += [
                self._slope(surface[:, end], covered[:, end], gap, is_there)
                for surface, end in ((under, above), (top, below))
            ]
        return torch.cat(found, -1)

    def _spots(self, gap_PXY: Tensor, is_there_PXY: Tensor, *offsets_P2: Tensor) -> Tensor:
        """Whether two surfaces face each other at all, how far apart (units), and where from a
        point that lies an offset before the window's middle (units): PC, such numbers for each of
        ``offsets_P2``.
        """
        gap, is_there = gap_PXY.flatten(1), is_there_PXY.flatten(1)
        near = torch.where(is_there, -gap * (self.unit_m / CLOSE_M), -torch.inf)
        weight = near.softmax(-1).nan_to_num()
        any_P1 = is_there.any(-1, keepdim=True).float()
        closest_P1, place_P2 = (weight * gap).sum(-1, keepdim=True), weight @ self.window_W2
        spots = [
            (any_P1, closest_P1, (place_P2 + offset_P2) / self.unit_m * any_P1)
            for offset_P2 in offsets_P2
        ]
        return torch.cat([number for spot in spots for number in spot], -1)

    def _slope(
        self, surface_PXY: Tensor, covered_PXY: Tensor, gap_PXY: Tensor, is_there_PXY: Tensor
    ) -> Tensor:
        """Slopes P2 (rise over run, along x and y) of a surface around where a gap is smallest; 0
        where none is.
        """
        height = surface_PXY / covered_PXY.clamp(min=SOLID) * self.unit_m
        solid = covered_PXY > SOLID
        slopes = []
        for axis in (1, 2):
            rise = (height.roll(-1, axis) - height.roll(1, axis)) / (2 * self.cell_m)
            whole = is_there_PXY & solid.roll(-1, axis) & solid.roll(1, axis)
            near = torch.where(whole, -gap_PXY * (self.unit_m / AROUND_M), -torch.inf).flatten(1)
            weight = near.softmax(-1).nan_to_num()
            slopes.append((weight * rise.clamp(-STEEP, STEEP).flatten(1)).sum(-1))
        return torch.stack(slopes, -1)

    def _look(
        self, maps_P3XY: Tensor, center_P3: Tensor, end_Q: Tensor, middle_Q2: Tensor
    ) -> HeightMaps:
        """The maps of objects ``end_Q`` in windows around ``middle_Q2``."""
        away_QW2 = middle_Q2[:, None] + self.window_W2 - center_P3[end_Q, None, :2]
        grid = (away_QW2 * (2 / self.crop_m)).flip(-1).reshape(-1, self.side, self.side, 2)
        seen = F.grid_sample(maps_P3XY[end_Q], grid, align_corners=False)
        return cast(HeightMaps, seen.unbind(1))


def _first(density_PXYZ: Tensor) -> Tensor:
    """How likely each voxel is the first that a ray along +z meets."""
    clear = torch.cumprod(1 - density_PXYZ, -1)
    return density_PXYZ * torch.cat([torch.ones_like(clear[..., :1]), clear[..., :-1]], -1)


def _ends(valid_BN: Tensor, both_BNN: Tensor) -> Ends:
    """The numbers among all objects, Q each, of every pair's receiver and sender."""
    number_BN = valid_BN.flatten().cumsum(0).reshape(valid_BN.shape) - 1
    scene_Q, receiver_Q, sender_Q = both_BNN.nonzero().unbind(1)
    return number_BN[scene_Q, receiver_Q], number_BN[scene_Q, sender_Q]
