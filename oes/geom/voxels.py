"""Voxel grids: centres, trilinear sampling, crops, voxelization, and 2x2x2 blocks.

Volumes are tensors ...XYZ. Voxel i of an axis covers [min + i*voxel, min + (i+1)*voxel) and its
value stands at its centre (``align_corners=False``): the outermost half voxel blends into the zeros
outside.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from oes.config import params


@params
class Grid:
    """Axis-aligned grid of cubic voxels: lowest corner (metres), voxel counts, voxel side."""

    min_m: tuple[float, float, float]
    shape: tuple[int, int, int]
    voxel_m: float

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Extent along x, y, z."""
        x, y, z = self.shape
        return x * self.voxel_m, y * self.voxel_m, z * self.voxel_m

    def halved(self) -> "Grid":
        """The same extent at half the resolution. Raises ValueError for an odd voxel count."""
        x, y, z = self.shape
        if x % 2 or y % 2 or z % 2:
            raise ValueError(f"grid {self.shape} cannot be halved: every count must be even")
        return Grid(min_m=self.min_m, shape=(x // 2, y // 2, z // 2), voxel_m=self.voxel_m * 2)


def cube(count: int, voxel_m: float) -> Grid:
    """Grid of count^3 voxels centred at the origin: the frame of an object crop."""
    low = -count * voxel_m / 2
    return Grid(min_m=(low, low, low), shape=(count, count, count), voxel_m=voxel_m)


def centers(grid: Grid, device: torch.device | None = None) -> Tensor:
    """Centres XYZ3 of all voxels, metres."""
    axes = [
        low + (torch.arange(count, device=device) + 0.5) * grid.voxel_m
        for low, count in zip(grid.min_m, grid.shape, strict=True)
    ]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)


def sample(volume_BCXYZ: Tensor, grid: Grid, points_BP3: Tensor) -> Tensor:
    """Trilinear values BPC at points in the grid's frame; zero outside."""
    assert volume_BCXYZ.shape[2:] == grid.shape, (volume_BCXYZ.shape, grid.shape)
    low, size = points_BP3.new_tensor(grid.min_m), points_BP3.new_tensor(grid.size_m)
    # grid_sample wants the last axis first, hence the flip.
    unit = ((points_BP3 - low) / size * 2 - 1).flip(-1)[:, :, None, None]
    values = F.grid_sample(volume_BCXYZ, unit, padding_mode="zeros", align_corners=False)
    return values[..., 0, 0].transpose(1, 2)


def crop(volume_BCXYZ: Tensor, grid: Grid, centers_BN3: Tensor, window: Grid) -> Tensor:
    """Windows BNCXYZ, resampled with the origin of ``window`` at each centre."""
    batch, count = centers_BN3.shape[:2]
    offsets = centers(window, centers_BN3.device).reshape(-1, 3)
    points = centers_BN3[:, :, None] + offsets
    values = sample(volume_BCXYZ, grid, points.reshape(batch, -1, 3))
    return values.reshape(batch, count, *window.shape, -1).movedim(-1, 2)


def voxelize(points_BP3: Tensor, grid: Grid) -> Tensor:
    """Occupancy BXYZ (bool) of points in the grid's frame; NaN and points outside are dropped."""
    batch, (x, y, z) = len(points_BP3), grid.shape
    cells = ((points_BP3 - points_BP3.new_tensor(grid.min_m)) / grid.voxel_m).floor()
    counts = torch.tensor(grid.shape, device=points_BP3.device)
    is_inside = ((cells >= 0) & (cells < counts)).all(-1)
    cells = torch.where(is_inside[..., None], cells, 0).long()
    flat = (cells[..., 0] * y + cells[..., 1]) * z + cells[..., 2]
    # Dropped points go to one extra cell, which is cut off: no ragged indexing.
    flat = torch.where(is_inside, flat, x * y * z)
    filled = torch.zeros(batch, x * y * z + 1, dtype=torch.bool, device=points_BP3.device)
    return filled.scatter_(1, flat, True)[:, :-1].reshape(batch, x, y, z)


def fold_order(points_XYZ3: Tensor) -> Tensor:
    """A field XYZ3 with contiguous 2x2x2 blocks, (X/2)(Y/2)(Z/2)83: the order ``unfold`` undoes."""
    x, y, z, channels = points_XYZ3.shape
    split = points_XYZ3.reshape(x // 2, 2, y // 2, 2, z // 2, 2, channels)
    blocks = split.permute(0, 2, 4, 1, 3, 5, 6)
    return blocks.reshape(x // 2, y // 2, z // 2, 8, channels)


def unfold(blocks_BCXYZ: Tensor) -> Tensor:
    """Depth to space: 8C channels of a coarse volume become C channels of a B C 2X 2Y 2Z volume."""
    batch, channels, x, y, z = blocks_BCXYZ.shape
    parts = blocks_BCXYZ.movedim(1, -1).reshape(batch, x, y, z, 2, 2, 2, channels // 8)
    fine = parts.permute(0, 1, 4, 2, 5, 3, 6, 7)
    return fine.reshape(batch, 2 * x, 2 * y, 2 * z, channels // 8).movedim(-1, 1)
