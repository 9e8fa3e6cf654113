"""Encoder of falling objects: height maps of undersides and tops in their current orientation.

The gap from an object's underside down to the table and to other objects decides when and where it
stops, and how it rotates then. The first frame's mask moves with the object (rotations about any
axis), and every step renders it as two height maps, which a CNN reads. The smallest gaps and the
slopes there are given as numbers too.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.dynamics.encoders.crop_encoder import CropConfig, WindowNet, window
from oes.dynamics.graph import GraphFeatures, ObjectState, TipMotion, valid_pairs

NODE_MAPS, EDGE_MAPS = 4, 8  # channels of the window images
GAP_SCALARS = 4  # existence, size and position (2) of the smallest gap
SLOPE_SCALARS = 2  # along x and y
# Length scales of the soft minimum over a gap: for its position, and for the slope around it.
GAP_SOFTNESS_M, SLOPE_SOFTNESS_M = 0.003, 0.006
MAX_SLOPE = 3.0
MIN_COVERAGE = 0.5

Ends = tuple[Tensor, Tensor]  # receivers E and senders E among the O objects


class HeightmapEncoder(nn.Module):
    """Graph features of one step from height maps; the tip is ignored.

    No gradient flows through the objects' poses. O counts the valid objects of all scenes, E the
    pairs of them. Maps O3XY: coverage (0 to 1), coverage x underside, coverage x top (metres from
    the centre).
    """

    NUM_SCALARS = GAP_SCALARS, 4 * (GAP_SCALARS + SLOPE_SCALARS)  # of nodes, of edges
    voxels_P3: Tensor
    window_Q2: Tensor

    def __init__(self, cfg: CropConfig, side: int, voxel_m: float, unit_m: float) -> None:
        """Heights are divided by ``unit_m``."""
        super().__init__()
        self.side, self.crop_m, self.cell_m, self.unit_m = side, side * voxel_m, cfg.cell_m, unit_m
        self.node = WindowNet(NODE_MAPS, cfg, side)
        self.edge = WindowNet(EDGE_MAPS, cfg, side)
        line = (torch.arange(side) + 0.5 - side / 2) * voxel_m
        cells = window(side, cfg.cell_m, (side / 2, side / 2))[:, :2]
        self.register_buffer("voxels_P3", torch.cartesian_prod(line, line, line), persistent=False)
        self.register_buffer("window_Q2", cells, persistent=False)

    def forward(self, mask_BNXYZ: Tensor, state: ObjectState, tip: TipMotion) -> GraphFeatures:
        """Features in the action's axes; ``mask_BNXYZ``: occupancy in world axes at t = 0."""
        valid_BN, pairs_BNN = state.valid_BN, valid_pairs(state.valid_BN)
        with torch.no_grad():
            axes_B33, ends = tip.axes_B33(), _ends(valid_BN, pairs_BNN)
            center_O3 = (state.center_BN3 @ axes_B33)[valid_BN]
            rotation_O33 = (axes_B33.mT[:, None] @ state.rotation_BN33)[valid_BN]
            maps_O3XY = self.maps(mask_BNXYZ[valid_BN], rotation_O33)
            node_O4XY = self.node_windows(maps_O3XY, center_O3)
            edge_E8XY = self.edge_windows(maps_O3XY, center_O3, ends)
            table_gap_OC = self.table_gaps(node_O4XY)
            object_gap_EC = self.object_gaps(edge_E8XY, center_O3, ends)
        edge_BNNC = _scatter(torch.cat([self.edge(edge_E8XY), object_gap_EC], -1), pairs_BNN)
        return GraphFeatures(
            node_BNC=_scatter(torch.cat([self.node(node_O4XY), table_gap_OC], -1), valid_BN),
            agent_BNC=torch.zeros_like(edge_BNNC[:, :, 0]),
            edge_BNNC=edge_BNNC,
        )

    def maps(self, mask_OXYZ: Tensor, rotation_O33: Tensor) -> Tensor:
        """Maps O3XY of masks rotated by ``rotation_O33``."""
        first_OP3 = self.voxels_P3 @ rotation_O33
        grid = (first_OP3 * (2 / self.crop_m)).flip(-1).reshape(-1, *[self.side] * 3, 3)
        now_OXYZ = F.grid_sample(mask_OXYZ[:, None], grid, align_corners=False)[:, 0]
        height_Z = self.voxels_P3[: self.side, 2]
        # Expected height of the first occupied voxel that a vertical ray meets, from either side.
        underside = _first_hit(now_OXYZ) @ height_Z
        top = _first_hit(now_OXYZ.flip(-1)) @ height_Z.flip(0)
        return torch.stack([1 - (1 - now_OXYZ).prod(-1), underside, top], 1)

    def node_windows(self, maps_O3XY: Tensor, center_O3: Tensor) -> Tensor:
        """O4XY: coverage, underside above the table, underside and top from the centre."""
        coverage, underside, top = maps_O3XY.unbind(1)
        above_table = underside + coverage * center_O3[:, 2, None, None]
        return torch.stack([coverage, *(x / self.unit_m for x in (above_table, underside, top))], 1)

    def edge_windows(self, maps_O3XY: Tensor, center_O3: Tensor, ends: Ends) -> Tensor:
        """E8XY, midway between receiver and sender: coverages, undersides, tops and gaps of both.

        Heights are from the receiver's centre. The gaps are from the receiver's underside down to
        the sender's top, and from the sender's underside down to the receiver's top.
        """
        middle_E2 = (center_O3[ends[0], :2] + center_O3[ends[1], :2]) / 2
        resampled = [self._resample(maps_O3XY, center_O3, end_E, middle_E2) for end_E in ends]
        # Axis 1: receiver, sender; flip(1) swaps them.
        coverage, underside, top = torch.stack(resampled, 2).unbind(1)
        rise_E2 = torch.stack([center_O3[end_E, 2] - center_O3[ends[0], 2] for end_E in ends], 1)
        lift = coverage * rise_E2[..., None, None]
        underside, top = underside + lift, top + lift
        # Heights are multiplied by coverage, so each term of a difference needs the other's.
        gap = underside * coverage.flip(1) - top.flip(1) * coverage
        return torch.cat([coverage, *(x / self.unit_m for x in (underside, top, gap))], 1)

    def table_gaps(self, node_O4XY: Tensor) -> Tensor:
        """Smallest gap OC between underside and table, located from the object's centre."""
        coverage, above_table = node_O4XY[:, 0], node_O4XY[:, 1]
        gap = above_table / coverage.clamp(min=MIN_COVERAGE)
        return self._smallest(gap, coverage > MIN_COVERAGE, torch.zeros_like(coverage[:, 0, :2]))

    def object_gaps(self, edge_E8XY: Tensor, center_O3: Tensor, ends: Ends) -> Tensor:
        """Smallest gaps EC of a pair, with either object on top, and the slopes of both surfaces.

        Each gap is located from both centres.
        """
        half_E2 = (center_O3[ends[1], :2] - center_O3[ends[0], :2]) / 2
        coverage, underside, top, gaps = torch.unflatten(edge_E8XY, 1, (4, 2)).unbind(1)
        both = coverage.prod(1)
        exists = both > MIN_COVERAGE**2
        features = []
        for above, below in ((0, 1), (1, 0)):
            gap = gaps[:, above] / both.clamp(min=MIN_COVERAGE**2)
            features += [
                self._smallest(gap, exists, half_E2, -half_E2),
                self._slope(underside[:, above], coverage[:, above], gap, exists),
                self._slope(top[:, below], coverage[:, below], gap, exists),
            ]
        return torch.cat(features, -1)

    def _smallest(self, gap_OXY: Tensor, exists_OXY: Tensor, *offsets_O2: Tensor) -> Tensor:
        """Existence, size and position of the smallest gap, OC; four numbers per offset.

        Positions are relative to a point that lies an offset before the window's centre.
        """
        weight = self._soft_argmin(gap_OXY, exists_OXY, GAP_SOFTNESS_M)
        exists_O1 = exists_OXY.flatten(1).any(-1, keepdim=True).float()
        size_O1 = (weight * gap_OXY.flatten(1)).sum(-1, keepdim=True)
        position_O2, features = weight @ self.window_Q2, []
        for offset_O2 in offsets_O2:
            features += [exists_O1, size_O1, (position_O2 + offset_O2) / self.unit_m * exists_O1]
        return torch.cat(features, -1)

    def _slope(self, surface: Tensor, coverage: Tensor, gap: Tensor, exists: Tensor) -> Tensor:
        """Slopes O2 (rise over run along x and y) of a surface OXY at the smallest gap, else 0."""
        height = surface / coverage.clamp(min=MIN_COVERAGE) * self.unit_m
        is_covered = coverage > MIN_COVERAGE
        slopes = []
        for axis in (1, 2):
            rise = (height.roll(-1, axis) - height.roll(1, axis)) / (2 * self.cell_m)
            # Central differences need both neighbours on the surface.
            is_inside = exists & is_covered.roll(-1, axis) & is_covered.roll(1, axis)
            weight = self._soft_argmin(gap, is_inside, SLOPE_SOFTNESS_M)
            slopes.append((weight * rise.clamp(-MAX_SLOPE, MAX_SLOPE).flatten(1)).sum(-1))
        return torch.stack(slopes, -1)

    def _soft_argmin(self, gap_OXY: Tensor, exists_OXY: Tensor, softness_m: float) -> Tensor:
        """Weights OQ of the cells, high where the gap is small; 0 where nothing exists."""
        near = torch.where(exists_OXY, -gap_OXY * (self.unit_m / softness_m), -torch.inf)
        return near.flatten(1).softmax(-1).nan_to_num()  # NaN: -inf everywhere

    def _resample(self, maps: Tensor, center_O3: Tensor, i_E: Tensor, middle_E2: Tensor) -> Tensor:
        """Maps E3XY of objects ``i_E`` in windows around ``middle_E2``."""
        offset_EQ2 = middle_E2[:, None] + self.window_Q2 - center_O3[i_E, None, :2]
        grid = (offset_EQ2 * (2 / self.crop_m)).flip(-1).reshape(-1, self.side, self.side, 2)
        return F.grid_sample(maps[i_E], grid, align_corners=False)


def _first_hit(occupancy_OXYZ: Tensor) -> Tensor:
    """Probability that each voxel is the first occupied one along +z."""
    clear = torch.cumprod(1 - occupancy_OXYZ, -1)
    return occupancy_OXYZ * torch.cat([torch.ones_like(clear[..., :1]), clear[..., :-1]], -1)


def _ends(valid_BN: Tensor, pairs_BNN: Tensor) -> Ends:
    """Positions among all valid objects of every pair's receiver and sender."""
    position_BN = valid_BN.flatten().cumsum(0).reshape(valid_BN.shape) - 1
    scene_E, receiver_E, sender_E = pairs_BNN.nonzero().unbind(1)
    return position_BN[scene_E, receiver_E], position_BN[scene_E, sender_E]


def _scatter(features_PC: Tensor, mask: Tensor) -> Tensor:
    """Features at the P true places of ``mask``, else 0."""
    zeros = features_PC.new_zeros(*mask.shape, features_PC.shape[-1])
    return zeros.index_put((mask,), features_PC)
