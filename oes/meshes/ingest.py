"""Foreign meshes, from a folder of files or a ShapeNetCore tree; bad files are rejected."""

import itertools
import math
import multiprocessing
import re
import resource
import shutil
import signal
from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from multiprocessing.context import ForkServerContext
from os import cpu_count
from pathlib import Path

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
    one_line,
    read_surface,
    repaired,
)
from oes.progress import progress_bar

SYNSETS = {"camera": "02942699", "mug": "03797390", "bowl": "02880940", "bed": "02818832"}
REASON = "reason.txt"
WALL_FACTOR = 10  # limit on wall-clock time over that on processor time


@params
class IngestConfig:
    """Reading of foreign files.

    ``up``: the axis 'y' or 'z' that points up; y for all GLB and ShapeNet files.
    ``limit_s``, ``limit_gb``: limits per file on processor time, which does not depend on other
    load, and on memory.
    ``max_height_m``: taller meshes are made smaller.
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
    """A mesh file to ingest."""

    id: str
    category: str
    source: str
    path: Path
    is_y_up: bool


def folder_candidates(
    folder: Path, cfg: IngestConfig, reserved: Collection[str]
) -> list[Candidate]:
    """Every mesh file below ``folder``; its category is the first subfolder, or 'custom'.

    Ids come from paths and differ from those in ``reserved``. Raises CatalogueError without files.
    """
    if not folder.is_dir():
        raise CatalogueError(f"{folder}: no such folder of meshes")
    found: dict[str, Candidate] = {}
    paths = [p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file()]
    for path in sorted(paths):
        relative = path.relative_to(folder)
        name = slug("_".join(relative.with_suffix("").parts)) or "mesh"
        names = itertools.chain([name], (f"{name}_{i}" for i in itertools.count(2)))
        id_ = next(n for n in names if n not in found and n not in reserved)
        category = slug(relative.parts[0]) or "custom" if len(relative.parts) > 1 else "custom"
        is_y_up = cfg.up == "y" or path.suffix.lower() == ".glb"
        found[id_] = Candidate(id_, category, str(relative), path, is_y_up)
    if not found:
        raise CatalogueError(f"{folder}: no file ending in {', '.join(SUFFIXES)}")
    return list(found.values())


def shapenet_candidates(root: Path, category: str) -> list[Candidate]:
    """Models of a category in ShapeNetCore v2 or v1. Raises CatalogueError without any."""
    synset = SYNSETS[category]
    folder = root / synset
    paths = sorted([*folder.glob("*/models/model_normalized.obj"), *folder.glob("*/model.obj")])
    if not paths:
        layouts = f"{synset}/<id>/models/model_normalized.obj or {synset}/<id>/model.obj"
        raise CatalogueError(f"{root}: no ShapeNet models of category '{category}' ({layouts})")
    models = [path.relative_to(folder).parts[0] for path in paths]
    return [
        Candidate(f"{category}_{slug(model)}", category, f"shapenet:{synset}/{model}", path, True)
        for model, path in zip(models, paths, strict=True)
    ]


def slug(text: str) -> str:
    """A name of lower-case letters, digits and underscores, safe for a folder."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:60]


def ingest(
    candidates: Sequence[Candidate],
    longest_m: Sequence[float],
    cfg: IngestConfig,
    out: Path,
    cache: Path,
) -> list[Rejection]:
    """Write every usable candidate to ``out/<id>``; returns the rejections, in order.

    Each file has a process of its own: one that crashes or exceeds its limits is rejected too.
    """
    # A fork server starts processes fast, yet without this one's threads and memory.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    jobs = list(zip(candidates, longest_m, strict=True))
    work = partial(_guarded, context=context, cfg=cfg, out=out, cache=cache)
    with ThreadPoolExecutor(cpu_count()) as pool:
        futures = [pool.submit(work, job) for job in jobs]
        # Counted as they end, so that one slow file does not hold up the count.
        list(progress_bar(as_completed(futures), total=len(jobs), desc="ingest", unit="file"))
    reasons = [future.result() for future in futures]
    pairs = zip(candidates, reasons, strict=True)
    return [Rejection(c.source, c.category, reason) for c, reason in pairs if reason]


def prepare_mesh(
    candidate: Candidate, longest_m: float, cfg: IngestConfig, cache: Path
) -> tuple[Draft, Mass]:
    """Read, repair, decompose and place one mesh file. Raises MeshRejected or NoParts."""
    mesh = read_surface(candidate.path, cfg.repair)
    check_surface(mesh, cfg.repair)
    if candidate.is_y_up:
        mesh.apply_transform(UPRIGHT_FROM_Y)
    mesh.apply_translation(-mesh.bounds.mean(0))
    # Repairs have absolute tolerances, so the mesh has its final size before.
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
    """Run one job in a child process; returns None, or the reason of a rejection."""
    candidate, longest_m = job
    folder = out / candidate.id
    folder.mkdir(parents=True, exist_ok=True)
    args = candidate, longest_m, cfg, folder, cache
    child = context.Process(target=_work, args=args, daemon=True)
    child.start()
    child.join(WALL_FACTOR * cfg.limit_s)
    is_late = child.is_alive() or child.exitcode == -signal.SIGXCPU
    crash = f"crashed (exit {child.exitcode})"
    reason = f"took longer than {cfg.limit_s:g} s" if is_late else crash
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
    """Job of the child process: writes either a complete mesh or a reason to ``folder``."""
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
        (folder / REASON).write_text(f"unusable: {one_line(error)}")
