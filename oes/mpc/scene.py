"""The scene of a planner, seen from above: footprints of objects, the rod and the table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oes.episode import Floats


@dataclass(frozen=True)
class Rod:
    """The pusher, a vertical cylinder (metres); |x| and |y| of its tip stay <= ``workspace_m``."""

    radius_m: float
    tip_height_m: float
    workspace_m: float


@dataclass(frozen=True)
class Footprint:
    """An object's vertical projection: centres of occupied cells of side ``cell_m`` (world)."""

    center_2: Floats
    points_P2: Floats
    cell_m: float

    @property
    def radius_m(self) -> float:
        """Radius of the enclosing circle about the centre."""
        return float(np.linalg.norm(self.points_P2 - self.center_2, axis=1).max() + self.cell_m / 2)


@dataclass(frozen=True)
class PlanningScene:
    """Footprints of objects to move and of obstacles, the rod, and the table's half width."""

    moved: Sequence[Footprint]
    obstacles: Sequence[Footprint]
    rod: Rod
    half_m: float


def object_footprint(
    center_3: Floats,
    size_3: Floats,
    occupancy_XYZ: NDArray[np.float32],
    voxel_m: float,
    threshold: float,
) -> Footprint:
    """Footprint of a completed occupancy grid: columns with a voxel above ``threshold`` (0..1).

    All heights count, as the rod is a vertical cylinder. An empty grid gives the box instead.
    """
    columns_XY = (occupancy_XYZ > threshold).any(axis=2)
    if columns_XY.any():
        cells_P2 = np.argwhere(columns_XY) + 0.5
        points_P2 = (cells_P2 - np.array(columns_XY.shape) / 2) * voxel_m + center_3[:2]
    else:
        axes = [np.linspace(-s / 2, s / 2, int(np.ceil(s / voxel_m)) + 1) for s in size_3[:2]]
        grid_XY2 = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        points_P2 = grid_XY2.reshape(-1, 2) + center_3[:2]
    return Footprint(center_3[:2], points_P2, voxel_m)
