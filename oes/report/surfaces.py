"""The tables about completed surfaces: ratios, ablations, certainty and physical sense, of all
tasks.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from oes.report.contact import Ratios, ablation_table, ablations, ratio_table, surface_ratios
from oes.report.findings import FIRST, Chapter
from oes.report.metrics import ratio_tree
from oes.report.names import SURFACES, VARIANTS
from oes.report.rows import Columns, kept, select
from oes.report.sense import certainty, certainty_table, sense, sense_table, tree
from oes.report.study import VARIED
from oes.report.table import Table

Chapters = Mapping[str, Chapter]


def surface_tables(chapters: Chapters, seed: int, notes: tuple[str, ...]) -> list[Table]:
    """Those for which there are rows."""
    told = {task: certainty(main_rows(chapter)) for task, chapter in chapters.items()}
    sensible = {task: sense(_varied(chapter)) for task, chapter in chapters.items()}
    tables = [sense_table(sensible, notes)]
    if any(told.values()):
        tables = [
            ratio_table(_ratios(chapters, seed), notes),
            certainty_table(told, notes),
            *tables,
        ]
    rows = _varied(chapters[FIRST.task], with_variants=True)
    if np.isin(rows["model"], list(VARIANTS)).any():
        tables.append(ablation_table(*ablations(rows, seed), notes))
    return tables


def surface_tree(chapters: Chapters, seed: int) -> dict[str, Any]:
    """The same figures for metrics.json."""
    _, variants = ablations(_varied(chapters[FIRST.task], with_variants=True), seed)
    return {
        "contact_ratio": {
            task: ratio_tree(ratios) for task, ratios in _ratios(chapters, seed).items()
        },
        "certainty": tree(
            {task: certainty(main_rows(chapter)) for task, chapter in chapters.items()}
        ),
        "sense": tree({task: sense(_varied(chapter)) for task, chapter in chapters.items()}),
        **({"ablations": ratio_tree(variants)} if variants else {}),
    }


def main_rows(chapter: Chapter) -> Columns:
    """The rows of the task's main splits, without ablations."""
    rows = chapter.rows
    is_main = np.isin(rows["split"], list(chapter.found.study.splits)) & ~np.isin(
        rows["model"], list(VARIANTS)
    )
    return kept(rows, is_main)


def _varied(chapter: Chapter, with_variants: bool = False) -> Columns:
    """One view, predicted boxes, main splits; of models that saw such views."""
    rows = select(chapter.rows, setting=VARIED)
    is_asked = np.isin(rows["split"], list(chapter.found.study.splits)) & ~np.char.endswith(
        rows["model"], "_fixed"
    )
    return kept(rows, is_asked & (with_variants | ~np.isin(rows["model"], list(VARIANTS))))


def _ratios(chapters: Chapters, seed: int) -> dict[str, Ratios]:
    """By task, where ``contact`` was scored."""
    rows = {task: _varied(chapter) for task, chapter in chapters.items()}
    return {
        task: surface_ratios(each, seed)
        for task, each in rows.items()
        if (each["model"] == SURFACES).any()
    }
