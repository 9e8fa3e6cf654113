"""Rows as CSV files, the form of all measurements."""

import csv
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path


def write_csv(path: Path, rows: Iterable[Mapping[str, object]], header: Collection[str]) -> None:
    """Write rows that may lack columns. Raises ValueError for a key that the header lacks."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, header, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def columns_of(rows: Iterable[Mapping[str, object]]) -> list[str]:
    """All keys of the rows, in order of first appearance."""
    return list(dict.fromkeys(name for row in rows for name in row))
