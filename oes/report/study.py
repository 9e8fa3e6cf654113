"""The tasks of the study as data, and the forecasts of one as lines of its tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oes.report.forecast import Group, Interval, Line, Printed, forecast_table, lines, ratio
from oes.report.names import BASELINE, METRICS, OURS, SETTINGS
from oes.report.paper import FORECAST, HORIZONS
from oes.report.rows import Columns, RowsError, kept, select
from oes.report.table import Table

VARIED, FIXED = "1view_pred", "fixed_pred"


@dataclass(frozen=True)
class Study:
    """One task: the splits behind its main table and behind the error by number of views (none: not
    made), that table's settings in their order with the paper's figures, and how things are called.

    ``by_objects`` is a key of metrics.json; ``suffix`` ends the other keys and the names of tables
    and figures.
    """

    task: str
    splits: tuple[str, ...]
    view_splits: tuple[str, ...]
    settings: tuple[str, ...]
    printed: Mapping[str, Printed]
    table: str
    caption: str
    scenes: str
    by_objects: str
    suffix: str

    def key(self, word: str) -> str:
        """A key of metrics.json."""
        return word + self.suffix.replace("-", "_")


STUDIES = {
    "pushing": Study(
        task="pushing",
        splits=("test2",),
        view_splits=("test2",),
        settings=tuple(SETTINGS),
        printed=FORECAST["pushing"],
        table="table1",
        caption="Forecasting pushed objects",
        scenes="two novel objects",
        by_objects="by_objects",
        suffix="",
    ),
    "falling": Study(
        task="falling",
        splits=("test3", "test4"),
        view_splits=(),
        settings=(VARIED, *(setting for setting in SETTINGS if setting != VARIED)),
        printed=FORECAST["falling"],
        table="table2",
        caption="Forecasting falling objects",
        scenes="three to four novel objects",
        by_objects="falling_by_objects",
        suffix="-falling",
    ),
}


@dataclass(frozen=True)
class Forecasts:
    """A study's main table and its variations as lines, and the ratio of errors that it is judged
    by.
    """

    study: Study
    main: list[Line]
    by_objects: list[Line]
    by_views: list[Line]
    ratios: dict[tuple[str, str, int], Interval]


def forecasts(rows: Columns, seed: int) -> Forecasts:
    """Average the errors of one task: by setting; by number of objects; by number of predicted-box
    views.

    Raises RowsError for rows that are not all of one task of ``STUDIES``.
    """
    tasks = np.unique(rows["task"]).tolist()
    if len(tasks) != 1 or tasks[0] not in STUDIES:
        raise RowsError(
            f"rows of errors must be of one task of {', '.join(STUDIES)}; these are of: {tasks}"
        )
    study = STUDIES[tasks[0]]
    main = _among(rows, study.splits)
    settings = [
        Group(key, SETTINGS[key], _own(main, key), study.printed.get(key, {}))
        for key in study.settings
    ]
    varied = _own(rows, VARIED)
    counts = [
        Group(str(n), str(n), select(varied, num_objects=n), {})
        for n in np.unique(varied["num_objects"])
    ]
    several = _among(rows, study.view_splits)
    predicted = kept(several, _is_found(several))
    views = [
        Group(str(n), str(n), select(predicted, num_views=n), {})
        for n in np.unique(predicted["num_views"])
    ]
    return Forecasts(
        study,
        lines(settings, seed),
        lines(counts, seed),
        lines(views, seed),
        _ratios(settings, seed),
    )


def forecast_tables(found: Forecasts, notes: Sequence[str]) -> list[Table]:
    """The main table, by number of objects and, where there is one, by number of views."""
    study = found.study
    tables = [
        forecast_table(study.table, f"{study.caption}, {study.scenes}", "setting", found.main, notes),
        forecast_table(
            f"by-objects{study.suffix}", f"Error by number of objects, {study.task} (one view, predicted boxes)",
            "objects_in_scene", found.by_objects, notes,
        ),
    ]  # fmt: skip
    if found.by_views:
        caption = f"Error by number of input views, {study.task} (predicted boxes)"
        tables.append(
            forecast_table(f"by-views{study.suffix}", caption, "input_views", found.by_views, notes)
        )
    return tables


def _ratios(settings: Sequence[Group], seed: int) -> dict[tuple[str, str, int], Interval]:
    return {
        (group.key, metric, T): found
        for group in settings
        for metric in METRICS
        for T in HORIZONS
        if (found := ratio(group.rows, OURS, BASELINE, metric, T, seed)) is not None
    }


def _among(rows: Columns, splits: Sequence[str]) -> Columns:
    return kept(rows, np.isin(rows["split"], np.array(splits, dtype=np.str_)))


def _own(rows: Columns, setting: str) -> Columns:
    """The rows of a setting; a model trained for the fixed camera counts only there."""
    here = select(rows, setting=setting)
    return here if setting == FIXED else kept(here, ~np.char.endswith(here["model"], "_fixed"))


def _is_found(rows: Columns) -> NDArray[np.bool_]:
    """Rows of random views with predicted boxes (``1view_pred``, ``2views_pred``...) of models that
    saw such views.
    """
    is_random = np.char.endswith(rows["setting"], "_pred") & (rows["setting"] != FIXED)
    return np.asarray(is_random & ~np.char.endswith(rows["model"], "_fixed"))
