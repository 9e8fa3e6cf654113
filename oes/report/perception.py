"""How well perception sees, from its raw rows: detection of novel objects and prediction of unseen
views.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oes.metrics.errors import Boxes, average_precision
from oes.report.rows import Columns, optional_float, read_columns, select
from oes.report.table import Table, rounded

BOX = ("x_m", "y_m", "z_m", "width_m", "depth_m", "height_m")
DETECTIONS: dict[str, Any] = {
    "episode": int,
    "step": int,
    "num_views": int,
    **dict.fromkeys(
        ("score", "iou", "mask_iou", "centre_mm", "chamfer_mm", "normal_deg"), optional_float
    ),
    **dict.fromkeys((*BOX, *(f"true_{name}" for name in BOX)), optional_float),
}
VIEWS: dict[str, Any] = {"num_views": int, "psnr_db": float, "ssim": float}

FIGURES = ("ap_25", "ap_50", "mask_iou")
LENGTHS = ("centre_mm", "chamfer_mm", "normal_deg")


def views_key(num_views: int) -> str:
    """``1view``, ``3views``."""
    return f"{num_views}view" + "s" * (num_views > 1)


def read_detections(paths: Sequence[Path]) -> Columns:
    """The detections of several splits as if of one: the episodes of each are numbered on from the
    one before.
    """
    parts = [read_columns([path], DETECTIONS) for path in paths]
    starts = np.cumsum([0, *(part["episode"].max(initial=-1) + 1 for part in parts)])
    episodes = [part["episode"] + start for part, start in zip(parts, starts, strict=False)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in DETECTIONS}
    return columns | {"episode": np.concatenate(episodes)}


def detector_figures(rows: Columns) -> dict[str, dict[str, float]]:
    """For each number of input views: AP at IoU 0.25 and 0.5; of matched detections mask IoU,
    centre error (mm), Chamfer distance (mm) of the completed surface and the error of its normals
    (degrees).
    """
    return {
        views_key(int(count)): _figures(select(rows, num_views=count))
        for count in np.unique(rows["num_views"])
    }


def view_figures(rows: Columns) -> dict[str, dict[str, float]]:
    """For each number of input views: mean PSNR (dB), mean SSIM and the number of views
    predicted.
    """
    figures = {}
    for count in np.unique(rows["num_views"]):
        here = rows["num_views"] == count
        psnr_db, ssim = (float(rows[name][here].mean()) for name in ("psnr_db", "ssim"))
        figures[views_key(int(count))] = {"psnr_db": psnr_db, "ssim": ssim, "n": int(here.sum())}
    return figures


def detector_table(
    name: str, caption: str, figures: Mapping[str, Mapping[str, float]], notes: tuple[str, ...]
) -> Table:
    """One row for each number of input views."""
    header = (
        "input",
        "AP at IoU 0.25",
        "AP at IoU 0.5",
        "mask IoU",
        "centre error (mm)",
        "surface: Chamfer (mm)",
        "its normals (deg)",
        "true objects",
        "found boxes",
    )
    return Table(
        name=name,
        caption=caption,
        header=header,
        cells=tuple(
            (
                key,
                *(f"{values[name]:.3f}" for name in FIGURES),
                *(f"{values[name]:.1f}" for name in LENGTHS),
                f"{values['objects']:.0f}",
                f"{values['boxes']:.0f}",
            )
            for key, values in figures.items()
        ),
        records=tuple({"input": key, **rounded(values)} for key, values in figures.items()),
        notes=notes,
    )


def view_table(figures: Mapping[str, Mapping[str, float]], notes: tuple[str, ...]) -> Table:
    """One row for each number of input views."""
    return Table(
        name="view-prediction",
        caption="Prediction of the image at a camera that perception has not seen, novel objects",
        header=("input", "PSNR (dB)", "SSIM", "images"),
        cells=tuple(
            (key, f"{values['psnr_db']:.2f}", f"{values['ssim']:.3f}", str(values["n"]))
            for key, values in figures.items()
        ),
        records=tuple({"input": key, **rounded(values)} for key, values in figures.items()),
        notes=notes,
    )


def _figures(rows: Columns) -> dict[str, float]:
    is_found, is_true = ~np.isnan(rows["x_m"]), ~np.isnan(rows["true_x_m"])
    scene = rows["episode"] * (rows["step"].max() + 1) + rows["step"]
    found, true = (
        _boxes(rows, scene, keep, prefix) for keep, prefix in ((is_found, ""), (is_true, "true_"))
    )
    matched = is_found & is_true
    score_P = rows["score"][is_found]
    return {
        "ap_25": average_precision(found, score_P, true, 0.25),
        "ap_50": average_precision(found, score_P, true, 0.5),
        "mask_iou": float(rows["mask_iou"][matched].mean()) if matched.any() else 0.0,
        **{
            name: float(rows[name][matched].mean()) if matched.any() else float("nan")
            for name in LENGTHS
        },
        "objects": int(is_true.sum()),
        "boxes": int(is_found.sum()),
    }


def _boxes(
    rows: Columns, scene: np.ndarray[Any, Any], keep: np.ndarray[Any, Any], prefix: str
) -> Boxes:
    values = np.stack([rows[prefix + name][keep] for name in BOX], axis=1)
    return Boxes(scene[keep], values[:, :3], values[:, 3:])
