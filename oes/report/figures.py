"""Figures as small PNGs; equal rows give equal bytes."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from oes.report.inputs import TASK_SPECS, RawData
from oes.report.names import (
    LAST,
    METRICS,
    MODEL_COLOURS,
    SETTINGS,
    SHOWN_T,
    VARIED,
    in_order,
    label,
)

STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
}
PALETTE = 64  # colours of a figure's PNG: a third of the bytes, no visible difference
BINS = 8
MIN_IOU = 0.5
LOGGED = {
    "perception": {
        "loss": "loss",
        "val_ap_50": "validation: AP at IoU 0.5",
        "val_psnr_db": "validation: PSNR (dB)",
    },
    "dynamics": {
        "loss": "loss",
        "mm_5": "held out: translation at T = 5 (mm)",
        "deg_5": "held out: rotation at T = 5 (deg)",
    },
}


@dataclass(frozen=True)
class Media:
    """An image or film of ``page``; ``path`` is relative to the report."""

    page: str
    path: str
    caption: str


def write_figures(frame: pd.DataFrame, raw: RawData, logs: pd.DataFrame, out: Path) -> list[Media]:
    """Write all plots to ``out/figures``."""
    (out / "figures").mkdir(parents=True, exist_ok=True)
    found: list[Media] = []

    def save(figure: Figure, page: str, name: str, caption: str) -> None:
        save_figure(figure, out / "figures" / f"{name}.png")
        found.append(Media(page, f"figures/{name}.png", caption))

    for task in raw.errors:
        spec, Task = TASK_SPECS[task], task.capitalize()
        rows = frame[(frame["task"] == task) & (frame["objects"] == "all")]
        varied = rows[(rows["block"] == "forecast") & (rows["group"] == VARIED)]
        caption = (
            f"{Task}: error over time, {SETTINGS[VARIED]}, {spec.scenes}; mean and 95% interval."
        )
        save(over_time(varied), task, f"error-over-time{spec.suffix}", caption)
        for block, axis in (("by_objects", "objects in the scene"), ("by_views", "input views")):
            if len(own := rows[(rows["block"] == block) & (rows["T"] == LAST)]):
                name = block.replace("_", "-") + spec.suffix
                caption = f"{Task}: error by number of {axis}, T = {LAST}; mean and 95% interval."
                save(by_group(own, axis), task, name, caption)
        moved = displacement(raw.cards[task, "train"].displacements_mm)
        caption = f"{Task}: displacement of the objects of the training episodes."
        save(moved, "data", f"displacement{spec.suffix}", caption)
    caption = "Detection from one view: share of correct detections by score, and number by score."
    save(reliability(raw.detections), "perception", "reliability", caption)
    for task in dict.fromkeys(logs["task"]) if len(logs) else ():
        own = logs[logs["task"] == task]
        caption = f"Training of {task if task == 'perception' else f'dynamics, {task}'}."
        save(learning(own), "data", f"learning-{task}", caption)
    return found


def over_time(rows: pd.DataFrame) -> Figure:
    """Error against T, a panel per metric, a line and a 95% band per model."""
    figure, panels = _panels(list(METRICS.values()))
    for metric, panel in zip(METRICS, panels, strict=True):
        for model in in_order(rows["model"]):
            own = rows[(rows["metric"] == metric) & (rows["model"] == model)]
            _draw(panel, model, own["T"].astype(int).tolist(), own)
        panel.set_xlabel("T (steps)")
        panel.set_xticks(SHOWN_T)
    return figure


def by_group(rows: pd.DataFrame, axis: str) -> Figure:
    """Error at the last T against a number of objects or views."""
    figure, panels = _panels(list(METRICS.values()))
    rows = rows.assign(number=rows["group"].astype(int)).sort_values("number", kind="stable")
    for metric, panel in zip(METRICS, panels, strict=True):
        for model in in_order(rows["model"]):
            own = rows[(rows["metric"] == metric) & (rows["model"] == model)]
            _draw(panel, model, own["number"].tolist(), own)
        panel.set_xlabel(axis)
        panel.set_xticks(sorted(set(rows["number"])))
    return figure


def displacement(values_mm: Mapping[int, Sequence[float]]) -> Figure:
    """Share of objects that moved farther than x by each T."""
    figure, (panel,) = _panels(["share of objects that moved farther"], size=(5, 3))
    for T, colour in zip(sorted(values_mm), ("#56b4e9", "#009e73", "#d55e00"), strict=False):
        ordered = sorted(values_mm[T])
        shares = [1 - i / len(ordered) for i in range(len(ordered))]
        panel.step(ordered, shares, where="post", color=colour, label=f"T = {T}")
    panel.set_xlabel("displacement since the start (mm)")
    panel.set_ylim(0, 1)
    return figure


def reliability(detections: Mapping[str, pd.DataFrame]) -> Figure:
    """Share of one-view detections with enough overlap by score; a line per task."""
    figure, (panel, counts) = _panels([f"share with IoU >= {MIN_IOU:g}", "detections"])
    for (task, rows), colour in zip(detections.items(), ("#0072b2", "#d55e00"), strict=False):
        own = rows[(rows["num_views"] == 1) & rows["score"].notna()].sort_values("score")
        score, is_hit = own["score"].to_numpy(), own["iou"].fillna(0).to_numpy() >= MIN_IOU
        # Bins of equal count: most scores are close to 1.
        bins = [part for part in np.array_split(np.arange(len(own)), BINS) if len(part)]
        points = [(score[part].mean(), is_hit[part].mean()) for part in bins]
        panel.plot(*zip(*points, strict=True), marker="o", color=colour, label=task)
        edges = np.linspace(0, 1, BINS + 1).tolist()
        counts.hist(score, bins=edges, histtype="step", color=colour, label=task)
    panel.plot([0, 1], [0, 1], color="#999999", linewidth=1, linestyle=":")
    panel.set(xlim=(0, 1), ylim=(0, 1.02), xlabel="score")
    counts.set_xlabel("score")
    return figure


def learning(logs: pd.DataFrame) -> Figure:
    """Logged measures against the step; a panel per measure, a line per model."""
    known = LOGGED["perception" if set(logs["task"]) == {"perception"} else "dynamics"]
    figure, panels = _panels(list(known.values()))
    for panel, name in zip(panels, known, strict=True):
        for model in in_order(logs["model"]) if name in logs else ():
            own = logs[(logs["model"] == model) & logs[name].notna()]
            colour = MODEL_COLOURS.get(model, "#0072b2")
            panel.plot(own["step"], own[name], color=colour, label=label(model))
        panel.set_xlabel("step")
        if name == "loss":
            panel.set_yscale("log")
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """A PNG of few colours, without date or software; the first panel has the legend."""
    with mpl.rc_context(STYLE):
        if figure.axes[0].get_legend_handles_labels()[0]:
            figure.axes[0].legend(fontsize=7)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    write_png(Image.open(buffer), path)


def write_png(image: Image.Image, path: Path) -> None:
    """A PNG with a palette."""
    image.convert("RGB").quantize(PALETTE, dither=Image.Dither.NONE).save(path, optimize=True)


def _panels(
    labels: Sequence[str], size: tuple[float, float] | None = None
) -> tuple[Figure, Sequence[Axes]]:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=size or (4 * len(labels), 3.2), layout="constrained")
        panels: Sequence[Axes] = figure.subplots(1, len(labels), squeeze=False)[0]
    for panel, text in zip(panels, labels, strict=True):
        panel.set_ylabel(text)
    return figure, panels


def _draw(panel: Axes, model: str, x: list[int], rows: pd.DataFrame) -> None:
    colour = MODEL_COLOURS.get(model, "#cc79a7")
    mean, low, high = (rows[name].to_numpy(float) for name in ("mean", "low", "high"))
    panel.plot(x, mean, marker="o", markersize=4, color=colour, label=label(model))
    panel.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
