"""OBJ files of triangles with one ``o`` group per part, deterministic to the byte."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh


def write_groups(path: Path, meshes: Sequence[trimesh.Trimesh]) -> None:
    """Write each mesh as one group (metres, with 8 decimals)."""
    lines, first = [], 1
    for index, mesh in enumerate(meshes):
        lines.append(f"o part_{index:02d}")
        lines += [f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in mesh.vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + first).tolist()]
        first += len(mesh.vertices)
    path.write_text("\n".join(lines) + "\n")


def read_groups(path: Path) -> list[trimesh.Trimesh]:
    """Read a file of ``write_groups``. Raises ValueError for any other, OSError if unreadable."""
    meshes, first = [], 1
    for group in path.read_text(encoding="ascii").split("o part_")[1:]:
        lines = group.splitlines()[1:]
        rows = {key: [x[2:].split() for x in lines if x.startswith(f"{key} ")] for key in "vf"}
        vertices = np.array(rows["v"], float)
        faces = np.array(rows["f"], np.int64) - first
        _check(vertices, faces)
        meshes.append(trimesh.Trimesh(vertices, faces, process=False))
        first += len(vertices)
    if not meshes:
        raise ValueError("no meshes")
    return meshes


def _check(vertices: np.ndarray, faces: np.ndarray) -> None:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise ValueError("vertices are not rows of three finite numbers")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError("faces are not rows of three existing vertices")
