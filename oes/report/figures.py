"""Figures, always the same bytes for the same rows: error over time, by objects, by views, and how
far things move.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oes.report.forecast import LAST, Interval, Line
from oes.report.names import COLOURS, METRICS, MODELS, SETTINGS, in_order
from oes.report.paper import HORIZONS
from oes.report.study import VARIED, Forecasts

STYLE: dict[Any, Any] = {
    "svg.hashsalt": "oes",
    "svg.fonttype": "path",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
}
PLAIN = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}


def write_figures(
    found: Forecasts, displacement_mm: Mapping[int, Sequence[float]], folder: Path
) -> dict[str, str]:
    """A study's figures as PNG and SVG; gives caption by the PNG's path relative to ``folder``'s
    parent.
    """
    folder.mkdir(parents=True, exist_ok=True)
    study = found.study
    suffix, task = study.suffix, study.task.capitalize()
    varied = [line for line in found.main if line.group == VARIED]
    over_time(varied, f"{SETTINGS[VARIED]}, {study.scenes}", folder / f"error-over-time{suffix}")
    by_group(found.by_objects, "objects in the scene", LAST, folder / f"by-objects{suffix}")
    displacement(displacement_mm, folder / f"displacement{suffix}")
    captions = {
        "error-over-time": f"{task}: error over time, mean and 95% interval.",
        "by-objects": f"{task}: error by number of objects, T = {LAST}.",
        "displacement": f"{task}: how far the objects of the training episodes move.",
    }
    if found.by_views:
        by_group(found.by_views, "input views", LAST, folder / f"by-views{suffix}")
        captions["by-views"] = f"{task}: error by number of input views, T = {LAST}."
    return {f"{folder.name}/{name}{suffix}.png": caption for name, caption in captions.items()}


def over_time(rows: Sequence[Line], title: str, path: Path) -> None:
    """Error against T with 95% bands, a panel a metric, a line a model."""
    figure, panels = _panels(title)
    for metric, panel in panels.items():
        for line in _chosen(rows, metric):
            _draw(panel, line.model, list(line.at), list(line.at.values()))
        panel.set_xlabel("T (steps)")
        panel.set_xticks(HORIZONS)
    save_figure(figure, path)


def by_group(rows: Sequence[Line], grouped_by: str, T: int, path: Path) -> None:
    """Error at one T against the number that ``Line.group`` holds (objects or views), a line a
    model.
    """
    figure, panels = _panels(f"all objects, T = {T}")
    for metric, panel in panels.items():
        chosen = [line for line in _chosen(rows, metric) if T in line.at]
        for model in in_order(line.model for line in chosen):
            own = sorted(
                (line for line in chosen if line.model == model), key=lambda line: int(line.group)
            )
            _draw(panel, model, [int(line.group) for line in own], [line.at[T] for line in own])
        panel.set_xlabel(grouped_by)
        panel.set_xticks(sorted({int(line.group) for line in chosen}))
    save_figure(figure, path)


def displacement(values_mm: Mapping[int, Sequence[float]], path: Path) -> None:
    """How far objects have moved by each T: the share of objects that moved farther than x."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5, 3), layout="constrained")
        panel = figure.subplots()
    for T, colour in zip(sorted(values_mm), ("#56b4e9", "#009e73", "#d55e00"), strict=False):
        ordered = sorted(values_mm[T])
        shares = [1 - i / len(ordered) for i in range(len(ordered))]
        panel.step(ordered, shares, where="post", color=colour, label=f"T = {T}")
    panel.set_xlabel("displacement since the start (mm)")
    panel.set_ylabel("share of objects that moved farther")
    panel.set_ylim(0, 1)
    panel.legend()
    save_figure(figure, path)


def _chosen(rows: Sequence[Line], metric: str) -> list[Line]:
    return [line for line in rows if line.metric == metric and line.objects == "all"]


def _panels(title: str) -> tuple[Figure, dict[str, Axes]]:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4 * len(METRICS), 3.2), layout="constrained")
        axes = figure.subplots(1, len(METRICS))
    figure.suptitle(title, fontsize=10)
    panels = dict(zip(METRICS, axes, strict=True))
    for metric, panel in panels.items():
        panel.set_ylabel(f"{METRICS[metric]}")
    return figure, panels


def _draw(panel: Axes, model: str, x: Sequence[int], intervals: Sequence[Interval]) -> None:
    colour = COLOURS.get(model, "#cc79a7")
    mean, low, high = zip(*intervals, strict=True)
    panel.plot(x, mean, marker="o", markersize=4, color=colour, label=MODELS.get(model, model))
    panel.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)


def save_figure(figure: Figure, path: Path) -> None:
    """PNG and SVG beside each other, without dates; the legend goes to the first panel that has
    lines.
    """
    with mpl.rc_context(STYLE):
        if figure.axes[0].get_legend_handles_labels()[0] and figure.axes[0].get_legend() is None:
            figure.axes[0].legend(fontsize=7)
        for suffix, metadata in PLAIN.items():
            figure.savefig(path.with_suffix(f".{suffix}"), dpi=150, metadata=metadata)
