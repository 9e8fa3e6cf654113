"""Voxel grids in the world: where voxels lie, sampling and cropping volumes, voxelising points,
folding 2x2x2 blocks.

Volumes are tensors ...XYZ. Voxel i of an axis covers [min + i*voxel, min + (i+1)*voxel) and its
value stands at its centre, so the outermost half voxel of a grid blends into the zeros outside
(align_corners=False throughout).
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from oes.config import params


@params
class Grid:
    """An axis-aligned grid of cubic voxels: its lowest corner in world metres, its voxels along x,
    y, z, their side.
    """

    min_m: tuple[float, float, float]
    shape: tuple[int, int, int]
    voxel_m: float

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Extent along x, y, z."""
        x, y, z = self.shape
        return x * self.voxel_m, y * self.voxel_m, z * self.voxel_m

    def halved(self) -> "Grid":
        """The same extent in voxels of twice the side. Raises ValueError where an axis has an odd
        count.
        """
        x, y, z = self.shape
        if x % 2 or y % 2 or z % 2:
            raise ValueError(
                f"grid of shape {self.shape} cannot be halved: every axis needs an even count"
            )
        return Grid(min_m=self.min_m, shape=(x // 2, y // 2, z // 2), voxel_m=self.voxel_m * 2)


def cube(count: int, voxel_m: float) -> Grid:
    """A grid of count^3 voxels centred at the origin: the frame of an object crop."""
    low = -count * voxel_m / 2
    return Grid(min_m=(low, low, low), shape=(count, count, count), voxel_m=voxel_m)


def centers(grid: Grid, device: torch.device | None = None) -> Tensor:
    """Centres of all voxels, XYZ3, metres."""
    axes = [
        low + (torch.arange(count, device=device) + 0.5) * grid.voxel_m
        for low, count in zip(grid.min_m, grid.shape, strict=True)
    ]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)


def sample(volume_BCXYZ: Tensor, grid: Grid, points_BP3: Tensor) -> Tensor:
    """Trilinear values BPC of volumes on ``grid`` at points in the grid's frame; zero outside."""
    assert volume_BCXYZ.shape[2:] == grid.shape, (volume_BCXYZ.shape, grid.shape)
    low, size = points_BP3.new_tensor(grid.min_m), points_BP3.new_tensor(grid.size_m)
    unit = ((points_BP3 - low) / size * 2 - 1).flip(-1)[:, :, None, None]
    values = F.grid_sample(
        volume_BCXYZ, unit, mode="bilinear", padding_mode="zeros", align_corners=False
    )
    return values[..., 0, 0].transpose(1, 2)


def crop(volume_BCXYZ: Tensor, grid: Grid, centers_BN3: Tensor, window: Grid) -> Tensor:
    """Windows BNCXYZ (the shape of ``window``) of volumes, resampled with the window's origin at
    each centre.
    """
    batch, count = centers_BN3.shape[:2]
    offsets = centers(window, centers_BN3.device).reshape(-1, 3)
    points = centers_BN3[:, :, None] + offsets
    values = sample(volume_BCXYZ, grid, points.reshape(batch, -1, 3))
    return values.reshape(batch, count, *window.shape, -1).movedim(-1, 2)


def voxelize(points_BP3: Tensor, grid: Grid) -> Tensor:
    """Which voxels hold a point or more (grid frame, metres), bool BXYZ; NaN and outside points are
    dropped.
    """
    batch, (x, y, z) = len(points_BP3), grid.shape
    cells = ((points_BP3 - points_BP3.new_tensor(grid.min_m)) / grid.voxel_m).floor()
    bounds = torch.tensor(grid.shape, device=points_BP3.device)
    inside = ((cells >= 0) & (cells < bounds)).all(-1)
    cells = torch.where(inside[..., None], cells, 0).long()
    flat = (cells[..., 0] * y + cells[..., 1]) * z + cells[..., 2]
    flat = torch.where(inside, flat, x * y * z)
    filled = torch.zeros(batch, x * y * z + 1, dtype=torch.bool, device=points_BP3.device)
    return filled.scatter_(1, flat, True)[:, :-1].reshape(batch, x, y, z)


def fold_order(points_XYZ3: Tensor) -> Tensor:
    """Reorder a field XYZ3 so that each 2x2x2 block is contiguous: (X/2)(Y/2)(Z/2)83, the order
    ``unfold`` undoes.
    """
    x, y, z, channels = points_XYZ3.shape
    blocks = points_XYZ3.reshape(x // 2, 2, y // 2, 2, z // 2, 2, channels).permute(
        0, 2, 4, 1, 3, 5, 6
    )
    return blocks.reshape(x // 2, y // 2, z // 2, 8, channels)


def unfold(blocks_BCXYZ: Tensor) -> Tensor:
    """Depth to space: channels (8 sub-voxels x C) of a coarse volume become a volume B C 2X 2Y 2Z,
    channels last.
    """
    batch, channels, x, y, z = blocks_BCXYZ.shape
    parts = blocks_BCXYZ.movedim(1, -1).reshape(batch, x, y, z, 2, 2, 2, channels // 8)
    return (
        parts.permute(0, 1, 4, 2, 5, 3, 6, 7)
        .reshape(batch, 2 * x, 2 * y, 2 * z, channels // 8)
        .movedim(-1, 1)
    )
