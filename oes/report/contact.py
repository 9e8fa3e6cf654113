"""What completed surfaces are worth: the model ``contact`` over the others, and what each part of
it adds.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from oes.report.forecast import Group, Interval, Line, interval, lines, ratio
from oes.report.names import BASELINE, METRICS, MODELS, OURS, SURFACES, VARIANTS
from oes.report.paper import HORIZONS
from oes.report.rows import Columns, kept
from oes.report.table import Table

Ratios = Mapping[tuple[str, str, int], Interval]

LAST = HORIZONS[-1]
RATIO_NOTE = (
    "Mean error over mean error on the same objects, with paired 95% intervals (bootstrap over episodes); one view, "
    "predicted boxes, novel objects."
)
ABLATION_NOTE = (
    "One view, predicted boxes, two novel objects. Every variant differs from the model itself in one thing; the last "
    "column but one holds them against it."
)


def surface_ratios(rows: Columns, seed: int) -> Ratios:
    """(other model, metric, T) -> error of ``contact`` over the other's, of rows of one setting."""
    return {
        (other, metric, T): found
        for other in (BASELINE, OURS)
        for metric in METRICS
        for T in HORIZONS
        if (found := ratio(rows, SURFACES, other, metric, T, seed)) is not None
    }


def ratio_table(found: Mapping[str, Ratios], notes: tuple[str, ...]) -> Table:
    """One line a task, other model and metric; ``found`` by task."""
    keys = [
        (task, other, metric) for task, ratios in found.items() for other, metric in _pairs(ratios)
    ]
    shown = {(task, *key): value for task, ratios in found.items() for key, value in ratios.items()}
    cells = [
        (
            task,
            MODELS[other],
            METRICS[metric],
            *(_cell(shown.get((task, other, metric, T))) for T in HORIZONS),
        )
        for task, other, metric in keys
    ]
    records = [
        {
            "task": task,
            "over": other,
            "metric": metric,
            "T": T,
            "ratio": mean,
            "low": low,
            "high": high,
        }
        for (task, other, metric, T), values in shown.items()
        for mean, low, high in [tuple(round(value, 4) for value in values)]
    ]
    header = ("task", "over", "error", *(f"T={T}" for T in HORIZONS))
    caption = f"{MODELS[SURFACES]}: its error over that of others"
    return Table(
        "contact-ratios", caption, header, tuple(cells), tuple(records), (RATIO_NOTE, *notes)
    )


def ablations(rows: Columns, seed: int) -> tuple[list[Line], Ratios]:
    """Lines of the models to compare, all objects, and ratios of variants to ``contact``, of rows
    of one setting.
    """
    words = [OURS, SURFACES, *VARIANTS]
    chosen = kept(rows, np.isin(rows["model"], np.array(words, dtype=np.str_)))
    found = [line for line in lines([Group("", "", chosen, {})], seed) if line.objects == "all"]
    order = {word: i for i, word in enumerate(words)}
    ratios = {
        (word, metric, LAST): value
        for word in VARIANTS
        for metric in METRICS
        if (value := ratio(rows, word, SURFACES, metric, LAST, seed)) is not None
    }
    return sorted(found, key=lambda line: order[line.model]), ratios


def ablation_table(found: Sequence[Line], ratios: Ratios, notes: tuple[str, ...]) -> Table:
    """One line a model and metric."""
    cells = tuple(
        (
            VARIANTS.get(line.model, MODELS.get(line.model, line.model)),
            METRICS[line.metric],
            *(interval(line.at[T]) if T in line.at else "" for T in HORIZONS),
            _cell(ratios.get((line.model, line.metric, LAST))),
            str(line.n),
        )
        for line in found
    )
    records = tuple(
        {
            "model": line.model,
            "metric": line.metric,
            "T": T,
            "mean": round(mean, 4),
            "low": round(low, 4),
        }
        | {"high": round(high, 4), "n": line.n}
        for line in found
        for T, (mean, low, high) in line.at.items()
    )
    header = (
        "model",
        "error",
        *(f"T={T}" for T in HORIZONS),
        f"over {MODELS[SURFACES]}, T={LAST}",
        "n",
    )
    return Table(
        "ablations",
        "What each part of Contact adds, pushing",
        header,
        cells,
        records,
        (ABLATION_NOTE, *notes),
    )


def _pairs(ratios: Ratios) -> list[tuple[str, str]]:
    return list(dict.fromkeys((other, metric) for other, metric, _ in ratios))


def _cell(values: Interval | None) -> str:
    return "" if values is None else f"{values[0]:.2f} [{values[1]:.2f}, {values[2]:.2f}]"
