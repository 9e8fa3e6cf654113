"""Tables of all subjects, from the tidy frame of aggregates."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd

from oes.report.aggregates import DEEP_MM, DIVERGED_MM, Aggregate, as_dicts
from oes.report.inputs import FIRST, TASK_SPECS
from oes.report.names import (
    BASELINE,
    CONTACT,
    CONTACT_NOTE,
    EDIT_LABELS,
    LAST,
    METRICS,
    OURS,
    SCENARIOS,
    SETTINGS,
    SHOWN_T,
    VARIED,
    label,
)
from oes.report.table import Table, TableGroup

Line = Mapping[Any, Aggregate]  # the rows of one printed line
Cell = Callable[[Line], str]
ERROR_INDEX = {"model": "model", "error": "metric"}

ERROR_NOTE = (
    "Means with 95% intervals, bootstrapped over episodes. "
    f"Diverged: objects forecast over {DIVERGED_MM / 1000} m off at T = {LAST}. "
    "Rotation is ambiguous for symmetric objects: the rotation of a cylinder about its axis counts "
    "although it cannot be seen. Surface distance is the error that is right for them: the mean "
    "distance from the object's surface as forecast to the nearest true surface (ADD-S), an error "
    "of translation and rotation together."
)
RATIO_NOTE = (
    "Mean error over mean error on the same objects, with paired 95% intervals (bootstrap over "
    "episodes); novel objects."
)
ABLATION_NOTE = (
    "One view, predicted boxes, two novel objects. Every variant differs from Contact in one "
    f"setting of its training or input; the last column is its error over Contact's at T = {LAST}."
)
CALIBRATION_NOTE = (
    "Sigma: scale of the error that the model expects. Coverage: share of objects whose "
    "translation error lies within the model's 50% (90%) interval. NLL: mean negative "
    "log-likelihood of the error (mm), under the model's own sigma for each object, and under the "
    "best sigma that is the same for all objects (homoscedastic). Both laws are fitted to held-out "
    "training episodes, so novel objects are harder."
)
PLAUSIBILITY_NOTE = (
    f"T = {LAST}, one view, predicted boxes. Penetration: maximum pairwise penetration depth of an "
    f"object as forecast; deep: share of objects over {DEEP_MM:g} mm. Motion of static objects: "
    "translation error of the objects that did not move."
)
TRIAL_NOTE = (
    "A trial succeeds when the mean distance of its objects to their goals is within the tolerance "
    "at the end (the paper's rule) and no object touched an obstacle; 'every object' requires the "
    "distance of each. Each plan uses one new image of one random camera; the planner makes no "
    "push that no forecast favours. Planner 'shooting': the best of random plans, as in the paper; "
    "'cem': the cross-entropy method in three iterations. Plans x pushes: plans forecast before "
    "each push, and pushes of each plan. All models and planners have the same starts, goals, "
    "cameras and perception. p of success: exact McNemar test of 3D-OES against the model on the "
    "same trials with the same planner; p of the final distance: Wilcoxon's signed-rank test."
)
VIDEO_NOTE = (
    "Forecasts from the first overhead image of test episodes (two novel objects); in brackets the "
    "score of that first image in place of the forecast. Error: for Visual Foresight, of the "
    "expected pixels of the objects' centres; for PlaNet, of the predicted distance to random "
    "goals; in brackets, without motion."
)
RENDER_NOTE = (
    "Object features of the first frame (one view), masked, moved by each row's motion, composed "
    "into the background map and decoded for three cameras at T = 1 / 3 / 5 (paper 3.2). Objects: "
    "pixels that show an object then or at first, and never the robot, whose features stay in "
    "place. Feature error: norm of the difference from the map encoded from the future image over "
    "that map's norm, within the visible part of the objects' hulls."
)
CONSISTENCY_NOTE = (
    "Each of three views of a rendered future is encoded alone, and objects are detected in it: "
    "number of views in which an object is detected, distance of its centre from where it was "
    "rendered, and spread of the centres between views. Photographs: the same with true images and "
    "true objects, the error of detection alone."
)
EDIT_NOTE = (
    "T = 5, one view, predicted boxes: the first scene is changed alike in Bullet and in what was "
    "perceived, then simulated and forecast. Mean over objects [bootstrap 95% interval over "
    "episodes]."
)


def all_groups(frame: pd.DataFrame) -> dict[str, TableGroup]:
    """All groups that have rows, by name."""
    groups: list[TableGroup] = []
    for task in TASK_SPECS:
        groups += forecast_groups(frame, task)
    for scenario in dict.fromkeys(_block(frame, "mpc")["group"]):
        groups.append(trial_group(frame, str(scenario)))
    groups += [
        ablation_group(frame),
        calibration_group(frame),
        plausibility_group(frame),
        *(detector_group(frame, task) for task in TASK_SPECS),
        view_group(frame),
        image_forecast_group(frame),
        *futures_groups(frame),
        edits_group(frame),
        data_group(frame),
    ]
    return {group.name: group for group in groups if len(group.rows)}


def forecast_groups(frame: pd.DataFrame, task: str) -> list[TableGroup]:
    """Errors by setting, by number of objects and of views, and ratios, of one task."""
    spec, groups = TASK_SPECS[task], []
    rows, ratios = (_block(frame, block, task) for block in ("forecast", "ratio"))
    for objects, ending, about in (("all", "", ""), ("moved", "-moved", ", moved objects")):
        own = _of(rows, objects=objects)
        tables = [
            _error_table(part, SETTINGS[key] + about)
            for key in spec.settings
            if len(part := _of(own, group=key))
        ]
        title = f"{spec.title}, {spec.scenes}{about}"
        groups.append(_group(spec.table + ending, title, tables, rows, ERROR_NOTE))
    for block, name in (("by_objects", "objects"), ("by_views", "input views")):
        shown = _of(own := _block(frame, block, task), objects="all", T=LAST)
        numbers = sorted(set(shown["group"]), key=int)
        columns = {number: _interval(number) for number in numbers}
        caption = f"Mean error with {', '.join(numbers)} {name}"
        table = _grid(caption, shown, ERROR_INDEX, "group", columns)
        title = f"Error by number of {name}, {task} (predicted boxes), T = {LAST}"
        file = block.replace("_", "-") + spec.suffix
        groups.append(_group(file, title, [table], own, ERROR_NOTE))
    pairs = zip(ratios["model"], ratios["against"], strict=True)
    shown = ratios.assign(pair=[f"{label(a)} / {label(b)}" for a, b in pairs])
    index = {"models": "pair", "input": "group", "error": "metric"}
    table = _grid("Ratio of mean errors", shown, index, "T", RATIOS_AT_T)
    title = f"Error over the error of other models, {task}"
    groups.append(_group(f"ratios{spec.suffix}", title, [table], ratios, RATIO_NOTE))
    return [group for group in groups if len(group.rows)]


def _error_table(rows: pd.DataFrame, caption: str) -> Table:
    counts = sorted({(row["n"], row["episodes"]) for row in as_dicts(rows)})
    about = " or ".join(f"{n} objects of {episodes} episodes" for n, episodes in counts)

    def printed(by_T: Line) -> str:
        values = [row["paper"] for row in by_T.values() if not pd.isna(row["paper"])]
        return " / ".join(f"{value:.1f}" for value in values)

    def diverged(by_T: Line) -> str:
        row = by_T.get(LAST)
        # The same under every metric, so it stands beside the first.
        is_first = row and row["metric"] == next(iter(METRICS))
        return f"{100 * row['diverged']:.1f}%" if row and is_first else ""

    columns = AT_T | {f"median, T={LAST}": _value(LAST, 1, "median")}
    columns |= {"diverged": diverged, "paper": printed}
    return _grid(f"{caption} ({about})", rows, ERROR_INDEX, "T", columns)


def ablation_group(frame: pd.DataFrame) -> TableGroup:
    """3D-OES, Contact and the variants of Contact."""
    variants = _block(frame, "ablation", FIRST.name)
    main = _of(_block(frame, "forecast", FIRST.name), group=VARIED, objects="all")
    both = main[main["model"].isin([OURS, CONTACT])] if len(variants) else main[:0]
    rows = pd.concat([both, variants], ignore_index=True)
    columns = {name: _interval((T, "")) for T, name in zip(SHOWN_T, AT_T, strict=True)}
    columns[f"over Contact, T={LAST}"] = _interval((LAST, CONTACT), 2)
    table = _grid("Contact and its variants", rows, ERROR_INDEX, ("T", "against"), columns)
    return _group("ablations", "Ablations of Contact, pushing", [table], rows, ABLATION_NOTE)


def calibration_group(frame: pd.DataFrame) -> TableGroup:
    """Coverage and likelihood of error models."""
    rows = _block(frame, "calibration")
    columns = {
        "sigma (mm)": _value("sigma_mm", 1),
        "coverage of 50%": _value("within_50", 2),
        "of 90%": _value("within_90", 2),
        "NLL": _value("nll", 2),
        "NLL, homoscedastic": _value("nll_homoscedastic", 2),
        "n": _value("nll", 0, "n"),
    }
    index = {"input": "group", "T": "T"}
    tables = [
        _grid(f"{label(str(model))}, {task}, novel objects", part, index, "metric", columns)
        for (task, model), part in rows.groupby(["task", "model"], sort=False)
    ]
    return _group("calibration", "Calibration of uncertainty", tables, rows, CALIBRATION_NOTE)


def plausibility_group(frame: pd.DataFrame) -> TableGroup:
    """Penetration, and motion of static objects, of all tasks."""
    rows = _block(frame, "plausibility")
    columns = {
        "penetration (mm)": _value("penetration_mm", 2),
        "deep": lambda by: f"{100 * by['deep_share']['mean']:.1f}%",
        "motion of static objects (mm)": _value("still_mm", 1),
        "objects": _value("penetration_mm", 0, "n"),
        "static objects": _value("still_mm", 0, "n"),
    }
    table = _grid("Novel objects", rows, {"task": "task", "model": "model"}, "metric", columns)
    title = "Physical plausibility of forecasts"
    return _group("plausibility", title, [table], rows, PLAUSIBILITY_NOTE)


def trial_group(frame: pd.DataFrame, scenario: str) -> TableGroup:
    """Success and distances of one scenario's trials."""
    rows = _of(_block(frame, "mpc"), group=scenario)
    success = {
        "trials": _value("success", 0, "n"),
        "success [95%]": _interval("success", 2),
        "p": _value("success", 2, "p_value", "g"),
        "every object": _value("all_success", 2),
        "collided with an obstacle": _value("collided", 2),
        "paper (50 trials)": _value("success", 2, "paper"),
    }
    distance = {
        "plans x pushes": lambda by: f"{by['plans']['mean']:.0f} x {by['horizon']['mean']:.0f}",
        "distance at start (mm)": _value("initial_mm", 0),
        "at end (mm)": _value("final_mm", 1),
        "p": _value("final_mm", 2, "p_value", "g"),
        "pushes": _value("pushes", 1),
        "did not run": _value("did_not_run", 0),
    }
    index = {"planner": "planner", "model": "model"}
    tables = [
        _grid("Success", rows, index, "metric", success),
        _grid("Plans and distances", rows, index, "metric", distance),
    ]
    name = "table3" + scenario.removeprefix("targets").replace("obstacle", "-obstacle")
    title = f"Model predictive control: pushing {SCENARIOS.get(scenario, scenario)}"
    return _group(name.replace("_", "-"), title, tables, rows, TRIAL_NOTE)


