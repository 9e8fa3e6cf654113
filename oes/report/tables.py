"""Tables of all subjects, from the tidy frame of aggregates."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pandas as pd

from oes.report.aggregates import DEEP_MM, DIVERGED_MM, Row, records
from oes.report.inputs import FIRST, TASKS
from oes.report.names import (
    BASELINE,
    CONTACT,
    CONTACT_NOTE,
    EDITS,
    HORIZONS,
    LAST,
    METRICS,
    OURS,
    SCENARIOS,
    SETTINGS,
    VARIED,
    label,
)
from oes.report.table import Table, TableGroup

Line = tuple[tuple[Any, ...], Mapping[Any, Row]]
AT_T = tuple(f"T={T}" for T in HORIZONS)

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
    for task in TASKS:
        groups += forecast_groups(frame, task)
    for scenario in dict.fromkeys(_block(frame, "mpc")["group"]):
        groups.append(trial_group(frame, str(scenario)))
    groups += [
        ablation_group(frame),
        calibration_group(frame),
        plausibility_group(frame),
        *(detector_group(frame, task) for task in TASKS),
        view_group(frame),
        image_forecast_group(frame),
        futures_group(frame, "renders"),
        futures_group(frame, "consistency"),
        edits_group(frame),
        data_group(frame),
    ]
    return {group.name: group for group in groups if len(group.rows)}


def forecast_groups(frame: pd.DataFrame, task: str) -> list[TableGroup]:
    """Errors by setting, by number of objects and of views, and ratios, of one task."""
    spec = TASKS[task]
    rows, ratios = (_block(frame, block, task) for block in ("forecast", "ratio"))
    keys = [key for key in spec.settings if key in set(rows["group"])]
    title = f"{spec.title}, {spec.scenes}"
    main = [_error_table(_of(rows, group=key, objects="all"), SETTINGS[key]) for key in keys]
    moved = [
        _error_table(part, f"{SETTINGS[key]}, moved objects")
        for key in keys
        if len(part := _of(rows, group=key, objects="moved"))
    ]
    groups = [
        _group(spec.table, title, main, rows, ERROR_NOTE),
        _group(f"{spec.table}-moved", f"{title}: those that moved", moved, rows, ERROR_NOTE),
    ]
    for block, header in (("by_objects", "objects"), ("by_views", "input views")):
        own = _block(frame, block, task)
        name = block.replace("_", "-") + spec.suffix
        title = f"Error by number of {header}, {task} (predicted boxes), T = {LAST}"
        shown = _of(own, objects="all", T=LAST)
        if len(shown):
            groups.append(_group(name, title, [_number_table(shown, header)], own, ERROR_NOTE))
    if len(ratios):
        title = f"Error over the error of other models, {task}"
        groups.append(
            _group(f"ratios{spec.suffix}", title, [_ratio_table(ratios)], ratios, RATIO_NOTE)
        )
    return groups


def _error_table(rows: pd.DataFrame, caption: str) -> Table:
    counts = sorted({(row["n"], row["episodes"]) for row in records(rows)})
    about = " or ".join(f"{n} objects of {episodes} episodes" for n, episodes in counts)
    cells = []
    for (model, metric), by_T in _lines(rows, ("model", "metric"), "T"):
        last = by_T.get(LAST)
        shares = last and metric == next(iter(METRICS))
        printed = [by_T[T]["paper"] for T in by_T if not pd.isna(by_T[T]["paper"])]
        cells.append(
            (
                label(model),
                METRICS[metric],
                *(_interval(by_T.get(T)) for T in HORIZONS),
                f"{last['median']:.1f}" if last else "",
                f"{100 * last['diverged']:.1f}%" if last and shares else "",
                " / ".join(f"{value:.1f}" for value in printed),
            )
        )
    header = ("model", "error", *AT_T, f"median, T={LAST}", "diverged", "paper")
    return _table(f"{caption} ({about})", header, cells)


def _number_table(rows: pd.DataFrame, header: str) -> Table:
    numbers = sorted(set(rows["group"]), key=int)
    cells = [
        (label(model), METRICS[metric], *(_interval(by_group.get(number)) for number in numbers))
        for (model, metric), by_group in _lines(rows, ("model", "metric"), "group")
    ]
    caption = f"Mean error with {header}: {', '.join(numbers)}"
    return _table(caption, ("model", "error", *numbers), cells)


def _ratio_table(rows: pd.DataFrame) -> Table:
    cells = [
        (
            f"{label(model)} / {label(against)}",
            SETTINGS[group],
            METRICS[metric].split(" (")[0],
            *(_interval(by_T.get(T), 2) for T in HORIZONS),
        )
        for (model, against, group, metric), by_T in _lines(
            rows, ("model", "against", "group", "metric"), "T"
        )
    ]
    return _table("Ratio of mean errors", ("models", "input", "error", *AT_T), cells)


def ablation_group(frame: pd.DataFrame) -> TableGroup:
    """3D-OES, Contact and the variants of Contact."""
    variants = _block(frame, "ablation", FIRST.name)
    main = _of(_block(frame, "forecast", FIRST.name), group=VARIED, objects="all")
    both = main[main["model"].isin([OURS, CONTACT])] if len(variants) else main[:0]
    rows = pd.concat([both, variants], ignore_index=True)
    ratios = {(row["model"], row["metric"]): row for row in records(rows) if row["against"]}
    cells = [
        (
            label(model),
            METRICS[metric],
            *(_interval(by_T.get(T)) for T in HORIZONS),
            _interval(ratios.get((model, metric)), 2),
        )
        for (model, metric), by_T in _lines(_of(rows, against=""), ("model", "metric"), "T")
    ]
    header = ("model", "error", *AT_T, f"over Contact, T={LAST}")
    table = _table("Contact and its variants", header, cells)
    return _group("ablations", "Ablations of Contact, pushing", [table], rows, ABLATION_NOTE)


def calibration_group(frame: pd.DataFrame) -> TableGroup:
    """Coverage and likelihood of error models."""
    rows = _block(frame, "calibration")
    tables = []
    for task in dict.fromkeys(rows["task"]):
        cells = [
            (
                label(model),
                SETTINGS[group],
                str(T),
                f"{by['sigma_mm']['mean']:.1f}",
                f"{by['within_50']['mean']:.2f} / {by['within_90']['mean']:.2f}",
                f"{by['nll']['mean']:.2f}",
                f"{by['nll_homoscedastic']['mean']:.2f}",
                str(by["nll"]["n"]),
            )
            for (model, group, T), by in _lines(
                _of(rows, task=task), ("model", "group", "T"), "metric"
            )
        ]
        header: tuple[str, ...] = (
            "model",
            "input",
            "T",
            "sigma (mm)",
            "coverage of 50% / 90% intervals",
        )
        header += ("NLL", "NLL, homoscedastic", "n")
        tables.append(_table(f"{str(task).capitalize()}, novel objects", header, cells))
    return _group("calibration", "Calibration of uncertainty", tables, rows, CALIBRATION_NOTE)


def plausibility_group(frame: pd.DataFrame) -> TableGroup:
    """Penetration, and motion of static objects, of all tasks."""
    rows = _block(frame, "plausibility")
    cells = [
        (
            task,
            label(model),
            f"{by['penetration_mm']['mean']:.2f}",
            f"{100 * by['deep_share']['mean']:.1f}%",
            _number(by["still_mm"]["mean"], 1),
            str(by["penetration_mm"]["n"]),
            str(by["still_mm"]["n"]),
        )
        for (task, model), by in _lines(rows, ("task", "model"), "metric")
    ]
    header = ("task", "model", "penetration (mm)", "deep", "motion of static objects (mm)")
    table = _table("Novel objects", (*header, "objects", "static objects"), cells)
    title = "Physical plausibility of forecasts"
    return _group("plausibility", title, [table], rows, PLAUSIBILITY_NOTE)


def trial_group(frame: pd.DataFrame, scenario: str) -> TableGroup:
    """Success and distances of one scenario's trials."""
    rows = _of(_block(frame, "mpc"), group=scenario)
    success, distance = [], []
    for (planner, model), by in _lines(rows, ("planner", "model"), "metric"):
        mean = {metric: row["mean"] for metric, row in by.items()}
        success.append(
            (
                *(planner, label(model), str(by["success"]["n"])),
                _interval(by["success"], 2),
                _number(by["success"]["p_value"], 2, "g"),
                *(f"{mean[name]:.2f}" for name in ("all_success", "collided")),
                _number(by["success"]["paper"], 2),
            )
        )
        distance.append(
            (
                *(planner, label(model), f"{mean['plans']:.0f} x {mean['horizon']:.0f}"),
                *(f"{mean['initial_mm']:.0f}", f"{mean['final_mm']:.1f}"),
                _number(by["final_mm"]["p_value"], 2, "g"),
                *(f"{mean['pushes']:.1f}", f"{mean['did_not_run']:.0f}"),
            )
        )
    head: tuple[str, ...] = ("planner", "model", "trials", "success [95%]", "p", "every object")
    head += ("pushes", "did not run")
    tables = [
        _table("Success", (*head[:6], "collided with an obstacle", "paper (50 trials)"), success),
        _table(
            "Plans and distances",
            (*head[:2], "plans x pushes", "distance at start (mm)", "at end (mm)", "p", *head[-2:]),
            distance,
        ),
    ]
    name = "table3" + scenario.removeprefix("targets").replace("obstacle", "-obstacle")
    title = f"Model predictive control: pushing {SCENARIOS.get(scenario, scenario)}"
    return _group(name.replace("_", "-"), title, tables, rows, TRIAL_NOTE)


