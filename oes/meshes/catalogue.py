"""Catalogue of meshes on disk: a folder per mesh, catalogue.csv (sizes, splits), rejected.csv."""

import csv
import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import trimesh
from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked

from oes.csv_io import columns_of, write_csv
from oes.episode import FALLING, PUSHING, Floats
from oes.meshes.convex import Mass
from oes.meshes.draft import Draft
from oes.meshes.objfile import read_groups, write_groups

LIST, REJECTED = "catalogue.csv", "rejected.csv"
VISUAL, COLLISION, RECORD = "visual.obj", "collision.obj", "mesh.json"
TRAIN, TEST = "train", "test"
_Vector = tuple[float, float, float]

BLOCK = "block"  # category of the meshes of the falling task; all others are pushed


class CatalogueError(ValueError):
    """A folder that is no complete catalogue, or a split without meshes."""


@dataclass(frozen=True)
class Mesh:
    """An object mesh in its obj frame (metres).

    ``parts``: convex parts that fill it, also the groups of the OBJ file ``collision_path``.
    ``inertia_obj_33``: about the centre of mass, at a density of 1 kg/m3.
    """

    id: str
    category: str
    source: str
    split: str
    visual: trimesh.Trimesh
    parts: tuple[trimesh.Trimesh, ...]
    collision_path: Path
    volume_m3: float
    com_obj_3: Floats
    inertia_obj_33: Floats
    extents_m_3: Floats


@dataclass(frozen=True)
class Catalogue:
    """Meshes by id, in the order of catalogue.csv."""

    meshes: dict[str, Mesh]

    def split(self, name: str, task: str = PUSHING) -> list[Mesh]:
        """The meshes of split 'train' or 'test' for a task. Raises CatalogueError without any."""
        is_block = task == FALLING
        meshes = [mesh for mesh in self.meshes.values() if (mesh.category == BLOCK) == is_block]
        found = [mesh for mesh in meshes if mesh.split == name]
        if not found:
            counts = dict(Counter(mesh.split for mesh in meshes))
            message = f"no mesh for {task} in split '{name}'; for {task} there are {counts}"
            raise CatalogueError(message)
        return found

    def counts(self) -> Counter[str]:
        """Number of meshes in each split."""
        return Counter(mesh.split for mesh in self.meshes.values())


@dataclass(frozen=True)
class Rejection:
    """A mesh that is not in the catalogue, and the reason."""

    source: str
    category: str
    reason: str


@checked(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Record:
    """The file mesh.json; mass properties at a density of 1 kg/m3."""

    id: str
    category: str
    source: str
    status: str
    volume_m3: float
    com_obj_m: _Vector
    inertia_obj_kg_m2: tuple[_Vector, _Vector, _Vector]
    extents_m: _Vector


def write_mesh(draft: Draft, mass: Mass, folder: Path) -> None:
    """Write one placed mesh; mesh.json is last, so that a folder with it is complete."""
    folder.mkdir(parents=True, exist_ok=True)
    write_groups(folder / VISUAL, [draft.visual])
    write_groups(folder / COLLISION, draft.parts)
    record = Record(
        draft.id,
        draft.category,
        draft.source,
        draft.status,
        mass.volume_m3,
        mass.com_obj_3.tolist(),
        mass.inertia_obj_33.tolist(),
        draft.visual.extents.tolist(),
    )
    (folder / RECORD).write_text(json.dumps(asdict(record), indent=1) + "\n")


def save_catalogue(
    folder: Path, splits: dict[str, str], rejections: Iterable[Rejection]
) -> Catalogue:
    """Write catalogue.csv and rejected.csv for the meshes already in ``folder``."""
    write_csv(folder / REJECTED, map(vars, rejections), ["source", "category", "reason"])
    meshes = [_read_mesh(folder / id_, split) for id_, split in splits.items()]
    rows = [_row(mesh, _read_record(folder / mesh.id).status) for mesh in meshes]
    write_csv(folder / LIST, rows, columns_of(rows) or ["id"])
    return Catalogue({mesh.id: mesh for mesh in meshes})


def load_catalogue(folder: Path) -> Catalogue:
    """Read a catalogue. Raises CatalogueError naming the file and what is wrong with it."""
    try:
        with (folder / LIST).open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        message = f"{folder}: not a catalogue of meshes: {LIST} cannot be read ({error})"
        raise CatalogueError(message) from error
    if not rows or not {"id", "split"} <= rows[0].keys():
        raise CatalogueError(f"{folder / LIST}: no meshes listed, or no columns 'id' and 'split'")
    for row in rows:
        if row["split"] not in (TRAIN, TEST) or Path(row["id"]).name != row["id"]:
            mesh = f"mesh '{row['id']}', split '{row['split']}'"
            expected = "the id is not a plain name, or the split neither train nor test"
            raise CatalogueError(f"{folder / LIST}: {mesh}: {expected}")
    meshes = [_read_mesh(folder / row["id"], row["split"]) for row in rows]
    return Catalogue({mesh.id: mesh for mesh in meshes})


def assign_splits(
    meshes: Sequence[tuple[str, str]], test_share: float, seed: int
) -> dict[str, str]:
    """Split of each (id, stratum): ``test_share`` of every stratum, rounded up, is 'test'.

    A lone mesh is 'train'. The order is that of a hash of the ids, so that a mesh keeps its split
    when other strata change.
    """
    order = sorted(meshes, key=lambda mesh: hashlib.sha256(f"{seed}/{mesh[0]}".encode()).digest())
    strata: dict[str, list[str]] = {}
    for id_, stratum in order:
        strata.setdefault(stratum, []).append(id_)
    tests: set[str] = set()
    for ids in strata.values():
        # The margin keeps 0.2 * 5, inexact in binary, from rounding up to 2.
        tests.update(ids[: min(len(ids) - 1, math.ceil(test_share * len(ids) - 1e-9))])
    return {id_: TEST if id_ in tests else TRAIN for id_, _ in meshes}


def _read_record(folder: Path) -> Record:
    path = folder / RECORD
    try:
        return TypeAdapter(Record).validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise CatalogueError(f"{path}: {' '.join(str(error).split())}") from error


def _read_mesh(folder: Path, split: str) -> Mesh:
    record = _read_record(folder)
    (visual, *_), parts = (_read_groups(folder / name) for name in (VISUAL, COLLISION))
    return Mesh(
        record.id,
        record.category,
        record.source,
        split,
        visual,
        tuple(parts),
        folder / COLLISION,
        record.volume_m3,
        np.array(record.com_obj_m),
        np.array(record.inertia_obj_kg_m2),
        np.array(record.extents_m),
    )


def _read_groups(path: Path) -> list[trimesh.Trimesh]:
    try:
        return read_groups(path)
    except (OSError, ValueError) as error:
        raise CatalogueError(f"{path}: {error}") from error


def _row(mesh: Mesh, status: str) -> dict[str, object]:
    x_mm, y_mm, z_mm = (f"{side * 1e3:.1f}" for side in mesh.extents_m_3)
    return {
        "id": mesh.id,
        "category": mesh.category,
        "source": mesh.source,
        "split": mesh.split,
        "x_mm": x_mm,
        "y_mm": y_mm,
        "z_mm": z_mm,
        "volume_cm3": f"{mesh.volume_m3 * 1e6:.2f}",
        "faces": len(mesh.visual.faces),
        "convex_parts": len(mesh.parts),
        "watertight": mesh.visual.is_watertight,
        "status": status,
    }
