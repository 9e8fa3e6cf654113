"""What all stages left behind, read: the rows of every table and figure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oes.config import params
from oes.report.card import Card, read_card, read_cards
from oes.report.futures import Futures, read_futures
from oes.report.names import VARIANTS
from oes.report.perception import VIEWS, detector_figures, read_detections, view_figures
from oes.report.provenance import describe_machine, provenance
from oes.report.rows import ERRORS, TRIALS, Columns, kept, read_columns, select
from oes.report.study import STUDIES, Forecasts, forecasts
from oes.report.trials import Outcome, outcomes
from oes.report.video import Figures, video_figures

FIRST = STUDIES[
    "pushing"
]  # the task of the trials, in whose scenes the prediction of views is measured


@params
class Tables:
    """The section ``tables``: seed of the bootstrap, name of the profile, tasks (pushing among
    them) and control scenarios in their order.
    """

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
    """What is told of one task: forecasts and all rows behind them (those of ablations too),
    detections and their figures, training episodes, where it all is from.
    """

    found: Forecasts
    rows: Columns
    detections: Columns
    detector: Mapping[str, Mapping[str, float]]
    card: Card
    line: str


def read_chapter(
    task: str, cfg: Tables, inputs: Inputs, seeds: Mapping[str, int], machine: str
) -> Chapter:
    """The chapter of a task. Raises RowsError for rows that cannot be read or are of another
    task.
    """
    every = read_columns(sorted(inputs.rollouts.glob(f"{task}-*/errors.csv")), ERRORS)
    found = forecasts(rows := kept(every, ~np.isin(every["model"], list(VARIANTS))), cfg.seed)
    paths = [inputs.objects / f"{task}-{split}" / "detections.csv" for split in found.study.splits]
    detections = read_detections(paths)
    card = read_card(inputs.episodes / f"{task}-train" / "card.json", task)
    line = provenance(cfg.profile, {"train": card.episodes} | _counts(rows), seeds, machine)
    return Chapter(found, every, detections, detector_figures(detections), card, line)


@dataclass(frozen=True)
class Findings:
    """What all stages left, read."""

    chapters: Mapping[str, Chapter]
    cards: Mapping[tuple[str, str], Card]
    trials: Columns
    control: Mapping[str, Sequence[Outcome]]
    views: Mapping[str, Mapping[str, float]]
    video: Figures
    futures: Sequence[Futures]
    machine: str

    @property
    def line(self) -> str:
        """Where the figures of the first task are from."""
        return self.chapters[FIRST.task].line


def read_findings(cfg: Tables, inputs: Inputs, seeds: Mapping[str, int]) -> Findings:
    """Everything that tables are made of. Raises RowsError, FileNotFoundError."""
    machine = describe_machine()
    trials = read_columns(sorted(inputs.trials.glob("*/trials.csv")), TRIALS)
    return Findings(
        cards=read_cards(inputs.episodes, cfg.tasks),
        chapters={task: read_chapter(task, cfg, inputs, seeds, machine) for task in cfg.tasks},
        trials=trials,
        control={scenario: outcomes(trials, scenario) for scenario in cfg.scenarios},
        views=view_figures(
            read_columns([inputs.objects / f"{FIRST.task}-{FIRST.splits[0]}" / "views.csv"], VIEWS)
        ),
        video=video_figures(inputs.dynamics),
        futures=read_futures(inputs.futures, cfg.tasks),
        machine=machine,
    )


def _counts(rows: Columns) -> dict[str, int]:
    """Test episodes of each split."""
    return {
        str(split): len(np.unique(select(rows, split=split)["episode_i"]))
        for split in np.unique(rows["split"])
    }