def detector_group(frame: pd.DataFrame, task: str) -> TableGroup:
    """Detection of novel objects by number of input views."""
    rows = _block(frame, "detector", task)
    columns = {
        "AP at IoU 0.25": _value("ap_25", 3),
        "AP at IoU 0.5": _value("ap_50", 3),
        "mask IoU": _value("mask_iou", 3),
        "centre error (mm)": _value("centre_mm", 1),
        "surface: Chamfer (mm)": _value("chamfer_mm", 1),
        "normals (deg)": _value("normal_deg", 1),
        "objects / detections": lambda by: (
            f"{by['objects']['mean']:.0f} / {by['boxes']['mean']:.0f}"
        ),
    }
    table = _grid("Novel objects", rows, {"input": "group"}, "metric", columns)
    return _group(f"detector{TASK_SPECS[task].suffix}", f"Detection in 3D, {task}", [table], rows)


def view_group(frame: pd.DataFrame) -> TableGroup:
    """Prediction of images at other cameras."""
    rows = _block(frame, "view_prediction")
    columns = {"PSNR (dB)": _value("psnr_db", 2), "SSIM": _value("ssim", 3)}
    columns["images"] = _value("ssim", 0, "n")
    table = _grid("Novel objects", rows, {"input": "group"}, "metric", columns)
    return _group("view-prediction", "Prediction of unseen views", [table], rows)


