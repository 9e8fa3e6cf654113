"""Table 2 from made-up falls whose means, medians and divergences are known."""

from pathlib import Path

import numpy as np
import pytest

from oes.csv_io import write_csv
from oes.report.metrics import study_tree
from oes.report.rows import ERRORS, RowsError, read_columns
from oes.report.study import forecast_tables, forecasts
from oes.report.table import markdown
from tests.report_inputs import UNTOLD


def _falls(path: Path) -> Path:
    """Falls among 2 to 4 objects, two episodes of each: all errors are T mm, but for one object of
    each scene that graph_xyz lets through the table, 100 T mm off.
    """
    rows = [
        {
            "task": "falling",
            "model": model,
            "setting": setting,
            "split": f"test{num_objects}",
            "episode_i": episode_i,
            "object_i": object_i,
            "num_objects": num_objects,
            "num_views": 1,
            "T": T,
            "translation_mm": 100 * T if model == "graph_xyz" and object_i == 0 else T,
            "rotation_deg": 2 * T,
            "surface_mm": T / 2,
            "moved": object_i < 2,
            "detected": True,
            "penetration_mm": 0.0,
            **UNTOLD,
        }
        for model in ("graph_xyz", "oes")
        for num_objects in (2, 3, 4)
        for setting in ("1view_gt", "1view_pred")
        for episode_i in range(2)
        for object_i in range(num_objects)
        for T in range(1, 6)
    ]
    write_csv(path, rows, list(rows[0]))
    return path


def test_table_2_tells_of_falls(tmp_path: Path) -> None:
    found = forecasts(read_columns([_falls(tmp_path / "errors.csv")], ERRORS), seed=0)
    table, by_objects = forecast_tables(found, ["Profile test."])
    assert (table.name, by_objects.name) == ("table2", "by-objects-falling") and not found.by_views
    assert [row[0] for row in table.cells if row[0]] == [
        "1 view, predicted boxes",
        "1 view, true boxes",
    ]
    first, *_, sixth = table.cells[:6]
    assert first[1:3] == ("graph-XYZ", "translation (mm)") and first[5].startswith("146.4 [")
    assert first[6:10] == ("5.0", "28.6%", "14", "5.2 / 11.7 / 278.6"), (
        "4 of the 14 objects, those of 2 not among them"
    )
    assert first[13:] == ("252.5", "50.0%", "8")
    errors = ("0.5 [0.5, 0.5]", "1.5 [1.5, 1.5]", "2.5 [2.5, 2.5]", "2.5")
    assert sixth[2:] == ("surface distance (mm)", *errors, "", "14", "", *errors, "", "8")
    assert table.cells[3][9] == "5.0 / 13.1 / 16.4" and table.cells[4][9] == "6.1 / 12.6 / 18.7"
    assert table.cells[1][9] == "5.7 / 10.4 / 43.3" and all(row[9] == "" for row in table.cells[6:])
    shares = {
        line.diverged for line in found.main if line.model == "graph_xyz" and line.objects == "all"
    }
    assert shares == {4 / 14}, "the same under every metric and setting"
    last = {
        record["metric"]: record
        for record in table.records
        if record["T"] == 5 and record["objects"] == "moved"
    }
    assert {record["median"] for record in last.values()} == {5.0, 10.0, 2.5}
    assert found.ratios["1view_pred", "translation_mm", 5][0] == pytest.approx(70 / 2050)
    assert {line.group for line in found.by_objects} == {"2", "3", "4"}
    assert "turned cylinder" in markdown(table) and "turned cylinder" in markdown(by_objects)
    tree = study_tree(found)
    assert list(tree) == ["falling", "ratio_falling", "falling_by_objects"]
    model = tree["falling"]["1view_pred"]["graph_xyz"]
    assert model["diverged"] == 4 / 14 and model["moved"]["diverged"] == 0.5
    assert model["median"]["translation_mm"] == {"1": 1.0, "3": 3.0, "5": 5.0}
    assert model["moved"]["median"]["translation_mm"]["5"] == 252.5


def test_rows_of_other_tasks_are_refused(tmp_path: Path) -> None:
    falls = read_columns([_falls(tmp_path / "falls.csv")], ERRORS)
    mixed = falls | {"task": np.where(falls["episode_i"] == 0, "pushing", "falling")}
    with pytest.raises(
        RowsError, match=r"one task of pushing, falling; these are of: \['falling', 'pushing'\]"
    ):
        forecasts(mixed, seed=0)
    with pytest.raises(RowsError, match=r"these are of: \[\]"):
        forecasts(read_columns([], ERRORS), seed=0)
