"""What a plan costs: the way that remains to the goals, and touching what shall not be touched."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.config import params
from oes.episode import Floats
from oes.mpc.geodesic import DistanceField, GeodesicDistance
from oes.mpc.sampler import Footprint, Rod
from oes.mpc.search import Rollouts

Bools = NDArray[np.bool_]
SAMPLES_PER_PUSH = 6  # places along each stroke of the rod that are looked at


@params
class AvoidConfig:
    """How obstacles are kept clear of: objects and rod by at least ``margin_m``; coming closer
    costs ``hit_m`` (m).
    """

    margin_m: float
    hit_m: float


@dataclass(frozen=True)
class PlanningScene:
    """Seen from above: the objects to be moved and those to be left alone; the rod and the table's
    half width (m).
    """

    moved: Sequence[Footprint]
    obstacles: Sequence[Footprint]
    rod: Rod
    half_m: float


class GoalCost:
    """Mean over the moved objects (the first of all) of the way that remains to their goals (paper
    3.3: the distance).

    Around obstacles the way is longer than the distance; a plan that touches one, with an object or
    with the rod, costs ``hit_m`` more from that step on.
    """

    def __init__(self, scene: PlanningScene, goal_G3: Floats, cfg: AvoidConfig) -> None:
        self.scene, self.cfg = scene, cfg
        points = [shape.points_P2 for shape in scene.obstacles]
        cell_m = max((shape.cell_m for shape in scene.obstacles), default=0.0)
        self.clearance = DistanceField(
            np.concatenate([np.zeros((0, 2)), *points]), cell_m, scene.half_m
        )
        circles = [(shape.center_2, shape.radius_m) for shape in scene.obstacles]
        self.ways = [
            GeodesicDistance(goal[:2], self.clearance, circles, shape.radius_m + cfg.margin_m)
            for goal, shape in zip(goal_G3, scene.moved, strict=True)
        ]

    def __call__(self, imagined: Rollouts) -> Tensor:
        """Metres, SH; infinite from where the rod would leave its reach."""
        is_out_SH = (imagined.tip_SI3[:, 1:, :2].abs() > self.scene.rod.reach_m).any(-1).cumsum(
            1
        ) > 0
        cost_SH = self._foreseen(imagined) if imagined.cost_SH is None else imagined.cost_SH
        return cost_SH.masked_fill(is_out_SH, torch.inf)

    def _foreseen(self, imagined: Rollouts) -> Tensor:
        count = len(self.ways)
        xy_SHG2 = imagined.position_SHN3[:, :, :count, :2].double().numpy()
        to_go_SH = np.mean([way(xy_SHG2[:, :, i]) for i, way in enumerate(self.ways)], axis=0)
        if not self.clearance.is_empty:
            turned_SHG22 = imagined.turned_SHN33[:, :, :count, :2, :2].double().numpy()
            touches_SH = self._object_touches(xy_SHG2, turned_SHG22) | self._rod_touches(
                imagined.tip_SI3
            )
            to_go_SH = to_go_SH + self.cfg.hit_m * np.maximum.accumulate(touches_SH, axis=1)
        return torch.from_numpy(to_go_SH)

    def at_rest(self) -> float:
        """What it costs to do nothing."""
        return float(
            np.mean(
                [
                    way(shape.center_2)
                    for way, shape in zip(self.ways, self.scene.moved, strict=True)
                ]
            )
        )

    def headings(self) -> Floats:
        """Where (rad) each moved object should set out to."""
        return np.array(
            [
                way.heading(shape.center_2)
                for way, shape in zip(self.ways, self.scene.moved, strict=True)
            ]
        )

    def _object_touches(self, xy_SHG2: Floats, turned_SHG22: Floats) -> Bools:
        """SH: whether an object is too close to an obstacle after a step or halfway through it."""
        touches = []
        for i, shape in enumerate(self.scene.moved):
            points = (shape.points_P2 - shape.center_2) @ turned_SHG22[:, :, i].swapaxes(-1, -2)
            after = xy_SHG2[:, :, i]
            before = np.concatenate(
                [np.broadcast_to(shape.center_2, after[:, :1].shape), after[:, :-1]], axis=1
            )
            for middle in ((before + after) / 2, after):
                gap_SH = self.clearance(points + middle[:, :, None]).min(axis=-1) - shape.cell_m / 2
                touches.append(gap_SH < self.cfg.margin_m)
        return np.asarray(np.any(touches, axis=0))

    def _rod_touches(self, tip_SI3: Tensor) -> Bools:
        tip_SI2 = tip_SI3[..., :2].double().numpy()
        along_L1 = np.linspace(0, 1, SAMPLES_PER_PUSH)[:, None]
        path_SHL2 = (
            tip_SI2[:, :-1, None] + (tip_SI2[:, 1:] - tip_SI2[:, :-1])[:, :, None] * along_L1
        )
        return np.asarray(
            self.clearance(path_SHL2).min(axis=-1) < self.scene.rod.radius_m + self.cfg.margin_m
        )
