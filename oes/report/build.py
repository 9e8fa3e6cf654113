"""Everything in reports/, from the raw rows of all stages."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oes.config import params
from oes.report.bundle import copy_films, copy_models
from oes.report.card import read_card
from oes.report.figures import by_group, displacement, over_time
from oes.report.forecast import Group, Interval, Line, forecast_table, lines, ratio
from oes.report.metrics import forecast_tree, ratio_tree, trials_tree, write_json
from oes.report.names import METRICS, SETTINGS
from oes.report.page import headline, write_page
from oes.report.paper import FORECAST, HORIZONS
from oes.report.perception import (
    DETECTIONS,
    VIEWS,
    detector_figures,
    detector_table,
    view_figures,
    view_table,
    views_key,
)
from oes.report.provenance import describe_machine, provenance
from oes.report.rows import ERRORS, TRIALS, Columns, read_columns, select
from oes.report.table import Table, write_table
from oes.report.trials import outcomes, trials_table

TASK, MAIN, VARIED, FIXED, LAST = "pushing", "test2", "1view_pred", "fixed_pred", 5
OURS, BASELINE = "oes", "graph_xyz"
SHEET = "contact_sheet.png"


@params
class Tables:
    """The section ``tables``: seed of the bootstrap, name of the profile, control scenarios in their order."""

    seed: int
    profile: str
    scenarios: tuple[str, ...]


@dataclass(frozen=True)
class Inputs:
    """The datasets of every stage."""

    meshes: Path
    episodes: Path
    perception: Path
    objects: Path
    dynamics: Path
    rollouts: Path
    trials: Path


@dataclass(frozen=True)
class Forecasts:
    """Table 1 and its variations as lines, and the ratio of errors that the study is judged by."""

    table1: list[Line]
    by_objects: list[Line]
    by_views: list[Line]
    ratios: dict[tuple[str, str, int], Interval]


def forecasts(rows: Columns, seed: int) -> Forecasts:
    """Average the errors: by setting on two objects; by number of objects; by number of predicted-box views."""
    main = select(rows, split=MAIN)
    settings = [Group(key, label, _own(main, key), FORECAST[key]) for key, label in SETTINGS.items()]
    varied = _own(rows, VARIED)
    counts = [Group(str(n), str(n), select(varied, num_objects=n), {}) for n in np.unique(varied["num_objects"])]
    predicted = {name: values[_is_found(main)] for name, values in main.items()}
    views = [Group(str(n), str(n), select(predicted, num_views=n), {}) for n in np.unique(predicted["num_views"])]
    ratios = {
        (group.key, metric, T): found
        for group in settings
        for metric in METRICS
        for T in HORIZONS
        if (found := ratio(group.rows, OURS, BASELINE, metric, T, seed)) is not None
    }
    return Forecasts(lines(settings, seed), lines(counts, seed), lines(views, seed), ratios)


def forecast_tables(found: Forecasts, notes: Sequence[str]) -> list[Table]:
    """Table 1, by number of objects, by number of views."""
    return [
        forecast_table("table1", "Forecasting pushed objects, two novel objects", "setting", found.table1, notes),
        forecast_table(
            "by-objects", "Error by number of objects (one view, predicted boxes)", "objects_in_scene",
            found.by_objects, notes,
        ),
        forecast_table(
            "by-views", "Error by number of input views (predicted boxes)", "input_views", found.by_views, notes
        ),
    ]  # fmt: skip


def build(cfg: Tables, inputs: Inputs, seeds: Mapping[str, int], out: Path) -> None:
    """Write every table, figure, film, the weights, metrics.json and README.md into ``out``.

    Raises RowsError for rows that cannot be read, FileNotFoundError for a stage's file that is not there.
    """
    rows = read_columns(sorted(inputs.rollouts.glob("*/errors.csv")), ERRORS)
    found = forecasts(rows, cfg.seed)
    trials = read_columns(sorted(inputs.trials.glob("*/trials.csv")), TRIALS)
    control = {scenario: outcomes(trials, scenario) for scenario in cfg.scenarios}
    seen = inputs.objects / f"{TASK}-{MAIN}"
    detector = detector_figures(read_columns([seen / "detections.csv"], DETECTIONS))
    views = view_figures(read_columns([seen / "views.csv"], VIEWS))
    card = read_card(inputs.episodes / f"{TASK}-train" / "card.json")
    machine = describe_machine()
    line = provenance(cfg.profile, {"train": card.episodes} | _counts(rows), seeds, machine)
    tables = [
        *forecast_tables(found, [line]),
        *(trials_table(each, f"table{3 + i}", name, (line,)) for i, (name, each) in enumerate(control.items())),
        detector_table(detector, (line,)),
        view_table(views, (line,)),
    ]
    out.mkdir(parents=True, exist_ok=True)
    for table in tables:
        write_table(table, out)
    figures = write_figures(found, card.displacement_mm, out / "figures")
    copy_models(inputs.perception, inputs.dynamics, out / "models")
    shutil.copyfile(inputs.meshes / SHEET, out / SHEET)
    films = copy_films(inputs.trials, trials, cfg.scenarios[0], OURS, out / "films")
    tree = {
        "profile": cfg.profile,
        "machine": machine,
        TASK: forecast_tree(found.table1),
        "ratio": {f"{OURS}/{BASELINE}": ratio_tree(found.ratios)},
        "by_objects": forecast_tree(found.by_objects),
        "by_views": forecast_tree(found.by_views),
        "mpc": {scenario: trials_tree(each) for scenario, each in control.items()},
        "detector": detector,
        "view_prediction": {**views[views_key(1)], **views},
        "capture": card.metrics,
    }
    write_json(tree, out / "metrics.json")
    opening = [headline(found.ratios, VARIED, LAST), line]
    write_page(out / "README.md", opening, tables, {SHEET: "The meshes.", **figures}, films)


def write_figures(found: Forecasts, displacement_mm: Mapping[int, Sequence[float]], folder: Path) -> dict[str, str]:
    """The figures as PNG and SVG; gives caption by the PNG's path relative to ``folder``'s parent."""
    folder.mkdir(parents=True, exist_ok=True)
    varied = [line for line in found.table1 if line.group == VARIED]
    over_time(varied, f"{SETTINGS[VARIED]}, two novel objects", folder / "error-over-time")
    by_group(found.by_objects, "objects in the scene", LAST, folder / "by-objects")
    by_group(found.by_views, "input views", LAST, folder / "by-views")
    displacement(displacement_mm, folder / "displacement")
    captions = {
        "error-over-time": "Error over time, mean and 95% interval.",
        "by-objects": f"Error by number of objects, T = {LAST}.",
        "by-views": f"Error by number of input views, T = {LAST}.",
        "displacement": "How far the objects of the training episodes move.",
    }
    return {f"{folder.name}/{name}.png": caption for name, caption in captions.items()}


def _counts(rows: Columns) -> dict[str, int]:
    """Test episodes of each split."""
    return {str(split): len(np.unique(select(rows, split=split)["episode_i"])) for split in np.unique(rows["split"])}


def _own(rows: Columns, setting: str) -> Columns:
    """The rows of a setting; a model trained for the fixed camera counts only there."""
    here = select(rows, setting=setting)
    is_own = np.ones(len(here["T"]), dtype=bool) if setting == FIXED else ~np.char.endswith(here["model"], "_fixed")
    return {name: values[is_own] for name, values in here.items()}


def _is_found(rows: Columns) -> NDArray[np.bool_]:
    """Rows of random views with predicted boxes (``1view_pred``, ``2views_pred``...) of models that saw such views."""
    is_random = np.char.endswith(rows["setting"], "_pred") & (rows["setting"] != FIXED)
    return np.asarray(is_random & ~np.char.endswith(rows["model"], "_fixed"))
