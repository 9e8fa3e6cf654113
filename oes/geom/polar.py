"""Radial profiles: a radius (metres) for each of D directions around a vertical axis.

Direction d has the angle 2 pi d / D from the x axis, so that mirror images in y and rotations by
2 pi / D permute the directions.
"""

import math

import torch
from torch import Tensor


def directions(count: int, device: torch.device | None = None) -> Tensor:
    """Unit vectors D2 of ``count`` directions."""
    angle_D = torch.arange(count, device=device) * (2 * math.pi / count)
    return torch.stack([angle_D.cos(), angle_D.sin()], -1)


def radius_at(radius_PRD: Tensor, row_PQ: Tensor, offset_PQ2: Tensor) -> Tensor:
    """Radii PQ towards points given from the axis, each in one row of stacked profiles.

    They are interpolated linearly between directions.
    """
    count = radius_PRD.shape[-1]
    angle_PQ = torch.atan2(offset_PQ2[..., 1], offset_PQ2[..., 0])
    position_PQ = angle_PQ * (count / (2 * math.pi))
    below_PQ = position_PQ.floor()
    first_PQ = below_PQ.long() % count
    # One flat gather per neighbour; indexing rows first would copy a whole profile per point.
    flat_PC, start_PQ = radius_PRD.flatten(-2), row_PQ * count
    near_PQ = flat_PC.gather(-1, start_PQ + first_PQ)
    next_PQ = flat_PC.gather(-1, start_PQ + (first_PQ + 1) % count)
    return near_PQ + (position_PQ - below_PQ) * (next_PQ - near_PQ)


def profile_points(radius_PD: Tensor) -> Tensor:
    """Points PD2 of profiles, from the axis."""
    return radius_PD[..., None] * directions(radius_PD.shape[-1], radius_PD.device)


def profile_normals(radius_PD: Tensor) -> Tensor:
    """Outward unit normals PD2: perpendicular to the chord between a point's neighbours."""
    points_PD2 = profile_points(radius_PD)
    chord_PD2 = points_PD2.roll(-1, -2) - points_PD2.roll(1, -2)
    normal_PD2 = torch.stack([chord_PD2[..., 1], -chord_PD2[..., 0]], -1)
    length_PD1 = normal_PD2.norm(dim=-1, keepdim=True)
    # Empty stretches (radius 0) have no chord: take the radial direction.
    radial_D2 = directions(radius_PD.shape[-1], radius_PD.device)
    return torch.where(length_PD1 > 1e-6, normal_PD2 / length_PD1.clamp(min=1e-6), radial_D2)
