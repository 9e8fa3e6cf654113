"""Making a catalogue: the study's 31 meshes, or all meshes of somebody's folder."""

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
from oes.meshes.sheet import write_sheet
from oes.stage import publish

log = logging.getLogger(__name__)

CACHE = Path(".work/convex")
CONTACT_SHEET = "contact_sheet.png"
MIT_PUSH = "mit_push"


@params
class SizeConfig:
    """Longest horizontal side of a mesh: a triangular distribution; the height of MIT Push plates:
    uniform; half the side of the cube among the blocks.
    """

    min_m: float
    mode_m: float
    max_m: float
    plate_min_m: float
    plate_max_m: float
    block_unit_m: float


@params
class MeshesConfig:
    """The meshes stage: ``per_category`` cameras, mugs, bowls and beds, generated, or from a
    ShapeNetCore folder.

    ``folder`` adds all meshes of any folder. ``test_share`` of each category (of MIT Push and of
    the blocks: of each family), rounded up, is held out; a lone mesh is for training.
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
    """The MIT Push plates, the four categories, the blocks and the meshes of the user's folder;
    ``out`` appears whole.

    Raises CatalogueError when a source that was asked for gives nothing usable.
    """
    with _whole(out) as folder:
        taken = [
            (_add(draft, _longest_m(draft.id, cfg), cfg, folder)[0], family)
            for family, draft in _plates(cfg)
        ]
        taken += [
            (_add(draft, longest_m, cfg, folder)[0], family)
            for family, draft, longest_m in _blocks(cfg)
        ]
        rejections: list[Rejection] = []
        for category in GENERATORS:
            if cfg.shapenet is None:
                taken += [
                    _add(draft, _longest_m(draft.id, cfg), cfg, folder)
                    for draft in _generated(category, cfg)
                ]
            else:
                taken += _add_shapenet(
                    shapenet_candidates(Path(cfg.shapenet), category), cfg, folder, rejections
                )
        if cfg.folder is not None:
            found = folder_candidates(Path(cfg.folder), cfg.ingest, {id_ for id_, _ in taken})
            taken += _add_files(found, cfg, folder, rejections)
        catalogue = save_catalogue(
            folder, assign_splits(taken, cfg.test_share, cfg.seed), rejections
        )
        write_sheet(catalogue, cfg.tile_px, folder / CONTACT_SHEET)
    return load_catalogue(out)


def ingest_folder(folder: Path, cfg: MeshesConfig, out: Path) -> Catalogue:
    """All usable meshes under ``folder`` as a catalogue at ``out``, every one in split 'test'.

    Raises CatalogueError when there is no mesh file, or none is usable (with the commonest
    reasons).
    """
    with _whole(out) as aside:
        rejections: list[Rejection] = []
        taken = _add_files(folder_candidates(folder, cfg.ingest, set()), cfg, aside, rejections)
        catalogue = save_catalogue(aside, {id_: TEST for id_, _ in taken}, rejections)
        write_sheet(catalogue, cfg.tile_px, aside / CONTACT_SHEET)
    return load_catalogue(out)


def drawn(seed: int, *words: str) -> np.random.Generator:
    """A generator that depends on the seed and these words only: no mesh's numbers depend on
    another mesh.
    """
    text = "/".join([str(seed), *words])
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big"))


def _longest_m(id_: str, cfg: MeshesConfig) -> float:
    return float(
        drawn(cfg.seed, id_, "size").triangular(cfg.size.min_m, cfg.size.mode_m, cfg.size.max_m)
    )


def _plates(cfg: MeshesConfig) -> Iterator[tuple[str, Draft]]:
    """Each plate with its family, so that the split holds out one rectangle, one triangle and one
    ellipse.
    """
    for name in OUTLINES_MM:
        id_ = f"mit_{name}"
        height_m = float(
            drawn(cfg.seed, id_, "height").uniform(cfg.size.plate_min_m, cfg.size.plate_max_m)
        )
        shape = plate(name, _longest_m(id_, cfg), height_m)
        status = f"generated; height {height_m * 1e3:.1f} mm, 12.7 mm in the original"
        yield (
            id_.rstrip("123"),
            Draft(id_, MIT_PUSH, "parametric", status, shape.solid, shape.parts),
        )


def _blocks(cfg: MeshesConfig) -> Iterator[tuple[str, Draft, float]]:
    """Each block with its stratum (its family, as no folder of the user's can be called) and
    longest side (m).
    """
    for family, blocks in BLOCKS.items():
        for name, shape in blocks.items():
            status = f"generated; 1 unit is {cfg.size.block_unit_m * 1e3:.1f} mm"
            draft = Draft(f"{BLOCK}_{name}", BLOCK, "parametric", status, shape.solid, shape.parts)
            longest_m = float(shape.solid.extents[:2].max()) * cfg.size.block_unit_m
            yield f"{BLOCK}/{family}", draft, longest_m


def _generated(category: str, cfg: MeshesConfig) -> Iterator[Draft]:
    for style in range(cfg.per_category):
        id_ = f"{category}_{style + 1}"
        shape = generate(category, style, drawn(cfg.seed, id_, "shape"))
        yield Draft(id_, category, "procedural", "generated", shape.solid, shape.parts)


def _add(draft: Draft, longest_m: float, cfg: MeshesConfig, folder: Path) -> tuple[str, str]:
    write_mesh(*placed(draft, longest_m, cfg.ingest.stand), folder / draft.id)
    return draft.id, draft.category


def _add_files(
    candidates: Sequence[Candidate], cfg: MeshesConfig, folder: Path, rejections: list[Rejection]
) -> list[tuple[str, str]]:
    """Ingest candidates; gives (id, category) of those taken and extends ``rejections`` by the
    others.

    They are pushed, so those in a folder called as the falling blocks' category count as 'custom'.
    """
    candidates = [replace(c, category="custom") if c.category == BLOCK else c for c in candidates]
    refused = ingest(
        candidates, [_longest_m(c.id, cfg) for c in candidates], cfg.ingest, folder, CACHE
    )
    rejections += refused
    taken = [(c.id, c.category) for c in candidates if (folder / c.id).exists()]
    if not taken:
        reasons = Counter(r.reason for r in refused).most_common(3)
        why = "; ".join(f"{number} x {reason}" for reason, number in reasons)
        raise CatalogueError(f"none of {len(candidates)} meshes is usable: {why}")
    log.info("%d of %d mesh files taken, %d rejected", len(taken), len(candidates), len(refused))
    return taken


def _add_shapenet(
    candidates: Sequence[Candidate], cfg: MeshesConfig, folder: Path, rejections: list[Rejection]
) -> list[tuple[str, str]]:
    """Up to ``per_category`` models, in an order drawn from the seed, passing over those
    rejected.
    """
    order = drawn(cfg.seed, "shapenet", candidates[0].category).permutation(len(candidates))
    queue = [candidates[i] for i in order]
    taken: list[tuple[str, str]] = []
    while queue and len(taken) < cfg.per_category:
        batch, queue = (
            queue[: cfg.per_category - len(taken)],
            queue[cfg.per_category - len(taken) :],
        )
        rejections += ingest(
            batch, [_longest_m(c.id, cfg) for c in batch], cfg.ingest, folder, CACHE
        )
        taken += [(c.id, c.category) for c in batch if (folder / c.id).exists()]
    if not taken:
        raise CatalogueError(
            f"none of {len(candidates)} ShapeNet models of '{candidates[0].category}' is usable"
        )
    return taken


@contextmanager
def _whole(out: Path) -> Iterator[Path]:
    """A fresh folder beside ``out`` that replaces it when the block ends well."""
    aside = out.with_name(f".{out.name}.aside")
    shutil.rmtree(aside, ignore_errors=True)
    aside.mkdir(parents=True)
    yield aside
    publish(aside, out)
