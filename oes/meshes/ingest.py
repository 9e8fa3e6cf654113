"""Meshes from elsewhere: any folder of mesh files, or a ShapeNetCore tree. A bad file is rejected
with a reason.
"""

import itertools
import math
import multiprocessing
import re
import resource
import shutil
import signal
from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing.context import ForkServerContext
from os import cpu_count
from pathlib import Path

from tqdm import tqdm

from oes.config import params
from oes.meshes.catalogue import RECORD, CatalogueError, Rejection, write_mesh
from oes.meshes.convex import ConvexConfig, Mass, NoParts, decompose
from oes.meshes.draft import Draft, MeshRejected, StandConfig, placed
from oes.meshes.repair import (
    READER_ERRORS,
    SUFFIXES,
    UPRIGHT_FROM_Y,
    RepairConfig,
    check_surface,
    read_surface,
    repaired,
)

SYNSETS = {"camera": "02942699", "mug": "03797390", "bowl": "02880940", "bed": "02818832"}
REASON = "reason.txt"
PATIENCE = 10


@params
class IngestConfig:
    """How foreign files are read: which axis is up (GLB and ShapeNet: always y), and limits a file.

    What would be taller than ``max_height_m`` at the size drawn for it is made smaller. ``limit_s``
    is processor time, so that a busy machine rejects nothing more; ten times that by the clock ends
    it too.
    """

    up: str
    limit_s: float
    limit_gb: float
    max_height_m: float
    repair: RepairConfig
    stand: StandConfig
    convex: ConvexConfig

    def __post_init__(self) -> None:
        if self.up not in ("y", "z"):
            raise ValueError(f"up is 'y' or 'z', not '{self.up}'")


@dataclass(frozen=True)
class Candidate:
    """A mesh file that may join the catalogue, with the longest horizontal side it is to have."""

    id: str
    category: str
    source: str
    path: Path
    is_y_up: bool


def folder_candidates(
    folder: Path, cfg: IngestConfig, reserved: Collection[str]
) -> list[Candidate]:
    """Every mesh file under ``folder``; a mesh's category is its first subfolder, or 'custom' at
    the top.

    Ids come from the path; those in ``reserved`` are not given again.
    """
    if not folder.is_dir():
        raise CatalogueError(f"{folder}: no such folder of meshes")
    found: dict[str, Candidate] = {}
    for path in sorted(
        p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file()
    ):
        relative = path.relative_to(folder)
        name = slug("_".join(relative.with_suffix("").parts)) or "mesh"
        names = itertools.chain([name], (f"{name}_{i}" for i in itertools.count(2)))
        id_ = next(n for n in names if n not in found and n not in reserved)
        category = slug(relative.parts[0]) or "custom" if len(relative.parts) > 1 else "custom"
        found[id_] = Candidate(
            id_, category, str(relative), path, cfg.up == "y" or path.suffix.lower() == ".glb"
        )
    if not found:
        raise CatalogueError(f"{folder}: no file ending in {', '.join(SUFFIXES)}")
    return list(found.values())


def shapenet_candidates(root: Path, category: str) -> list[Candidate]:
    """One category's models in ShapeNetCore v2 (<synset>/<id>/models/model_normalized.obj) or v1
    (<id>/model.obj).
    """
    synset = SYNSETS[category]
    folder = root / synset
    paths = sorted([*folder.glob("*/models/model_normalized.obj"), *folder.glob("*/model.obj")])
    if not paths:
        layouts = f"{synset}/<id>/models/model_normalized.obj or {synset}/<id>/model.obj"
        raise CatalogueError(f"{root}: no ShapeNet models of category '{category}' ({layouts})")
    named = [(path.relative_to(folder).parts[0], path) for path in paths]
    return [
        Candidate(f"{category}_{slug(model)}", category, f"shapenet:{synset}/{model}", path, True)
        for model, path in named
    ]


def slug(text: str) -> str:
    """Lower-case letters, digits and underscores only: safe as a folder's name."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:60]


def ingest(
    candidates: Sequence[Candidate],
    longest_m: Sequence[float],
    cfg: IngestConfig,
    out: Path,
    cache: Path,
) -> list[Rejection]:
    """Prepare each candidate into ``out/<id>``, each in a process of its own; returns those
    rejected, in order.

    A file that crashes its process, or takes it beyond the limits of time and memory, is rejected
    like any other.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    jobs = list(zip(candidates, longest_m, strict=True))
    work = partial(_guarded, context=context, cfg=cfg, out=out, cache=cache)
    with ThreadPoolExecutor(cpu_count()) as pool:
        reasons = list(tqdm(pool.map(work, jobs), "ingest", len(jobs), unit="mesh", disable=None))
    return [
        Rejection(c.source, c.category, why)
        for c, why in zip(candidates, reasons, strict=True)
        if why
    ]


def prepare_mesh(
    candidate: Candidate, longest_m: float, cfg: IngestConfig, cache: Path
) -> tuple[Draft, Mass]:
    """Read, mend, decompose and place one mesh file. Raises Rejected or NoParts."""
    mesh = read_surface(candidate.path, cfg.repair)
    check_surface(mesh, cfg.repair)
    if candidate.is_y_up:
        mesh.apply_transform(UPRIGHT_FROM_Y)
    mesh.apply_translation(-mesh.bounds.mean(0))
    mesh.vertices *= longest_m / float(mesh.extents[:2].max())
    mesh, status = repaired(mesh, cfg.repair)
    parts = decompose(mesh, cfg.convex, cache)
    draft = Draft(candidate.id, candidate.category, candidate.source, status, mesh, parts)
    draft, mass = placed(draft, longest_m, cfg.stand)
    shrink = cfg.max_height_m / float(draft.visual.extents[2])
    return (draft, mass) if shrink >= 1 else placed(draft, shrink * longest_m, cfg.stand)


def _guarded(
    job: tuple[Candidate, float],
    context: ForkServerContext,
    cfg: IngestConfig,
    out: Path,
    cache: Path,
) -> str | None:
    """Run one job in a child process; None when the mesh was taken, else the reason."""
    candidate, longest_m = job
    folder = out / candidate.id
    folder.mkdir(parents=True, exist_ok=True)
    child = context.Process(
        target=_work, args=(candidate, longest_m, cfg, folder, cache), daemon=True
    )
    child.start()
    child.join(PATIENCE * cfg.limit_s)
    is_late = child.is_alive() or child.exitcode == -signal.SIGXCPU
    reason = (
        f"took longer than {cfg.limit_s:g} s" if is_late else f"crashed (exit {child.exitcode})"
    )
    child.kill()
    child.join()
    if (folder / RECORD).exists():
        return None
    note = folder / REASON
    reason = note.read_text() if note.exists() else reason
    shutil.rmtree(folder)
    return reason


def _work(
    candidate: Candidate, longest_m: float, cfg: IngestConfig, folder: Path, cache: Path
) -> None:
    """The child's job: leaves either a whole mesh or a reason in ``folder``."""
    limit = int(cfg.limit_gb * 2**30)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(cfg.limit_s), resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        draft, mass = prepare_mesh(candidate, longest_m, cfg, cache)
        write_mesh(draft, mass, folder)
    except (MeshRejected, NoParts) as rejection:
        (folder / REASON).write_text(str(rejection))
    except READER_ERRORS as error:
        (folder / REASON).write_text(
            f"unusable: {type(error).__name__}: {' '.join(str(error).split())[:120]}"
        )
