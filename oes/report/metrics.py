"""metrics.json (all aggregates as one tree), summary.json and CSV files for DVC's plots."""

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from oes.report.aggregates import Aggregate, as_dicts
from oes.report.inputs import FIRST, TASK_SPECS
from oes.report.names import BASELINE, CONTACT, LAST, OURS, VARIED, views_key
from oes.schema import MODEL_LABELS

Tree = dict[str, Any]
Place = tuple[tuple[Any, ...], Any]  # keys from the root, value

COUNTED = ("plans", "horizon", "did_not_run", "objects", "boxes")  # integers in the tree
SHOWN_METRICS = ("translation_mm", "rotation_deg")  # of the summary


def metrics_tree(frame: pd.DataFrame) -> Tree:
    """Blocks as nested dictionaries, keyed by task, group, model, metric and T where they apply.

    The keys of pushing have no suffix: ``ratio``, ``detector``; those of falling end in
    ``_falling``, except ``falling_by_objects``.
    """
    tree: Tree = {}
    for row in as_dicts(frame):
        for path, value in _places(row):
            put(tree, path, value)
    if views := tree.get("view_prediction"):
        tree["view_prediction"] = views[views_key(1)] | views
    return tree


def put(tree: Tree, path: Iterable[Any], value: object) -> None:
    """Set a value below nested string keys."""
    *above, last = map(str, path)
    for key in above:
        tree = tree.setdefault(key, {})
    tree[last] = value


def _places(row: Aggregate) -> list[Place]:
    """Paths and values of one row of the tidy frame."""
    block, metric = row["block"], row["metric"]
    row |= {"key": _key(block, row["task"])}
    row["mean"] = int(row["mean"]) if metric in COUNTED else row["mean"]
    if block in _SPECIAL:
        return _SPECIAL[block](row)
    above = tuple(row[name] for name in _PATHS[block])
    found = [((*above, metric), row["mean"])]
    if block != "detector":
        is_still = block == "plausibility" and metric == "still_mm"
        found.append(((*above, "n_still" if is_still else "n"), row["n"]))
    return found


def _key(block: str, task: str) -> str:
    if block == "forecast":
        return task
    if block == "by_objects" and task != FIRST.name:
        return f"{task}_by_objects"
    if block in ("by_views", "ratio", "detector", "capture"):
        return block + TASK_SPECS[task].suffix.replace("-", "_")
    return _KEYS.get(block, block)


def _error_places(row: Aggregate) -> list[Place]:
    above = row["key"], row["group"], row["model"]
    at = above if row["objects"] == "all" else (*above, row["objects"])
    metric, T = row["metric"], row["T"]
    found = [
        ((*at, metric, T), row["mean"]),
        ((*at, "n"), row["n"]),
        ((*at, "interval_95", metric, T), [row["low"], row["high"]]),
        ((*at, "median", metric, T), row["median"]),
        ((*at, "diverged"), row["diverged"]),
    ]
    if row["objects"] == "all":
        found.append(((*at, "detected_share"), row["detected_share"]))
    return found


def _ratio_places(row: Aggregate) -> list[Place]:
    value = {"ratio": row["mean"], "interval_95": [row["low"], row["high"]]}
    model, against, end = row["model"], row["against"], (row["metric"], row["T"])
    if row["block"] == "ablation":
        return [(("ablations", model, *end), value)] if against else []
    if model == CONTACT:
        return [(("contact_ratio", row["task"], against, *end), value)]
    return [((row["key"], f"{model}/{against}", row["group"], *end), value)]


def _capture_places(row: Aggregate) -> list[Place]:
    by_T: tuple[int, ...] = () if pd.isna(row["T"]) else (row["T"],)
    at = row["key"], row["metric"], *by_T
    return [(at, row["mean"])] if row["group"] == "train" else []


def _trial_places(row: Aggregate) -> list[Place]:
    metric, at = row["metric"], (row["key"], row["group"], row["model"], row["planner"])
    if metric in ("initial_mm", "pushes"):
        return []
    found: list[Place] = [((*at, metric), row["mean"])]
    if metric == "success":
        found += [((*at, "trials"), row["n"]), ((*at, "interval_95"), [row["low"], row["high"]])]
    if not pd.isna(row["p_value"]):
        name = "p_value" if metric == "success" else "distance_p_value"
        found.append(((*at, name), row["p_value"]))
    return found


_PATHS = {
    "calibration": ("key", "task", "model", "group", "T"),
    "plausibility": ("key", "task", "model"),
    "detector": ("key", "group"),
    "view_prediction": ("key", "group"),
    "image_forecast": ("key", "model", "T"),
    "renders": ("key", "task", "block", "model", "T"),
    "consistency": ("key", "task", "block", "model", "T"),
    "edits": ("key", "task", "block", "group", "model", "T"),
}
_SPECIAL: dict[str, Callable[[Aggregate], list[Place]]] = {
    **dict.fromkeys(("forecast", "by_objects", "by_views"), _error_places),
    **dict.fromkeys(("ratio", "ablation"), _ratio_places),
    "capture": _capture_places,
    "mpc": _trial_places,
}
_KEYS = {"image_forecast": "video", **dict.fromkeys(("renders", "consistency", "edits"), "futures")}


