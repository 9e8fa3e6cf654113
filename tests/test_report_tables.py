"""Aggregates, tables and metrics from rows whose means are known."""

import csv
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from oes.csv_io import write_csv
from oes.report.aggregates import as_dicts, error_aggregates, ratio, tidy, trial_aggregates
from oes.report.metrics import metrics_tree, plain, write_json
from oes.report.rows import RowsError, read_rows
from oes.report.table import Table, TableGroup, latex, markdown, write_group
from oes.report.tables import forecast_groups, trial_group
from oes.schema import ERRORS, TRIALS
from tests.report_inputs import UNCALIBRATED


def _errors(path: Path) -> pd.DataFrame:
    """Two models, three episodes of two objects; graph_xyz is off by 10 T per object number, oes by
    half of that.

    Surface distances are a fifth as large, and ten times that in the last episode.
    """
    rows = [
        {
            **{"task": "pushing", "model": model, "setting": "1view_pred", "split": "test2"},
            **{"episode_i": episode_i, "object_i": object_i, "num_objects": 2, "num_views": 1},
            "T": T,
            "translation_mm": factor * 10 * T * (object_i + 1),
            "rotation_deg": factor * T,
            "surface_mm": factor * 2 * T * (object_i + 1) * (10 if episode_i == 2 else 1),
            "moved": object_i == 0,
            "detected": not (episode_i == 0 and object_i == 1),
            "penetration_mm": 0.0,
            **UNCALIBRATED,
        }
        for model, factor in (("graph_xyz", 1.0), ("oes", 0.5))
        for episode_i in range(3)
        for object_i in range(2)
        for T in (1, 3, 5)
    ]
    write_csv(path, rows, ERRORS)
    return read_rows([path], ERRORS)


@pytest.fixture
def errors(tmp_path: Path) -> pd.DataFrame:
    return _errors(tmp_path / "errors.csv")


@pytest.fixture
def main(errors: pd.DataFrame) -> tuple[TableGroup, TableGroup]:
    """The groups of all and of moved objects."""
    every, moved = forecast_groups(error_aggregates(errors, seed=0), "pushing")[:2]
    return every, moved


ALL = """\
**1 view, predicted boxes (6 objects of 3 episodes)**

| model | error | T=1 | T=3 | T=5 | median, T=5 | diverged | paper |
| --- | --- | --- | --- | --- | --- | --- | --- |
| graph-XYZ | translation (mm) | 15.0 [15.0, 15.0] | 45.0 [45.0, 45.0] | 75.0 [75.0, 75.0] \
| 75.0 | 0.0% | 6.7 / 35.4 / 68.2 |
| graph-XYZ | rotation (deg) | 1.0 [1.0, 1.0] | 3.0 [3.0, 3.0] | 5.0 [5.0, 5.0] \
| 5.0 |  | 3.0 / 20.1 / 30.3 |
| graph-XYZ | surface distance (mm) | 12.0 [3.0, 30.0] | 36.0 [9.0, 90.0] | 60.0 [15.0, 150.0] \
| 20.0 |  |  |
| 3D-OES | translation (mm) | 7.5 [7.5, 7.5] | 22.5 [22.5, 22.5] | 37.5 [37.5, 37.5] \
| 37.5 | 0.0% | 4.3 / 25.2 / 47.0 |
| 3D-OES | rotation (deg) | 0.5 [0.5, 0.5] | 1.5 [1.5, 1.5] | 2.5 [2.5, 2.5] \
| 2.5 |  | 2.7 / 12.1 / 19.7 |
| 3D-OES | surface distance (mm) | 6.0 [1.5, 15.0] | 18.0 [4.5, 45.0] | 30.0 [7.5, 75.0] \
| 10.0 |  |  |
"""
MOVED = """\
**1 view, predicted boxes, moved objects (3 objects of 3 episodes)**

| model | error | T=1 | T=3 | T=5 | median, T=5 | diverged | paper |
| --- | --- | --- | --- | --- | --- | --- | --- |
| graph-XYZ | translation (mm) | 10.0 [10.0, 10.0] | 30.0 [30.0, 30.0] | 50.0 [50.0, 50.0] \
| 50.0 | 0.0% |  |
| graph-XYZ | rotation (deg) | 1.0 [1.0, 1.0] | 3.0 [3.0, 3.0] | 5.0 [5.0, 5.0] | 5.0 |  |  |
| graph-XYZ | surface distance (mm) | 8.0 [2.0, 20.0] | 24.0 [6.0, 60.0] | 40.0 [10.0, 100.0] \
| 10.0 |  |  |
| 3D-OES | translation (mm) | 5.0 [5.0, 5.0] | 15.0 [15.0, 15.0] | 25.0 [25.0, 25.0] \
| 25.0 | 0.0% |  |
| 3D-OES | rotation (deg) | 0.5 [0.5, 0.5] | 1.5 [1.5, 1.5] | 2.5 [2.5, 2.5] | 2.5 |  |  |
| 3D-OES | surface distance (mm) | 4.0 [1.0, 10.0] | 12.0 [3.0, 30.0] | 20.0 [5.0, 50.0] \
| 5.0 |  |  |
"""


