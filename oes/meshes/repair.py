"""Reading and repair of a mesh file of unknown quality."""

import struct
from collections.abc import Callable
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

from oes.config import params
from oes.meshes.draft import MeshRejected

SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".off")
UPRIGHT_FROM_Y = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
READER_ERRORS = (  # what trimesh's readers raise on damaged files
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    AssertionError,
    NotImplementedError,
    OSError,
    EOFError,
    MemoryError,
    RecursionError,
    struct.error,
)


@params
class RepairConfig:
    """Limits on a file and its mesh; one of more than ``simplify_faces`` is simplified."""

    max_bytes: int
    max_faces: int
    simplify_faces: int


def read_surface(path: Path, cfg: RepairConfig) -> trimesh.Trimesh:
    """The triangles of a file, as they are. Raises MeshRejected."""
    try:
        size = path.stat().st_size
        if size == 0:
            raise MeshRejected("empty file")
        if size > cfg.max_bytes:
            raise MeshRejected(f"{size} bytes, at most {cfg.max_bytes}")
        kind = path.suffix[1:].lower()
        # From an open file, so that a damaged one cannot name other files to read.
        with path.open("rb") as file:
            mesh = trimesh.load_mesh(file, file_type=kind, process=False, skip_materials=True)
    except MeshRejected:
        raise
    except READER_ERRORS as error:
        raise MeshRejected(f"unreadable: {one_line(error)}") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise MeshRejected("no triangles: truncated, or not what its name says")
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def one_line(error: Exception) -> str:
    """Class and message of an error, shortened."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"


def check_surface(mesh: trimesh.Trimesh, cfg: RepairConfig) -> None:
    """Raise MeshRejected for what no repair cures: face counts, bad numbers, a flat mesh."""
    if not 4 <= len(mesh.faces) <= cfg.max_faces:
        raise MeshRejected(f"{len(mesh.faces)} faces, from 4 to {cfg.max_faces} are accepted")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise MeshRejected("faces name vertices that do not exist")
    points = mesh.vertices[np.unique(mesh.faces)]
    bad = int((~np.isfinite(points)).any(1).sum())
    if bad:
        raise MeshRejected(f"{bad} of {len(points)} vertices are not finite numbers")
    extents = np.ptp(points, axis=0)
    if not 1e-12 < extents.max() < 1e12:
        raise MeshRejected(f"implausible size: {extents.max():.3g} units")
    if extents.min() < 1e-6 * extents.max():
        raise MeshRejected("zero volume: flat")


def repaired(mesh: trimesh.Trimesh, cfg: RepairConfig) -> tuple[trimesh.Trimesh, str]:
    """A repaired copy of a mesh about 0.1 units wide, and the repairs in words, or 'clean'."""
    mesh = mesh.copy()
    done = [name for name, repair in STEPS.items() if repair(mesh)]
    if len(mesh.faces) < 4:
        raise MeshRejected("fewer than 4 faces are not degenerate or duplicate")
    if len(mesh.faces) > cfg.simplify_faces:
        before = len(mesh.faces)
        mesh = simplified(mesh, cfg.simplify_faces)
        done.append(f"simplified {before} to {len(mesh.faces)} faces")
    if not mesh.is_volume:
        done.append("still open: mass from its convex parts")
    return mesh, "; ".join(done) or "clean"


def _merge(mesh: trimesh.Trimesh) -> bool:
    before = len(mesh.vertices)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.remove_unreferenced_vertices()
    return len(mesh.vertices) < before


def _drop(mesh: trimesh.Trimesh, keep_F: NDArray[np.bool_]) -> bool:
    mesh.update_faces(keep_F)
    mesh.remove_unreferenced_vertices()
    return not bool(np.all(keep_F))


def _wind(mesh: trimesh.Trimesh) -> bool:
    before = mesh.faces.copy()
    mesh.fix_normals()
    return not np.array_equal(before, mesh.faces)


def _fill(mesh: trimesh.Trimesh) -> bool:
    before = len(mesh.faces)
    mesh.fill_holes()
    if len(mesh.faces) == before:
        return False
    mesh.fix_normals()
    return True


STEPS: dict[str, Callable[[trimesh.Trimesh], bool]] = {
    "merged vertices": _merge,
    "dropped degenerate faces": lambda mesh: _drop(mesh, mesh.nondegenerate_faces()),
    "dropped duplicate faces": lambda mesh: _drop(mesh, mesh.unique_faces()),
    "rewound faces": _wind,
    "filled holes": _fill,
}


def simplified(mesh: trimesh.Trimesh, max_faces: int) -> trimesh.Trimesh:
    """A mesh of at most ``max_faces`` faces: by manifold3d if closed, else by vertex clustering.

    Raises MeshRejected if even cells of a tenth of its size leave more.
    """
    size = float(mesh.extents.max())
    for tolerance in size * np.geomspace(1e-4, 0.1, 13):
        smaller = _collapsed(mesh, tolerance) if mesh.is_volume else _clustered(mesh, tolerance)
        if 4 <= len(smaller.faces) <= max_faces and (smaller.is_volume or not mesh.is_volume):
            return smaller
    raise MeshRejected(f"{len(mesh.faces)} faces cannot be simplified to {max_faces}")


def _collapsed(mesh: trimesh.Trimesh, tolerance: float) -> trimesh.Trimesh:
    surface = manifold3d.Mesh64(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.uint64))
    found = manifold3d.Manifold(surface).simplify(tolerance).to_mesh64()
    return trimesh.Trimesh(
        np.asarray(found.vert_properties)[:, :3], np.asarray(found.tri_verts), process=False
    )


def _clustered(mesh: trimesh.Trimesh, cell: float) -> trimesh.Trimesh:
    index_P3 = np.round(mesh.vertices / cell).astype(np.int64)
    cells, cell_P = np.unique(index_P3, axis=0, return_inverse=True)
    cell_P = cell_P.ravel()
    total = np.zeros((len(cells), 3))
    np.add.at(total, cell_P, mesh.vertices)
    means = total / np.bincount(cell_P)[:, None]
    merged = trimesh.Trimesh(means, cell_P[mesh.faces], process=False)
    _drop(merged, merged.nondegenerate_faces())
    _drop(merged, merged.unique_faces())
    return merged
