"""Convex parts of a mesh, and mass properties (at density 1 kg/m3) from them."""

import hashlib
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import coacd
import numpy as np
import trimesh
from numpy.typing import NDArray

from oes.config import params
from oes.episode import Floats
from oes.meshes.objfile import read_groups, write_groups


@params
class ConvexConfig:
    """CoACD's settings: a lower ``threshold`` (concavity) and longer searches follow the surface
    closer, at a price.
    """

    threshold: float
    resolution: int
    mcts_iterations: int
    mcts_depth: int
    max_parts: int
    max_part_vertices: int


class NoParts(ValueError):
    """A mesh that no acceptable set of convex parts fills."""


@dataclass(frozen=True)
class Mass:
    """Volume, centre of mass (obj frame) and inertia about it, both axes along obj, for a density
    of 1 kg/m3.
    """

    volume_m3: float
    com_obj_3: Floats
    inertia_obj_33: Floats


def decompose(mesh: trimesh.Trimesh, cfg: ConvexConfig, cache: Path) -> tuple[trimesh.Trimesh, ...]:
    """Convex parts: the mesh itself when convex, else CoACD's, remembered in ``cache`` under their
    content's hash.

    Raises NoParts when CoACD finds none, or more than ``cfg.max_parts``.
    """
    if mesh.is_watertight and mesh.is_convex:
        return (mesh.convex_hull,)
    content = (
        np.ascontiguousarray(mesh.vertices).tobytes()
        + np.ascontiguousarray(mesh.faces, np.int64).tobytes()
    )
    path = cache / f"{hashlib.sha256(content + repr(asdict(cfg)).encode()).hexdigest()}.obj"
    if not path.exists():
        parts = _coacd(mesh, cfg)
        cache.mkdir(parents=True, exist_ok=True)
        aside = path.with_suffix(f".{os.getpid()}.part")
        write_groups(aside, parts)
        aside.replace(path)
    return tuple(part.convex_hull for part in read_groups(path))


def _coacd(mesh: trimesh.Trimesh, cfg: ConvexConfig) -> list[trimesh.Trimesh]:
    coacd.set_log_level("off")
    found = coacd.run_coacd(
        coacd.Mesh(mesh.vertices, mesh.faces),
        threshold=cfg.threshold,
        max_convex_hull=cfg.max_parts,
        resolution=cfg.resolution,
        mcts_iterations=cfg.mcts_iterations,
        mcts_max_depth=cfg.mcts_depth,
        decimate=True,
        max_ch_vertex=cfg.max_part_vertices,
    )
    parts = [trimesh.Trimesh(vertices, faces) for vertices, faces in found]
    solid = [
        part
        for part in parts
        if len(part.vertices) > 3 and part.extents.min() > 1e-6 * part.extents.max()
    ]
    if not solid:
        raise NoParts("no convex part found")
    if len(solid) > cfg.max_parts:
        raise NoParts(f"{len(solid)} convex parts, at most {cfg.max_parts}")
    return solid


def fill(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """The solid that overlapping parts fill together."""
    if len(parts) == 1:
        return parts[0]
    solid: trimesh.Trimesh = trimesh.boolean.union(list(parts), engine="manifold")
    return solid


def inside(parts: Sequence[trimesh.Trimesh], points_P3: Floats) -> NDArray[np.bool_]:
    """Which points lie in at least one convex part (P,)."""
    found_P = np.zeros(len(points_P3), bool)
    for part in parts:
        normal_F3 = part.face_normals
        offset_F = (normal_F3 * part.triangles[:, 0]).sum(1)
        near_P = ~found_P & np.all(
            (points_P3 >= part.bounds[0]) & (points_P3 <= part.bounds[1]), axis=1
        )
        found_P[near_P] = np.all(points_P3[near_P] @ normal_F3.T <= offset_F + 1e-9, axis=1)
    return found_P


def solid_mass(solid: trimesh.Trimesh) -> Mass:
    """Mass properties of a closed surface."""
    return Mass(
        float(solid.volume), np.asarray(solid.center_mass), np.asarray(solid.moment_inertia)
    )


def scaled_mass(mass: Mass, scale_3: Floats) -> Mass:
    """Mass properties after scaling along the obj axes: exact, from the second moments of the
    volume.
    """
    second_33 = np.eye(3) * np.trace(mass.inertia_obj_33) / 2 - mass.inertia_obj_33
    stretch = math.prod(np.abs(scale_3))
    second_33 = stretch * second_33 * np.outer(scale_3, scale_3)
    inertia_33 = np.eye(3) * np.trace(second_33) - second_33
    return Mass(mass.volume_m3 * stretch, mass.com_obj_3 * scale_3, inertia_33)
