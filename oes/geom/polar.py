"""Outlines around a vertical axis: a radius (metres) for each of K directions, evenly spaced from
the x axis on.
"""

import math

import torch
from torch import Tensor


def directions(count: int, device: torch.device | None = None) -> Tensor:
    """Unit vectors K2; direction k is at angle 2 pi k / K: mirror images in y and turns by 2 pi / K
    permute them.
    """
    angle_K = torch.arange(count, device=device) * (2 * math.pi / count)
    return torch.stack([angle_K.cos(), angle_K.sin()], -1)


def radius_at(radius_PK: Tensor, offset_PQ2: Tensor) -> Tensor:
    """Radii PQ of outlines towards points given from the axis: linear between directions."""
    band_PQ = torch.zeros(offset_PQ2.shape[:-1], dtype=torch.long, device=offset_PQ2.device)
    return radius_in(radius_PK[:, None], band_PQ, offset_PQ2)


def radius_in(radius_PBK: Tensor, band_PQ: Tensor, offset_PQ2: Tensor) -> Tensor:
    """Radii PQ of stacked outlines towards points, each in the band it is in: linear between
    directions.
    """
    count = radius_PBK.shape[-1]
    place_PQ = torch.atan2(offset_PQ2[..., 1], offset_PQ2[..., 0]) * (count / (2 * math.pi))
    below_PQ = place_PQ.floor()
    first_PQ = below_PQ.long() % count
    flat_PC = radius_PBK.flatten(-2)
    near_PQ = flat_PC.gather(-1, band_PQ * count + first_PQ)
    return near_PQ + (place_PQ - below_PQ) * (
        flat_PC.gather(-1, band_PQ * count + (first_PQ + 1) % count) - near_PQ
    )


def corners(radius_PK: Tensor) -> Tensor:
    """Points PK2 of outlines, from the axis."""
    return radius_PK[..., None] * directions(radius_PK.shape[-1], radius_PK.device)


def normals(radius_PK: Tensor) -> Tensor:
    """Unit normals PK2, outward, at the points of outlines: across the chord between each point's
    neighbours.
    """
    points_PK2 = corners(radius_PK)
    chord_PK2 = points_PK2.roll(-1, -2) - points_PK2.roll(1, -2)
    across_PK2 = torch.stack([chord_PK2[..., 1], -chord_PK2[..., 0]], -1)
    length_PK1 = across_PK2.norm(dim=-1, keepdim=True)
    radial_K2 = directions(radius_PK.shape[-1], radius_PK.device)
    return torch.where(length_PK1 > 1e-6, across_PK2 / length_PK1.clamp(min=1e-6), radial_K2)
