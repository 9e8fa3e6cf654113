"""Reading the dataset card of a split."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oes.report.rows import RowsError

# What sets things in motion, which the cards of each task tell by figures of their own.
CAUSES: dict[str, Callable[[Any], dict[str, Any]]] = {
    "pushing": lambda tree: {"rod_rms_mm": tree["rod_rms_mm"]["mean"]},
    "falling": lambda tree: {"impact": tree["impact"]},
}


@dataclass(frozen=True)
class Card:
    """What the report says of a split: its size, every object's displacement by T, and the figures of metrics.json."""

    episodes: int
    displacement_mm: dict[int, Sequence[float]]
    metrics: dict[str, Any]


def read_card(path: Path, task: str) -> Card:
    """The card.json of a task's split. Raises FileNotFoundError, or RowsError naming the file and the missing key."""
    tree = json.loads(path.read_text(encoding="utf-8"))
    try:
        return Card(
            episodes=tree["episodes"],
            displacement_mm={int(T): values for T, values in tree["displacements_mm"].items()},
            metrics={
                "displacement_mm": {T: values["mean"] for T, values in tree["displacement_mm"].items()},
                **CAUSES[task](tree),
                "share_object_contact": tree["share_object_contact"],
                "share_moved": tree["share_moved"],
            },
        )
    except KeyError as error:
        raise RowsError(f"{path}: no key {error}") from None