def image_forecast_group(frame: pd.DataFrame) -> TableGroup:
    """Accuracy of the baselines that forecast images."""
    rows = _block(frame, "image_forecast")

    def beside_still(metric: str, still: str, digits: int) -> Cell:
        return lambda by: f"{by[metric]['mean']:.{digits}f} ({by[still]['mean']:.{digits}f})"

    columns = {
        "PSNR (dB)": beside_still("psnr_db", "still_psnr_db", 1),
        "SSIM": beside_still("ssim", "still_ssim", 3),
        "error (mm)": beside_still("error_mm", "still_mm", 1),
        "clips": _value("ssim", 0, "n"),
    }
    table = _grid("Unseen episodes", rows, {"model": "model", "T": "T"}, "metric", columns)
    return _group("image-forecasts", "Baselines that forecast images", [table], rows, VIDEO_NOTE)


def futures_groups(frame: pd.DataFrame) -> list[TableGroup]:
    """Rendered futures, and detection in them."""
    rendered = {
        "PSNR (dB)": _by_T("psnr_db", 1),
        "PSNR of objects (dB)": _by_T("objects_psnr_db", 1),
        "SSIM": _by_T("ssim", 3),
        "feature error": _by_T("feature_error", 2),
        "n": _value(("ssim", LAST), 0, "n"),
    }
    detected = {
        "views that show it": _by_T("views_found", 2),
        "from where it was rendered (mm)": _by_T("centre_mm", 1),
        "between views (mm)": _by_T("spread_mm", 1),
        "n": _value(("centre_mm", LAST), 0, "n"),
    }
    groups = []
    for name, block, title, columns, note in (
        ("futures", "renders", "Rendered futures as images and features", rendered, RENDER_NOTE),
        ("consistency", "consistency", "Detection in rendered futures", detected, CONSISTENCY_NOTE),
    ):
        rows = _block(frame, block)
        index = {"task": "task", "motion": "model"}
        table = _grid("T = 1 / 3 / 5", rows, index, ("metric", "T"), columns)
        groups.append(_group(name, title, [table], rows, note))
    return groups