def detector_group(frame: pd.DataFrame, task: str) -> TableGroup:
    """Detection of novel objects by number of input views."""
    rows = _block(frame, "detector", task)
    columns = {"ap_25": 3, "ap_50": 3, "mask_iou": 3}
    columns |= {"centre_mm": 1, "chamfer_mm": 1, "normal_deg": 1}
    cells = [
        (
            key,
            *(
                _number(by[name]["mean"], digits) if name in by else ""
                for name, digits in columns.items()
            ),
            f"{by['objects']['mean']:.0f} / {by['boxes']['mean']:.0f}",
        )
        for (key,), by in _lines(rows, ("group",), "metric")
    ]
    header: tuple[str, ...] = (
        "input",
        "AP at IoU 0.25",
        "AP at IoU 0.5",
        "mask IoU",
        "centre error (mm)",
    )
    header += ("surface: Chamfer (mm)", "normals (deg)", "true objects / detections")
    table = _table(f"{task.capitalize()}, novel objects", header, cells)
    title = f"Detection in 3D, {task}"
    return _group(f"detector{TASKS[task].suffix}", title, [table], rows)


def view_group(frame: pd.DataFrame) -> TableGroup:
    """Prediction of images at other cameras."""
    rows = _block(frame, "view_prediction")
    cells = [
        (key, f"{by['psnr_db']['mean']:.2f}", f"{by['ssim']['mean']:.3f}", str(by["ssim"]["n"]))
        for (key,), by in _lines(rows, ("group",), "metric")
    ]
    table = _table("Novel objects", ("input", "PSNR (dB)", "SSIM", "images"), cells)
    return _group("view-prediction", "Prediction of unseen views", [table], rows)


