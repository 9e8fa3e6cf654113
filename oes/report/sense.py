"""Whether a model knows how sure it is, and whether what it foresees is physically sensible."""

from collections.abc import Mapping

import numpy as np

from oes.report.names import MODELS, SETTINGS, in_order
from oes.report.paper import HORIZONS
from oes.report.rows import Columns, kept, select
from oes.report.table import Table, rounded

Figures = Mapping[tuple[str, ...], Mapping[str, float]]

LAST = HORIZONS[-1]
DEEP_MM = 1.0
CERTAINTY_NOTE = (
    "Scale: of the error that the model expects. Coverage: share of objects whose translation error lies within its "
    "interval of 50% (90%). NLL: mean negative log-likelihood of the error (mm), under the model's own scale for each "
    "object, and under the best scale that is the same for all objects (what a forecast without uncertainty can have). "
    "Both laws are fitted to held-out training episodes, so novel objects are harder than what they have seen."
)
SENSE_NOTE = (
    f"At T = {LAST}, one view, predicted boxes. Penetration: how deep an object, as forecast, is in another, or that "
    f"in it; deep: by more than {DEEP_MM:g} mm. Moved though still: how far objects that stay where they are were "
    "forecast to move (translation error of those that did not move)."
)


def certainty(rows: Columns) -> Figures:
    """(model, setting, T) -> mean scale (mm), coverages, NLLs and n, of the models that tell how
    sure they are.
    """
    told = kept(rows, ~np.isnan(rows["scale_mm"]))
    keys = [
        (model, setting, T)
        for model in in_order(map(str, np.unique(told["model"])))
        for setting in SETTINGS
        for T in HORIZONS
    ]
    names = ("scale_mm", "within_50", "within_90", "nll", "nll_same")
    parts = {key: select(told, model=key[0], setting=key[1], T=key[2]) for key in keys}
    return {
        (model, setting, str(T)): {name: float(part[name].mean()) for name in names}
        | {"n": float(len(part["T"]))}
        for (model, setting, T), part in parts.items()
        if len(part["T"])
    }


def certainty_table(found: Mapping[str, Figures], notes: tuple[str, ...]) -> Table:
    """One line a task, setting and T; ``found`` by task."""
    header = (
        "task",
        "model",
        "setting",
        "T",
        "scale (mm)",
        "within 50%",
        "within 90%",
        "NLL",
        "NLL, one scale",
        "n",
    )
    every = [
        (task, key, values) for task, figures in found.items() for key, values in figures.items()
    ]
    cells = tuple(
        (
            *(task, MODELS.get(model, model), SETTINGS[setting], T, f"{values['scale_mm']:.1f}"),
            *(f"{values[name]:.2f}" for name in ("within_50", "within_90", "nll", "nll_same")),
            f"{values['n']:.0f}",
        )
        for task, (model, setting, T), values in every
    )
    records = tuple(
        {"task": task, "model": model, "setting": setting, "T": int(T)} | rounded(values)
        for task, (model, setting, T), values in every
    )
    caption = "How sure forecasts are, and how right they are in that, novel objects"
    return Table("certainty", caption, header, cells, records, (CERTAINTY_NOTE, *notes))


def sense(rows: Columns) -> Figures:
    """(model,) -> mean penetration (mm), share of it that is deep, error of what did not move (mm),
    of one setting.
    """
    last = select(rows, T=LAST)
    found: dict[tuple[str, ...], Mapping[str, float]] = {}
    for model in in_order(map(str, np.unique(last["model"]))):
        own = select(last, model=model)
        still_mm = own["translation_mm"][~own["moved"]]
        found[(model,)] = {
            "penetration_mm": float(own["penetration_mm"].mean()),
            "deep_share": float((own["penetration_mm"] > DEEP_MM).mean()),
            "still_mm": float(still_mm.mean()) if len(still_mm) else float("nan"),
            "n": float(len(own["T"])),
            "n_still": float(len(still_mm)),
        }
    return found


def sense_table(found: Mapping[str, Figures], notes: tuple[str, ...]) -> Table:
    """One line a task and model; ``found`` by task."""
    header = (
        "task",
        "model",
        "penetration (mm)",
        "deep",
        "moved though still (mm)",
        "n",
        "n still",
    )
    every = [
        (task, model, values)
        for task, figures in found.items()
        for (model,), values in figures.items()
    ]
    cells = tuple(
        (
            *(
                task,
                MODELS.get(model, model),
                f"{values['penetration_mm']:.2f}",
                f"{100 * values['deep_share']:.1f}%",
            ),
            *("" if np.isnan(values["still_mm"]) else f"{values['still_mm']:.1f}",),
            *(f"{values[name]:.0f}" for name in ("n", "n_still")),
        )
        for task, model, values in every
    )
    records = tuple(
        {"task": task, "model": model} | rounded(values) for task, model, values in every
    )
    caption = "Physical sense of forecasts, novel objects"
    return Table("sense", caption, header, cells, records, (SENSE_NOTE, *notes))


def tree(found: Mapping[str, Figures]) -> dict[str, object]:
    """Figures by task and then by each part of their keys, for metrics.json."""
    out: dict[str, object] = {}
    for task, figures in found.items():
        for key, values in figures.items():
            place = out.setdefault(task, {})
            for part in key[:-1]:
                assert isinstance(place, dict)
                place = place.setdefault(part, {})
            assert isinstance(place, dict)
            place[key[-1]] = dict(values)
    return out
