"""Outlines around a vertical axis."""

import math

import torch
from shapely import Point, Polygon

from oes.geom.polar import profile_points, directions, profile_normals, radius_at, row_radius_at


def ellipse(a: float = 0.04, b: float = 0.025, count: int = 256) -> torch.Tensor:
    side_K2 = directions(count)
    return 1 / (side_K2 / torch.tensor([a, b])).norm(dim=-1)


def test_radii_are_read_between_directions_all_the_way_round() -> None:
    radius_1K = torch.arange(8.0)[None]
    offset_112 = torch.tensor(
        [[[math.cos(angle), math.sin(angle)]] for angle in (0.5 * math.pi / 4, -math.pi / 8)]
    )
    found = radius_at(radius_1K.expand(2, -1), offset_112)
    torch.testing.assert_close(
        found, torch.tensor([[0.5], [3.5]]), msg="between 0 and 1; between 7 and 0"
    )
    bands_1BK = torch.stack([radius_1K, radius_1K + 10], 1)
    both = row_radius_at(bands_1BK, torch.tensor([[0, 1]]), offset_112[:1].expand(1, 2, 2))
    torch.testing.assert_close(both, torch.tensor([[0.5, 10.5]]))


def test_normals_of_an_ellipse_are_those_of_geometry() -> None:
    radius_K = ellipse()
    points_K2 = profile_points(radius_K)
    true_K2 = points_K2 / torch.tensor([0.04, 0.025]) ** 2
    true_K2 /= true_K2.norm(dim=-1, keepdim=True)
    assert (profile_normals(radius_K) * true_K2).sum(-1).min() > 0.9995
    torch.testing.assert_close(
        profile_normals(torch.zeros(8)), directions(8), msg="of nothing: straight out"
    )


def test_corners_go_around_what_an_outline_holds() -> None:
    assert Polygon(profile_points(ellipse()).numpy()).contains(Point(0.039, 0.0))