def test_forecast_tables_are_the_golden_ones(
    main: tuple[TableGroup, TableGroup], tmp_path: Path
) -> None:
    group, moved = main
    assert [markdown(table) for table in group.tables] == [ALL]
    assert [markdown(table) for table in moved.tables] == [MOVED]
    write_group(group, tmp_path)
    assert (tmp_path / "table1.csv").read_text().splitlines()[:3] == [
        "task,group,model,metric,objects,T,mean,low,high,median,n,episodes,detected_share,diverged,paper",
        "pushing,1view_pred,graph_xyz,translation_mm,all,1,15.0,15.0,15.0,15.0,6,3,0.8333,0.0,6.7",
        "pushing,1view_pred,graph_xyz,translation_mm,all,3,45.0,45.0,45.0,45.0,6,3,0.8333,0.0,35.4",
    ]
    with (tmp_path / "table1.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 2 * 3 * 2 * 3
    text = latex(group)
    assert text.count(r"\\") == 1 + 6 and "43.8" not in text
    assert r"\label{tab:table1-1}" in text and r"3D-OES & translation (mm) & 7.5 [7.5, 7.5]" in text
    assert "cylinder" in " ".join(group.notes)


def test_latex_escapes_what_tex_would_read(errors: pd.DataFrame) -> None:
    table = Table("50% of {x}_1 & y", ("a", "b"), (("<", "~"),))
    text = latex(TableGroup("t", "", (table,), errors, ("a < b", "`code` and **bold**")))
    assert r"50\% of \{x\}\_1 \& y" in text and "a $<$ b" in text and "code and bold" in text


def test_ratio_is_paired_and_its_interval_holds_it(errors: pd.DataFrame) -> None:
    models = ("oes", "graph_xyz")
    found = ratio(errors, models, "translation_mm", 5, seed=0) or {}
    assert [found[name] for name in ("mean", "low", "high")] == pytest.approx([0.5] * 3)
    factors = np.random.default_rng(0).uniform(0.5, 1.5, len(errors))
    noisy = errors.assign(translation_mm=errors["translation_mm"] * factors)
    found = ratio(noisy, models, "translation_mm", 5, seed=0) or {}
    assert found["low"] < found["mean"] < found["high"]
    shuffled = noisy.sample(frac=1, random_state=1)
    assert ratio(shuffled, models, "translation_mm", 5, seed=0) == found, "pairs, not positions"
    assert ratio(errors, ("oes", "planet"), "translation_mm", 5, seed=0) is None


def test_metrics_have_the_agreed_shape(errors: pd.DataFrame, tmp_path: Path) -> None:
    tree = metrics_tree(error_aggregates(errors, seed=0))
    model = tree["pushing"]["1view_pred"]["oes"]
    assert model["translation_mm"] == {"1": 7.5, "3": 22.5, "5": 37.5}
    assert model["rotation_deg"]["5"] == 2.5
    assert model["n"] == 6 and model["moved"]["n"] == 3
    assert model["moved"]["translation_mm"]["5"] == 25.0
    assert model["interval_95"]["rotation_deg"]["5"] == [2.5, 2.5]
    assert model["median"]["surface_mm"] == {"1": 2.0, "3": 6.0, "5": 10.0}
    assert model["surface_mm"]["5"] == 30.0
    assert model["diverged"] == model["moved"]["diverged"] == 0.0
    ratios = tree["ratio"]["oes/graph_xyz"]["1view_pred"]["translation_mm"]["5"]
    assert ratios == {"ratio": 0.5, "interval_95": [0.5, 0.5]}
    rest = [float("nan"), float("inf"), 0.1234564, 3, "x"]
    write_json(plain({"pushing": tree, "rest": rest}), tmp_path / "metrics.json")
    read = json.loads((tmp_path / "metrics.json").read_text())
    assert read["rest"] == [None, None, 0.123456, 3, "x"]
    assert read["pushing"]["pushing"]["1view_pred"]["oes"]["moved"] == model["moved"]


def _trials(path: Path) -> pd.DataFrame:
    """oes succeeds in 9 of 10 with both planners, graph_xyz in 4 of the same 10; one graph_xyz
    trial did not run.
    """
    rows = [
        {
            **{"scenario": "targets", "model": model, "planner": planner, "plans": 30},
            **{"horizon": 1, "trial_i": i, "num_objects": 1},
            **{"success": i < wins, "all_success": i < wins},
            "collided": planner == "cem" and i == 9,
            "initial_mm": 150.0,
            "mean_final_mm": "nan"
            if (model, i) == ("graph_xyz", 9)
            else 20.0
            if i < wins
            else 80.0,
            **{"estimated_mm": 20.0, "steps_used": 5},
            "failure": "no room" if (model, i) == ("graph_xyz", 9) else "",
        }
        for model, planner, wins in (
            ("oes", "cem", 9),
            ("oes", "shooting", 9),
            ("graph_xyz", "shooting", 4),
        )
        for i in range(10)
    ]
    write_csv(path, rows, TRIALS)
    return read_rows([path], TRIALS)


def test_trials_are_paired(tmp_path: Path) -> None:
    frame = tidy(trial_aggregates(_trials(tmp_path / "trials.csv"), "targets"))
    rows = {(row["planner"], row["model"], row["metric"]): row for row in as_dicts(frame)}
    order = [("shooting", "graph_xyz"), ("shooting", "oes"), ("cem", "oes")]
    assert list(dict.fromkeys(key[:2] for key in rows)) == order
    mean = {key: row["mean"] for key, row in rows.items()}
    assert mean["shooting", "oes", "collided"] == 0 and mean["cem", "oes", "collided"] == 0.1
    ours = rows["shooting", "oes", "success"]
    assert ours["mean"] == 0.9 and np.isnan(ours["p_value"]) and ours["paper"] == 0.86
    assert np.isnan(rows["cem", "oes", "success"]["paper"])
    assert (ours["low"], ours["high"]) == pytest.approx((0.596, 0.982), abs=1e-3)
    assert rows["shooting", "graph_xyz", "success"]["p_value"] == pytest.approx(2 * 0.5**5)
    assert mean["shooting", "graph_xyz", "did_not_run"] == 1
    assert 0 < rows["shooting", "graph_xyz", "final_mm"]["p_value"] < 0.1
    assert np.isnan(rows["shooting", "oes", "final_mm"]["p_value"])
    assert mean["shooting", "graph_xyz", "final_mm"] == pytest.approx((4 * 20 + 5 * 80) / 9)
    success, distance = map(markdown, trial_group(frame, "targets").tables)
    row = "| shooting | graph-XYZ | 10 | 0.40 [0.17, 0.69] | 0.062 | 0.40 | 0.00 | 0.76 |"
    assert row in success
    assert "| shooting | graph-XYZ | 30 x 1 | 150 | 53.3 | 0.062 | 5.0 | 1 |" in distance
    tree = metrics_tree(frame)["mpc"]["targets"]
    assert tree["oes"]["shooting"]["success"] == 0.9 and "p_value" not in tree["oes"]["shooting"]
    assert tree["oes"]["cem"]["trials"] == 10 and list(tree["graph_xyz"]) == ["shooting"]


def test_bad_rows_name_the_file_and_the_place(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    path.write_text("a,b\n1,x\n2,3.5\n")
    with pytest.raises(RowsError, match=r"rows.csv: line 2, column b: 'x' is not a float"):
        read_rows([path], {"a": "int", "b": "float"})
    with pytest.raises(RowsError, match=r"rows.csv: lacks the columns c"):
        read_rows([path], {"a": "int", "c": "float"})
    path.write_text("")
    with pytest.raises(RowsError, match=r"rows.csv: No columns"):
        read_rows([path], {"a": "int"})
    path.write_text("a,b,c\n1,True,\n2,False,0.1\n1,True,\n")
    rows = read_rows([path], {"a": "int", "b": "bool", "c": "float?"})
    assert rows["b"].tolist() == [True, False, True] and rows["a"].tolist() == [1, 2, 1]
    assert rows["c"].isna().tolist() == [True, False, True] and rows["c"][1] == 0.1
