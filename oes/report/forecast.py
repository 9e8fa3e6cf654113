"""Errors of forecasting, averaged: Table 1, by number of objects, by number of views, and the ratio that matters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oes.measure import bootstrap_mean, bootstrap_ratio
from oes.report.names import METRICS, MODELS, in_order
from oes.report.paper import HORIZONS
from oes.report.rows import Columns, select
from oes.report.table import Table

Interval = tuple[float, float, float]
Printed = Mapping[str, Mapping[str, tuple[float, float, float]]]


@dataclass(frozen=True)
class Group:
    """The rows behind one block of a table: its key, how it is called, and the paper's figures for it."""

    key: str
    label: str
    rows: Columns
    printed: Printed


@dataclass(frozen=True)
class Line:
    """One model in one group under one metric, over all objects or the moved ones.

    ``at`` maps T to mean and 95% interval (bootstrap over episodes); ``n`` counts objects, ``seen`` is the share of
    them that was detected.
    """

    group: str
    label: str
    model: str
    metric: str
    objects: str
    at: Mapping[int, Interval]
    n: int
    episodes: int
    seen: float
    printed: tuple[float, ...] | None


def lines(groups: Sequence[Group], seed: int) -> list[Line]:
    """Every model x metric x (all, moved) of every group that has rows; models in the study's order."""
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


def forecast_table(name: str, caption: str, grouped_by: str, found: Sequence[Line], notes: Sequence[str]) -> Table:
    """Lines as a table: all objects and moved objects side by side, a name only where it changes."""
    times = [f"T={T}" for T in HORIZONS]
    header = (grouped_by, "model", "error", *times, "n", "paper", *(f"moved: {time}" for time in times), "n moved")
    shown = [line for line in found if line.objects == "all"]
    moved = {(line.group, line.model, line.metric): line for line in found if line.objects == "moved"}
    cells = []
    for above, line in zip([None, *shown], shown, strict=False):
        label = line.label if above is None or above.group != line.group else ""
        model = MODELS.get(line.model, line.model) if label or above is None or above.model != line.model else ""
        cells.append((label, model, *_cells(line, moved.get((line.group, line.model, line.metric)))))
    return Table(
        name=name,
        caption=caption,
        header=header,
        cells=tuple(cells),
        records=tuple(record for line in found for record in _records(line, grouped_by.replace(" ", "_"))),
        notes=tuple(notes),
    )


def ratio(rows: Columns, model: str, against: str, metric: str, T: int, seed: int) -> Interval | None:
    """Mean error of one model over another's on the same objects, with its paired 95% interval; None without pairs."""
    a, b = (_by_object(select(rows, model=name, T=T), metric) for name in (model, against))
    keys = sorted(a.keys() & b.keys())
    if not keys:
        return None
    values = [np.array([side[key] for key in keys]) for side in (a, b)]
    episodes = np.unique([f"{split}/{episode}" for split, episode, _ in keys], return_inverse=True)[1]
    return bootstrap_ratio(values[0], values[1], episodes, seed)


def _line(group: Group, model: str, metric: str, objects: str, rows: Columns, seed: int) -> Line:
    at = {}
    for T in HORIZONS:
        here = select(rows, T=T)
        if len(here["T"]):
            at[T] = bootstrap_mean(here[metric], _episodes(here), seed)
    last = select(rows, T=max(at))
    printed = group.printed.get(model, {}).get(metric) if objects == "all" else None
    return Line(
        group=group.key,
        label=group.label,
        model=model,
        metric=metric,
        objects=objects,
        at=at,
        n=len(last["T"]),
        episodes=len(np.unique(_episodes(last))),
        seen=float(last["detected"].mean()),
        printed=printed,
    )


def _episodes(rows: Columns) -> NDArray[np.int64]:
    """A number for each episode, distinct over splits."""
    names = [f"{split}/{episode}" for split, episode in zip(rows["split"], rows["episode_i"], strict=True)]
    return np.unique(names, return_inverse=True)[1].astype(np.int64)


def _by_object(rows: Columns, metric: str) -> dict[tuple[str, int, int], float]:
    keys = zip(rows["split"].tolist(), rows["episode_i"].tolist(), rows["object_i"].tolist(), strict=True)
    return dict(zip(keys, rows[metric].tolist(), strict=True))


def _cells(line: Line, moved: Line | None) -> tuple[str, ...]:
    """What stands right of the names; the columns of moved objects stay empty when none moved."""
    paper = " / ".join(f"{value:.1f}" for value in line.printed) if line.printed else ""
    counts = (str(line.n), str(moved.n) if moved else "")
    ours, theirs = ([_interval(x.at[T]) if x and T in x.at else "" for T in HORIZONS] for x in (line, moved))
    return (METRICS[line.metric], *ours, counts[0], paper, *theirs, counts[1])


def _interval(values: Interval) -> str:
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
            "n": line.n,
            "episodes": line.episodes,
            "detected_share": round(line.seen, 4),
            "paper": printed.get(T, ""),
        }
        for T, (mean, low, high) in line.at.items()
    ]
