"""Fields of density and features, and what rays through them show: volume rendering, without
anything to train.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from oes.geom.se3 import transform
from oes.geom.voxels import Grid, sample

CLEAR_LOGIT = 3.0  # a density of so much less than nothing makes a voxel as good as clear


@dataclass(frozen=True)
class Field:
    """A volume BCXYZ on a grid; channel 0 is a density, the others are what it looks like."""

    volume_BCXYZ: Tensor
    grid: Grid

    def repeated(self, count: int) -> "Field":
        """One scene's field (B = 1) as that of so many scenes."""
        return Field(self.volume_BCXYZ.expand(count, -1, -1, -1, -1), self.grid)


@dataclass(frozen=True)
class Rays:
    """Rays of one image a scene: world origin B3, unit directions BP3."""

    origin_B3: Tensor
    direction_BP3: Tensor


def march(
    field: Field, rays: Rays, chord: tuple[Tensor, Tensor], count: int
) -> tuple[Tensor, Tensor, Tensor]:
    """``count`` samples between two distances BP of each ray: features BPSC, optical thickness BPS,
    distance BPS.
    """
    start, length = chord[0], chord[1] - chord[0]
    steps = (torch.arange(count, device=start.device) + 0.5) / count
    distance = start[..., None] + length[..., None] * steps
    points = rays.origin_B3[:, None, None] + rays.direction_BP3[:, :, None] * distance[..., None]
    values = sample(field.volume_BCXYZ, field.grid, points.flatten(1, 2)).reshape(
        *distance.shape, -1
    )
    thickness = (
        F.softplus(values[..., 0] - CLEAR_LOGIT) * (length / count / field.grid.voxel_m)[..., None]
    )
    return values[..., 1:], thickness, distance


def composite(
    features_BPSC: Tensor, thickness_BPS: Tensor, distance_BPS: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """What is seen along each ray: features BPC, distance BP (both weighted by visibility) and
    opacity BP.
    """
    passed = (
        torch.cat([torch.zeros_like(thickness_BPS[..., :1]), thickness_BPS.cumsum(-1)], dim=-1)
        .neg()
        .exp()
    )
    weight = passed[..., :-1] - passed[..., 1:]
    features = (weight[..., None] * features_BPSC).sum(-2)
    return features, (weight * distance_BPS).sum(-1), 1 - passed[..., -1]


def rays_of(K_B33: Tensor, world_T_cam_B44: Tensor, size: tuple[int, int], stride_px: int) -> Rays:
    """The rays through the centres of stride x stride pixel blocks, row by row; ``size`` counts the
    blocks.
    """
    rows, columns = (
        torch.arange(count, device=K_B33.device) * stride_px + stride_px / 2 for count in size
    )
    v, u = torch.meshgrid(rows, columns, indexing="ij")
    pix = torch.stack([u, v, torch.ones_like(u)], dim=-1).reshape(1, -1, 3)
    rays_cam = pix @ torch.linalg.inv(K_B33).transpose(1, 2)
    origin = world_T_cam_B44[:, :3, 3]
    return Rays(origin, F.normalize(transform(world_T_cam_B44, rays_cam) - origin[:, None], dim=-1))


def ray_box_intersection(rays: Rays, grid: Grid) -> tuple[Tensor, Tensor]:
    """Distances BP at which rays enter and leave the grid's box; equal (a chord of no length) where
    they miss it.
    """
    low = rays.origin_B3.new_tensor(grid.min_m)
    high = low + rays.origin_B3.new_tensor(grid.size_m)
    safe = torch.where(rays.direction_BP3.abs() < 1e-6, 1e-6, rays.direction_BP3)
    first, second = (low - rays.origin_B3)[:, None] / safe, (high - rays.origin_B3)[:, None] / safe
    near = torch.minimum(first, second).amax(-1).clamp(min=0)
    far = torch.maximum(first, second).amin(-1)
    return near, torch.maximum(near, far)