def edits_group(frame: pd.DataFrame) -> TableGroup:
    """Forecasts of edited scenes."""
    rows = _block(frame, "edits")
    models = [name for name in ("static", BASELINE, OURS) if name in set(rows["model"])]
    columns = {label(model): _interval(model) for model in models}
    columns["objects"] = lambda by: str(next(iter(by.values()))["n"])
    tables = []
    for metric in ("translation_mm", "rotation_deg"):
        shown, caption = _of(rows, metric=metric, T=LAST), f"Error of {METRICS[metric]}"
        tables.append(_grid(caption, shown, {"task": "task", "edit": "group"}, "model", columns))
    return _group("counterfactuals", "Forecasts of edited scenes", tables, rows, EDIT_NOTE)


def data_group(frame: pd.DataFrame) -> TableGroup:
    """Size and motion of every split."""
    rows = _block(frame, "capture").assign(T=lambda found: found["T"].fillna(0))
    share = ("share_object_contact", 0)
    columns = {
        "episodes": _value(share, 0, "episodes"),
        "displacement at T = 1 / 3 / 5 (mm)": _by_T("displacement_mm", 1),
        "episodes with object contacts": lambda by: f"{by[share]['mean']:.0%}",
    }
    table = _grid("All splits", rows, {"task": "task", "split": "group"}, ("metric", "T"), columns)
    return _group("data", "Episodes", [table], rows)