def image_forecast_group(frame: pd.DataFrame) -> TableGroup:
    """Accuracy of the baselines that forecast images."""
    rows = _block(frame, "image_forecast")
    formats = {"psnr_db": 1, "ssim": 3, "error_mm": 1}
    cells = [
        (
            *(label(model), str(T)),
            *(
                f"{by[name]['mean']:.{digits}f} "
                f"({by['still_' + name.removeprefix('error_')]['mean']:.{digits}f})"
                for name, digits in formats.items()
            ),
            str(by["ssim"]["n"]),
        )
        for (model, T), by in _lines(rows, ("model", "T"), "metric")
    ]
    header = ("model", "T", "PSNR (dB)", "SSIM", "error (mm)", "clips")
    table = _table("Unseen episodes", header, cells)
    title = "Baselines that forecast images"
    return _group("image-forecasts", title, [table], rows, VIDEO_NOTE)


def futures_group(frame: pd.DataFrame, block: str) -> TableGroup:
    """Rendered futures (``renders``) or detection in them (``consistency``)."""
    name, title, note, columns = {
        "renders": (
            "futures",
            "Rendered futures as images and features",
            RENDER_NOTE,
            {
                "psnr_db": ("PSNR (dB)", 1),
                "objects_psnr_db": ("PSNR of objects (dB)", 1),
                "ssim": ("SSIM", 3),
                "feature_error": ("feature error", 2),
            },
        ),
        "consistency": (
            "consistency",
            "Detection in rendered futures",
            CONSISTENCY_NOTE,
            {
                "views_found": ("views that show it", 2),
                "centre_mm": ("from where it was rendered (mm)", 1),
                "spread_mm": ("between views (mm)", 1),
            },
        ),
    }[block]
    rows = _block(frame, block)
    cells = []
    for (task, source), by_metric in _nested(rows, ("task", "model"), "metric"):
        shown = [
            " / ".join(_number(row["mean"], digits) or "-" for row in by_metric[metric])
            for metric, (_, digits) in columns.items()
        ]
        first = next(iter(by_metric.values()))[0]
        cells.append((task, label(source), *shown, str(first["n"])))
    header = ("task", "motion", *(text for text, _ in columns.values()), "n")
    table = _table("T = 1 / 3 / 5", header, cells)
    return _group(name, title, [table], rows, note)


