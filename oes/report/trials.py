"""Table 3: pushing objects to targets by model predictive control."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oes.measure import mcnemar_exact, wilson
from oes.report.names import MODELS, in_order
from oes.report.paper import CONTROL
from oes.report.rows import Columns, select
from oes.report.table import Table

OURS = "oes"
NOTE = (
    "A trial succeeds when the mean distance of its objects to their goals is within the tolerance at the end (the "
    "paper's rule); 'success of every object' asks it of each. Each push is the best of random ones (random shooting, "
    "as in the paper), planned from one new image of one random camera; a push that no forecast favours is not made. "
    "All models have the same starts, goals, cameras and perception. p: exact McNemar test on the paired trials."
)


@dataclass(frozen=True)
class Outcome:
    """One model on one scenario. ``p_value``: exact McNemar test of oes against it on the same trials."""

    model: str
    trials: int
    success: float
    interval: tuple[float, float]
    p_value: float | None
    all_success: float
    initial_mm: float
    final_mm: float
    steps: float
    failures: int
    printed: float | None


def outcomes(rows: Columns, scenario: str) -> list[Outcome]:
    """Success of every model; a trial that failed to run counts as one without success."""
    here = select(rows, scenario=scenario)
    ours = _successes(select(here, model=OURS))
    models = in_order(map(str, np.unique(here["model"])))
    return [_outcome(select(here, model=model), ours, scenario) for model in models]


def trials_table(found: list[Outcome], name: str, scenario: str, notes: tuple[str, ...]) -> Table:
    """The outcomes, one row a model."""
    header = (
        "model",
        "trials",
        "success [95%]",
        "p (3D-OES against it)",
        "success of every object",
        "distance at start (mm)",
        "distance at end (mm)",
        "pushes",
        "did not run",
        "paper (50 trials)",
    )
    return Table(
        name=name,
        caption=f"Pushing with model predictive control: {scenario}",
        header=header,
        cells=tuple(_cells(outcome) for outcome in found),
        records=tuple(_record(outcome, scenario) for outcome in found),
        notes=(NOTE, *notes),
    )


def _outcome(rows: Columns, ours: dict[int, bool], scenario: str) -> Outcome:
    model, theirs = str(rows["model"][0]), _successes(rows)
    ran = rows["failure"] == ""
    paired = sorted(ours.keys() & theirs.keys())
    only_ours = sum(ours[i] and not theirs[i] for i in paired)
    only_theirs = sum(theirs[i] and not ours[i] for i in paired)
    return Outcome(
        model=model,
        trials=len(theirs),
        success=float(rows["success"].mean()),
        interval=wilson(sum(theirs.values()), len(theirs)),
        p_value=mcnemar_exact(only_ours, only_theirs) if model != OURS and paired else None,
        all_success=float(rows["all_success"].mean()),
        initial_mm=_mean(rows["initial_mm"][ran]),
        final_mm=_mean(rows["mean_final_mm"][ran]),
        steps=_mean(rows["steps_used"][ran]),
        failures=int((~ran).sum()),
        printed=CONTROL.get(scenario, {}).get(model),
    )


def _successes(rows: Columns) -> dict[int, bool]:
    return dict(zip(rows["trial_i"].tolist(), rows["success"].tolist(), strict=True))


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _cells(outcome: Outcome) -> tuple[str, ...]:
    return (
        MODELS.get(outcome.model, outcome.model),
        str(outcome.trials),
        f"{outcome.success:.2f} [{outcome.interval[0]:.2f}, {outcome.interval[1]:.2f}]",
        "" if outcome.p_value is None else f"{outcome.p_value:.2g}",
        f"{outcome.all_success:.2f}",
        f"{outcome.initial_mm:.0f}",
        f"{outcome.final_mm:.1f}",
        f"{outcome.steps:.1f}",
        str(outcome.failures),
        "" if outcome.printed is None else f"{outcome.printed:.2f}",
    )


def _record(outcome: Outcome, scenario: str) -> dict[str, object]:
    return {
        "scenario": scenario,
        "model": outcome.model,
        "trials": outcome.trials,
        "success": round(outcome.success, 4),
        "low": round(outcome.interval[0], 4),
        "high": round(outcome.interval[1], 4),
        "p_value": "" if outcome.p_value is None else f"{outcome.p_value:.6g}",
        "all_success": round(outcome.all_success, 4),
        "initial_mm": round(outcome.initial_mm, 2),
        "final_mm": round(outcome.final_mm, 2),
        "pushes": round(outcome.steps, 2),
        "did_not_run": outcome.failures,
        "paper": "" if outcome.printed is None else outcome.printed,
    }
