"""Shapes in free motion: the undersides and tops of objects as they lie now, as height maps.

What falls comes to rest on what is beneath it: the height of its underside above the table and above the others' tops
decides when and where it is stopped, and how that makes it turn. So the first frame's mask is carried along with the
object, turned as it has turned (about any axis), and seen as two height maps: its underside from below, its top from
above. A window of them is read by convolutions; the place where two surfaces are closest is given as numbers too.
"""

from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.dynamics.graph import ObjectState, Sight, action_axes
from oes.dynamics.slabs import Crop, SlabNet, read_each, window

OWN, PAIR = 4, 8  # channels of the two kinds of window
SPOT = 4  # numbers about the place where two surfaces are closest
RELIEF_OWN, RELIEF_PAIR = SPOT, 4 * SPOT  # how much wider than what the convolutions give
CLOSE_M = 0.003  # what is farther than the closest place by so much counts for less
SOLID = 0.5

Maps = tuple[Tensor, Tensor, Tensor]  # BNXY: covered (0 to 1), covered x underside, covered x top (metres from centre)


class ReliefSight(nn.Module):
    """Readings of one step, in the action's axes; of the tip nothing is read. No gradient runs back through how the
    objects lie."""

    points_P3: Tensor
    window_P2: Tensor

    def __init__(self, cfg: Crop, side: int, voxel_m: float, unit_m: float) -> None:
        """``unit_m`` is the height that counts as 1."""
        super().__init__()
        self.side, self.crop_m, self.unit_m = side, side * voxel_m, unit_m
        self.pair_width = cfg.width + RELIEF_PAIR
        self.own = SlabNet(OWN, cfg, side)
        self.pair = SlabNet(PAIR, cfg, side)
        line = (torch.arange(side) + 0.5 - side / 2) * voxel_m
        self.register_buffer("points_P3", torch.cartesian_prod(line, line, line), persistent=False)
        self.register_buffer("window_P2", window(side, cfg.cell_m, (side / 2, side / 2))[:, :2], persistent=False)

    def forward(self, mask_BNXYZ: Tensor, state: ObjectState, action_B3: Tensor) -> Sight:
        """``mask_BNXYZ``: probabilities at t = 0, centred at the objects, in world axes."""
        with torch.no_grad():
            axes_B33 = action_axes(action_B3)
            center_BN3 = state.center_BN3 @ axes_B33
            maps = self.maps(mask_BNXYZ, axes_B33.mT[:, None] @ state.turned_BN33)
            own_BN4XY, pair_BE8XY = self._own(maps, center_BN3), self._pairs(maps, center_BN3)
            spot_BNC, spots_BEC = self._lowest(own_BN4XY), self._closest(pair_BE8XY, center_BN3)
        own_BNC = torch.cat([read_each(self.own, own_BN4XY), spot_BNC], -1)
        scenes, num = own_BNC.shape[:2]
        pair_BNNC = own_BNC.new_zeros(scenes, num, num, self.pair_width)
        receivers, senders = _ends(center_BN3)
        pair_BNNC[:, receivers, senders] = torch.cat([read_each(self.pair, pair_BE8XY), spots_BEC], -1)
        return Sight(own_BNC, own_BNC.new_zeros(scenes, num, self.pair_width), pair_BNNC)

    def maps(self, mask_BNXYZ: Tensor, turned_BN33: Tensor) -> Maps:
        """Height maps, from each object's centre, of the masks turned by ``turned_BN33``."""
        scenes, num = mask_BNXYZ.shape[:2]
        first_BNP3 = self.points_P3 @ turned_BN33
        grid = (first_BNP3 * (2 / self.crop_m)).flip(-1).reshape(scenes * num, self.side, self.side, self.side, 3)
        now = F.grid_sample(mask_BNXYZ.flatten(0, 1)[:, None], grid, align_corners=False)[:, 0]
        height_Z = self.points_P3[: self.side, 2]
        under, top = _first(now) @ height_Z, _first(now.flip(-1)) @ height_Z.flip(0)
        covered = 1 - (1 - now).prod(-1)
        return cast(Maps, tuple(x.reshape(scenes, num, self.side, self.side) for x in (covered, under, top)))

    def _own(self, maps: Maps, center_BN3: Tensor) -> Tensor:
        """Windows BN4XY: covered; underside above the table; underside and top from the centre."""
        covered, under, top = maps
        above_table = under + covered * center_BN3[..., 2, None, None]
        return torch.stack([covered, *(x / self.unit_m for x in (above_table, under, top))], 2)

    def _pairs(self, maps: Maps, center_BN3: Tensor) -> Tensor:
        """Windows BE8XY midway between receivers and senders: both objects' maps, heights from the receiver's centre;
        the gap from the receiver's underside down to the sender's top, and the other way round."""
        ends = _ends(center_BN3)
        middle_BE2 = (center_BN3[:, ends[0], :2] + center_BN3[:, ends[1], :2]) / 2
        covered, under, top = zip(*(self._look(maps, center_BN3, end, middle_BE2) for end in ends), strict=True)
        lift_BE = (center_BN3[:, ends[1], 2] - center_BN3[:, ends[0], 2])[..., None, None]
        under, top = (under[0], under[1] + covered[1] * lift_BE), (top[0], top[1] + covered[1] * lift_BE)
        gaps = [under[0] * covered[1] - top[1] * covered[0], under[1] * covered[0] - top[0] * covered[1]]
        return torch.stack([*covered, *(x / self.unit_m for x in (*under, *top, *gaps))], 2)

    def _lowest(self, own_BN4XY: Tensor) -> Tensor:
        """Where an object's underside is closest to the table, BNC."""
        covered, above_table = own_BN4XY[:, :, 0], own_BN4XY[:, :, 1]
        return self._spot(
            above_table / covered.clamp(min=SOLID), covered > SOLID, torch.zeros_like(covered[..., 0, :2])
        )

    def _closest(self, pair_BE8XY: Tensor, center_BN3: Tensor) -> Tensor:
        """Where the receiver's underside is closest to the sender's top, and the reverse; each from either centre."""
        ends = _ends(center_BN3)
        half_BE2 = (center_BN3[:, ends[1], :2] - center_BN3[:, ends[0], :2]) / 2
        both = pair_BE8XY[:, :, 0] * pair_BE8XY[:, :, 1]
        gaps = [pair_BE8XY[:, :, channel] / both.clamp(min=SOLID**2) for channel in (PAIR - 2, PAIR - 1)]
        return torch.cat(
            [self._spot(gap, both > SOLID**2, from_BE2) for gap in gaps for from_BE2 in (half_BE2, -half_BE2)], -1
        )

    def _spot(self, gap_BPXY: Tensor, is_there_BPXY: Tensor, offset_BP2: Tensor) -> Tensor:
        """Whether two surfaces face each other at all, how far apart (units), and where from a point that lies
        ``offset_BP2`` before the window's middle (units): BPC."""
        gap, is_there = gap_BPXY.flatten(2), is_there_BPXY.flatten(2)
        near = torch.where(is_there, -gap * (self.unit_m / CLOSE_M), -torch.inf)
        weight = near.softmax(-1).nan_to_num()
        place = weight @ self.window_P2 / self.unit_m + offset_BP2 / self.unit_m
        any_BP1 = is_there.any(-1, keepdim=True).float()
        return torch.cat([any_BP1, (weight * gap).sum(-1, keepdim=True), place * any_BP1], -1)

    def _look(self, maps: Maps, center_BN3: Tensor, end_E: Tensor, middle_BE2: Tensor) -> Maps:
        """The maps of objects ``end_E`` in windows around ``middle_BE2``."""
        away_BEP2 = middle_BE2[:, :, None] + self.window_P2 - center_BN3[:, end_E, None, :2]
        grid = (away_BEP2 * (2 / self.crop_m)).flip(-1).reshape(-1, self.side, self.side, 2)
        images = torch.stack([image[:, end_E] for image in maps], 2).flatten(0, 1)
        seen = F.grid_sample(images, grid, align_corners=False).reshape(*middle_BE2.shape[:2], 3, self.side, self.side)
        return cast(Maps, seen.unbind(2))


def _first(density_PXYZ: Tensor) -> Tensor:
    """How likely each voxel is the first that a ray along +z meets."""
    clear = torch.cumprod(1 - density_PXYZ, -1)
    return density_PXYZ * torch.cat([torch.ones_like(clear[..., :1]), clear[..., :-1]], -1)


def _ends(center_BN3: Tensor) -> tuple[Tensor, Tensor]:
    """Receiver and sender of every pair of different objects."""
    receivers, senders = (~torch.eye(center_BN3.shape[1], dtype=torch.bool, device=center_BN3.device)).nonzero().T
    return receivers, senders
