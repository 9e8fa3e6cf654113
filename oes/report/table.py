"""A table as Markdown, CSV and LaTeX. Markdown and LaTeX hold the printed cells, CSV the numbers
behind them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from oes.csv_io import write_csv


@dataclass(frozen=True)
class Table:
    """``cells`` are printed under ``header``; ``records`` are the same facts, one number a column,
    for machines.
    """

    name: str
    caption: str
    header: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]
    records: tuple[Mapping[str, object], ...]
    notes: tuple[str, ...]


def rounded(values: Mapping[str, float]) -> dict[str, float]:
    """Numbers as records hold them."""
    return {name: round(value, 4) for name, value in values.items()}


def markdown(table: Table) -> str:
    """A pipe table below its caption, above its notes."""
    lines = [_pipes(table.header), _pipes(["---"] * len(table.header)), *map(_pipes, table.cells)]
    return "\n\n".join([f"**{table.caption}**", "\n".join(lines), *table.notes]) + "\n"


def latex(table: Table) -> str:
    """A booktabs table; the notes follow as text."""
    columns = "l" * len(table.header)
    body = [" & ".join(map(_escaped, row)) + r" \\" for row in table.cells]
    head = " & ".join(map(_escaped, table.header)) + r" \\"
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{_escaped(table.caption)}}}",
        rf"\label{{tab:{table.name}}}",
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        head,
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
        *(rf"\par\smallskip {_escaped(note)}" for note in table.notes),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def write_table(table: Table, folder: Path) -> None:
    """``<name>.md``, ``<name>.csv`` and ``<name>.tex`` in an existing folder."""
    (folder / f"{table.name}.md").write_text(markdown(table), encoding="utf-8")
    (folder / f"{table.name}.tex").write_text(latex(table), encoding="utf-8")
    header = list(dict.fromkeys(key for record in table.records for key in record))
    write_csv(folder / f"{table.name}.csv", table.records, header)


def _pipes(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


_TEX = str.maketrans(
    {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)
_TEX |= str.maketrans({character: f"\\{character}" for character in "&%$#_{}"})
_TEX |= str.maketrans({"<": r"$<$", ">": r"$>$"})


def _escaped(text: str) -> str:
    return text.replace("**", "").replace("`", "").translate(_TEX)
