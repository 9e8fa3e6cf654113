"""Messages between the points that matter: of an object's surface, with the rod, with other objects
and the table.

Every point of a surface knows where it lies, which way it faces, how sure it is, how high above the
table it is, how far from the rod's path, and how deep in another object. A small network reads each
point; an object's message is the mean and the greatest of its points'.
"""

import torch
from torch import Tensor, nn

from oes.config import params
from oes.dynamics.graph import GraphFeatures, ObjectState, action_axes, distinct_pairs, mlp
from oes.dynamics.rigid_body.bodies import ContactPhysics
from oes.dynamics.shapes import ObjectShapes, ShapeUncertainty
from oes.geom.polar import directions, normals, radius_in
from oes.objects import LAYERS

OWN, PATH, PAIR = 9, 4, 6  # numbers a point knows: of itself, of the rod's path, of another object
GAPS = 2  # and how far it is above and below that
FAR_M = 0.1
NOWHERE_M = 1e3


@params
class SurfacePoints:
    """Which points are read: every so many directions of ``rows`` (rows of an outline: 0 of all
    heights, 1 of all but the lowest, 2 of the foot, then bands of ``band_m``, upwards), and the
    width of the networks that read them.
    """

    every: int
    rows: tuple[int, ...]
    band_m: float
    width: int
    layers: int

    @property
    def has_heights(self) -> bool:
        """Whether its points lie at heights of their own, so that it matters how far they are above
        or below others.
        """
        return min(self.rows) >= LAYERS


@params
class ContactConfig:
    """The model ``contact``: what its messages see, how objects slide (null where they fall), how
    its draws differ, the time of a step, and whether surfaces are the true ones (an ablation) or as
    perceived.
    """

    skin: SurfacePoints
    physics: ContactPhysics | None
    doubt: ShapeUncertainty
    step_s: float
    gt_surfaces: bool


class PointNet(nn.Module):
    """Points ...PC to a message ...W: a small network a point, pooled by mean and maximum over
    those that are there.
    """

    def __init__(self, inputs: int, cfg: SurfacePoints) -> None:
        super().__init__()
        self.each = mlp(inputs, cfg.width, cfg.layers)
        self.join = mlp(2 * cfg.width, cfg.width, 1)

    def forward(self, points_PC: Tensor, there_P: Tensor) -> Tensor:
        """``there_P``: how likely each point is there, 0 to 1."""
        each_PW = self.each(points_PC) * there_P[..., None]
        mean_W = each_PW.sum(-2) / there_P.sum(-1, keepdim=True).clamp(min=1)
        message_W: Tensor = self.join(torch.cat([mean_W, each_PW.amax(-2)], -1))
        return message_W


