"""Physical plausibility of forecasts: penetration depth between objects."""

from itertools import permutations

import numpy as np
from scipy.spatial import ConvexHull

from oes.episode import Body, Episode, Floats
from oes.geom.se3 import inverse, transform
from oes.meshes.catalogue import Catalogue


class PenetrationMeter:
    """Penetration depths among a catalogue's bodies, by the convex parts of their meshes."""

    def __init__(self, catalogue: Catalogue, points: dict[str, Floats]) -> None:
        """``points``: samples P3 of each mesh's surface (obj frame, unit scale)."""
        self.catalogue, self.points = catalogue, points
        self._cache: dict[tuple[str, tuple[float, ...]], list[Floats]] = {}

    def depths_mm(self, episode: Episode, world_T_obj_TN44: Floats) -> Floats:
        """Maximum pairwise penetration TN (mm) of each object at the given poses; 0 for none."""
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
        """Largest depth T (metres) of points (obj frame) below the surface of a body's parts."""
        low_3, high_3 = self.catalogue.meshes[body.mesh].visual.bounds * body.scale_3
        is_near_TP = ((points_TP3 > low_3) & (points_TP3 < high_3)).all(-1)
        depth_TP = np.zeros(is_near_TP.shape)
        if is_near_TP.any():
            near_Q3 = points_TP3[is_near_TP]
            planes = self._planes(body)
            inside = [-(near_Q3 @ plane[:, :3].T + plane[:, 3]).max(-1) for plane in planes]
            depth_TP[is_near_TP] = np.maximum(np.max(inside, axis=0), 0)
        return np.asarray(depth_TP.max(-1))

    def _planes(self, body: Body) -> list[Floats]:
        """Outward unit normals and offsets F4 of each part's faces; negative values are inside."""
        key = (body.mesh, tuple(body.scale_3.tolist()))
        if key not in self._cache:
            self._cache[key] = [
                # QJ joggles coplanar points, which box-shaped parts have many of.
                ConvexHull(part.vertices * body.scale_3, qhull_options="QJ").equations
                for part in self.catalogue.meshes[body.mesh].parts
            ]
        return self._cache[key]