def results_table(tree: Mapping[str, Any]) -> Table:
    """One row per model over all tasks, from the tree of metrics.json (see ``readme``)."""
    models = ("static", "planet", "visual_foresight", "graph_xyz_image", BASELINE, OURS)
    pushing, falling = (tree.get(task, {}).get(VARIED, {}) for task in TASK_SPECS)

    def error(found: Mapping[str, Any], model: str, T: int) -> str:
        if model not in found:
            return ""
        mm, deg = (found[model][name][str(T)] for name in ("translation_mm", "rotation_deg"))
        return f"{mm:.1f}/{deg:.1f}"

    def success(scenario: str, model: str) -> str:
        found = tree["mpc"].get(scenario, {}).get(model, {})
        return "/".join(f"{values['success']:.2f}" for values in found.values())

    cells = [
        (
            label(model),
            *(error(pushing, model, T) for T in SHOWN_T),
            error(falling, model, LAST),
            *(success(scenario, model) for scenario in ("targets", "obstacle")),
        )
        for model in (*models, CONTACT, "simulator")
    ]
    header = ("model", "pushing, T=1", "T=3", "T=5", "falling, T=5", "targets", "obstacle")
    return Table("Mean errors (mm/deg) and success of trials (shooting/cem)", header, tuple(cells))


def _group(
    name: str, title: str, tables: Sequence[Table], rows: pd.DataFrame, *notes: str
) -> TableGroup:
    """A group; where it shows Contact, a note names the prior that Contact has."""
    more = (CONTACT_NOTE,) if (rows["model"] == CONTACT).any() else ()
    return TableGroup(name, title, tuple(tables), rows, (*notes, *more))


def _grid(
    caption: str,
    rows: pd.DataFrame,
    index: Mapping[str, str],
    by: str | tuple[str, str],
    columns: Mapping[str, Cell],
) -> Table:
    """A line for each value of the ``index`` columns; cells print the rows of a line, keyed ``by``
    the remaining column or two.
    """
    lines: dict[tuple[Any, ...], dict[Any, Aggregate]] = {}
    for row in as_dicts(rows):
        line = lines.setdefault(tuple(row[name] for name in index.values()), {})
        line[row[by] if isinstance(by, str) else tuple(row[name] for name in by)] = row
    cells = tuple(
        (*map(_text, index.values(), key), *(cell(line) for cell in columns.values()))
        for key, line in lines.items()
    )
    return Table(caption, (*index, *columns), cells)


def _text(column: str, value: object) -> str:
    if column == "model":
        return label(str(value))
    return {**METRICS, **SETTINGS, **EDIT_LABELS}.get(str(value), str(value))


def _value(key: object, digits: int, field: str = "mean", kind: str = "f") -> Cell:
    """Prints a number of the row under ``key``; empty where there is none."""
    return lambda line: _number(line[key][field], digits, kind) if key in line else ""


def _by_T(metric: str, digits: int) -> Cell:
    """Prints the means of a metric at every T, of rows keyed by metric and T."""
    return lambda line: " / ".join(
        _number(row["mean"], digits) or "-" for key, row in line.items() if key[0] == metric
    )


def _interval(key: object, digits: int = 1) -> Cell:
    """Prints the mean and the interval of the row under ``key``."""

    def show(line: Line) -> str:
        if key not in line:
            return ""
        mean, low, high = (f"{line[key][name]:.{digits}f}" for name in ("mean", "low", "high"))
        return f"{mean} [{low}, {high}]"

    return show


def _number(value: float, digits: int, kind: str = "f") -> str:
    return "" if pd.isna(value) else f"{value:.{digits}{kind}}"


def _block(frame: pd.DataFrame, block: str, task: str | None = None) -> pd.DataFrame:
    rows = frame[frame["block"] == block]
    return rows if task is None else rows[rows["task"] == task]


def _of(rows: pd.DataFrame, **equal: object) -> pd.DataFrame:
    """Rows whose columns have these values."""
    for name, value in equal.items():
        rows = rows[rows[name] == value]
    return rows


AT_T = {f"T={T}": _interval(T) for T in SHOWN_T}
RATIOS_AT_T = {f"T={T}": _interval(T, 2) for T in SHOWN_T}
