"""Everything in reports/, from the raw rows of all stages."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oes.config import params
from oes.report.bundle import copy_films, copy_models
from oes.report.card import Card, read_card
from oes.report.figures import write_figures
from oes.report.forecast import LAST
from oes.report.futures import copy_gallery, futures_tables, futures_tree, read_futures
from oes.report.metrics import study_tree, trials_tree, write_json
from oes.report.names import OURS, SCENARIOS
from oes.report.page import headline, write_page
from oes.report.perception import (
    VIEWS,
    detector_figures,
    detector_table,
    read_detections,
    view_figures,
    view_table,
    views_key,
)
from oes.report.provenance import describe_machine, provenance
from oes.report.rows import ERRORS, TRIALS, Columns, read_columns, select
from oes.report.strips import forecast_films
from oes.report.study import STUDIES, VARIED, Forecasts, forecast_tables, forecasts
from oes.report.table import Table, write_table
from oes.report.trials import outcomes, trials_table
from oes.report.video import copy_forecasts, video_figures, video_table

FIRST = STUDIES["pushing"]  # the task of the trials, in whose scenes the prediction of views is measured
SHEET = "contact_sheet.png"


@params
class Tables:
    """The section ``tables``: seed of the bootstrap, name of the profile, tasks (pushing among them) and control
    scenarios in their order."""

    seed: int
    profile: str
    tasks: tuple[str, ...]
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
    futures: Path
    trials: Path


@dataclass(frozen=True)
class Chapter:
    """What is told of one task: forecasts, figures of the detector, the training episodes, and where it all is from."""

    found: Forecasts
    detector: Mapping[str, Mapping[str, float]]
    card: Card
    line: str


def read_chapter(task: str, cfg: Tables, inputs: Inputs, seeds: Mapping[str, int], machine: str) -> Chapter:
    """The chapter of a task. Raises RowsError for rows that cannot be read or are of another task."""
    rows = read_columns(sorted(inputs.rollouts.glob(f"{task}-*/errors.csv")), ERRORS)
    found = forecasts(rows, cfg.seed)
    detections = [inputs.objects / f"{task}-{split}" / "detections.csv" for split in found.study.splits]
    card = read_card(inputs.episodes / f"{task}-train" / "card.json", task)
    line = provenance(cfg.profile, {"train": card.episodes} | _counts(rows), seeds, machine)
    return Chapter(found, detector_figures(read_detections(detections)), card, line)


def build(cfg: Tables, inputs: Inputs, seeds: Mapping[str, int], out: Path) -> None:
    """Write every table, figure, film, the weights, metrics.json and README.md into ``out``.

    Raises RowsError for rows that cannot be read, FileNotFoundError for a stage's file that is not there.
    """
    machine = describe_machine()
    chapters = {task: read_chapter(task, cfg, inputs, seeds, machine) for task in cfg.tasks}
    trials = read_columns(sorted(inputs.trials.glob("*/trials.csv")), TRIALS)
    control = {scenario: outcomes(trials, scenario) for scenario in cfg.scenarios}
    views = view_figures(read_columns([inputs.objects / f"{FIRST.task}-{FIRST.splits[0]}" / "views.csv"], VIEWS))
    video = video_figures(inputs.dynamics)
    futures = read_futures(inputs.futures, cfg.tasks)
    line = chapters[FIRST.task].line
    tables = [
        *(table for chapter in chapters.values() for table in forecast_tables(chapter.found, [chapter.line])),
        *(trials_table(each, _table3(name, cfg), name, (line,)) for name, each in control.items()),
        *(_detector_table(chapter) for chapter in chapters.values()),
        view_table(views, (line,)),
        *([video_table(video, (line,))] if video else []),
        *futures_tables(futures, cfg.seed, (line,)),
    ]
    out.mkdir(parents=True, exist_ok=True)
    for table in tables:
        write_table(table, out)
    figures = {SHEET: "The meshes."}
    for chapter in chapters.values():
        figures |= write_figures(chapter.found, chapter.card.displacement_mm, out / "figures")
    figures |= copy_forecasts(inputs.dynamics, video, out / "figures")
    gallery, gallery_films = copy_gallery(inputs.futures, cfg.tasks, out / "figures")
    copy_models(inputs.perception, inputs.dynamics, out / "models")
    shutil.copyfile(inputs.meshes / SHEET, out / SHEET)
    films = {
        "Forecasts": [name for task in chapters for name in forecast_films(inputs.rollouts, task, out / "films")],
        "Imagined from three sides": gallery_films,
        **{
            f"Trials {SCENARIOS.get(name, name)}": copy_films(inputs.trials, trials, name, OURS, out / "films")
            for name in cfg.scenarios
        },
    }
    tree = {
        "profile": cfg.profile,
        "machine": machine,
        **{key: value for chapter in chapters.values() for key, value in _tree(chapter).items()},
        "mpc": {scenario: trials_tree(each) for scenario, each in control.items()},
        **({"video": video} if video else {}),
        **({"futures": futures_tree(futures)} if futures else {}),
        "view_prediction": {**views[views_key(1)], **views},
    }
    write_json(tree, out / "metrics.json")
    opening = [text for each in chapters.values() for text in (headline(each.found, VARIED, LAST), each.line)]
    write_page(out / "README.md", opening, tables, figures | gallery, films)


def _table3(scenario: str, cfg: Tables) -> str:
    """Table 3 of the paper is the first scenario's."""
    return "table3" if scenario == cfg.scenarios[0] else f"table3-{scenario.replace('_', '-')}"


def _counts(rows: Columns) -> dict[str, int]:
    """Test episodes of each split."""
    return {str(split): len(np.unique(select(rows, split=split)["episode_i"])) for split in np.unique(rows["split"])}


def _detector_table(chapter: Chapter) -> Table:
    study = chapter.found.study
    caption = f"Detection of novel objects in 3D, {study.task}"
    return detector_table(f"detector{study.suffix}", caption, chapter.detector, (chapter.line,))


def _tree(chapter: Chapter) -> dict[str, object]:
    study = chapter.found.study
    about = {study.key("detector"): chapter.detector, study.key("capture"): chapter.card.metrics}
    return study_tree(chapter.found) | about
