"""The catalogue of meshes on disk: one folder a mesh, catalogue.csv (the list and the split),
rejected.csv.
"""

import csv
import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked

from oes.episode import FALLING, PUSHING, Floats
from oes.meshes.convex import Mass
from oes.meshes.draft import Draft
from oes.meshes.objfile import read_groups, write_groups

LIST, REJECTED = "catalogue.csv", "rejected.csv"
VISUAL, COLLISION, RECORD = "visual.obj", "collision.obj", "mesh.json"
TRAIN, TEST = "train", "test"
BLOCK = "block"  # the category of meshes that fall; all others are pushed


class CatalogueError(ValueError):
    """A folder that is not a whole catalogue, or a mesh asked for that it does not hold."""


@dataclass(frozen=True)
class Mesh:
    """One object mesh in its obj frame: metres, z up, at rest on its base, origin at its box
    centre.

    ``parts`` are convex and fill it; ``collision_path`` holds them as the groups of one OBJ. Mass
    properties are for a density of 1 kg/m3, the inertia about the centre of mass.
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

    @property
    def mass(self) -> Mass:
        """Volume, centre of mass and inertia together, as ``convex.scaled_mass`` takes them."""
        return Mass(self.volume_m3, self.com_obj_3, self.inertia_obj_33)


@dataclass(frozen=True)
class Catalogue:
    """Meshes by id, in the order of catalogue.csv."""

    meshes: dict[str, Mesh]

    def split(self, name: str, task: str = PUSHING) -> list[Mesh]:
        """The meshes of 'train' or 'test' for a task: blocks fall, all others are pushed.

        Raises CatalogueError when there are none.
        """
        mine = [
            mesh for mesh in self.meshes.values() if (mesh.category == BLOCK) == (task == FALLING)
        ]
        found = [mesh for mesh in mine if mesh.split == name]
        if not found:
            counts = dict(Counter(mesh.split for mesh in mine))
            raise CatalogueError(
                f"no mesh for {task} in split '{name}'; for {task} there are {counts}"
            )
        return found

    def counts(self) -> Counter[str]:
        """Meshes in each split."""
        return Counter(mesh.split for mesh in self.meshes.values())


@dataclass(frozen=True)
class Rejection:
    """A mesh that was not taken, and why."""

    source: str
    category: str
    reason: str


@checked(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Record:
    """mesh.json: what is known of a mesh besides its triangles; lengths in metres, density 1
    kg/m3.
    """

    id: str
    category: str
    source: str
    status: str
    volume_m3: float
    com_obj_m: tuple[float, float, float]
    inertia_obj_kg_m2: tuple[
        tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]
    ]
    extents_m: tuple[float, float, float]


def write_mesh(draft: Draft, mass: Mass, folder: Path) -> None:
    """Write one placed mesh into ``folder``; mesh.json last, so that a folder with it is whole."""
    folder.mkdir(parents=True, exist_ok=True)
    write_groups(folder / VISUAL, [draft.visual])
    write_groups(folder / COLLISION, draft.parts)
    record = {
        "id": draft.id,
        "category": draft.category,
        "source": draft.source,
        "status": draft.status,
        "volume_m3": mass.volume_m3,
        "com_obj_m": mass.com_obj_3.tolist(),
        "inertia_obj_kg_m2": mass.inertia_obj_33.tolist(),
        "extents_m": draft.visual.extents.tolist(),
    }
    (folder / RECORD).write_text(json.dumps(record, indent=1) + "\n")


def save_catalogue(
    folder: Path, splits: dict[str, str], rejections: Iterable[Rejection]
) -> Catalogue:
    """List the meshes written into ``folder`` in catalogue.csv with their splits, and the rejected;
    then load them.
    """
    with (folder / REJECTED).open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["source", "category", "reason"])
        writer.writerows((r.source, r.category, r.reason) for r in rejections)
    meshes = [_read_mesh(folder / id_, split) for id_, split in splits.items()]
    rows = [_row(mesh, _read_record(folder / mesh.id).status) for mesh in meshes]
    with (folder / LIST).open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]) if rows else ["id"], lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    return Catalogue({mesh.id: mesh for mesh in meshes})


def load_catalogue(folder: Path) -> Catalogue:
    """Read a catalogue. Raises CatalogueError naming the file and what is wrong with it."""
    try:
        with (folder / LIST).open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise CatalogueError(
            f"{folder}: not a catalogue of meshes: {LIST} cannot be read ({error})"
        ) from error
    if not rows or not {"id", "split"} <= rows[0].keys():
        raise CatalogueError(f"{folder / LIST}: no meshes listed, or no columns 'id' and 'split'")
    for row in rows:
        if row["split"] not in (TRAIN, TEST) or Path(row["id"]).name != row["id"]:
            where = f"{folder / LIST}: mesh '{row['id']}', split '{row['split']}'"
            raise CatalogueError(f"{where}: not a plain name, or neither train nor test")
    meshes = [_read_mesh(folder / row["id"], row["split"]) for row in rows]
    return Catalogue({mesh.id: mesh for mesh in meshes})


def assign_splits(
    meshes: Sequence[tuple[str, str]], test_share: float, seed: int
) -> dict[str, str]:
    """Split of each (id, stratum): in every stratum the ``test_share`` (rounded up) with the lowest
    hash is test.

    A hash of the id decides, so meshes keep their split when others join other strata. A lone mesh
    is train.
    """
    ranked: dict[str, list[str]] = {}
    for id_, stratum in sorted(
        meshes, key=lambda mesh: hashlib.sha256(f"{seed}/{mesh[0]}".encode()).digest()
    ):
        ranked.setdefault(stratum, []).append(id_)
    tests: set[str] = set()
    for ids in ranked.values():
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
    surfaces = {}
    for name in (VISUAL, COLLISION):
        try:
            surfaces[name] = read_groups(folder / name)
        except (OSError, ValueError) as error:
            raise CatalogueError(f"{folder / name}: {error}") from error
    return Mesh(
        record.id,
        record.category,
        record.source,
        split,
        surfaces[VISUAL][0],
        tuple(surfaces[COLLISION]),
        folder / COLLISION,
        record.volume_m3,
        np.array(record.com_obj_m),
        np.array(record.inertia_obj_kg_m2),
        np.array(record.extents_m),
    )


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