def summary(tree: Mapping[str, Any]) -> Tree:
    """The few numbers that ``dvc metrics show`` prints, from the tree of metrics.json."""
    found: Tree = {}
    for task in TASK_SPECS:
        models = tree.get(task, {}).get(VARIED, {})
        for model in (name for name in MODEL_LABELS if name in models):
            error = models[model]["translation_mm"][str(LAST)]
            put(found, (task, "translation_mm", model), error)
        for model, ratios in _ratios(tree, task).items():
            for metric, ratio in ratios.items():
                name = metric.split("_")[0]
                put(found, (task, f"{model}_over_graph_xyz", name), ratio["ratio"])
        if detector := tree.get(_key("detector", task), {}).get(views_key(1)):
            put(found, (task, "detector", "ap_50"), detector["ap_50"])
    for scenario, models in tree["mpc"].items():
        for model in (name for name in (OURS, CONTACT) if name in models):
            for planner, values in models[model].items():
                put(found, ("success", scenario, f"{model}_{planner}"), values["success"])
    put(found, ("view_prediction", "psnr_db"), tree["view_prediction"]["psnr_db"])
    return found


def headline_ratios(tree: Mapping[str, Any]) -> list[str]:
    """A line per model: its error over that of graph-XYZ at the last T, in every task."""
    parts: dict[str, list[str]] = {}
    for task in TASK_SPECS:
        for model, ratios in _ratios(tree, task).items():
            values = [
                f"{value['ratio']:.2f} [{low:.2f}, {high:.2f}] in {metric.split('_')[0]}"
                for metric, value in ratios.items()
                for low, high in [value["interval_95"]]
            ]
            parts.setdefault(model, []).append(f"{task} {', '.join(values)}")
    return [
        f"{MODEL_LABELS[model]} over graph-XYZ: {'; '.join(each)}." for model, each in parts.items()
    ]


def _ratios(tree: Mapping[str, Any], task: str) -> dict[str, Tree]:
    """By model and metric: 3D-OES and Contact over graph-XYZ at the last T."""
    ours = tree.get(_key("ratio", task), {}).get(f"{OURS}/{BASELINE}", {}).get(VARIED, {})
    contact = tree.get("contact_ratio", {}).get(task, {}).get(BASELINE, {})
    found = {
        model: {metric: each[metric][str(LAST)] for metric in SHOWN_METRICS if metric in each}
        for model, each in ((OURS, ours), (CONTACT, contact))
    }
    return {model: ratios for model, ratios in found.items() if ratios}


def write_plots(frame: pd.DataFrame, logs: pd.DataFrame, folder: Path) -> None:
    """``error_over_T.csv`` (mean translation error by T) and ``learning.csv`` (held-out
    translation error by step), a column per task and model.
    """
    folder.mkdir(parents=True, exist_ok=True)
    chosen = frame[(frame["block"] == "forecast") & (frame["group"] == VARIED)]
    chosen = chosen[(chosen["metric"] == "translation_mm") & (chosen["objects"] == "all")]
    _write_wide(chosen, ("T", "mean"), folder / "error_over_T.csv")
    held_out = logs.dropna(subset=["mm_5"]) if "mm_5" in logs else pd.DataFrame()
    _write_wide(held_out, ("step", "mm_5"), folder / "learning.csv")


def _write_wide(rows: pd.DataFrame, axes: tuple[str, str], path: Path) -> None:
    if rows.empty:
        path.write_text(f"{axes[0]},{axes[1]}\n", encoding="utf-8")
        return
    lines = rows["task"] + "_" + rows["model"]
    wide = rows.assign(line=lines).pivot(index=axes[0], columns="line", values=axes[1])
    # DVC breaks a line at an empty cell; models log at different steps.
    wide = wide.interpolate(method="index", limit_area="inside")
    wide[list(dict.fromkeys(lines))].round(4).to_csv(path, lineterminator="\n")


def write_json(tree: Tree, path: Path) -> None:
    """Strict JSON in the given order."""
    path.write_text(json.dumps(plain(tree), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def plain(value: Any) -> Any:
    """Floats of six significant digits, None for those not finite; string keys."""
    match value:
        case Mapping():
            return {str(key): plain(below) for key, below in value.items()}
        case list() | tuple():
            return [plain(below) for below in value]
        case float():
            return float(f"{value:.6g}") if math.isfinite(value) else None
        case _:
            return value
