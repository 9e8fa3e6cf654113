"""How deep forecast objects stick in one another, by the convex parts of their meshes: a forecast's
physical sense.
"""

from itertools import permutations

import numpy as np
from scipy.spatial import ConvexHull

from oes.episode import Body, Episode, Floats
from oes.geom.se3 import inverse, transform
from oes.meshes.catalogue import Catalogue

Planes = tuple[
    Floats, ...
]  # of each convex part: F4, outward unit normals and offsets; inside where all are negative


class PenetrationMeter:
    """Depths of penetration among the bodies of a catalogue; what is known of a scaled body is
    kept.
    """

    def __init__(self, catalogue: Catalogue, points: dict[str, Floats]) -> None:
        """``points``: some of each mesh's surface, P3 in its obj frame, unit scale."""
        self.catalogue, self.points = catalogue, points
        self.known: dict[tuple[str, tuple[float, ...]], Planes] = {}

    def depths_mm(self, episode: Episode, world_T_obj_TN44: Floats) -> Floats:
        """How deep (mm) each object is in others, or others in it, TN, where they are put; 0 where
        nothing overlaps.
        """
        depth_TN = np.zeros(world_T_obj_TN44.shape[:2])
        for i, j in permutations(range(len(episode.bodies)), 2):
            first, second = episode.bodies[i], episode.bodies[j]
            second_T_first_T44 = inverse(world_T_obj_TN44[:, j]) @ world_T_obj_TN44[:, i]
            points_TP3 = transform(second_T_first_T44, self.points[first.mesh] * first.scale_3)
            depth_T = self._depth(second, points_TP3) * 1e3
            depth_TN[:, i] = np.maximum(depth_TN[:, i], depth_T)
            depth_TN[:, j] = np.maximum(depth_TN[:, j], depth_T)
        return depth_TN

    def _depth(self, body: Body, points_TP3: Floats) -> Floats:
        """The greatest depth T (metres) of points, in the body's obj frame, inside it."""
        low_3, high_3 = self.catalogue.meshes[body.mesh].visual.bounds * body.scale_3
        is_near_TP = ((points_TP3 > low_3) & (points_TP3 < high_3)).all(-1)
        depth_TP = np.zeros(is_near_TP.shape)
        if is_near_TP.any():
            near_Q3 = points_TP3[is_near_TP]
            inside = [
                -(near_Q3 @ part[:, :3].T + part[:, 3]).max(-1) for part in self._planes(body)
            ]
            depth_TP[is_near_TP] = np.maximum(np.max(inside, axis=0), 0)
        return np.asarray(depth_TP.max(-1))

    def _planes(self, body: Body) -> Planes:
        key = (body.mesh, tuple(body.scale_3.tolist()))
        if key not in self.known:
            parts = self.catalogue.meshes[body.mesh].parts
            self.known[key] = tuple(
                ConvexHull(p.vertices * body.scale_3, qhull_options="QJ").equations for p in parts
            )
        return self.known[key]