def edits_group(frame: pd.DataFrame) -> TableGroup:
    """Forecasts of edited scenes."""
    rows = _block(frame, "edits")
    models = [name for name in ("static", BASELINE, OURS) if name in set(rows["model"])]
    tables = []
    for metric in ("translation_mm", "rotation_deg"):
        shown = _of(rows, metric=metric, T=LAST)
        cells = [
            (
                *(task, EDITS[kind]),
                *(_interval(by.get(model)) for model in models),
                str(next(iter(by.values()))["n"]),
            )
            for (task, kind), by in _lines(shown, ("task", "group"), "model")
        ]
        header = ("task", "edit", *map(label, models), "objects")
        tables.append(_table(f"Error of {METRICS[metric]}", header, cells))
    return _group("counterfactuals", "Forecasts of edited scenes", tables, rows, EDIT_NOTE)


def data_group(frame: pd.DataFrame) -> TableGroup:
    """Size and motion of every split."""
    rows = _block(frame, "capture")
    cells = []
    for (task, split), by_metric in _nested(rows, ("task", "group"), "metric"):
        displacement = (f"{row['mean']:.1f}" for row in by_metric["displacement_mm"])
        share = by_metric["share_object_contact"][0]
        row = (task, split, str(share["episodes"]), " / ".join(displacement))
        cells.append((*row, f"{share['mean']:.0%}"))
    header = ("task", "split", "episodes", "displacement at T = 1 / 3 / 5 (mm)")
    table = _table("All splits", (*header, "episodes with object contacts"), cells)
    return _group("data", "Episodes", [table], rows)


def results_table(tree: Mapping[str, Any]) -> Table:
    """One row per model over all tasks, from the tree of metrics.json (see ``readme``)."""
    models = ("static", "planet", "visual_foresight", "graph_xyz_image", BASELINE, OURS)
    pushing, falling = (tree.get(task, {}).get(VARIED, {}) for task in TASKS)

    def error(found: Mapping[str, Any], model: str, T: int) -> str:
        if model not in found:
            return ""
        mm, deg = (found[model][name][str(T)] for name in ("translation_mm", "rotation_deg"))
        return f"{mm:.1f} mm, {deg:.1f}°"

    def success(scenario: str, model: str) -> str:
        found = tree["mpc"].get(scenario, {}).get(model, {})
        return " / ".join(f"{values['success']:.2f}" for values in found.values())

    cells = [
        (
            label(model),
            *(error(pushing, model, T) for T in HORIZONS),
            error(falling, model, LAST),
            *(success(scenario, model) for scenario in ("targets", "obstacle")),
        )
        for model in (*models, CONTACT, "simulator")
    ]
    header: tuple[str, ...] = ("model", "pushing, T=1", "T=3", "T=5", "falling, T=5")
    header += ("targets (shooting / cem)", "around an obstacle")
    return Table("Mean errors and shares of successful trials", header, tuple(cells))


def _group(
    name: str, title: str, tables: Sequence[Table], rows: pd.DataFrame, *notes: str
) -> TableGroup:
    """A group; where it shows Contact, a note names the prior that Contact has."""
    more = (CONTACT_NOTE,) if (rows["model"] == CONTACT).any() else ()
    return TableGroup(name, title, tuple(tables), rows, (*notes, *more))


def _table(caption: str, header: Sequence[str], cells: Iterable[Sequence[str]]) -> Table:
    return Table(caption, tuple(header), tuple(map(tuple, cells)))


def _block(frame: pd.DataFrame, block: str, task: str | None = None) -> pd.DataFrame:
    rows = frame[frame["block"] == block]
    return rows if task is None else rows[rows["task"] == task]


def _of(rows: pd.DataFrame, **equal: object) -> pd.DataFrame:
    """Rows whose columns have these values."""
    for name, value in equal.items():
        rows = rows[rows[name] == value]
    return rows


def _nested(rows: pd.DataFrame, index: Sequence[str], column: str) -> list[tuple[Any, Any]]:
    """Rows by index and column, in order of appearance; a list of rows under each."""
    found: dict[tuple[Any, ...], dict[Any, list[Row]]] = {}
    for row in records(rows):
        place = found.setdefault(tuple(row[name] for name in index), {})
        place.setdefault(row[column], []).append(row)
    return list(found.items())


def _lines(rows: pd.DataFrame, index: Sequence[str], column: str) -> list[Line]:
    """As ``_nested``, of indices that determine one row."""
    return [
        (key, {name: each[0] for name, each in by.items()})
        for key, by in _nested(rows, index, column)
    ]


def _interval(row: Row | None, digits: int = 1) -> str:
    if row is None:
        return ""
    mean, low, high = (f"{row[name]:.{digits}f}" for name in ("mean", "low", "high"))
    return f"{mean} [{low}, {high}]"


def _number(value: float, digits: int, kind: str = "f") -> str:
    return "" if pd.isna(value) else f"{value:.{digits}{kind}}"
