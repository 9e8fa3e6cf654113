"""metrics.json: the figures of every table as one tree, for DVC and for whoever compares runs."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from oes.report.forecast import Interval, Line
from oes.report.names import BASELINE, OURS
from oes.report.study import Forecasts
from oes.report.trials import Outcome

Tree = dict[str, Any]


def study_tree(found: Forecasts) -> Tree:
    """The main table under the task's name, the errors by numbers of objects and of views, and the
    ratio.
    """
    study = found.study
    return {
        study.task: forecast_tree(found.main),
        study.key("ratio"): {f"{OURS}/{BASELINE}": ratio_tree(found.ratios)},
        study.by_objects: forecast_tree(found.by_objects),
        **({study.key("by_views"): forecast_tree(found.by_views)} if found.by_views else {}),
    }


def forecast_tree(rows: Sequence[Line]) -> Tree:
    """group -> model -> means of all objects by metric and T; beside them all else, and the same of
    moved objects.
    """
    tree: Tree = {}
    for line in rows:
        model = tree.setdefault(line.group, {}).setdefault(line.model, {})
        place = model if line.objects == "all" else model.setdefault(line.objects, {})
        place[line.metric] = {str(T): mean for T, (mean, _, _) in line.at.items()}
        place["n"] = line.n
        place.setdefault("interval_95", {})[line.metric] = {
            str(T): [low, high] for T, (_, low, high) in line.at.items()
        }
        place.setdefault("median", {})[line.metric] = {
            str(T): median for T, median in line.median.items()
        }
        place["diverged"] = line.diverged
        if line.objects == "all":
            place["detected_share"] = line.seen
    return tree


def ratio_tree(ratios: Mapping[tuple[str, str, int], Interval]) -> Tree:
    """setting -> metric -> T -> ratio and its paired interval, from (setting, metric, T) -> (mean,
    low, high).
    """
    tree: Tree = {}
    for (setting, metric, T), (mean, low, high) in ratios.items():
        place = tree.setdefault(setting, {}).setdefault(metric, {})
        place[str(T)] = {"ratio": mean, "interval_95": [low, high]}
    return tree


def trials_tree(found: Sequence[Outcome]) -> Tree:
    """model -> planner -> success and trials, and what else is known."""
    tree: Tree = {}
    for outcome in found:
        tree.setdefault(outcome.model, {})[outcome.planner] = {
            "plans": outcome.plans,
            "horizon": outcome.horizon,
            "success": outcome.success,
            "trials": outcome.trials,
            "interval_95": outcome.interval,
            "all_success": outcome.all_success,
            "collided": outcome.collided,
            "final_mm": outcome.final_mm,
            "did_not_run": outcome.failures,
            **({} if outcome.p_value is None else {"p_value": outcome.p_value}),
            **(
                {}
                if outcome.distance_p_value is None
                else {"distance_p_value": outcome.distance_p_value}
            ),
        }
    return tree


def write_json(tree: Tree, path: Path) -> None:
    """Strict JSON, keys in the order given; six significant digits, null where there is no finite
    number.
    """
    path.write_text(json.dumps(_plain(tree), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    match value:
        case Mapping():
            return {str(key): _plain(below) for key, below in value.items()}
        case list() | tuple():
            return [_plain(below) for below in value]
        case float():
            return float(f"{value:.6g}") if math.isfinite(value) else None
        case _:
            return value
