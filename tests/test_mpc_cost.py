"""Geodesic distances and plan costs against hand-computed geometry."""

import numpy as np
import pytest
import torch

from oes.mpc.cost import AvoidConfig, GoalCost
from oes.mpc.geodesic import DistanceField, GeodesicDistance
from oes.mpc.scene import Footprint, PlanningScene, Rod
from oes.mpc.search import Rollouts

ROD = Rod(radius_m=0.008, tip_height_m=0.02, workspace_m=0.26)
AVOID = AvoidConfig(margin_m=0.01, collision_cost_m=1.0)


def _disc(center: tuple[float, float], radius_m: float) -> Footprint:
    line = np.arange(-radius_m, radius_m + 1e-9, 0.005)
    points = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    return Footprint(
        np.array(center), points[np.linalg.norm(points, axis=1) <= radius_m] + center, 0.005
    )


def _clearance(*shapes: Footprint) -> DistanceField:
    return DistanceField(
        np.concatenate([np.zeros((0, 2)), *(shape.points_P2 for shape in shapes)]), 0.005, 0.3
    )


def test_clearance_is_the_distance_from_the_nearest_obstacle() -> None:
    clearance = _clearance(_disc((0.1, 0.0), 0.04), _disc((-0.2, 0.0), 0.02))
    places = np.array([[0.0, 0.0], [0.1, 0.2], [-0.1, 0.0]])
    assert clearance(places) == pytest.approx([0.06, 0.16, 0.08], abs=0.006)
    assert clearance(np.array([[0.1, 0.0]])) < 0
    assert np.isinf(_clearance()(places)).all()


def test_a_path_without_obstacles_is_straight() -> None:
    distance = GeodesicDistance(np.array([0.1, 0.0]), _clearance(), [], 0.03)
    assert distance(np.array([[0.1, 0.2], [-0.2, 0.0]])) == pytest.approx([0.2, 0.3])
    assert distance.heading(np.array([0.0, 0.1])) == pytest.approx(-np.pi / 4)


def test_a_path_around_a_disc_follows_its_tangents() -> None:
    """Between (-0.2, 0) and (0.2, 0) around a circle of 0.09 m: two tangents and an arc."""
    disc = _disc((0.0, 0.0), 0.06)
    distance = GeodesicDistance(
        np.array([0.2, 0.0]), _clearance(disc), [(disc.center_2, disc.radius_m)], 0.03
    )
    radius, reach = 0.09, 0.2
    tangents = 2 * np.sqrt(reach**2 - radius**2) + 2 * radius * np.arcsin(radius / reach)
    assert distance(np.array([-0.2, 0.0])) == pytest.approx(tangents, rel=0.06)
    assert distance(np.array([-0.2, 0.0])) > tangents
    assert abs(distance.heading(np.array([-0.2, 0.01]))) == pytest.approx(
        np.arcsin(radius / reach), abs=0.15
    )
    assert distance(np.array([0.1, 0.2])) == pytest.approx(np.hypot(0.1, 0.2)), (
        "an unobstructed straight path"
    )
    assert np.isfinite(distance(np.zeros(2))), "even from within the obstacle"


def _rollouts(tips: list[list[float]], positions: list[list[float]]) -> Rollouts:
    """One plan of one object and an obstacle that stays, all at height 0."""
    tip, moved = (torch.tensor([[*xy, 0.0] for xy in places]) for places in (tips, positions))
    position = torch.stack([moved, torch.zeros_like(moved)], 1)
    return Rollouts(tip[None], position[None], torch.eye(3).expand(1, len(moved), 2, 3, 3))


def _cost() -> GoalCost:
    scene = PlanningScene([_disc((-0.15, 0.0), 0.03)], [_disc((0.0, 0.0), 0.04)], ROD, 0.3)
    return GoalCost(scene, np.array([[0.2, 0.0, 0.0]]), AVOID)


def test_cost_is_the_remaining_geodesic_distance() -> None:
    cost = _cost()
    clear = cost(
        _rollouts([[-0.15, -0.05], [-0.15, 0.0], [-0.15, 0.05]], [[-0.15, 0.05], [-0.15, 0.1]])
    )
    assert clear.shape == (1, 2) and (clear < 0.5).all()
    assert clear[0, 0] == pytest.approx(cost.initial(), abs=0.05) and cost.initial() > 0.36


def test_a_collision_of_object_or_rod_is_penalized_from_then_on() -> None:
    tips = [[-0.2, 0.0], [-0.15, 0.0], [-0.2, 0.1]]
    into = _cost()(_rollouts(tips, [[-0.06, 0.0], [-0.15, 0.1]]))
    assert (into > 1).all(), "a collision persists"
    through = _cost()(_rollouts(tips, [[-0.15, 0.0], [0.15, 0.0]]))
    assert through[0, 0] < 1 < through[0, 1], "halfway through a step counts too"
    by_rod = _cost()(_rollouts([[-0.1, 0.0], [0.1, 0.0]], [[-0.15, 0.0]]))
    assert by_rod[0, 0] > 1


def test_leaving_the_workspace_costs_infinity() -> None:
    out = _cost()(
        _rollouts([[-0.2, 0.0], [-0.25, 0.0], [-0.3, 0.0], [-0.2, 0.0]], [[-0.15, 0.0]] * 3)
    )
    assert torch.isfinite(out[0, 0]) and torch.isinf(out[0, 1:]).all()


def test_a_footprint_rotates_with_its_object() -> None:
    """A bar 20 cm long beside the obstacle touches it once it has turned."""
    line = np.arange(-0.1, 0.1, 0.005)
    bar = Footprint(np.array([-0.1, 0.0]), np.stack([np.full_like(line, -0.1), line], 1), 0.005)
    cost = GoalCost(
        PlanningScene([bar], [_disc((0.0, 0.0), 0.04)], ROD, 0.3),
        np.array([[0.2, 0.0, 0.0]]),
        AVOID,
    )
    still = _rollouts([[-0.25, 0.2], [-0.25, 0.2]], [[-0.1, 0.0]])
    quarter = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]).expand(1, 1, 2, 3, 3)
    turned = cost(Rollouts(still.tip_SI3, still.position_STN3, quarter))
    assert turned[0, 0] - cost(still)[0, 0] == pytest.approx(AVOID.collision_cost_m)
