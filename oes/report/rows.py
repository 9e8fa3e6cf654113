"""Raw rows (CSV) as data frames."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pandas as pd
from pandas.errors import EmptyDataError, ParserError

from oes.schema import Columns

_TRUTH = {"True": True, "true": True, "1": True, "False": False, "false": False, "0": False}
# Python's own conversions: those of pandas need not round to the nearest float.
_READ: dict[str, Callable[[str], Any]] = {
    "str": str,
    "int": int,
    "float": float,
    "float?": lambda cell: float(cell) if cell else float("nan"),
    "bool": _TRUTH.__getitem__,
}
_DTYPES = {"str": "str", "int": "int64", "float": "float64", "float?": "float64", "bool": "bool"}


class RowsError(ValueError):
    """A file that lacks a column or a key, or holds a value of the wrong type."""


def read_rows(paths: Iterable[Path], columns: Columns) -> pd.DataFrame:
    """The given columns (``oes.schema``) of CSV files, one after another.

    Raises RowsError naming file, line and column; FileNotFoundError for a missing file.
    """
    parts = [_read(path, columns) for path in paths]
    empty = pd.DataFrame({name: pd.Series(dtype=_DTYPES[kind]) for name, kind in columns.items()})
    return pd.concat(parts, ignore_index=True) if parts else empty


def _read(path: Path, columns: Columns) -> pd.DataFrame:
    try:
        text = pd.read_csv(path, dtype=str, keep_default_na=False).fillna("")
    except (EmptyDataError, ParserError) as error:
        raise RowsError(f"{path}: {error}") from error
    if missing := [name for name in columns if name not in text]:
        raise RowsError(f"{path}: lacks the columns {', '.join(missing)}; it has {list(text)}")
    return pd.DataFrame(
        {name: _typed(text[name], kind, f"{path}: line") for name, kind in columns.items()}
    )


def _typed(cells: "pd.Series[Any]", kind: str, place: str) -> "pd.Series[Any]":
    values = []
    for line_i, cell in enumerate(cells, start=2):
        try:
            values.append(_READ[kind](cell))
        except (ValueError, KeyError):
            wanted = kind.removesuffix("?")
            raise RowsError(
                f"{place} {line_i}, column {cells.name}: {cell!r} is not a {wanted}"
            ) from None
    return pd.Series(values, dtype=_DTYPES[kind])
