"""Convex parts of a mesh, and mass properties (at density 1 kg/m3) from them."""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import coacd
import numpy as np
import trimesh

from oes.config import params
from oes.episode import Floats
from oes.meshes.objfile import read_groups, write_groups


@params
class ConvexConfig:
    """Settings of CoACD (Wei et al. 2022); ``threshold`` is its concavity."""

    threshold: float
    resolution: int
    mcts_iterations: int
    mcts_depth: int
    max_parts: int
    max_part_vertices: int


class NoParts(ValueError):
    """A mesh without an acceptable convex decomposition."""


@dataclass(frozen=True)
class Mass:
    """Volume, centre of mass and inertia about it, along the obj axes, at 1 kg/m3."""

    volume_m3: float
    com_obj_3: Floats
    inertia_obj_33: Floats


def decompose(mesh: trimesh.Trimesh, cfg: ConvexConfig, cache: Path) -> tuple[trimesh.Trimesh, ...]:
    """The mesh itself if convex, else its convex parts by CoACD, cached by a hash of the input.

    Raises NoParts if CoACD finds none, or more than ``cfg.max_parts``.
    """
    if mesh.is_watertight and mesh.is_convex:
        return (mesh.convex_hull,)
    digest = hashlib.sha256(np.ascontiguousarray(mesh.vertices).tobytes())
    digest.update(np.ascontiguousarray(mesh.faces, np.int64).tobytes())
    digest.update(repr(asdict(cfg)).encode())
    path = cache / f"{digest.hexdigest()}.obj"
    if not path.exists():
        parts = _coacd(mesh, cfg)
        cache.mkdir(parents=True, exist_ok=True)
        part_path = path.with_suffix(f".{os.getpid()}.part")  # another process may write it too
        write_groups(part_path, parts)
        part_path.replace(path)
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
    """Union of overlapping convex parts."""
    if len(parts) == 1:
        return parts[0]
    solid: trimesh.Trimesh = trimesh.boolean.union(list(parts), engine="manifold")
    return solid


def solid_mass(solid: trimesh.Trimesh) -> Mass:
    """Mass properties of a closed surface."""
    com_3, inertia_33 = np.asarray(solid.center_mass), np.asarray(solid.moment_inertia)
    return Mass(float(solid.volume), com_3, inertia_33)
