"""A printed table as Markdown and LaTeX; the rows behind a group of tables as CSV."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd


@dataclass(frozen=True)
class Table:
    """Printed cells under a header of at most ``MAX_COLUMNS`` columns."""

    caption: str
    header: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class TableGroup:
    """Tables of one subject. ``rows``: the rows of the tidy frame that they print."""

    name: str
    title: str
    tables: tuple[Table, ...]
    rows: pd.DataFrame
    notes: tuple[str, ...]


MAX_COLUMNS = 8


def markdown(table: Table) -> str:
    """A pipe table below its caption."""
    lines = [_pipes(table.header), _pipes(["---"] * len(table.header)), *map(_pipes, table.cells)]
    return f"**{table.caption}**\n\n" + "\n".join(lines) + "\n"


def latex(group: TableGroup) -> str:
    """A booktabs table per table of the group; the notes follow the last one."""
    parts = []
    for table_i, table in enumerate(group.tables):
        body = [" & ".join(map(_escaped, row)) + r" \\" for row in table.cells]
        parts += [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{_escaped(table.caption)}}}",
            rf"\label{{tab:{group.name}-{table_i + 1}}}",
            rf"\begin{{tabular}}{{{'l' * len(table.header)}}}",
            r"\toprule",
            " & ".join(map(_escaped, table.header)) + r" \\",
            r"\midrule",
            *body,
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table}",
        ]
    parts += [rf"\par\smallskip {_escaped(note)}" for note in group.notes]
    return "\n".join(parts) + "\n"


def write_group(group: TableGroup, folder: Path) -> None:
    """``<name>.csv`` (without columns that are empty in every row) and ``<name>.tex``."""
    rows = group.rows.drop(columns="block").round(4)
    # p-values may be far below the fourth digit.
    rows["p_value"] = [float(f"{value:.6g}") for value in group.rows["p_value"]]
    is_used = ((rows != "") & rows.notna()).any()
    rows.loc[:, is_used].to_csv(folder / f"{group.name}.csv", index=False, lineterminator="\n")
    (folder / f"{group.name}.tex").write_text(latex(group), encoding="utf-8")


def _pipes(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


_TEX = str.maketrans(
    {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)
_TEX |= str.maketrans({character: f"\\{character}" for character in "&%$#_{}"})
_TEX |= str.maketrans({"<": r"$<$", ">": r"$>$"})


def _escaped(text: str) -> str:
    return text.replace("**", "").replace("`", "").translate(_TEX)
