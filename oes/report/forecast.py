"""Errors of forecasting, averaged: every table of them, and the ratio that matters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oes.metrics.statistics import bootstrap_mean, bootstrap_ratio
from oes.report.names import METRICS, MODELS, in_order
from oes.report.paper import HORIZONS
from oes.report.rows import Columns, select
from oes.report.table import Table

Interval = tuple[float, float, float]
Printed = Mapping[str, Mapping[str, tuple[float, float, float]]]

DIVERGED_MM = 300.0
LAST = HORIZONS[-1]
NOTE = (
    "Means with 95% intervals, bootstrapped over episodes. "
    f"Diverged: objects forecast over {DIVERGED_MM / 1000} m off at T = {LAST}. "
    "Rotation is ambiguous for symmetric objects: a turned cylinder looks the same, but its turn counts. "
    "Surface distance is the error that is right for them: the mean distance from the object's surface as forecast to "
    "the nearest true surface, an error of translation and rotation together."
)


@dataclass(frozen=True)
class Group:
    """The rows behind one block of a table: its key, how it is called, and the paper's figures for
    it.
    """

    key: str
    label: str
    rows: Columns
    printed: Printed


@dataclass(frozen=True)
class Line:
    """One model in one group under one metric, over all objects or the moved ones.

    ``at`` maps T to mean and 95% interval (bootstrap over episodes), ``median`` to the median;
    ``n`` counts objects, ``seen`` and ``diverged`` are the shares of them that were detected, and
    forecast over 0.3 m off at the last T (the same under every metric).
    """

    group: str
    label: str
    model: str
    metric: str
    objects: str
    at: Mapping[int, Interval]
    median: Mapping[int, float]
    n: int
    episodes: int
    seen: float
    diverged: float
    printed: tuple[float, ...] | None


def lines(groups: Sequence[Group], seed: int) -> list[Line]:
    """Every model x metric x (all, moved) of every group that has rows; models in the study's
    order.
    """
    found = []
    for group in groups:
        for model in in_order(map(str, np.unique(group.rows["model"]))):
            rows = select(group.rows, model=model)
            for metric in METRICS:
                for objects in ("all", "moved"):
                    kept = rows if objects == "all" else select(rows, moved=True)
                    if len(kept["T"]):
                        found.append(_line(group, model, metric, objects, kept, seed))
    return found


def forecast_table(
    name: str, caption: str, grouped_by: str, found: Sequence[Line], notes: Sequence[str]
) -> Table:
    """Lines as a table: all objects and moved objects side by side, a name only where it
    changes.
    """
    columns = (*(f"T={T}" for T in HORIZONS), f"median, T={LAST}", "diverged")
    header = (
        grouped_by,
        "model",
        "error",
        *columns,
        "n",
        "paper",
        *(f"moved: {each}" for each in columns),
        "n moved",
    )
    shown = [line for line in found if line.objects == "all"]
    moved = {
        (line.group, line.model, line.metric): line for line in found if line.objects == "moved"
    }
    cells = []
    for above, line in zip([None, *shown], shown, strict=False):
        label = line.label if above is None or above.group != line.group else ""
        model = (
            MODELS.get(line.model, line.model)
            if label or above is None or above.model != line.model
            else ""
        )
        both = (
            _side(line, bool(model)),
            _side(moved.get((line.group, line.model, line.metric)), bool(model)),
        )
        cells.append((label, model, METRICS[line.metric], *both[0], _printed(line), *both[1]))
    return Table(
        name=name,
        caption=caption,
        header=header,
        cells=tuple(cells),
        records=tuple(
            record for line in found for record in _records(line, grouped_by.replace(" ", "_"))
        ),
        notes=(NOTE, *notes),
    )


def ratio(
    rows: Columns, model: str, against: str, metric: str, T: int, seed: int
) -> Interval | None:
    """Mean error of one model over another's on the same objects, with its paired 95% interval;
    None without pairs.
    """
    a, b = (_by_object(select(rows, model=name, T=T), metric) for name in (model, against))
    keys = sorted(a.keys() & b.keys())
    if not keys:
        return None
    values = [np.array([side[key] for key in keys]) for side in (a, b)]
    episodes = np.unique([f"{split}/{episode}" for split, episode, _ in keys], return_inverse=True)[
        1
    ]
    return bootstrap_ratio(values[0], values[1], episodes, seed)


def _line(group: Group, model: str, metric: str, objects: str, rows: Columns, seed: int) -> Line:
    at, median = {}, {}
    for T in HORIZONS:
        here = select(rows, T=T)
        if len(here["T"]):
            at[T] = bootstrap_mean(here[metric], _episodes(here), seed)
            median[T] = float(np.median(here[metric]))
    last = select(rows, T=max(at))
    printed = group.printed.get(model, {}).get(metric) if objects == "all" else None
    return Line(
        group=group.key,
        label=group.label,
        model=model,
        metric=metric,
        objects=objects,
        at=at,
        median=median,
        n=len(last["T"]),
        episodes=len(np.unique(_episodes(last))),
        seen=float(last["detected"].mean()),
        diverged=float((last["translation_mm"] > DIVERGED_MM).mean()),
        printed=printed,
    )


def _episodes(rows: Columns) -> NDArray[np.int64]:
    """A number for each episode, distinct over splits."""
    names = [
        f"{split}/{episode}"
        for split, episode in zip(rows["split"], rows["episode_i"], strict=True)
    ]
    return np.unique(names, return_inverse=True)[1].astype(np.int64)


def _by_object(rows: Columns, metric: str) -> dict[tuple[str, int, int], float]:
    keys = zip(
        rows["split"].tolist(), rows["episode_i"].tolist(), rows["object_i"].tolist(), strict=True
    )
    return dict(zip(keys, rows[metric].tolist(), strict=True))


def _side(line: Line | None, is_first: bool) -> tuple[str, ...]:
    """The columns of all objects or of moved ones, the count last; empty when there are none.

    What is the same under every metric stands only in the model's first row.
    """
    if line is None:
        return ("",) * (len(HORIZONS) + 3)
    means = (interval(line.at[T]) if T in line.at else "" for T in HORIZONS)
    median = f"{line.median[LAST]:.1f}" if LAST in line.median else ""
    return (*means, median, f"{100 * line.diverged:.1f}%" if is_first else "", str(line.n))


def _printed(line: Line) -> str:
    return " / ".join(f"{value:.1f}" for value in line.printed) if line.printed else ""


def interval(values: Interval) -> str:
    """A mean and its interval, as printed."""
    return f"{values[0]:.1f} [{values[1]:.1f}, {values[2]:.1f}]"


def _records(line: Line, grouped_by: str) -> list[dict[str, object]]:
    printed = dict(zip(HORIZONS, line.printed, strict=True)) if line.printed else {}
    return [
        {
            grouped_by: line.group,
            "model": line.model,
            "metric": line.metric,
            "objects": line.objects,
            "T": T,
            "mean": round(mean, 4),
            "low": round(low, 4),
            "high": round(high, 4),
            "median": round(line.median[T], 4),
            "n": line.n,
            "episodes": line.episodes,
            "detected_share": round(line.seen, 4),
            "diverged": round(line.diverged, 4),
            "paper": printed.get(T, ""),
        }
        for T, (mean, low, high) in line.at.items()
    ]
