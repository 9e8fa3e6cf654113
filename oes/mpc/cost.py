"""Cost of a plan: remaining geodesic distance to the goals plus a collision cost."""

import numpy as np
import torch
from torch import Tensor

from oes.config import params
from oes.episode import Bools, Floats
from oes.mpc.geodesic import DistanceField, GeodesicDistance
from oes.mpc.scene import PlanningScene
from oes.mpc.search import Rollouts

SAMPLES_PER_PUSH = 6  # points of each stroke of the rod that are tested for collision


@params
class AvoidConfig:
    """Distance that objects and rod keep from obstacles, and the cost of coming closer."""

    margin_m: float
    collision_cost_m: float


class GoalCost:
    """Mean remaining geodesic distance (metres) of the moved objects to their goals (paper 3.3).

    The moved objects are the first G of a rollout. From the first step at which an object or the
    rod violates the margin of an obstacle, ``collision_cost_m`` is added.
    """

    def __init__(self, scene: PlanningScene, goal_G3: Floats, cfg: AvoidConfig) -> None:
        self.scene, self.cfg = scene, cfg
        points = [shape.points_P2 for shape in scene.obstacles]
        cell_m = max((shape.cell_m for shape in scene.obstacles), default=0.0)
        points_P2 = np.concatenate([np.zeros((0, 2)), *points])
        self.clearance = DistanceField(points_P2, cell_m, scene.half_m)
        circles = [(shape.center_2, shape.radius_m) for shape in scene.obstacles]
        self.moved = [
            (GeodesicDistance(goal[:2], self.clearance, circles, x.radius_m + cfg.margin_m), x)
            for goal, x in zip(goal_G3, scene.moved, strict=True)
        ]

    def __call__(self, rollouts: Rollouts) -> Tensor:
        """Costs ST (metres), infinite from the step at which the rod leaves its workspace."""
        tip_ST2 = rollouts.tip_SI3[:, 1:, :2]
        is_out_ST = (tip_ST2.abs() > self.scene.rod.workspace_m).any(-1).cumsum(1) > 0
        cost_ST = rollouts.cost_ST
        if cost_ST is None:
            cost_ST = self._goal_and_collision_cost(rollouts)
        return cost_ST.masked_fill(is_out_ST, torch.inf)

    def initial(self) -> float:
        """Cost of the current state, without any push."""
        return float(np.mean([distance(shape.center_2) for distance, shape in self.moved]))

    def headings(self) -> Floats:
        """Initial direction G (rad) of each moved object's shortest path to its goal."""
        return np.array([distance.heading(shape.center_2) for distance, shape in self.moved])

    def _goal_and_collision_cost(self, rollouts: Rollouts) -> Tensor:
        count = len(self.moved)
        xy_STG2 = rollouts.position_STN3[:, :, :count, :2].double().numpy()
        remaining = [distance(xy_STG2[:, :, i]) for i, (distance, _) in enumerate(self.moved)]
        cost_ST = np.mean(remaining, axis=0)
        if not self.clearance.is_empty:
            rotation_STG22 = rollouts.rotation_STN33[:, :, :count, :2, :2].double().numpy()
            collides_ST = self._object_collides(xy_STG2, rotation_STG22)
            collides_ST = collides_ST | self._rod_collides(rollouts.tip_SI3)
            # A collision is not undone by later steps, so the penalty persists.
            has_collided_ST = np.maximum.accumulate(collides_ST, axis=1)
            cost_ST = cost_ST + self.cfg.collision_cost_m * has_collided_ST
        return torch.from_numpy(cost_ST)

    def _object_collides(self, xy_STG2: Floats, rotation_STG22: Floats) -> Bools:
        """Margin violations ST after each step or halfway through it."""
        collides = []
        for i, shape in enumerate(self.scene.moved):
            offset_P2 = shape.points_P2 - shape.center_2
            points = offset_P2 @ rotation_STG22[:, :, i].swapaxes(-1, -2)
            after = xy_STG2[:, :, i]
            start = np.broadcast_to(shape.center_2, after[:, :1].shape)
            before = np.concatenate([start, after[:, :-1]], axis=1)
            # The midpoint catches thin obstacles that a step of several cm would jump over.
            for center in ((before + after) / 2, after):
                distance = self.clearance(points + center[:, :, None])
                gap_ST = distance.min(axis=-1) - shape.cell_m / 2
                collides.append(gap_ST < self.cfg.margin_m)
        return np.asarray(np.any(collides, axis=0))

    def _rod_collides(self, tip_SI3: Tensor) -> Bools:
        tip_SI2 = tip_SI3[..., :2].double().numpy()
        fraction_Q1 = np.linspace(0, 1, SAMPLES_PER_PUSH)[:, None]
        stroke_ST2 = tip_SI2[:, 1:] - tip_SI2[:, :-1]
        path_STQ2 = tip_SI2[:, :-1, None] + stroke_ST2[:, :, None] * fraction_Q1
        limit_m = self.scene.rod.radius_m + self.cfg.margin_m
        return np.asarray(self.clearance(path_STQ2).min(axis=-1) < limit_m)
