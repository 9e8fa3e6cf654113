"""Reading and mending a mesh file of unknown quality."""

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
READER_ERRORS = (
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
    """Limits on files nobody has vetted; above ``simplify_faces`` a mesh is simplified, above
    ``max_faces`` refused.
    """

    max_bytes: int
    max_faces: int
    simplify_faces: int


def read_surface(path: Path, cfg: RepairConfig) -> trimesh.Trimesh:
    """The triangles of a file, as they are; nothing beside the file itself is opened. Raises
    Rejected.
    """
    try:
        size = path.stat().st_size
        if size == 0:
            raise MeshRejected("empty file")
        if size > cfg.max_bytes:
            raise MeshRejected(f"{size} bytes, at most {cfg.max_bytes}")
        with path.open("rb") as file:
            mesh = trimesh.load_mesh(
                file, file_type=path.suffix[1:].lower(), process=False, skip_materials=True
            )
    except MeshRejected:
        raise
    except READER_ERRORS as error:
        raise MeshRejected(
            f"unreadable: {type(error).__name__}: {' '.join(str(error).split())[:120]}"
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise MeshRejected("no triangles: truncated, or not what its name says")
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def check_surface(mesh: trimesh.Trimesh, cfg: RepairConfig) -> None:
    """Raise Rejected for what cannot be mended: too few or too many faces, bad numbers, no extent
    in some direction.
    """
    if not 4 <= len(mesh.faces) <= cfg.max_faces:
        raise MeshRejected(f"{len(mesh.faces)} faces, from 4 to {cfg.max_faces} are taken")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise MeshRejected("faces name vertices that do not exist")
    points = mesh.vertices[np.unique(mesh.faces)]
    bad = int((~np.isfinite(points)).any(1).sum())
    if bad:
        raise MeshRejected(f"{bad} of {len(points)} vertices are not finite numbers")
    extents = np.ptp(points, axis=0)
    if not 1e-12 < extents.max() < 1e12:
        raise MeshRejected(f"absurd size: {extents.max():.3g} units")
    if extents.min() < 1e-6 * extents.max():
        raise MeshRejected("zero volume: flat")


def repaired(mesh: trimesh.Trimesh, cfg: RepairConfig) -> tuple[trimesh.Trimesh, str]:
    """A mended copy of a mesh about 0.1 units wide, and what was done: 'clean' when nothing was."""
    mesh = mesh.copy()
    done = [word for word, act in STEPS.items() if act(mesh)]
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
    """At most ``max_faces`` faces: by manifold3d for closed meshes, else by merging vertices in
    ever larger cells.
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
    cells, owner_P = np.unique(
        np.round(mesh.vertices / cell).astype(np.int64), axis=0, return_inverse=True
    )
    total = np.zeros((len(cells), 3))
    np.add.at(total, owner_P.ravel(), mesh.vertices)
    merged = trimesh.Trimesh(
        total / np.bincount(owner_P.ravel())[:, None], owner_P.ravel()[mesh.faces], process=False
    )
    _drop(merged, merged.nondegenerate_faces())
    _drop(merged, merged.unique_faces())
    return merged
