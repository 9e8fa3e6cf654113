"""Volume rendering of density and feature fields along rays, without trained parameters."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from oes.geom.se3 import transform
from oes.geom.voxels import Grid, sample

DENSITY_SHIFT = 3.0  # softplus(0 - shift) is almost 0: a density logit of 0 is free space


@dataclass(frozen=True)
class Field:
    """A volume BCXYZ on a grid: channel 0 is a density logit, the others are appearance."""

    volume_BCXYZ: Tensor
    grid: Grid

    def repeated(self, count: int) -> "Field":
        """The field of one scene (B = 1), repeated along the batch."""
        return Field(self.volume_BCXYZ.expand(count, -1, -1, -1, -1), self.grid)


@dataclass(frozen=True)
class Rays:
    """P rays of one camera for each scene: origin B3 and unit directions BP3, in the world."""

    origin_B3: Tensor
    direction_BP3: Tensor


def sample_along_rays(
    field: Field, rays: Rays, near_far: tuple[Tensor, Tensor], num_samples: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Uniform samples between two distances BP of each ray.

    Returns features BPQC, optical thickness BPQ and distance BPQ.
    """
    start, length = near_far[0], near_far[1] - near_far[0]
    # Midpoints of equal intervals: the same samples in training and inference, without jitter.
    steps = (torch.arange(num_samples, device=start.device) + 0.5) / num_samples
    distance = start[..., None] + length[..., None] * steps
    points = rays.origin_B3[:, None, None] + rays.direction_BP3[:, :, None] * distance[..., None]
    values = sample(field.volume_BCXYZ, field.grid, points.flatten(1, 2))
    values = values.reshape(*distance.shape, -1)
    # Density is per voxel, not per metre, so that its logits do not depend on the voxel size.
    interval_voxels = length / num_samples / field.grid.voxel_m
    thickness = F.softplus(values[..., 0] - DENSITY_SHIFT) * interval_voxels[..., None]
    return values[..., 1:], thickness, distance


def alpha_composite(
    features_BPQC: Tensor, thickness_BPQ: Tensor, distance_BPQ: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Features BPC and distance BP, weighted by visibility, and opacity BP of each ray.

    Quadrature of the volume rendering integral (NeRF, Mildenhall et al. 2020, equation 3).
    """
    start = torch.zeros_like(thickness_BPQ[..., :1])
    transmittance = torch.cat([start, thickness_BPQ.cumsum(-1)], dim=-1).neg().exp()
    # Differences of transmittance are exact weights: they sum to the opacity by construction.
    weight = transmittance[..., :-1] - transmittance[..., 1:]
    features = (weight[..., None] * features_BPQC).sum(-2)
    return features, (weight * distance_BPQ).sum(-1), 1 - transmittance[..., -1]


def camera_rays(
    K_B33: Tensor, world_T_cam_B44: Tensor, size: tuple[int, int], stride_px: int
) -> Rays:
    """Rays through the centres of stride x stride pixel blocks, row by row.

    ``size``: (rows, columns) of blocks.
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
    """Distances BP at which rays enter and leave the grid's box; equal for a ray that misses it."""
    low = rays.origin_B3.new_tensor(grid.min_m)
    high = low + rays.origin_B3.new_tensor(grid.size_m)
    # The slab method divides by the direction: components near 0 would give 0 / 0.
    safe = torch.where(rays.direction_BP3.abs() < 1e-6, 1e-6, rays.direction_BP3)
    first, second = (low - rays.origin_B3)[:, None] / safe, (high - rays.origin_B3)[:, None] / safe
    # A camera inside the box starts at distance 0, not behind itself.
    near = torch.minimum(first, second).amax(-1).clamp(min=0)
    far = torch.maximum(first, second).amin(-1)
    return near, torch.maximum(near, far)
