"""Aggregates of all raw rows as one tidy frame: a row per number, with its interval.

Blocks (column ``block``): forecast, by_objects, by_views, ratio, ablation, calibration,
plausibility, detector, view_prediction, capture, mpc, image_forecast, renders, consistency, edits.
``group`` is the setting, the number of objects or views, the split, the scenario or the edit.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oes import schema
from oes.metrics.errors import Boxes, average_precision
from oes.metrics.statistics import (
    bootstrap_mean,
    bootstrap_ratio,
    mcnemar_exact,
    signed_rank,
    wilson,
)
from oes.report.inputs import FIRST, TASK_SPECS, Card, RawData, TaskSpec
from oes.report.names import (
    BASELINE,
    CONTACT,
    EDIT_LABELS,
    FIXED,
    LAST,
    METRICS,
    OURS,
    SETTINGS,
    SHOWN_T,
    VARIED,
    in_order,
    views_key,
)
from oes.report.paper import PAPER_SUCCESS, Printed
from oes.report.rows import RowsError

Aggregate = dict[str, Any]

DIVERGED_MM = 300.0
DEEP_MM = 1.0
PAPER_PLANNER = "shooting"
CALIBRATION = ("sigma_mm", "within_50", "within_90", "nll", "nll_homoscedastic")
MATCHED = ("centre_mm", "chamfer_mm", "normal_deg")  # of detections matched to an object

NAMES = ("block", "task", "group", "model", "against", "planner", "metric", "objects")
VALUES = ("mean", "low", "high", "median", "detected_share", "diverged", "p_value", "paper")
COUNTS = ("T", "n", "episodes")
COLUMNS = (*NAMES, "T", "mean", "low", "high", "median", "n", "episodes", *VALUES[4:])


def tidy(rows: Iterable[Aggregate]) -> pd.DataFrame:
    """Rows as the tidy frame; an absent name is empty, an absent number missing."""
    frame = pd.DataFrame(list(rows), columns=list(COLUMNS))
    frame[list(NAMES)] = frame[list(NAMES)].astype(object).fillna("").astype("str")
    return frame.astype(dict.fromkeys(VALUES, "float64") | dict.fromkeys(COUNTS, "Int64"))


def as_dicts(frame: pd.DataFrame) -> list[Aggregate]:
    """Rows of the frame as dictionaries."""
    return [{str(name): value for name, value in row.items()} for row in frame.to_dict("records")]


def aggregate(raw: RawData, scenarios: Iterable[str], seed: int) -> pd.DataFrame:
    """All aggregates of a study."""
    parts = [error_aggregates(errors, seed) for errors in raw.errors.values()]
    rows = [
        *(
            row
            for task, found in raw.detections.items()
            for row in detector_aggregates(found, task)
        ),
        *(row for (task, split), card in raw.cards.items() for row in _capture(card, task, split)),
        *(row for scenario in scenarios for row in trial_aggregates(raw.trials, scenario)),
        *_image_forecasts(raw),
        *_futures(raw, seed),
        *view_prediction(raw.views),
    ]
    return pd.concat([*parts, tidy(rows)], ignore_index=True)


def error_aggregates(errors: pd.DataFrame, seed: int) -> pd.DataFrame:
    """Aggregates of the forecast errors of one task. Raises RowsError for several or others."""
    names = sorted(set(errors["task"]))
    if len(names) != 1 or names[0] not in TASK_SPECS:
        raise RowsError(
            f"errors must be of one task of {', '.join(TASK_SPECS)}; these are of: {names}"
        )
    task = TASK_SPECS[names[0]]
    rows = [
        *_forecasts(errors[~errors["model"].isin(list(schema.VARIANT_LABELS))], task, seed),
        *_ratios(errors, task, seed),
        *_ablations(errors, task, seed),
        *_calibration(errors, task),
        *_plausibility(errors, task),
    ]
    return tidy({"task": task.name} | row for row in rows)


def _forecasts(rows: pd.DataFrame, task: TaskSpec, seed: int) -> Iterator[Aggregate]:
    main = rows[rows["split"].isin(task.splits)]
    for setting in task.settings:
        printed = task.printed.get(setting, {})
        about = {"block": "forecast", "group": setting}
        yield from _means(_of_setting(main, setting), about, seed, printed)
    varied = _of_setting(rows, VARIED)
    for num, part in varied.groupby("num_objects"):
        yield from _means(part, {"block": "by_objects", "group": str(num)}, seed)
    # Random views with predicted boxes: 1view_pred, 2views_pred, ..., not the fixed camera.
    is_random = rows["setting"].str.endswith("_pred") & (rows["setting"] != FIXED)
    is_random &= ~rows["model"].str.endswith("_fixed") & rows["split"].isin(task.view_splits)
    for num, part in rows[is_random].groupby("num_views"):
        yield from _means(part, {"block": "by_views", "group": str(num)}, seed)


def _means(
    rows: pd.DataFrame, about: Aggregate, seed: int, printed: Printed | None = None
) -> list[Aggregate]:
    """A row per model, metric, (all or moved) objects and T. ``n``, ``episodes`` and the shares
    are of the last T, the same under every metric.
    """
    found = []
    for model in in_order(rows["model"]):
        own = rows[rows["model"] == model]
        for metric in METRICS:
            paper = dict(zip(SHOWN_T, (printed or {}).get(model, {}).get(metric, ()), strict=False))
            for objects, kept in (("all", own), ("moved", own[own["moved"]])):
                by_T = {T: part for T in SHOWN_T if len(part := kept[kept["T"] == T])}
                shared = about | {"model": model, "metric": metric, "objects": objects}
                shared |= _shares(by_T[max(by_T)]) if by_T else {}
                for T, part in by_T.items():
                    row = shared | {"T": T, "median": float(np.median(part[metric]))}
                    row |= _interval(bootstrap_mean(_array(part, metric), _episodes(part), seed))
                    found.append(row | ({"paper": paper.get(T)} if objects == "all" else {}))
    return found


def _shares(last: pd.DataFrame) -> Aggregate:
    return {
        "n": len(last),
        "episodes": len(np.unique(_episodes(last))),
        "detected_share": _mean(last["detected"]),
        "diverged": _mean(last["translation_mm"] > DIVERGED_MM),
    }


def _ratios(errors: pd.DataFrame, task: TaskSpec, seed: int) -> Iterator[Aggregate]:
    """3D-OES over graph-XYZ in every setting; Contact over both in ``VARIED``."""
    main = errors[errors["split"].isin(task.splits)]
    for setting in task.settings:
        own = _of_setting(main, setting)
        pairs = [(OURS, BASELINE)]
        pairs += [(CONTACT, BASELINE), (CONTACT, OURS)] if setting == VARIED else []
        for model, against in pairs:
            for metric in METRICS:
                for T in SHOWN_T:
                    found = ratio(own, (model, against), metric, T, seed)
                    yield from [{"block": "ratio", "group": setting} | found] if found else []


def ratio(
    rows: pd.DataFrame, models: tuple[str, str], metric: str, T: int, seed: int
) -> Aggregate | None:
    """Mean error of the first model over that of the second on the same objects, with a paired
    interval; None without pairs.
    """
    keys = ["split", "episode_i", "object_i"]
    at = rows.loc[rows["T"] == T, [*keys, "model", metric]]
    ours, theirs = (at[at["model"] == model] for model in models)
    pairs = ours.merge(theirs, on=keys, suffixes=("", "_against")).sort_values(keys)
    if pairs.empty:
        return None
    values = _array(pairs, metric), _array(pairs, f"{metric}_against")
    found = _interval(bootstrap_ratio(*values, _episodes(pairs), seed))
    return {"model": models[0], "against": models[1], "metric": metric, "T": T} | found


def _ablations(errors: pd.DataFrame, task: TaskSpec, seed: int) -> Iterator[Aggregate]:
    """Means of the variants of Contact, and their ratios to Contact itself."""
    varied = _of_setting(errors[errors["split"].isin(task.splits)], VARIED)
    is_variant = varied["model"].isin(list(schema.VARIANT_LABELS))
    if task is not FIRST or not is_variant.any():
        return
    for row in _means(varied[is_variant], {"block": "ablation", "group": VARIED}, seed):
        if row["objects"] == "all":
            yield row
    for variant in schema.VARIANT_LABELS:
        for metric in METRICS:
            found = ratio(varied, (variant, CONTACT), metric, LAST, seed)
            yield from [{"block": "ablation", "group": VARIED} | found] if found else []


def _calibration(errors: pd.DataFrame, task: TaskSpec) -> Iterator[Aggregate]:
    """Of models with an error model: mean sigma, coverages and negative log-likelihoods."""
    rows = errors[errors["split"].isin(task.splits) & errors["sigma_mm"].notna()]
    rows = rows[~rows["model"].isin(list(schema.VARIANT_LABELS))]
    for model in in_order(rows["model"]):
        for setting in SETTINGS:
            for T in SHOWN_T:
                own = (rows["model"] == model) & (rows["setting"] == setting) & (rows["T"] == T)
                about = {"block": "calibration", "group": setting, "model": model, "T": T}
                if own.any():
                    yield from _all_means(rows[own], CALIBRATION, about)


def _plausibility(errors: pd.DataFrame, task: TaskSpec) -> Iterator[Aggregate]:
    """Penetration, and forecast motion of objects that did not move (``n`` counts those)."""
    rows = _of_setting(errors[errors["split"].isin(task.splits)], VARIED)
    rows = rows[(rows["T"] == LAST) & ~rows["model"].isin(list(schema.VARIANT_LABELS))]
    for model in in_order(rows["model"]):
        own = rows[rows["model"] == model]
        depth_mm, still_mm = own["penetration_mm"], own.loc[~own["moved"], "translation_mm"]
        for metric, values in (
            ("penetration_mm", depth_mm),
            ("deep_share", depth_mm > DEEP_MM),
            ("still_mm", still_mm),
        ):
            about = {"block": "plausibility", "group": VARIED, "model": model, "T": LAST}
            yield about | {"metric": metric, "mean": _mean(values), "n": len(values)}


def detector_aggregates(rows: pd.DataFrame, task: str) -> Iterator[Aggregate]:
    """By number of views: AP of novel objects; of matched detections mask IoU, centre error,
    Chamfer distance and normal error of the completed surface; counts of objects and boxes.
    """
    for num_views, own in rows.groupby("num_views"):
        about = {"block": "detector", "task": task, "group": views_key(int(str(num_views)))}
        for metric, value in detector_metrics(own).items():
            yield about | {"metric": metric, "mean": value}


def detector_metrics(rows: pd.DataFrame) -> dict[str, float]:
    """Metrics of the detections of one number of views."""
    is_found, is_true = rows["x_m"].notna(), rows["true_x_m"].notna()
    scene_P = rows["episode"] * (rows["step"].max() + 1) + rows["step"]

    def boxes(keep: "pd.Series[bool]", prefix: str) -> Boxes:
        values = rows.loc[keep, [prefix + name for name in schema.BOX]].to_numpy()
        return Boxes(scene_P[keep].to_numpy(), values[:, :3], values[:, 3:])

    found, true = boxes(is_found, ""), boxes(is_true, "true_")
    score_P = _array(rows[is_found], "score")
    matched = rows[is_found & is_true]
    return {
        "ap_25": average_precision(found, score_P, true, 0.25),
        "ap_50": average_precision(found, score_P, true, 0.5),
        "mask_iou": _mean(matched["mask_iou"]) if len(matched) else 0.0,
        **{name: _mean(matched[name]) for name in MATCHED},
        "objects": int(is_true.sum()),
        "boxes": int(is_found.sum()),
    }


def view_prediction(views: pd.DataFrame) -> Iterator[Aggregate]:
    """PSNR and SSIM of predicted views by number of input views."""
    for num_views, own in views.groupby("num_views"):
        about = {"block": "view_prediction", "group": views_key(int(str(num_views)))}
        yield from _all_means(own, ("psnr_db", "ssim"), about)


def _capture(card: Card, task: str, split: str) -> Iterator[Aggregate]:
    about = {"block": "capture", "task": task, "group": split, "episodes": card.episodes}
    for metric, value in card.metrics.items():
        by_T = value.items() if isinstance(value, dict) else [(None, value)]
        yield from (about | {"metric": metric, "T": T and int(T), "mean": mean} for T, mean in by_T)


def trial_aggregates(trials: pd.DataFrame, scenario: str) -> Iterator[Aggregate]:
    """Every model with each planner (the paper's first); a trial that did not run failed.

    Success and final distance hold the p of a paired test of 3D-OES against the model.
    """
    here = trials[trials["scenario"] == scenario]
    for planner in sorted(set(here["planner"]), key=lambda name: (name != PAPER_PLANNER, name)):
        with_it = here[here["planner"] == planner]
        for model in in_order(with_it["model"]):
            own, ours = (with_it[with_it["model"] == name] for name in (model, OURS))
            about = {"block": "mpc", "group": scenario, "model": model, "planner": planner}
            paper = PAPER_SUCCESS.get(scenario, {}).get(model) if planner == PAPER_PLANNER else None
            for row in _trial_rows(own, ours):
                yield about | {"n": len(own), "paper": paper} | row


def _trial_rows(own: pd.DataFrame, ours: pd.DataFrame) -> list[Aggregate]:
    ran = own[own["failure"] == ""]
    low, high = wilson(int(own["success"].sum()), len(own))
    pairs = ours.merge(own, on="trial_i", suffixes=("", "_against")).sort_values("trial_i")
    p_values: Aggregate = {}
    if own["model"].iloc[0] != OURS and len(pairs):
        first, second = pairs["success"], pairs["success_against"]
        p_values["success"] = mcnemar_exact(
            int((first & ~second).sum()), int((second & ~first).sum())
        )
        both = pairs[["mean_final_mm", "mean_final_mm_against"]].to_numpy()
        both = both[np.isfinite(both).all(axis=1)]
        p_values["final_mm"] = signed_rank(both[:, 0], both[:, 1])
    means = {
        "plans": int(own["plans"].iloc[0]),
        "horizon": int(own["horizon"].iloc[0]),
        "success": _mean(own["success"]),
        "all_success": _mean(own["all_success"]),
        "collided": _mean(own["collided"]),
        "initial_mm": _mean(ran["initial_mm"]),
        "final_mm": _mean(ran["mean_final_mm"]),
        "pushes": _mean(ran["steps_used"]),
        "did_not_run": len(own) - len(ran),
    }
    return [
        {"metric": name, "mean": value, "p_value": p_values.get(name)}
        | ({"low": low, "high": high} if name == "success" else {})
        for name, value in means.items()
    ]


def _image_forecasts(raw: RawData) -> Iterator[Aggregate]:
    names = [name for name in schema.FORECASTS if name not in ("clip", "T")]
    for model, rows in raw.image_forecasts.items():
        for T, part in rows.groupby("T"):
            about = {"block": "image_forecast", "task": FIRST.name, "model": model, "T": T}
            yield from _all_means(part, names, about)


def _futures(raw: RawData, seed: int) -> Iterator[Aggregate]:
    """Means of rendered futures and of edits, by model or source; intervals of the edits."""
    for task, tables in raw.futures.items():
        for block in ("renders", "consistency"):
            names = [name for name, kind in schema.FUTURES[block].items() if kind == "float?"]
            for source in in_order(tables[block]["source"]):
                own = tables[block][tables[block]["source"] == source]
                for T in sorted(set(tables[block]["T"])):
                    about = {"block": block, "task": task, "model": source, "T": T}
                    yield from _all_means(own[own["T"] == T], names, about)
        edits = tables["edits"]
        for kind in sorted(set(edits["edit"]), key=list(EDIT_LABELS).index):
            for model in in_order(edits.loc[edits["edit"] == kind, "model"]):
                own = edits[(edits["edit"] == kind) & (edits["model"] == model)]
                about = {"block": "edits", "task": task, "group": kind, "model": model}
                for T, part in own.groupby("T"):
                    yield from _edit_rows(part, about | {"T": T}, seed)


def _edit_rows(part: pd.DataFrame, about: Aggregate, seed: int) -> Iterator[Aggregate]:
    for metric in ("translation_mm", "rotation_deg"):
        found = bootstrap_mean(_array(part, metric), part["episode_i"].to_numpy(), seed)
        yield about | {"metric": metric, "n": len(part)} | _interval(found)


def _all_means(rows: pd.DataFrame, metrics: Iterable[str], about: Aggregate) -> Iterator[Aggregate]:
    """A row per metric; missing values are left out of the mean, ``n`` counts all rows."""
    for metric in metrics:
        yield about | {"metric": metric, "mean": _mean(rows[metric].dropna()), "n": len(rows)}


def _of_setting(rows: pd.DataFrame, setting: str) -> pd.DataFrame:
    """Rows of a setting; models trained for the fixed camera count only in its setting."""
    own = rows[rows["setting"] == setting]
    return own if setting == FIXED else own[~own["model"].str.endswith("_fixed")]


def _episodes(rows: pd.DataFrame) -> NDArray[np.int64]:
    """An index per row of its episode, distinct over splits."""
    names = (rows["split"] + "/" + rows["episode_i"].astype("str")).to_numpy(str)
    return np.unique(names, return_inverse=True)[1].astype(np.int64)


def _array(rows: pd.DataFrame, column: str) -> NDArray[np.float64]:
    return rows[column].to_numpy(np.float64)


def _mean(values: "pd.Series[Any]") -> float:
    return float(values.to_numpy().mean()) if len(values) else float("nan")


def _interval(values: tuple[float, float, float]) -> Aggregate:
    return dict(zip(("mean", "low", "high"), values, strict=True))
