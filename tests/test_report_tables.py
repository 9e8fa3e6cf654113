"""Tables and metrics from hand-made rows whose means are known."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from oes.csv_io import write_csv
from oes.report.forecast import Group, Line, forecast_table, lines, ratio
from oes.report.metrics import forecast_tree, ratio_tree, trials_tree, write_json
from oes.report.paper import FORECAST
from oes.report.rows import ERRORS, TRIALS, RowsError, read_columns, select
from oes.report.table import latex, markdown, write_table
from oes.report.trials import outcomes, trials_table
from tests.report_inputs import UNTOLD


def _errors(path: Path) -> Path:
    """Two models, three episodes of two objects; graph_xyz errs by 10 T per object number, oes by
    half of that.

    Surfaces are off by a fifth as much, and by ten times that in the last episode.
    """
    rows = []
    for model, factor in (("graph_xyz", 1.0), ("oes", 0.5)):
        for episode_i in range(3):
            for object_i in range(2):
                for T in (1, 3, 5):
                    rows.append(
                        {
                            "task": "pushing",
                            "model": model,
                            "setting": "1view_pred",
                            "split": "test2",
                            "episode_i": episode_i,
                            "object_i": object_i,
                            "num_objects": 2,
                            "num_views": 1,
                            "T": T,
                            "translation_mm": factor * 10 * T * (object_i + 1),
                            "rotation_deg": factor * T,
                            "surface_mm": factor
                            * 2
                            * T
                            * (object_i + 1)
                            * (10 if episode_i == 2 else 1),
                            "moved": object_i == 0,
                            "detected": not (episode_i == 0 and object_i == 1),
                            "penetration_mm": 0.0,
                            **UNTOLD,
                        }
                    )
    write_csv(path, rows, list(rows[0]))
    return path


@pytest.fixture
def found(tmp_path: Path) -> list[Line]:
    rows = read_columns([_errors(tmp_path / "errors.csv")], ERRORS)
    return lines(
        [Group("1view_pred", "1 view, predicted boxes", rows, FORECAST["pushing"]["1view_pred"])],
        seed=0,
    )


MARKDOWN = """\
**Errors**

| setting | model | error | T=1 | T=3 | T=5 | median, T=5 | diverged | n | paper \
| moved: T=1 | moved: T=3 | moved: T=5 | moved: median, T=5 | moved: diverged | n moved |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
| 1 view, predicted boxes | graph-XYZ | translation (mm) | 15.0 [15.0, 15.0] | 45.0 [45.0, 45.0] | 75.0 [75.0, 75.0] \
| 75.0 | 0.0% | 6 | 6.7 / 35.4 / 68.2 | 10.0 [10.0, 10.0] | 30.0 [30.0, 30.0] | 50.0 [50.0, 50.0] | 50.0 | 0.0% | 3 |
|  |  | rotation (deg) | 1.0 [1.0, 1.0] | 3.0 [3.0, 3.0] | 5.0 [5.0, 5.0] \
| 5.0 |  | 6 | 3.0 / 20.1 / 30.3 | 1.0 [1.0, 1.0] | 3.0 [3.0, 3.0] | 5.0 [5.0, 5.0] | 5.0 |  | 3 |
|  |  | surface distance (mm) | 12.0 [3.0, 30.0] | 36.0 [9.0, 90.0] | 60.0 [15.0, 150.0] \
| 20.0 |  | 6 |  | 8.0 [2.0, 20.0] | 24.0 [6.0, 60.0] | 40.0 [10.0, 100.0] | 10.0 |  | 3 |
|  | 3D-OES | translation (mm) | 7.5 [7.5, 7.5] | 22.5 [22.5, 22.5] | 37.5 [37.5, 37.5] \
| 37.5 | 0.0% | 6 | 4.3 / 25.2 / 47.0 | 5.0 [5.0, 5.0] | 15.0 [15.0, 15.0] | 25.0 [25.0, 25.0] | 25.0 | 0.0% | 3 |
|  |  | rotation (deg) | 0.5 [0.5, 0.5] | 1.5 [1.5, 1.5] | 2.5 [2.5, 2.5] \
| 2.5 |  | 6 | 2.7 / 12.1 / 19.7 | 0.5 [0.5, 0.5] | 1.5 [1.5, 1.5] | 2.5 [2.5, 2.5] | 2.5 |  | 3 |
|  |  | surface distance (mm) | 6.0 [1.5, 15.0] | 18.0 [4.5, 45.0] | 30.0 [7.5, 75.0] \
| 10.0 |  | 6 |  | 4.0 [1.0, 10.0] | 12.0 [3.0, 30.0] | 20.0 [5.0, 50.0] | 5.0 |  | 3 |

