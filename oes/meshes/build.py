"""Construction of a catalogue: the study's meshes, or all meshes of a user's folder."""

import hashlib
import logging
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from oes.config import params
from oes.meshes.catalogue import (
    BLOCK,
    TEST,
    Catalogue,
    CatalogueError,
    Rejection,
    assign_splits,
    load_catalogue,
    save_catalogue,
    write_mesh,
)
from oes.meshes.draft import Draft, placed
from oes.meshes.generators.blocks import BLOCKS
from oes.meshes.generators.mit_push import OUTLINES_MM, plate
from oes.meshes.generators.procedural import GENERATORS, generate
from oes.meshes.ingest import (
    Candidate,
    IngestConfig,
    folder_candidates,
    ingest,
    shapenet_candidates,
)
from oes.stage import publish

log = logging.getLogger(__name__)

CACHE = Path(".work/convex")
MIT_PUSH = "mit_push"


@params
class SizeConfig:
    """Sizes of meshes.

    ``min_m``, ``mode_m``, ``max_m``: triangular distribution of the longest horizontal side.
    ``plate_min_m``, ``plate_max_m``: range of the uniform height of MIT Push plates.
    ``block_unit_m``: half the side of the cube among the blocks.
    """

    min_m: float
    mode_m: float
    max_m: float
    plate_min_m: float
    plate_max_m: float
    block_unit_m: float


@params
class MeshesConfig:
    """The section ``meshes`` of params.yaml.

    ``per_category``: number of cameras, mugs, bowls and beds each.
    ``test_share``: share of each stratum in split 'test', rounded up; a lone mesh is in 'train'.
    ``shapenet``: ShapeNetCore folder with those categories; null generates them.
    ``folder``: folder whose meshes are added, or null.
    ``tile_px``: side of a mesh's picture on the contact sheet.
    """

    seed: int
    per_category: int
    test_share: float
    shapenet: str | None
    folder: str | None
    size: SizeConfig
    ingest: IngestConfig
    tile_px: int


def build_catalogue(cfg: MeshesConfig, out: Path) -> Catalogue:
    """MIT Push plates, blocks, the four categories and the user's meshes; ``out`` appears whole.

    Raises CatalogueError if a requested source has no usable mesh.
    """
    with _published(out) as folder:
        strata, rejections = [], list[Rejection]()
        categories = () if cfg.shapenet else tuple(GENERATORS)
        for draft, stratum, longest_m in (
            *_plates(cfg),
            *_blocks(cfg),
            *_generated(cfg, categories),
        ):
            write_mesh(*placed(draft, longest_m, cfg.ingest.stand), folder / draft.id)
            strata.append((draft.id, stratum))
        for category in GENERATORS if cfg.shapenet else ():
            candidates = shapenet_candidates(Path(str(cfg.shapenet)), category)
            strata += _add_shapenet(candidates, cfg, folder, rejections)
        if cfg.folder is not None:
            reserved = {id_ for id_, _ in strata}
            candidates = folder_candidates(Path(cfg.folder), cfg.ingest, reserved)
            strata += _add_files(candidates, cfg, folder, rejections)
        save_catalogue(folder, assign_splits(strata, cfg.test_share, cfg.seed), rejections)
    return load_catalogue(out)


def ingest_folder(folder: Path, cfg: MeshesConfig, out: Path) -> Catalogue:
    """All usable meshes below ``folder`` as a catalogue at ``out``, each in split 'test'.

    Logs the number of files done and the time left. Raises CatalogueError if there is no mesh file,
    or none is usable (with the commonest reasons).
    """
    with _published(out) as part:
        rejections: list[Rejection] = []
        added = _add_files(folder_candidates(folder, cfg.ingest, set()), cfg, part, rejections)
        save_catalogue(part, {id_: TEST for id_, _ in added}, rejections)
    return load_catalogue(out)


def named_rng(seed: int, *names: str) -> np.random.Generator:
    """A random stream for these names; no mesh depends on how many others there are."""
    digest = hashlib.sha256("/".join([str(seed), *names]).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "big"))


def _longest_m(id_: str, cfg: MeshesConfig) -> float:
    size = cfg.size
    return float(named_rng(cfg.seed, id_, "size").triangular(size.min_m, size.mode_m, size.max_m))


