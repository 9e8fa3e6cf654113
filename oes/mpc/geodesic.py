"""Ways around obstacles on the table: how far any place is from an obstacle, and how long the way
to a goal is.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from oes.episode import Floats

GRID_M = 0.004
CORNERS = 16  # places around each obstacle at which a way may bend
SAMPLES_PER_LEG = 24  # places along a straight piece of a way that are looked at
COLLISION_PENALTY = 20.0  # a metre too close to an obstacle counts as so many more


class DistanceField:
    """The distance (m) of places xy from the nearest obstacle, on a grid over the table; infinite
    without obstacles.
    """

    def __init__(self, points_P2: Floats, cell_m: float, half_m: float) -> None:
        """``points_P2`` stand for cells of side ``cell_m``; the table is ``half_m`` wide to each
        side of the origin.
        """
        self.half_m, self.is_empty = half_m, not len(points_P2)
        line = np.arange(-half_m, half_m + GRID_M, GRID_M)
        self._distance_XY: Floats = np.full((len(line), len(line)), np.inf)
        if not self.is_empty:
            nodes = np.stack(np.meshgrid(line, line, indexing="ij"), -1)
            self._distance_XY = np.asarray(KDTree(points_P2).query(nodes)[0]) - cell_m / 2

    def __call__(self, xy: Floats) -> Floats:
        """For places (..., 2); beyond the table as at its edge."""
        index = np.rint((xy + self.half_m) / GRID_M).astype(int).clip(0, len(self._distance_XY) - 1)
        return np.asarray(self._distance_XY[index[..., 0], index[..., 1]])


class GeodesicDistance:
    """The length of the shortest way to a goal for something round, around obstacles.

    Ways are straight pieces between corners around the obstacles (a visibility graph). A piece that
    passes an obstacle closer than ``radius_m`` is longer by a toll instead of forbidden: every
    place has a finite length.
    """

    def __init__(
        self,
        goal_2: Floats,
        clearance: DistanceField,
        rounds: list[tuple[Floats, float]],
        radius_m: float,
    ):
        """``rounds``: middle and radius of a circle around each obstacle."""
        self.clearance, self.radius_m = clearance, radius_m
        corners_C2 = np.concatenate(
            [[goal_2], *(self._corners(middle, radius) for middle, radius in rounds)]
        )
        self._corners_C2 = corners_C2
        self._onward_C = np.zeros(1)
        if len(corners_C2) > 1:
            self._onward_C = dijkstra(self._lengths(corners_C2), indices=[0])[0]

    def __call__(self, xy: Floats) -> Floats:
        """Metres from places (..., 2)."""
        return np.asarray((self._lengths(xy) + self._onward_C).min(axis=-1))

    def heading(self, xy_2: Floats) -> float:
        """The direction (rad) in which the way from a place sets out."""
        next_2 = self._corners_C2[int((self._lengths(xy_2) + self._onward_C).argmin())]
        return float(np.arctan2(*(next_2 - xy_2)[::-1]))

    def _corners(self, middle_2: Floats, radius_m: float) -> Floats:
        """Just far enough from an obstacle that the straight pieces between neighbours stay clear
        of it.
        """
        angle = np.arange(CORNERS) * (2 * np.pi / CORNERS)
        away = (radius_m + self.radius_m + GRID_M) / np.cos(np.pi / CORNERS)
        corners = middle_2 + away * np.stack([np.cos(angle), np.sin(angle)], -1)
        return np.asarray(
            corners[(np.abs(corners) <= self.clearance.half_m - self.radius_m).all(-1)]
        )

    def _lengths(self, xy: Floats) -> Floats:
        """From places (..., 2) straight to every corner: (..., C)."""
        leg = self._corners_C2 - xy[..., None, :]
        length = np.linalg.norm(leg, axis=-1)
        if self.clearance.is_empty:
            return np.asarray(length)
        along_L: NDArray[np.float64] = (np.arange(SAMPLES_PER_LEG) + 0.5) / SAMPLES_PER_LEG
        places = xy[..., None, None, :] + leg[..., None, :] * along_L[:, None]
        inside = (self.clearance(places) < self.radius_m).mean(axis=-1)
        return np.asarray(length * (1 + COLLISION_PENALTY * inside))