Means with 95% intervals, bootstrapped over episodes. Diverged: objects forecast over 0.3 m off at T = 5. \
Rotation is ambiguous for symmetric objects: a turned cylinder looks the same, but its turn counts. \
Surface distance is the error that is right for them: the mean distance from the object's surface as forecast to \
the nearest true surface, an error of translation and rotation together.

Profile test.
"""


def test_forecast_table_is_the_golden_one(found: list[Line], tmp_path: Path) -> None:
    table = forecast_table("table1", "Errors", "setting", found, ["Profile test."])
    assert markdown(table) == MARKDOWN
    write_table(table, tmp_path)
    assert (tmp_path / "table1.md").read_text() == MARKDOWN
    assert (tmp_path / "table1.csv").read_text().splitlines()[:3] == [
        "setting,model,metric,objects,T,mean,low,high,median,n,episodes,detected_share,diverged,paper",
        "1view_pred,graph_xyz,translation_mm,all,1,15.0,15.0,15.0,15.0,6,3,0.8333,0.0,6.7",
        "1view_pred,graph_xyz,translation_mm,all,3,45.0,45.0,45.0,45.0,6,3,0.8333,0.0,35.4",
    ]
    with (tmp_path / "table1.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 2 * 3 * 2 * 3
    text = latex(table)
    assert text.count(r"\\") == 1 + 6 and "43.8" not in text
    assert r"\label{tab:table1}" in text and r"3D-OES & translation (mm) & 7.5 [7.5, 7.5]" in text


def test_latex_escapes_what_tex_would_read(found: list[Line]) -> None:
    text = latex(
        forecast_table("t", "50% of {x}_1 & y", "setting", found, ["a < b", "`code` and **bold**"])
    )
    assert r"50\% of \{x\}\_1 \& y" in text and "a $<$ b" in text and "code and bold" in text


def test_ratio_is_paired_and_its_interval_holds_it(tmp_path: Path) -> None:
    rows = read_columns([_errors(tmp_path / "errors.csv")], ERRORS)
    assert ratio(rows, "oes", "graph_xyz", "translation_mm", 5, seed=0) == pytest.approx(
        (0.5, 0.5, 0.5)
    )
    rng = np.random.default_rng(0)
    noisy = rows | {
        "translation_mm": rows["translation_mm"] * rng.uniform(0.5, 1.5, len(rows["T"]))
    }
    middle, low, high = ratio(noisy, "oes", "graph_xyz", "translation_mm", 5, seed=0) or (0, 0, 0)
    assert low < middle < high
    assert ratio(rows, "oes", "planet", "translation_mm", 5, seed=0) is None


def test_metrics_have_the_agreed_shape(found: list[Line], tmp_path: Path) -> None:
    tree = forecast_tree(found)
    model = tree["1view_pred"]["oes"]
    assert (
        model["translation_mm"] == {"1": 7.5, "3": 22.5, "5": 37.5}
        and model["rotation_deg"]["5"] == 2.5
    )
    assert (
        model["n"] == 6
        and model["moved"]["n"] == 3
        and model["moved"]["translation_mm"]["5"] == 25.0
    )
    assert model["interval_95"]["rotation_deg"]["5"] == [2.5, 2.5]
    assert (
        model["median"]["surface_mm"] == {"1": 2.0, "3": 6.0, "5": 10.0}
        and model["surface_mm"]["5"] == 30.0
    )
    assert model["diverged"] == model["moved"]["diverged"] == 0.0
    ratios = ratio_tree({("1view_pred", "translation_mm", 5): (0.5, 0.4, 0.6)})
    assert ratios["1view_pred"]["translation_mm"]["5"] == {"ratio": 0.5, "interval_95": [0.4, 0.6]}
    write_json(
        {"pushing": tree, "rest": [float("nan"), float("inf"), 0.123456, 3, "x"]},
        tmp_path / "metrics.json",
    )
    read = json.loads((tmp_path / "metrics.json").read_text())
    assert read["rest"] == [None, None, 0.123456, 3, "x"]
    assert read["pushing"]["1view_pred"]["oes"]["moved"] == tree["1view_pred"]["oes"]["moved"]


def _trials(path: Path) -> Path:
    """oes succeeds in 9 of 10 with both planners, graph_xyz in 4 of the same 10; one graph_xyz
    trial did not run.
    """
    rows = [
        {
            "scenario": "targets",
            "model": model,
            "planner": planner,
            "plans": 30,
            "horizon": 1,
            "trial_i": i,
            "num_objects": 1,
            "success": i < wins,
            "all_success": i < wins,
            "collided": planner == "cem" and i == 9,
            "initial_mm": 150.0,
            "mean_final_mm": "nan"
            if (model, i) == ("graph_xyz", 9)
            else 20.0
            if i < wins
            else 80.0,
            "estimated_mm": 20.0,
            "steps_used": 5,
            "failure": "no room" if (model, i) == ("graph_xyz", 9) else "",
            "video": "",
        }
        for model, planner, wins in (
            ("oes", "cem", 9),
            ("oes", "shooting", 9),
            ("graph_xyz", "shooting", 4),
        )
        for i in range(10)
    ]
    write_csv(path, rows, list(TRIALS))
    return path


def test_trials_table_pairs_the_trials(tmp_path: Path) -> None:
    found = outcomes(read_columns([_trials(tmp_path / "trials.csv")], TRIALS), "targets")
    assert [(each.planner, each.model) for each in found] == [
        ("shooting", "graph_xyz"),
        ("shooting", "oes"),
        ("cem", "oes"),
    ]
    baseline, ours, searched = found
    assert (ours.collided, searched.collided) == (0, 0.1) and searched.printed is None
    assert ours.success == 0.9 and ours.p_value is None and ours.printed == 0.86
    assert ours.interval == pytest.approx((0.596, 0.982), abs=1e-3)
    assert baseline.p_value == pytest.approx(2 * 0.5**5) and baseline.failures == 1
    assert ours.distance_p_value is None and 0 < (baseline.distance_p_value or 0) < 0.1
    assert baseline.final_mm == pytest.approx((4 * 20 + 5 * 80) / 9)
    text = markdown(trials_table(found, "table3", "targets", ()))
    row = "| shooting | 30 x 1 | graph-XYZ | 10 | 0.40 [0.17, 0.69] | 0.062 | 0.40 | 0.00 | 150 | 53.3 | 0.062 | 5.0 |"
    assert row in text
    tree = trials_tree(found)
    assert tree["oes"]["shooting"]["success"] == 0.9 and "p_value" not in tree["oes"]["shooting"]
    assert tree["oes"]["cem"]["trials"] == 10 and list(tree["graph_xyz"]) == ["shooting"]


def test_bad_rows_name_the_file_and_the_place(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    path.write_text("a,b\n1,x\n2,3.5\n")
    with pytest.raises(RowsError, match=r"rows.csv: line 2, column b: 'x' is not a float"):
        read_columns([path], {"a": int, "b": float})
    with pytest.raises(RowsError, match=r"rows.csv: lacks the columns c"):
        read_columns([path], {"a": int, "c": float})
    path.write_text("a,b\n1,True\n2,False\n1,True\n")
    assert select(read_columns([path], {"a": int, "b": bool}), a=1)["b"].tolist() == [True, True]
