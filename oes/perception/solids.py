"""Solid points of meshes: what posed objects fill, fast enough to voxelise every training sample
anew.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from oes.episode import Body, Floats
from oes.geom.se3 import transform
from oes.meshes.catalogue import Catalogue

PointCloud = NDArray[np.float32]


@dataclass(frozen=True)
class Solids:
    """P points for each catalogue mesh (obj frame, unit scale): hull corners, surface and interior.
    ``skins``: points of its surface alone, with their unit normals.
    """

    points: Mapping[str, PointCloud]
    skins: Mapping[str, tuple[Floats, Floats]]

    def posed(self, body: Body, world_T_obj_44: Floats) -> Floats:
        """The points of one body in the world, P3. Raises KeyError naming a mesh that the catalogue
        lacks.
        """
        if body.mesh not in self.points:
            raise KeyError(
                f"mesh {body.mesh!r} is not in the catalogue ({len(self.points)} meshes)"
            )
        return transform(world_T_obj_44, self.points[body.mesh] * body.scale_3)

    def surface(self, body: Body, world_T_obj_44: Floats) -> tuple[Floats, Floats]:
        """Points of one body's surface in the world and their outward unit normals, P3 each."""
        points_P3, normal_P3 = self.skins[body.mesh]
        scaled_P3 = normal_P3 / body.scale_3
        unit_P3 = scaled_P3 / np.linalg.norm(scaled_P3, axis=-1, keepdims=True)
        return transform(world_T_obj_44, points_P3 * body.scale_3), unit_P3 @ world_T_obj_44[
            :3, :3
        ].T


def solids_of(catalogue: Catalogue, count: int) -> Solids:
    """``count`` points for every mesh of a catalogue; the same catalogue gives the same points."""
    meshes = catalogue.meshes.values()
    return Solids(
        {mesh.id: solid_points(mesh.visual, mesh.parts, count, seed=0) for mesh in meshes},
        {mesh.id: sample_surface(mesh.visual, count // 4) for mesh in meshes},
    )


def sample_surface(visual: trimesh.Trimesh, count: int) -> tuple[Floats, Floats]:
    """``count`` points of a surface and the unit normals of their faces, count x 3 each."""
    points_P3, face_P = trimesh.sample.sample_surface(visual, count, seed=0)
    return np.asarray(points_P3), np.asarray(visual.face_normals[face_P])


def solid_points(
    visual: trimesh.Trimesh, parts: tuple[trimesh.Trimesh, ...], count: int, seed: int
) -> PointCloud:
    """``count`` points of a solid, count x 3: half of them inside, the rest its hull's corners and
    its surface.

    Dense enough that every 1 cm voxel that a 15 cm object fills holds one, thin walls included. The
    inside of a mesh that is not watertight is that of its convex parts.
    """
    rng = np.random.default_rng(seed)
    corners = np.asarray(visual.vertices)[ConvexHull(visual.vertices, qhull_options="QJ").vertices]
    corners = corners[: count // 4]
    inner = _inside(visual, parts, count // 2)
    if len(inner) > count // 2:
        inner = rng.permutation(inner)[: count // 2]
    surface, _ = trimesh.sample.sample_surface(visual, count - len(inner) - len(corners), seed=seed)
    return np.concatenate([corners, inner, surface]).astype(np.float32)


def _inside(visual: trimesh.Trimesh, parts: tuple[trimesh.Trimesh, ...], count: int) -> Floats:
    """About ``count`` lattice points inside the solid, at most 6 mm apart where the count
    allows.
    """
    volume = abs(visual.volume) if visual.is_watertight else sum(abs(part.volume) for part in parts)
    spacing = max((volume / count) ** (1 / 3), 0.003)
    axes = [np.arange(low + spacing / 2, high, spacing) for low, high in visual.bounds.T]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if visual.is_watertight:
        return lattice[visual.contains(lattice)]
    return lattice[np.logical_or.reduce([_in_convex(part, lattice) for part in parts])]


def _in_convex(part: trimesh.Trimesh, points_P3: Floats) -> NDArray[np.bool_]:
    equations = ConvexHull(part.vertices, qhull_options="QJ").equations
    outside = (points_P3 @ equations[:, :3].T + equations[:, 3] > 1e-9).any(axis=1)
    return np.asarray(~outside, dtype=np.bool_)
