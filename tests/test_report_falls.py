"""Table 2 from synthetic falls whose means, medians and divergences are known."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from oes.csv_io import write_csv
from oes.report.aggregates import as_dicts, error_aggregates
from oes.report.metrics import metrics_tree
from oes.report.rows import RowsError, read_rows
from oes.report.tables import forecast_groups
from oes.schema import ERRORS
from tests.report_inputs import UNCALIBRATED


def _falls(path: Path) -> pd.DataFrame:
    """Falls among 2 to 4 objects, two episodes of each: all errors are T mm, except for one object
    of each scene that graph_xyz lets fall through the table, 100 T mm off.
    """
    rows = [
        {
            **{"task": "falling", "model": model, "setting": setting},
            **{"split": f"test{num_objects}", "episode_i": episode_i, "object_i": object_i},
            **{"num_objects": num_objects, "num_views": 1, "T": T},
            "translation_mm": 100 * T if model == "graph_xyz" and object_i == 0 else T,
            "rotation_deg": 2 * T,
            "surface_mm": T / 2,
            **{"moved": object_i < 2, "detected": True, "penetration_mm": 0.0},
            **UNCALIBRATED,
        }
        for model in ("graph_xyz", "oes")
        for num_objects in (2, 3, 4)
        for setting in ("1view_gt", "1view_pred")
        for episode_i in range(2)
        for object_i in range(num_objects)
        for T in range(1, 6)
    ]
    write_csv(path, rows, ERRORS)
    return read_rows([path], ERRORS)


def test_table_2_describes_falls(tmp_path: Path) -> None:
    frame = error_aggregates(_falls(tmp_path / "errors.csv"), seed=0)
    groups = {group.name: group for group in forecast_groups(frame, "falling")}
    assert list(groups) == ["table2", "table2-moved", "by-objects-falling", "ratios-falling"]
    table, second = groups["table2"].tables
    assert table.caption == "1 view, predicted boxes (14 objects of 4 episodes)", (
        "the objects of scenes of 2 are not among them"
    )
    assert second.caption.startswith("1 view, true boxes")
    first, turn, *_, sixth = table.cells
    assert first[:2] == ("graph-XYZ", "translation (mm)") and first[4].startswith("146.4 [")
    assert first[5:] == ("5.0", "28.6%", "5.2 / 11.7 / 278.6"), "4 of the 14 objects"
    moved = groups["table2-moved"].tables[0]
    assert moved.caption.endswith("moved objects (8 objects of 4 episodes)")
    assert moved.cells[0][5:] == ("252.5", "50.0%", "")
    means = ("0.5 [0.5, 0.5]", "1.5 [1.5, 1.5]", "2.5 [2.5, 2.5]", "2.5")
    assert sixth[1:] == ("surface distance (mm)", *means, "", "")
    assert moved.cells[5][1:] == ("surface distance (mm)", *means, "", "")
    assert [row[7] for row in table.cells[3:5]] == ["5.0 / 13.1 / 16.4", "6.1 / 12.6 / 18.7"]
    assert turn[7] == "5.7 / 10.4 / 43.3" and all(row[7] == "" for row in second.cells)
    main = frame[(frame["block"] == "forecast") & (frame["objects"] == "all")]
    shares = set(main.loc[main["model"] == "graph_xyz", "diverged"])
    assert shares == {4 / 14}, "the same under every metric and setting"
    last = [row for row in as_dicts(frame) if (row["T"], row["objects"]) == (5, "moved")]
    medians = {row["metric"]: row["median"] for row in last if row["model"] == "oes"}
    assert medians == {"translation_mm": 5.0, "rotation_deg": 10.0, "surface_mm": 2.5}
    (ratio,) = [
        row["mean"]
        for row in as_dicts(frame)
        if (row["block"], row["group"], row["metric"], row["T"])
        == ("ratio", "1view_pred", "translation_mm", 5)
    ]
    assert ratio == pytest.approx(70 / 2050)
    by_objects = groups["by-objects-falling"]
    assert by_objects.tables[0].header == ("model", "error", "2", "3", "4")
    for name in ("table2", "table2-moved", "by-objects-falling"):
        assert "cylinder" in " ".join(groups[name].notes)


def test_metrics_of_falls(tmp_path: Path) -> None:
    tree = metrics_tree(error_aggregates(_falls(tmp_path / "errors.csv"), seed=0))
    assert {"falling", "ratio_falling", "falling_by_objects"} < tree.keys()
    assert "pushing" not in tree and "by_views_falling" not in tree
    model = tree["falling"]["1view_pred"]["graph_xyz"]
    assert model["diverged"] == 4 / 14 and model["moved"]["diverged"] == 0.5
    assert model["median"]["translation_mm"] == {"1": 1.0, "3": 3.0, "5": 5.0}
    assert model["moved"]["median"]["translation_mm"]["5"] == 252.5


def test_rows_of_other_tasks_are_refused(tmp_path: Path) -> None:
    falls = _falls(tmp_path / "falls.csv")
    mixed = falls.assign(task=np.where(falls["episode_i"] == 0, "pushing", "falling"))
    with pytest.raises(
        RowsError, match=r"one task of pushing, falling; these are of: \['falling', 'pushing'\]"
    ):
        error_aggregates(mixed, seed=0)
    with pytest.raises(RowsError, match=r"these are of: \[\]"):
        error_aggregates(read_rows([], ERRORS), seed=0)
