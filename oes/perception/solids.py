"""Point clouds that fill the meshes of a catalogue, to be posed and voxelised per sample."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from oes.episode import Body, Floats
from oes.geom.se3 import transform
from oes.meshes.catalogue import Catalogue

MIN_SPACING_M = 0.003


@dataclass(frozen=True)
class Solids:
    """Points P3 of every catalogue mesh (obj frame, unit scale): hull corners, surface, interior.

    ``surface_points``: points of the surface alone and their unit normals.
    """

    points: Mapping[str, NDArray[np.float32]]
    surface_points: Mapping[str, tuple[Floats, Floats]]

    def posed(self, body: Body, world_T_obj_44: Floats) -> Floats:
        """World points P3 of one body. Raises KeyError for a mesh that is not in the catalogue."""
        if body.mesh not in self.points:
            count = len(self.points)
            raise KeyError(f"mesh {body.mesh!r} is not in the catalogue ({count} meshes)")
        return transform(world_T_obj_44, self.points[body.mesh] * body.scale_3)

    def surface(self, body: Body, world_T_obj_44: Floats) -> tuple[Floats, Floats]:
        """World points P3 of one body's surface and their outward unit normals P3."""
        points_P3, normal_P3 = self.surface_points[body.mesh]
        # Normals transform by the inverse transpose of the scaling.
        scaled_P3 = normal_P3 / body.scale_3
        unit_P3 = scaled_P3 / np.linalg.norm(scaled_P3, axis=-1, keepdims=True)
        world_P3 = transform(world_T_obj_44, points_P3 * body.scale_3)
        return world_P3, unit_P3 @ world_T_obj_44[:3, :3].T


def solids_of(catalogue: Catalogue, count: int) -> Solids:
    """``count`` points for every mesh of a catalogue, with a fixed seed."""
    meshes = catalogue.meshes.values()
    return Solids(
        {mesh.id: solid_points(mesh.visual, mesh.parts, count) for mesh in meshes},
        {mesh.id: sample_surface(mesh.visual, count // 4) for mesh in meshes},
    )


def sample_surface(visual: trimesh.Trimesh, count: int) -> tuple[Floats, Floats]:
    """``count`` points P3 of a surface and the unit normals P3 of their faces."""
    points_P3, face_P = trimesh.sample.sample_surface(visual, count, seed=0)
    return np.asarray(points_P3), np.asarray(visual.face_normals[face_P])


def solid_points(
    visual: trimesh.Trimesh, parts: tuple[trimesh.Trimesh, ...], count: int
) -> NDArray[np.float32]:
    """``count`` points P3 of a solid: half of them inside, the rest hull corners and surface.

    The interior of a mesh that is not watertight is that of its convex ``parts``.
    """
    corners = np.asarray(visual.vertices)[ConvexHull(visual.vertices, qhull_options="QJ").vertices]
    corners = corners[: count // 4]
    inner = _interior_points(visual, parts, count // 2)
    if len(inner) > count // 2:
        inner = np.random.default_rng(0).permutation(inner)[: count // 2]
    surface, _ = sample_surface(visual, count - len(inner) - len(corners))
    return np.concatenate([corners, inner, surface]).astype(np.float32)


def _interior_points(
    visual: trimesh.Trimesh, parts: tuple[trimesh.Trimesh, ...], count: int
) -> Floats:
    """About ``count`` points P3 of a regular lattice inside the solid."""
    volume = abs(visual.volume) if visual.is_watertight else sum(abs(part.volume) for part in parts)
    # The lattice is no denser than needed: every voxel of 1 cm inside holds a point.
    spacing = max((volume / count) ** (1 / 3), MIN_SPACING_M)
    axes = [np.arange(low + spacing / 2, high, spacing) for low, high in visual.bounds.T]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if visual.is_watertight:
        return lattice[visual.contains(lattice)]
    is_inside = np.zeros(len(lattice), dtype=bool)
    for part in parts:
        planes = ConvexHull(part.vertices, qhull_options="QJ").equations
        is_inside |= (lattice @ planes[:, :3].T + planes[:, 3] <= 1e-9).all(axis=1)
    return lattice[is_inside]
