"""What the baselines that forecast pictures have learned, on test episodes: a baseline that learned
nothing is no comparison.
"""

import shutil
from pathlib import Path

import numpy as np

from oes.report.names import MODELS
from oes.report.rows import Columns, Kind, read_columns, select
from oes.report.table import Table, rounded

FORECASTS: dict[str, Kind] = {
    "clip": int,
    "T": int,
    "psnr_db": float,
    "ssim": float,
    "still_psnr_db": float,
    "still_ssim": float,
    "error_mm": float,
    "still_mm": float,
}
VIDEO_MODELS = ("visual_foresight", "planet")
NOTE = (
    "Forecasts from the first picture of test episodes (two novel objects), seen from above; in brackets what that "
    "first picture would score in place of the forecast. Error: for Visual Foresight, of where the pixels of the "
    "objects' centres are expected; for PlaNet, of the distance to random goals that its reward tells; in brackets, if "
    "nothing moved."
)
Figures = dict[str, dict[str, dict[str, float]]]  # model -> T -> name -> mean


def video_figures(dynamics: Path) -> Figures:
    """Means over clips for the models whose ``forecasts.csv`` is there."""
    found: Figures = {}
    for model in VIDEO_MODELS:
        path = dynamics / f"pushing-{model}" / "forecasts.csv"
        if path.exists():
            rows = read_columns([path], FORECASTS)
            found[model] = {str(T): _means(select(rows, T=T)) for T in np.unique(rows["T"])}
    return found


def video_table(figures: Figures, notes: tuple[str, ...]) -> Table:
    """One row a model and horizon."""
    at = [(model, T, values) for model, by_T in figures.items() for T, values in by_T.items()]
    return Table(
        name="video",
        caption="What the baselines that forecast pictures have learned",
        header=("model", "T", "PSNR (dB)", "SSIM", "error (mm)", "clips"),
        cells=tuple(
            (
                MODELS[model],
                T,
                f"{values['psnr_db']:.1f} ({values['still_psnr_db']:.1f})",
                f"{values['ssim']:.3f} ({values['still_ssim']:.3f})",
                f"{values['error_mm']:.1f} ({values['still_mm']:.1f})",
                f"{values['n']:.0f}",
            )
            for model, T, values in at
        ),
        records=tuple({"model": model, "T": T, **rounded(values)} for model, T, values in at),
        notes=(NOTE, *notes),
    )


def copy_forecasts(dynamics: Path, figures: Figures, folder: Path) -> dict[str, str]:
    """The pictures of forecasts, from ``folder``'s parent, with their captions."""
    captions: dict[str, str] = {}
    for model in figures:
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / f"forecasts-{model.replace('_', '-')}.png"
        shutil.copyfile(dynamics / f"pushing-{model}" / "forecasts.png", target)
        captions[f"{folder.name}/{target.name}"] = (
            f"{MODELS[model]}: above what came, below what was forecast."
        )
    return captions


def _means(rows: Columns) -> dict[str, float]:
    names = [name for name in FORECASTS if name not in ("clip", "T")]
    return {name: float(rows[name].mean()) for name in names} | {"n": len(rows["T"])}