def _plates(cfg: MeshesConfig) -> Iterator[tuple[Draft, str, float]]:
    """Each plate, its stratum (rectangles, triangles, ellipses, ...) and longest side (m)."""
    for name in OUTLINES_MM:
        id_ = f"mit_{name}"
        rng, longest_m = named_rng(cfg.seed, id_, "height"), _longest_m(id_, cfg)
        height_m = float(rng.uniform(cfg.size.plate_min_m, cfg.size.plate_max_m))
        shape = plate(name, longest_m, height_m)
        status = f"generated; height {height_m * 1e3:.1f} mm, 12.7 mm in the original"
        draft = Draft(id_, MIT_PUSH, "parametric", status, shape.solid, shape.parts)
        yield draft, id_.rstrip("123"), longest_m


def _blocks(cfg: MeshesConfig) -> Iterator[tuple[Draft, str, float]]:
    """Each block, its stratum (its family) and longest side (m)."""
    for family, blocks in BLOCKS.items():
        for name, shape in blocks.items():
            status = f"generated; 1 unit is {cfg.size.block_unit_m * 1e3:.1f} mm"
            draft = Draft(f"{BLOCK}_{name}", BLOCK, "parametric", status, shape.solid, shape.parts)
            longest_m = float(shape.solid.extents[:2].max()) * cfg.size.block_unit_m
            # The slash keeps it apart from the strata of a user's folders.
            yield draft, f"{BLOCK}/{family}", longest_m


def _generated(cfg: MeshesConfig, categories: Sequence[str]) -> Iterator[tuple[Draft, str, float]]:
    for category in categories:
        for style in range(cfg.per_category):
            id_ = f"{category}_{style + 1}"
            shape = generate(category, style, named_rng(cfg.seed, id_, "shape"))
            draft = Draft(id_, category, "procedural", "generated", shape.solid, shape.parts)
            yield draft, category, _longest_m(id_, cfg)


def _ingest(
    candidates: Sequence[Candidate], cfg: MeshesConfig, folder: Path
) -> tuple[list[tuple[str, str]], list[Rejection]]:
    """(id, category) of the accepted candidates, and the rejections of the others."""
    sizes_m = [_longest_m(candidate.id, cfg) for candidate in candidates]
    rejections = ingest(candidates, sizes_m, cfg.ingest, folder, CACHE)
    return [(c.id, c.category) for c in candidates if (folder / c.id).exists()], rejections


def _add_files(
    candidates: Sequence[Candidate], cfg: MeshesConfig, folder: Path, rejections: list[Rejection]
) -> list[tuple[str, str]]:
    """(id, category) of the accepted candidates; the others are appended to ``rejections``."""
    # The category of blocks selects the falling task; a user's meshes are pushed.
    candidates = [replace(c, category="custom") if c.category == BLOCK else c for c in candidates]
    accepted, rejected = _ingest(candidates, cfg, folder)
    rejections += rejected
    if not accepted:
        reasons = Counter(rejection.reason for rejection in rejected).most_common(3)
        why = "; ".join(f"{number} x {reason}" for reason, number in reasons)
        raise CatalogueError(f"none of {len(candidates)} meshes is usable: {why}")
    counts = len(accepted), len(candidates), len(rejected)
    log.info("%d of %d mesh files accepted, %d rejected", *counts)
    return accepted


def _add_shapenet(
    candidates: Sequence[Candidate], cfg: MeshesConfig, folder: Path, rejections: list[Rejection]
) -> list[tuple[str, str]]:
    """(id, category) of up to ``per_category`` usable models in random order."""
    category = candidates[0].category
    order = named_rng(cfg.seed, "shapenet", category).permutation(len(candidates))
    queue = [candidates[i] for i in order]
    accepted: list[tuple[str, str]] = []
    while queue and len(accepted) < cfg.per_category:
        count = cfg.per_category - len(accepted)
        found, rejected = _ingest(queue[:count], cfg, folder)
        accepted, queue = accepted + found, queue[count:]
        rejections += rejected
    if not accepted:
        raise CatalogueError(
            f"{cfg.shapenet}: none of {len(candidates)} models of category '{category}' is usable"
        )
    return accepted


@contextmanager
def _published(out: Path) -> Iterator[Path]:
    """A new folder that replaces ``out`` if the block ends without an error."""
    part = out.with_name(f".{out.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    yield part
    publish(part, out)
