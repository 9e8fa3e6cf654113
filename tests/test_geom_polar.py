"""Radial profiles around a vertical axis."""

import math

import torch
from shapely import Point, Polygon

from oes.geom.polar import directions, profile_normals, profile_points, radius_at


def ellipse(a: float = 0.04, b: float = 0.025, count: int = 256) -> torch.Tensor:
    side_D2 = directions(count)
    return 1 / (side_D2 / torch.tensor([a, b])).norm(dim=-1)


def test_radii_are_interpolated_between_directions_across_the_wrap() -> None:
    radius_1D = torch.arange(8.0)[None]
    offset_112 = torch.tensor(
        [[[math.cos(angle), math.sin(angle)]] for angle in (0.5 * math.pi / 4, -math.pi / 8)]
    )
    lowest_21 = torch.zeros(2, 1, dtype=torch.long)
    found = radius_at(radius_1D.expand(2, 1, -1), lowest_21, offset_112)
    torch.testing.assert_close(
        found, torch.tensor([[0.5], [3.5]]), msg="between 0 and 1; between 7 and 0"
    )
    rows_1RD = torch.stack([radius_1D, radius_1D + 10], 1)
    both = radius_at(rows_1RD, torch.tensor([[0, 1]]), offset_112[:1].expand(1, 2, 2))
    torch.testing.assert_close(both, torch.tensor([[0.5, 10.5]]))


def test_normals_of_an_ellipse_match_the_analytic_ones() -> None:
    radius_D = ellipse()
    points_D2 = profile_points(radius_D)
    true_D2 = points_D2 / torch.tensor([0.04, 0.025]) ** 2
    true_D2 /= true_D2.norm(dim=-1, keepdim=True)
    assert (profile_normals(radius_D) * true_D2).sum(-1).min() > 0.9995
    torch.testing.assert_close(
        profile_normals(torch.zeros(8)), directions(8), msg="an empty profile has radial normals"
    )


def test_profile_points_enclose_the_profile() -> None:
    assert Polygon(profile_points(ellipse()).numpy()).contains(Point(0.039, 0.0))
