"""Reading the outputs of all stages into data frames."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from oes import schema
from oes.config import params
from oes.report.names import SETTINGS, VARIED
from oes.report.paper import PAPER_ERRORS, Printed
from oes.report.rows import RowsError, read_rows


@params
class TablesConfig:
    """The section ``tables``. ``seed``: of the bootstrap. ``tasks`` must include pushing."""

    seed: int
    profile: str
    tasks: tuple[str, ...]
    scenarios: tuple[str, ...]


@dataclass(frozen=True)
class Inputs:
    """The dataset folder of every stage."""

    meshes: Path
    episodes: Path
    perception: Path
    objects: Path
    dynamics: Path
    rollouts: Path
    futures: Path
    trials: Path


@dataclass(frozen=True)
class TaskSpec:
    """Splits, settings and captions of one task's tables.

    ``splits``: test splits of the main table. ``view_splits``: of the error by number of views;
    empty if there is no such table. ``suffix`` ends the names of files and of metrics.json keys.
    """

    name: str
    splits: tuple[str, ...]
    view_splits: tuple[str, ...]
    settings: tuple[str, ...]
    printed: Mapping[str, Printed]
    table: str
    title: str
    scenes: str
    suffix: str


TASK_SPECS = {
    "pushing": TaskSpec(
        name="pushing",
        splits=("test2",),
        view_splits=("test2",),
        settings=tuple(SETTINGS),
        printed=PAPER_ERRORS["pushing"],
        table="table1",
        title="Forecasting pushed objects",
        scenes="two novel objects",
        suffix="",
    ),
    "falling": TaskSpec(
        name="falling",
        splits=("test3", "test4"),
        view_splits=(),
        settings=(VARIED, *(setting for setting in SETTINGS if setting != VARIED)),
        printed=PAPER_ERRORS["falling"],
        table="table2",
        title="Forecasting falling objects",
        scenes="three to four novel objects",
        suffix="-falling",
    ),
}
FIRST = TASK_SPECS["pushing"]  # the task of trials, baselines and view prediction

# The cause of motion, which a dataset card describes by other numbers for each task.
CAUSES: dict[str, Callable[[Any], dict[str, Any]]] = {
    "pushing": lambda tree: {"rod_rms_mm": tree["rod_rms_mm"]["mean"]},
    "falling": lambda tree: {"impact": tree["impact"]},
}


@dataclass(frozen=True)
class Card:
    """Dataset card of a split: episodes, displacement of every object by T, and statistics."""

    episodes: int
    displacements_mm: Mapping[int, Sequence[float]]
    metrics: dict[str, Any]


@dataclass(frozen=True)
class RawData:
    """Raw rows of all stages. By task: ``errors``, ``detections``; by task and split: ``cards``;
    by task and table: ``futures``; by model: ``image_forecasts``.
    """

    errors: Mapping[str, pd.DataFrame]
    detections: Mapping[str, pd.DataFrame]
    views: pd.DataFrame
    trials: pd.DataFrame
    futures: Mapping[str, Mapping[str, pd.DataFrame]]
    image_forecasts: Mapping[str, pd.DataFrame]
    cards: Mapping[tuple[str, str], Card]


def read_inputs(cfg: TablesConfig, inputs: Inputs) -> RawData:
    """Read all rows. Raises RowsError, FileNotFoundError."""
    specs = {name: TASK_SPECS[name] for name in cfg.tasks}
    views = inputs.objects / f"{FIRST.name}-{FIRST.splits[0]}" / "views.csv"
    forecasts = {
        name: inputs.dynamics / f"pushing-{name}" / "forecasts.csv" for name in schema.IMAGE_MODELS
    }
    return RawData(
        errors={
            name: read_rows(sorted(inputs.rollouts.glob(f"{name}-*/errors.csv")), schema.ERRORS)
            for name in cfg.tasks
        },
        detections={
            name: read_detections(
                [inputs.objects / f"{name}-{split}" / "detections.csv" for split in spec.splits]
            )
            for name, spec in specs.items()
        },
        views=read_rows([views], schema.VIEWS),
        trials=read_rows(sorted(inputs.trials.glob("*/trials.csv")), schema.TRIALS),
        futures={
            name: {
                table: read_rows([inputs.futures / name / f"{table}.csv"], columns)
                for table, columns in schema.FUTURES.items()
            }
            for name in cfg.tasks
            if (inputs.futures / name).exists()
        },
        image_forecasts={
            name: read_rows([path], schema.FORECASTS)
            for name, path in forecasts.items()
            if path.exists()
        },
        cards={
            (name, path.parent.name.removeprefix(f"{name}-")): read_card(path, name)
            for name in cfg.tasks
            for path in sorted(inputs.episodes.glob(f"{name}-*/card.json"))
        },
    )


def read_detections(paths: Sequence[Path]) -> pd.DataFrame:
    """Detections of several splits; episode numbers continue from one split to the next."""
    parts, start = [], 0
    for path in paths:
        part = read_rows([path], schema.DETECTIONS)
        parts.append(part.assign(episode=part["episode"] + start))
        start += int(part["episode"].max()) + 1 if len(part) else 0
    return pd.concat(parts, ignore_index=True)


def read_card(path: Path, task: str) -> Card:
    """The card.json of a split. Raises FileNotFoundError, or RowsError for a missing key."""
    tree = json.loads(path.read_text(encoding="utf-8"))
    try:
        return Card(
            tree["episodes"],
            {int(T): values for T, values in tree["displacements_mm"].items()},
            {
                "displacement_mm": {T: each["mean"] for T, each in tree["displacement_mm"].items()},
                **CAUSES[task](tree),
                "share_object_contact": tree["share_object_contact"],
                "share_moved": tree["share_moved"],
            },
        )
    except KeyError as error:
        raise RowsError(f"{path}: no key {error}") from None


def learning_logs(perception: Path, dynamics: Path, tasks: Sequence[str]) -> pd.DataFrame:
    """Training logs of perception and of every dynamics model that logs held-out errors (no
    ablations), with the columns ``task`` (``perception`` or a task) and ``model``.
    """
    logs = {("perception", "perception"): perception / "log.csv"}
    for task in tasks:
        for path in sorted(dynamics.glob(f"{task}-*/log.csv")):
            model = path.parent.name.removeprefix(f"{task}-")
            if model not in schema.VARIANT_LABELS and "mm_5" in path.read_text(encoding="utf-8"):
                logs[task, model] = path
    read = {key: pd.read_csv(path) for key, path in logs.items() if path.exists()}
    parts = [log.assign(task=task, model=model) for (task, model), log in read.items()]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
