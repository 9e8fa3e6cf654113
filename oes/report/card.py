"""The dataset cards of the splits: read, and as a table."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oes.report.rows import RowsError
from oes.report.table import Table

# What sets things in motion, which the cards of each task tell by figures of their own.
CAUSES: dict[str, Callable[[Any], dict[str, Any]]] = {
    "pushing": lambda tree: {"rod_rms_mm": tree["rod_rms_mm"]["mean"]},
    "falling": lambda tree: {"impact": tree["impact"]},
}


@dataclass(frozen=True)
class Card:
    """What the report says of a split: its size, every object's displacement by T, and the figures
    of metrics.json.
    """

    episodes: int
    displacement_mm: dict[int, Sequence[float]]
    metrics: dict[str, Any]


def read_card(path: Path, task: str) -> Card:
    """The card.json of a task's split. Raises FileNotFoundError, or RowsError naming the file and
    the missing key.
    """
    tree = json.loads(path.read_text(encoding="utf-8"))
    try:
        return Card(
            episodes=tree["episodes"],
            displacement_mm={int(T): values for T, values in tree["displacements_mm"].items()},
            metrics={
                "displacement_mm": {
                    T: values["mean"] for T, values in tree["displacement_mm"].items()
                },
                **CAUSES[task](tree),
                "share_object_contact": tree["share_object_contact"],
                "share_moved": tree["share_moved"],
            },
        )
    except KeyError as error:
        raise RowsError(f"{path}: no key {error}") from None


def read_cards(episodes: Path, tasks: Sequence[str]) -> dict[tuple[str, str], Card]:
    """The cards of all splits, by task and split. Raises as ``read_card``."""
    paths = [
        (task, path) for task in tasks for path in sorted(episodes.glob(f"{task}-*/card.json"))
    ]
    return {
        (task, path.parent.name.removeprefix(f"{task}-")): read_card(path, task)
        for task, path in paths
    }


def data_table(cards: Mapping[tuple[str, str], Card], notes: tuple[str, ...]) -> Table:
    """A row per split: how many episodes, and what happens in them."""
    header = (
        "task",
        "split",
        "episodes",
        "displacement at T = 1 / 3 / 5 (mm)",
        "episodes in which objects touch",
    )
    return Table(
        name="data",
        caption="The episodes",
        header=header,
        cells=tuple(
            (
                task,
                split,
                str(card.episodes),
                " / ".join(f"{value:.1f}" for value in card.metrics["displacement_mm"].values()),
                f"{card.metrics['share_object_contact']:.0%}",
            )
            for (task, split), card in cards.items()
        ),
        records=tuple(
            {
                "task": task,
                "split": split,
                "episodes": card.episodes,
                **{
                    f"displacement_mm_{T}": value
                    for T, value in card.metrics["displacement_mm"].items()
                },
                "share_object_contact": card.metrics["share_object_contact"],
            }
            for (task, split), card in cards.items()
        ),
        notes=notes,
    )
