"""Raw rows (CSV) as columns."""

import csv
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = dict[str, NDArray[Any]]
Kind = Callable[[Any], Any]  # a type, or a function that reads a cell


def optional_float(text: str) -> float:
    """A number, or NaN for an empty cell."""
    return float(text) if text else float("nan")


ERRORS: dict[str, Kind] = {
    "task": str,
    "model": str,
    "setting": str,
    "split": str,
    "episode_i": int,
    "object_i": int,
    "num_objects": int,
    "num_views": int,
    "T": int,
    "translation_mm": float,
    "rotation_deg": float,
    "surface_mm": float,
    "moved": bool,
    "detected": bool,
    "penetration_mm": float,
    "scale_mm": optional_float,
    "within_50": optional_float,
    "within_90": optional_float,
    "nll": optional_float,
    "nll_same": optional_float,
}

TRIALS: dict[str, Kind] = {
    "scenario": str,
    "model": str,
    "planner": str,
    "plans": int,
    "horizon": int,
    "trial_i": int,
    "num_objects": int,
    "success": bool,
    "all_success": bool,
    "collided": bool,
    "initial_mm": float,
    "mean_final_mm": float,
    "estimated_mm": float,
    "steps_used": int,
    "failure": str,
    "video": str,
}

_DTYPES: dict[Kind, Any] = {str: np.str_, int: np.int64, float: np.float64, bool: np.bool_}
_TRUTH = {"True": True, "true": True, "1": True, "False": False, "false": False, "0": False}


class RowsError(ValueError):
    """A CSV file that lacks a column or holds a value of the wrong type."""


def read_columns(paths: Sequence[Path], kinds: Mapping[str, Kind]) -> Columns:
    """The asked columns of several CSV files, one after another; other columns are passed over.

    Raises RowsError naming the file and the column, and FileNotFoundError for a file that is not
    there.
    """
    gathered: dict[str, list[Any]] = {name: [] for name in kinds}
    for path in paths:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            missing = [name for name in kinds if name not in (reader.fieldnames or ())]
            if missing:
                raise RowsError(
                    f"{path}: lacks the columns {', '.join(missing)}; it has {reader.fieldnames}"
                )
            for line_i, row in enumerate(reader, start=2):
                for name, kind in kinds.items():
                    gathered[name].append(_value(row[name], kind, path, line_i, name))
    return {
        name: np.array(values, dtype=_DTYPES.get(kinds[name], np.float64))
        for name, values in gathered.items()
    }


def select(columns: Columns, **equal: object) -> Columns:
    """The rows whose columns have these values."""
    keep = np.ones(len(next(iter(columns.values()))), dtype=bool)
    for name, value in equal.items():
        keep &= columns[name] == value
    return kept(columns, keep)


def kept(columns: Columns, is_kept: NDArray[np.bool_]) -> Columns:
    """The rows for which a mask holds."""
    return {name: values[is_kept] for name, values in columns.items()}


def _value(text: str | None, kind: Kind, path: Path, line_i: int, name: str) -> object:
    try:
        return _TRUTH[text or ""] if kind is bool else kind(text)
    except (ValueError, TypeError, KeyError) as error:
        raise RowsError(
            f"{path}: line {line_i}, column {name}: {text!r} is not a {getattr(kind, '__name__', kind)}"
        ) from error
