"""What reports/ keeps beside tables: the weights of the trained models, the contact sheet, some
films.
"""

import shutil
from itertools import product
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from oes.report.names import VARIANTS
from oes.report.rows import Columns, select
from oes.training.tensor_io import ordered

LARGE_BYTES = 500_000
FILMS = 2  # of successes and of failures each


class WeightsError(ValueError):
    """A weights file that cannot be read; names it."""


def copy_half(source: Path, target: Path) -> None:
    """Weights in half precision (float32 tensors only), with the same metadata: half the bytes in
    git.
    """
    try:
        with safe_open(source, framework="np") as file:
            about = file.metadata()
            tensors = {name: file.get_tensor(name) for name in file.keys()}
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{source}: not a readable safetensors file: {error}") from error
    with np.errstate(over="ignore"):
        halved = {
            name: x.astype(np.float16) if x.dtype == np.float32 else x
            for name, x in tensors.items()
        }
    overflown = [
        name
        for name, value in halved.items()
        if value.dtype == np.float16 and not np.isfinite(value).all()
    ]
    if overflown:
        raise WeightsError(f"{source}: does not fit half precision: {', '.join(overflown)}")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(ordered(save(halved, about)))


def _is_variant(folder: str) -> bool:
    return folder.partition("-")[2] in VARIANTS


def copy_models(perception: Path, dynamics: Path, folder: Path) -> None:
    """``perception/`` and ``dynamics/<task>-<model>/``, but for ablations; what is large, in half
    precision.

    Raises FileNotFoundError when there is no dynamics model.
    """
    copy_half(
        perception / "perception.safetensors", folder / "perception" / "perception.safetensors"
    )
    models = [
        path
        for path in sorted(dynamics.glob("*/model.safetensors"))
        if not _is_variant(path.parent.name)
    ]
    if not models:
        raise FileNotFoundError(f"{dynamics}: holds no model.safetensors in any folder")
    for source in models:
        target = folder / "dynamics" / source.parent.name / source.name
        target.parent.mkdir(parents=True, exist_ok=True)
        (copy_half if source.stat().st_size > LARGE_BYTES else shutil.copyfile)(source, target)


def copy_films(trials: Path, rows: Columns, scenario: str, model: str, folder: Path) -> list[str]:
    """Films of two successes and two failures (the last ones), if there are any, as MP4 and GIF.

    Gives their paths from ``folder``'s parent.
    """
    names: list[str] = []
    own = select(rows, scenario=scenario, model=model)
    for is_success in (True, False):
        filmed = [Path(name) for name in select(own, success=is_success)["video"] if name]
        for film, suffix in product(filmed[-FILMS:], (".mp4", ".gif")):
            folder.mkdir(parents=True, exist_ok=True)
            source = (trials / f"{scenario}-{model}" / film).with_suffix(suffix)
            shutil.copyfile(source, folder / f"{scenario}-{source.name}")
            names.append(f"{folder.name}/{scenario}-{source.name}")
    return names