class SurfaceEncoder(nn.Module):
    """The readings of one step, in the action's axes. No gradient runs back through where the
    points lie.
    """

    def __init__(self, cfg: SurfacePoints, unit_m: float) -> None:
        super().__init__()
        self.cfg, self.unit_m = cfg, unit_m
        self.own, self.path = PointNet(OWN, cfg), PointNet(OWN + PATH, cfg)
        self.pair = PointNet(OWN + PAIR + GAPS * cfg.has_heights, cfg)

    def forward(
        self, shapes: ObjectShapes, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> GraphFeatures:
        """The tip goes from ``tip_world_B3`` by ``action_B3`` (metres; NaN: there is no robot)."""
        axes_B33 = action_axes(action_B3)
        with torch.no_grad():
            skin_BNP3, normal_BNP3, sure_BNP, there_BNP = self._points(
                shapes, axes_B33, state.turned_BN33
            )
            place_BNP3 = skin_BNP3 + state.center_BN3[:, :, None] @ axes_B33[:, None]
            numbers = [
                skin_BNP3 / self.unit_m,
                normal_BNP3,
                sure_BNP[..., None],
                there_BNP[..., None],
            ]
            own_BNPC = torch.cat([*numbers, place_BNP3[..., 2:] / self.unit_m], -1)
            path_BNPC = self._path(place_BNP3, tip_world_B3, action_B3, axes_B33)
            pair_BNNPC = self._inside(shapes, state, place_BNP3, axes_B33)
        own_BNNPC = own_BNPC[:, :, None].expand(*pair_BNNPC.shape[:-1], OWN)
        there_BNNP = there_BNP[:, :, None].expand(pair_BNNPC.shape[:-1])
        receivers, senders = (
            distinct_pairs(place_BNP3.shape[1], place_BNP3.device).nonzero().unbind(1)
        )
        read_BEPC = torch.cat([own_BNNPC, pair_BNNPC], -1)[:, receivers, senders]
        found_BEC = self.pair(read_BEPC, there_BNNP[:, receivers, senders])
        message_BNNC = found_BEC.new_zeros(*pair_BNNPC.shape[:3], found_BEC.shape[-1])
        message_BNNC[:, receivers, senders] = found_BEC
        path_BNC = self.path(torch.cat([own_BNPC, path_BNPC], -1), there_BNP)
        return GraphFeatures(self.own(own_BNPC, there_BNP), path_BNC, message_BNNC)

    def _points(
        self, shapes: ObjectShapes, axes_B33: Tensor, turned_BN33: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Points and normals BNP3 from the reference points, in the action's axes, scales and
        presences BNP.
        """
        rows, every = list(self.cfg.rows), self.cfg.every
        radius_BNRK = shapes.radius_BNRK[:, :, rows]
        side_K2, facing_BNRK2 = directions(radius_BNRK.shape[-1]), normals(radius_BNRK)
        height_R = torch.tensor([max(row - LAYERS, 0) + 0.5 for row in rows]) * self.cfg.band_m
        flat_BNRK2 = radius_BNRK[..., None] * side_K2
        depth_BN11 = self._foot(shapes)[..., None, None]
        z_BNRK1 = (height_R[:, None] + depth_BN11).expand(radius_BNRK.shape)[..., None]
        points = torch.cat([flat_BNRK2, z_BNRK1], -1)[..., ::every, :].flatten(2, 3)
        facing = torch.cat([facing_BNRK2, torch.zeros_like(z_BNRK1)], -1)[..., ::every, :].flatten(
            2, 3
        )
        now_BN33 = turned_BN33.mT @ axes_B33[:, None]
        sure = shapes.scale_BNRK[:, :, rows, ::every].flatten(2) / self.unit_m
        there = (shapes.presence_BNRK * (shapes.radius_BNRK > 0))[:, :, rows, ::every].flatten(2)
        return points @ now_BN33, facing @ now_BN33, sure, there

    def _foot(self, shapes: ObjectShapes) -> Tensor:
        """The height BN of the lowest band's bottom from the reference point: that of the box where
        heights matter, or else half of the bands that are there, below it.
        """
        if self.cfg.has_heights:
            return -shapes.foot_BN
        there_BNB = (shapes.radius_BNRK[:, :, LAYERS:] > 0).any(-1).float()
        return -there_BNB.sum(-1) * self.cfg.band_m / 2

    def _path(
        self, place_BNP3: Tensor, tip_world_B3: Tensor, action_B3: Tensor, axes_B33: Tensor
    ) -> Tensor:
        """BNP4: from the nearest place on the rod's way to the point (x, y), how far it is, how far
        along that is.
        """
        tip_B2 = (tip_world_B3.nan_to_num(nan=NOWHERE_M)[:, None] @ axes_B33)[:, 0, :2]
        length_B = action_B3[:, :2].norm(dim=-1)[:, None, None]
        x_BNP, y_BNP = (place_BNP3[..., :2] - tip_B2[:, None, None]).unbind(-1)
        along_BNP = x_BNP.clamp(min=0).minimum(length_B)
        away_BNP2 = torch.stack([x_BNP - along_BNP, y_BNP], -1)
        near = [
            away_BNP2.clamp(-FAR_M, FAR_M),
            away_BNP2.norm(dim=-1, keepdim=True).clamp(max=FAR_M),
        ]
        return torch.cat([*near, along_BNP[..., None]], -1) / self.unit_m

    def _inside(
        self, shapes: ObjectShapes, state: ObjectState, place_BNP3: Tensor, axes_B33: Tensor
    ) -> Tensor:
        """BNNP6: of each receiver's points in each sender: from its reference point (3, the
        action's axes), how far within its outline at that height, whether there is any there, and
        the height above its foot; then ``_gaps``, if points have heights.
        """
        num, band_m = place_BNP3.shape[1], self.cfg.band_m
        from_other_BNNP3 = place_BNP3[:, :, None] - (state.center_BN3 @ axes_B33)[:, None, :, None]
        first_BNNP3 = from_other_BNNP3 @ axes_B33.mT[:, None, None] @ state.turned_BN33[:, None]
        height_BNNP = first_BNNP3[..., 2] - self._foot(shapes)[:, None, :, None]
        bands_BNBK = shapes.radius_BNRK[:, :, LAYERS:]
        band_BNNP = (height_BNNP / band_m).floor().long()
        top = bands_BNBK.shape[2] - 1
        is_level_BNNP = (band_BNNP >= 0) & (band_BNNP <= top)
        outline_PK = bands_BNBK[:, None].expand(-1, num, -1, -1, -1).flatten(0, 2)
        place_PQ2 = first_BNNP3[..., :2].flatten(0, 2)
        reach_PQ = radius_in(outline_PK, band_BNNP.clamp(0, top).flatten(0, 2), place_PQ2)
        within_BNNP = reach_PQ.reshape(band_BNNP.shape) - first_BNNP3[..., :2].norm(dim=-1)
        there_BNNP = (is_level_BNNP & (reach_PQ.reshape(band_BNNP.shape) > 0)).float()
        lengths = [from_other_BNNP3, within_BNNP[..., None], height_BNNP[..., None]]
        lengths += [self._gaps(shapes, first_BNNP3, height_BNNP)] if self.cfg.has_heights else []
        near = torch.cat(lengths, -1).clamp(-2 * FAR_M, 2 * FAR_M) / self.unit_m
        return torch.cat([near, there_BNNP[..., None]], -1)

    def _gaps(self, shapes: ObjectShapes, first_BNNP3: Tensor, height_BNNP: Tensor) -> Tensor:
        """BNNP2: how far the bottom of each point's band is above the top of the sender, and its
        top below the bottom of the sender, on the point's vertical (negative: past it); far, where
        there is nothing of the sender there.

        Bands are as tall as ``band_m``, but for the highest of an object, which ends where its box
        does.
        """
        bands_BNBK, band_m = shapes.radius_BNRK[:, :, LAYERS:], self.cfg.band_m
        (num, count), points = bands_BNBK.shape[1:3], height_BNNP.shape[-1]
        outline_PK = bands_BNBK[:, None].expand(-1, num, -1, -1, -1).flatten(0, 2)
        band_PQ = torch.arange(count).repeat_interleave(points).expand(len(outline_PK), -1)
        place_PP2 = first_BNNP3[..., :2].flatten(0, 2)
        reach_PQ = radius_in(outline_PK, band_PQ, place_PP2.repeat(1, count, 1))
        is_over_PQ = reach_PQ > place_PP2.norm(dim=-1).repeat(1, count)
        is_over_BNNBP = is_over_PQ.reshape(*height_BNNP.shape[:3], count, points)
        floor_B1 = torch.arange(count)[:, None] * band_m
        ceiling_BNBP = (floor_B1 + band_m).minimum(shapes.tall_BN[..., None, None])
        top_BNNP = torch.where(is_over_BNNBP, ceiling_BNBP[:, None], -NOWHERE_M).amax(-2)
        bottom_BNNP = torch.where(is_over_BNNBP, floor_B1, NOWHERE_M).amin(-2)
        row_P = torch.tensor(self.cfg.rows).repeat_interleave(points // len(self.cfg.rows)) - LAYERS
        over_BNP = ((row_P + 1) * band_m).minimum(shapes.tall_BN[..., None]) - (
            row_P + 0.5
        ) * band_m
        own_top_BNNP = height_BNNP + over_BNP[:, :, None]
        return torch.stack([height_BNNP - band_m / 2 - top_BNNP, bottom_BNNP - own_top_BNNP], -1)
