"""How training went, and how far the detector's scores can be trusted, as figures."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from oes.report.figures import STYLE, save_figure
from oes.report.names import COLOURS, MODELS, VARIANTS, in_order
from oes.report.rows import Columns, select

BINS = 8
MIN_IOU = 0.5
PERCEPTION = {
    "loss": "loss",
    "val_ap_50": "validation: AP at IoU 0.5",
    "val_psnr_db": "validation: PSNR (dB)",
}
DYNAMICS = {
    "loss": "loss",
    "mm_5": "held out: translation at T = 5 (mm)",
    "deg_5": "held out: rotation at T = 5 (deg)",
}


def reliability(detections: Mapping[str, Columns], path: Path) -> None:
    """Share of boxes (one view) that overlap a true one by half, against their score; a line a
    task.
    """
    figure, (panel, counts) = _row(2)
    for (task, rows), colour in zip(detections.items(), ("#0072b2", "#d55e00"), strict=False):
        own = select(rows, num_views=1)
        found = ~np.isnan(own["score"])
        score, is_hit = own["score"][found], np.nan_to_num(own["iou"][found]) >= MIN_IOU
        bins = np.minimum((score * BINS).astype(int), BINS - 1)
        filled = [b for b in range(BINS) if (bins == b).any()]
        panel.plot(
            [score[bins == b].mean() for b in filled], [is_hit[bins == b].mean() for b in filled], marker="o",
            color=colour, label=task,
        )  # fmt: skip
        counts.hist(
            score,
            bins=np.linspace(0, 1, BINS + 1).tolist(),
            histtype="step",
            color=colour,
            label=task,
        )
    panel.plot([0, 1], [0, 1], color="#999999", linewidth=1, linestyle=":")
    panel.set(
        xlabel="score",
        ylabel=f"share with IoU of at least {MIN_IOU:g}",
        xlim=(0, 1),
        ylim=(0, 1.02),
    )
    counts.set(xlabel="score", ylabel="boxes found")
    save_figure(figure, path)


def learning(logs: Mapping[str, Path], measures: Mapping[str, str], path: Path) -> None:
    """Measures of training logs against the step; a panel a measure, a line a log (a model's word,
    or any).
    """
    figure, panels = _row(len(measures))
    read = {word: _read(log) for word, log in logs.items()}
    for panel, (name, label) in zip(panels, measures.items(), strict=True):
        for word in in_order(read):
            points = [(row["step"], row[name]) for row in read[word] if name in row]
            if points:
                panel.plot(
                    *zip(*points, strict=True),
                    color=COLOURS.get(word, "#0072b2"),
                    label=MODELS.get(word, word),
                )
        panel.set(xlabel="step", ylabel=label)
        if name == "loss":
            panel.set_yscale("log")
    save_figure(figure, path)


def write_curves(
    perception: Path, dynamics: Path, detections: Mapping[str, Columns], folder: Path
) -> dict[str, str]:
    """All figures of this module; gives captions by the PNGs' paths relative to ``folder``'s
    parent.
    """
    folder.mkdir(parents=True, exist_ok=True)
    captions = {}
    if detections:
        reliability(detections, folder / "reliability")
        captions["reliability"] = (
            "Detection from one view: what a score is worth, and how many boxes have it."
        )
    if (perception / "log.csv").exists():
        learning({"perception": perception / "log.csv"}, PERCEPTION, folder / "learning-perception")
        captions["learning-perception"] = "Perception: training."
    for task in detections:
        logs = {
            path.parent.name.split("-")[1]: path
            for path in sorted(dynamics.glob(f"{task}-*/log.csv"))
        }
        logs = {
            word: path
            for word, path in logs.items()
            if word not in VARIANTS and "mm_5" in path.read_text()
        }
        if logs:
            learning(logs, DYNAMICS, folder / f"learning-{task}")
            captions[f"learning-{task}"] = f"Dynamics, {task}: training."
    return {f"{folder.name}/{name}.png": caption for name, caption in captions.items()}


def _row(count: int) -> tuple[Figure, Sequence[mpl.axes.Axes]]:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4 * count, 3.2), layout="constrained")
        panels: Sequence[mpl.axes.Axes] = figure.subplots(1, count, squeeze=False)[0]
    return figure, panels


def _read(path: Path) -> list[dict[str, float]]:
    """The rows of a log; empty cells are left out."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {name: float(cell) for name, cell in row.items() if cell}
            for row in csv.DictReader(file)
        ]
