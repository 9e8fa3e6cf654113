"""Table 3: pushing objects to targets, and around obstacles, by model predictive control."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oes.metrics.statistics import mcnemar_exact, signed_rank, wilson
from oes.report.names import MODELS, OURS, SCENARIOS, in_order
from oes.report.paper import CONTROL
from oes.report.rows import Columns, select
from oes.report.table import Table

NOTE = (
    "A trial succeeds when the mean distance of its objects to their goals is within the tolerance at the end (the "
    "paper's rule) and nothing touched an obstacle; 'success of every object' asks the distance of each. Planned from "
    "one new image of one random camera; a push that no forecast favours is not made. Planner 'shooting': the best of "
    "random plans, as in the paper; 'cem': the cross-entropy method, in three rounds, the later ones around the best "
    "of the one before. Plans x pushes: how many are imagined before each push, of how many pushes each. All models "
    "and planners have the same starts, goals, cameras and perception. p: exact McNemar test on the trials paired "
    "with 3D-OES's with the same planner; after the distance at the end: Wilcoxon's signed-rank test on them."
)
PAPERS = "shooting"  # the planner of the paper


@dataclass(frozen=True)
class Outcome:
    """One model and planner on one scenario. ``p_value``: exact McNemar test of oes against it on
    the same trials.

    ``distance_p_value``: Wilcoxon's signed-rank test of the distances at the end, on those that ran
    with both.
    """

    model: str
    planner: str
    plans: int
    horizon: int
    trials: int
    success: float
    interval: tuple[float, float]
    p_value: float | None
    distance_p_value: float | None
    all_success: float
    collided: float
    initial_mm: float
    final_mm: float
    steps: float
    failures: int
    printed: float | None


def outcomes(rows: Columns, scenario: str) -> list[Outcome]:
    """Success of every model with each planner; a trial that failed to run counts as one without
    success.
    """
    here = select(rows, scenario=scenario)
    found = []
    for planner in sorted(
        map(str, np.unique(here["planner"])), key=lambda name: (name != PAPERS, name)
    ):
        with_it = select(here, planner=planner)
        ours = select(with_it, model=OURS)
        models = in_order(map(str, np.unique(with_it["model"])))
        found += [_outcome(select(with_it, model=model), ours, scenario) for model in models]
    return found


def trials_table(
    found: Sequence[Outcome], name: str, scenario: str, notes: tuple[str, ...]
) -> Table:
    """The outcomes, one row a planner and model."""
    header = (
        "planner",
        "plans x pushes",
        "model",
        "trials",
        "success [95%]",
        "p (3D-OES against it)",
        "success of every object",
        "collided with an obstacle",
        "distance at start (mm)",
        "distance at end (mm)",
        "p",
        "pushes",
        "did not run",
        "paper (50 trials)",
    )
    return Table(
        name=name,
        caption=f"Pushing with model predictive control: {SCENARIOS.get(scenario, scenario)}",
        header=header,
        cells=tuple(_cells(outcome) for outcome in found),
        records=tuple(_record(outcome, scenario) for outcome in found),
        notes=(NOTE, *notes),
    )


def _outcome(rows: Columns, ours: Columns, scenario: str) -> Outcome:
    model = str(rows["model"][0])
    ran = rows["failure"] == ""
    is_paired = model != OURS and bool(np.isin(rows["trial_i"], ours["trial_i"]).any())
    return Outcome(
        model=model,
        planner=(planner := str(rows["planner"][0])),
        plans=int(rows["plans"][0]),
        horizon=int(rows["horizon"][0]),
        trials=len(ran),
        success=float(rows["success"].mean()),
        interval=wilson(int(rows["success"].sum()), len(ran)),
        p_value=_success_p(ours, rows) if is_paired else None,
        distance_p_value=_distance_p(ours, rows) if is_paired else None,
        all_success=float(rows["all_success"].mean()),
        collided=float(rows["collided"].mean()),
        initial_mm=_mean(rows["initial_mm"][ran]),
        final_mm=_mean(rows["mean_final_mm"][ran]),
        steps=_mean(rows["steps_used"][ran]),
        failures=int((~ran).sum()),
        printed=CONTROL.get(scenario, {}).get(model) if planner == PAPERS else None,
    )


def _success_p(ours: Columns, theirs: Columns) -> float:
    first, second = _paired("success", ours, theirs)
    return mcnemar_exact(int((first & ~second).sum()), int((second & ~first).sum()))


def _distance_p(ours: Columns, theirs: Columns) -> float:
    first, second = _paired("mean_final_mm", ours, theirs)
    both = np.isfinite(first) & np.isfinite(second)
    return signed_rank(first[both], second[both])


def _paired(column: str, ours: Columns, theirs: Columns) -> tuple[NDArray[Any], NDArray[Any]]:
    """The values of both models in the trials that both have."""
    _, first, second = np.intersect1d(ours["trial_i"], theirs["trial_i"], return_indices=True)
    return ours[column][first], theirs[column][second]


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _cells(outcome: Outcome) -> tuple[str, ...]:
    return (
        outcome.planner,
        f"{outcome.plans} x {outcome.horizon}",
        MODELS.get(outcome.model, outcome.model),
        str(outcome.trials),
        f"{outcome.success:.2f} [{outcome.interval[0]:.2f}, {outcome.interval[1]:.2f}]",
        "" if outcome.p_value is None else f"{outcome.p_value:.2g}",
        f"{outcome.all_success:.2f}",
        f"{outcome.collided:.2f}",
        f"{outcome.initial_mm:.0f}",
        f"{outcome.final_mm:.1f}",
        "" if outcome.distance_p_value is None else f"{outcome.distance_p_value:.2g}",
        f"{outcome.steps:.1f}",
        str(outcome.failures),
        "" if outcome.printed is None else f"{outcome.printed:.2f}",
    )


def _record(outcome: Outcome, scenario: str) -> dict[str, object]:
    return {
        "scenario": scenario,
        "model": outcome.model,
        "planner": outcome.planner,
        "plans": outcome.plans,
        "horizon": outcome.horizon,
        "trials": outcome.trials,
        "success": round(outcome.success, 4),
        "low": round(outcome.interval[0], 4),
        "high": round(outcome.interval[1], 4),
        "p_value": "" if outcome.p_value is None else f"{outcome.p_value:.6g}",
        "all_success": round(outcome.all_success, 4),
        "collided": round(outcome.collided, 4),
        "initial_mm": round(outcome.initial_mm, 2),
        "final_mm": round(outcome.final_mm, 2),
        "distance_p_value": ""
        if outcome.distance_p_value is None
        else f"{outcome.distance_p_value:.6g}",
        "pushes": round(outcome.steps, 2),
        "did_not_run": outcome.failures,
        "paper": "" if outcome.printed is None else outcome.printed,
    }
