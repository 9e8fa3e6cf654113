"""Trained weights and meshes for the apps: those of a study that has run, or those kept in git."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from oes.config import PARAMS, load
from oes.dynamics import MODELS
from oes.meshes.build import MeshesConfig, build_catalogue
from oes.meshes.catalogue import Catalogue, load_catalogue

DATASETS = Path("datasets")  # outputs of the stages
KEPT = Path("reports/models")  # weights in git
FALLBACK_MESHES = Path(".work/demo-meshes")


class WeightsMissing(ValueError):
    """No folder has the trained weights that an app needs."""


def find_weights(
    roots: Sequence[Path], required: Sequence[str], task: str = "pushing"
) -> tuple[Path, dict[str, Path]]:
    """Perception weights and the folder of each trained model, from the first root that has both.

    Raises WeightsMissing if no root has them, the ``required`` models among them.
    """
    for root in roots:
        perception = root / "perception" / "perception.safetensors"
        folders = {name: root / "dynamics" / f"{task}-{name}" for name in MODELS}
        trained = {
            name: path for name, path in folders.items() if (path / "model.safetensors").is_file()
        }
        if perception.is_file() and trained and trained.keys() >= set(required):
            return perception, trained
    raise WeightsMissing(
        f"no trained weights in {' or '.join(map(str, roots))}: run `make all` first"
    )


def find_catalogue() -> Catalogue:
    """The study's meshes, or plates and blocks with the same split, which take a second to make."""
    for folder in (DATASETS / "meshes", FALLBACK_MESHES):
        if folder.exists():
            return load_catalogue(folder)
    cfg = load(PARAMS, "meshes", MeshesConfig)
    return build_catalogue(
        replace(cfg, per_category=0, shapenet=None, folder=None), FALLBACK_MESHES
    )
