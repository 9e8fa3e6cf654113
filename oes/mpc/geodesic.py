"""Distances on the table: to the nearest obstacle, and to a goal around obstacles."""

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from oes.episode import Floats

FIELD_CELL_M = 0.004
NUM_CORNERS = 16  # vertices of the polygon around each obstacle
SAMPLES_PER_EDGE = 24  # points of an edge that are tested for collision
COLLISION_PENALTY = 20.0  # extra length of an edge, per metre that lies too close to an obstacle


class DistanceField:
    """Distance (metres) from the nearest obstacle on a grid; infinite without obstacles."""

    def __init__(self, points_P2: Floats, cell_m: float, half_m: float) -> None:
        """``points_P2``: occupied cells of side ``cell_m``; ``half_m``: the table's half width."""
        self.half_m, self.is_empty = half_m, not len(points_P2)
        axis = np.arange(-half_m, half_m + FIELD_CELL_M, FIELD_CELL_M)
        self._distance_XY: Floats = np.full((len(axis), len(axis)), np.inf)
        if not self.is_empty:
            nodes_XY2 = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1)
            distance_XY = KDTree(points_P2).query(nodes_XY2)[0]
            self._distance_XY = np.asarray(distance_XY) - cell_m / 2

    def __call__(self, xy: Floats) -> Floats:
        """Distances ... of points ...2; a point beyond the table takes the value at its edge."""
        # Nearest-neighbour lookup: the error is below FIELD_CELL_M, less than the planning margin.
        index = np.rint((xy + self.half_m) / FIELD_CELL_M).astype(int)
        index = index.clip(0, len(self._distance_XY) - 1)
        return np.asarray(self._distance_XY[index[..., 0], index[..., 1]])


class GeodesicDistance:
    """Length of the shortest collision-free path of a disc to a goal, by a visibility graph.

    The graph's nodes are the goal and the corners of a polygon around each obstacle. An edge that
    passes closer than the disc's radius to an obstacle is penalized, not removed: every point then
    has a finite distance, also inside an obstacle.
    """

    def __init__(
        self,
        goal_2: Floats,
        clearance: DistanceField,
        circles: list[tuple[Floats, float]],
        radius_m: float,
    ) -> None:
        """``circles``: centre and radius around each obstacle; ``radius_m``: of the disc."""
        self.clearance, self.radius_m = clearance, radius_m
        corners = [self._corners(*circle) for circle in circles]
        self._node_P2 = np.concatenate([[goal_2], *corners])
        self._to_goal_P = np.zeros(1)
        if len(self._node_P2) > 1:
            edges_PP = self._edge_lengths(self._node_P2)
            self._to_goal_P = dijkstra(edges_PP, indices=[0])[0]

    def __call__(self, xy: Floats) -> Floats:
        """Distances ... to the goal (metres) from points ...2."""
        return np.asarray((self._edge_lengths(xy) + self._to_goal_P).min(axis=-1))

    def heading(self, xy_2: Floats) -> float:
        """Initial direction (rad) of the shortest path from a point."""
        first = int((self._edge_lengths(xy_2) + self._to_goal_P).argmin())
        x, y = self._node_P2[first] - xy_2
        return float(np.arctan2(y, x))

    def _corners(self, center_2: Floats, radius_m: float) -> Floats:
        angle = np.arange(NUM_CORNERS) * (2 * np.pi / NUM_CORNERS)
        # Circumscribed polygon: its sides, not only its corners, clear the obstacle.
        distance = (radius_m + self.radius_m + FIELD_CELL_M) / np.cos(np.pi / NUM_CORNERS)
        corner_P2 = center_2 + distance * np.stack([np.cos(angle), np.sin(angle)], -1)
        limit_m = self.clearance.half_m - self.radius_m
        return np.asarray(corner_P2[(np.abs(corner_P2) <= limit_m).all(-1)])

    def _edge_lengths(self, xy: Floats) -> Floats:
        """Penalized lengths ...P of the straight edges from points ...2 to all nodes."""
        edge = self._node_P2 - xy[..., None, :]
        length = np.linalg.norm(edge, axis=-1)
        if self.clearance.is_empty:
            return np.asarray(length)
        fraction_Q: Floats = (np.arange(SAMPLES_PER_EDGE) + 0.5) / SAMPLES_PER_EDGE
        points = xy[..., None, None, :] + edge[..., None, :] * fraction_Q[:, None]
        colliding = (self.clearance(points) < self.radius_m).mean(axis=-1)
        return np.asarray(length * (1 + COLLISION_PENALTY * colliding))
