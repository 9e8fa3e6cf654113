"""View prediction: the feature map seen from any camera, by compositing it along rays and decoding the image in 2D."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.se3 import transform
from oes.geom.voxels import Grid, sample

NUM_RAY_CHANNELS = 8


@params
class Decoder:
    """One ray per ``stride_px`` x ``stride_px`` pixels, ``num_samples`` samples where it crosses the grid."""

    stride_px: int
    num_samples: int
    channels: int


class ViewDecoder(nn.Module):
    """Channel 0 of the map is a density; the others are composited along each ray, then a 2D net paints the image."""

    def __init__(self, cfg: Decoder, map_channels: int) -> None:
        super().__init__()
        self.cfg = cfg
        width = cfg.channels
        self.first = nn.Conv2d(map_channels - 1 + NUM_RAY_CHANNELS, width, 3, padding=1)
        self.middle = nn.ModuleList(nn.Conv2d(width, width, 3, padding=1) for _ in range(3))
        self.last = nn.Conv2d(width, 3 * cfg.stride_px**2, 3, padding=1)

    def forward(
        self, map_BCXYZ: Tensor, grid: Grid, K_B33: Tensor, world_T_cam_B44: Tensor, size: tuple[int, int]
    ) -> Tensor:
        """RGB BHW3 in [0, 1] as the cameras see it; ``size`` is (height, width) in pixels, divisible by the stride."""
        rays = self._composite(map_BCXYZ, grid, K_B33, world_T_cam_B44, size)
        x = F.relu(self.first(rays.contiguous(memory_format=torch.channels_last)))
        for conv in self.middle:
            x = F.relu(x + conv(x))
        image = F.pixel_shuffle(self.last(x).float(), self.cfg.stride_px).sigmoid()
        return image.movedim(1, -1)

    def _composite(
        self, map_BCXYZ: Tensor, grid: Grid, K_B33: Tensor, world_T_cam_B44: Tensor, size: tuple[int, int]
    ) -> Tensor:
        """Alpha-composited features, opacity, expected distance, ray origin and direction: BChw, one pixel a ray."""
        height, width = size[0] // self.cfg.stride_px, size[1] // self.cfg.stride_px
        origin, direction = _rays(K_B33, world_T_cam_B44, (height, width), self.cfg.stride_px)
        near, far = _crossing(origin, direction, grid)
        steps = (torch.arange(self.cfg.num_samples, device=near.device) + 0.5) / self.cfg.num_samples
        distance = near[..., None] + (far - near)[..., None] * steps
        points = origin[:, None, None] + direction[:, :, None] * distance[..., None]
        values = sample(map_BCXYZ, grid, points.flatten(1, 2)).reshape(*distance.shape, -1)
        length = (far - near)[..., None] / self.cfg.num_samples / grid.voxel_m
        clear = -F.softplus(values[..., 0]) * length
        through = torch.cat([torch.zeros_like(clear[..., :1]), clear.cumsum(-1)], dim=-1).exp()
        weight = through[..., :-1] - through[..., 1:]
        features = (weight[..., None] * values[..., 1:]).sum(-2)
        seen = torch.stack([1 - through[..., -1], (weight * distance).sum(-1)], dim=-1)
        rays = torch.cat([features, seen, origin[:, None].expand_as(direction), direction], dim=-1)
        return rays.transpose(1, 2).reshape(len(rays), -1, height, width)


def _rays(K_B33: Tensor, world_T_cam_B44: Tensor, size: tuple[int, int], stride_px: int) -> tuple[Tensor, Tensor]:
    """World origin B3 and unit directions BP3 of the rays through the centres of stride x stride pixel blocks."""
    rows, columns = (torch.arange(count, device=K_B33.device) * stride_px + stride_px / 2 for count in size)
    v, u = torch.meshgrid(rows, columns, indexing="ij")
    pix = torch.stack([u, v, torch.ones_like(u)], dim=-1).reshape(1, -1, 3)
    rays_cam = pix @ torch.linalg.inv(K_B33).transpose(1, 2)
    origin = world_T_cam_B44[:, :3, 3]
    return origin, F.normalize(transform(world_T_cam_B44, rays_cam) - origin[:, None], dim=-1)


def _crossing(origin_B3: Tensor, direction_BP3: Tensor, grid: Grid) -> tuple[Tensor, Tensor]:
    """Distances BP at which rays enter and leave the grid's box; equal (a chord of no length) where they miss it."""
    low = origin_B3.new_tensor(grid.min_m)
    high = low + origin_B3.new_tensor(grid.size_m)
    safe = torch.where(direction_BP3.abs() < 1e-6, 1e-6, direction_BP3)
    first, second = (low - origin_B3)[:, None] / safe, (high - origin_B3)[:, None] / safe
    near = torch.minimum(first, second).amax(-1).clamp(min=0)
    far = torch.maximum(first, second).amin(-1)
    return near, torch.maximum(near, far)
