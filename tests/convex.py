"""Point-in-solid test of the convex parts of a mesh."""

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from oes.episode import Floats


def is_inside(parts: Sequence[trimesh.Trimesh], points_P3: Floats) -> NDArray[np.bool_]:
    """Whether each point (P) lies in at least one convex part."""
    planes = [ConvexHull(part.vertices).equations for part in parts]
    distances = [points_P3 @ plane_F4[:, :3].T + plane_F4[:, 3] for plane_F4 in planes]
    return np.any([(distance_PF <= 1e-9).all(1) for distance_PF in distances], axis=0)
