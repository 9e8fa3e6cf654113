"""The whole of reports/ from a small, complete set of rows; and again, with the same bytes."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from oes.config import ParamsError, load
from oes.report.build import build
from oes.report.bundle import WeightsError, copy_half
from oes.report.card import read_card
from oes.report.findings import Inputs, Tables
from oes.report.names import METRICS, MODELS, SETTINGS
from oes.report.perception import DETECTIONS, VIEWS, detector_figures, read_detections, view_figures
from oes.report.provenance import describe_machine, read_seeds
from oes.report.rows import ERRORS, TRIALS, RowsError, read_columns
from oes.report.study import forecasts
from oes.report.video import VIDEO_MODELS
from tests.report_inputs import make_inputs

CFG = Tables(seed=0, profile="test", tasks=("pushing", "falling"), scenarios=("targets",))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Inputs:
    return make_inputs(tmp_path_factory.mktemp("datasets"))


@pytest.fixture(scope="module")
def reports(inputs: Inputs, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "reports"
    build(CFG, inputs, {"trials": 0}, out)
    return out


def test_everything_is_there(reports: Path) -> None:
    pushing = ("table1", "table3", "by-objects", "by-views", "detector", "view-prediction", "video")
    imagined = ("futures", "consistency", "counterfactuals", "data")
    for name in (*pushing, *imagined, "table2", "by-objects-falling", "detector-falling"):
        for suffix in ("md", "csv", "tex"):
            text = (reports / f"{name}.{suffix}").read_text()
            assert len(text) > 50, (name, suffix)
        assert "Profile test; episodes: 12 train, 4 test1" in (reports / f"{name}.md").read_text()
        assert "seeds: trials 0; machine: " in (reports / f"{name}.md").read_text()
    figures = {path.name for path in (reports / "figures").iterdir()}
    both = ("error-over-time", "by-objects", "displacement")
    trained = ("reliability", "learning-perception", "learning-pushing")
    stems = (*both, *trained, "by-views", *(f"{stem}-falling" for stem in both))
    gallery = {
        f"imagined-{task}-{kind}-000000.png"
        for task in CFG.tasks
        for kind in ("forecast", "views", "edits")
    }
    gallery.add("forecasts-planet.png")
    assert figures == {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")} | gallery
    films = {path.name for path in (reports / "films").iterdir()}
    stems = ("targets-trial_000", "targets-trial_005", "rollouts-pushing", "rollouts-falling")
    sides = {f"imagined-{task}-views-000000.mp4" for task in CFG.tasks}
    assert films == {f"{stem}.{kind}" for stem in stems for kind in ("mp4", "gif")} | sides
    assert (reports / "contact_sheet.png").exists()
    page = (reports / "index.html").read_text()
    assert (
        "| falling | train | 12 | 10.0 / 30.0 / 50.0 | 40% |" in (reports / "data.md").read_text()
    )
    assert page.count("<video ") == len(sides) + 4 and page.count("<img ") == 1 + sum(
        name.endswith(".png") for name in figures
    )
    assert (
        "pushing: error of 3D-OES over that of graph-XYZ" in page
        and "to targets succeed (shooting)" in page
    )


def test_the_page_shows_every_table_and_its_links_hold(reports: Path) -> None:
    page = (reports / "README.md").read_text()
    links = [part.split(")")[0] for part in page.split("](")[1:]]
    assert {
        "table1.csv",
        "figures/by-views.png",
        "films/targets-trial_000.gif",
        "contact_sheet.png",
    } <= set(links)
    for link in links:
        assert (reports / link).exists(), link
    assert page.count("ratio of mean errors: translation 2.") == 2, (
        "oes is fifth in the order, graph_xyz second"
    )
    below = page.split("## Forecasts\n")[1].split("## Trials\n")[0]
    assert "![rollouts-pushing](films/rollouts-pushing.gif)" in below
    assert "- [films/rollouts-falling.mp4](films/rollouts-falling.mp4)" in below


def test_metrics_json_has_the_agreed_shape(reports: Path) -> None:
    tree = json.loads((reports / "metrics.json").read_text())
    assert tree["profile"] == "test" and "cores" in tree["machine"]
    assert set(tree["pushing"]) == set(SETTINGS)
    for setting in SETTINGS:
        alone = set() if setting == "fixed_pred" else {"graph_xyz_image_fixed"}
        assert set(tree["pushing"][setting]) == set(MODELS) - alone - set(VIDEO_MODELS)
    model = tree["pushing"]["1view_pred"]["oes"]
    assert set(METRICS) | {
        "n",
        "interval_95",
        "median",
        "diverged",
        "moved",
        "detected_share",
    } == set(model)
    assert all(
        set(model[metric]) == set(model["median"][metric]) == {"1", "3", "5"} for metric in METRICS
    )
    assert model["n"] == 8
    assert set(tree["by_objects"]) == set("12345") and set(tree["by_views"]) == set("1235")
    assert tree["by_objects"]["5"]["oes"]["n"] == 20
    assert tree["mpc"]["targets"]["oes"]["shooting"]["success"] == pytest.approx(5 / 6, abs=1e-4)
    assert tree["mpc"]["targets"]["oes"]["shooting"]["trials"] == 6
    assert (
        tree["video"]["planet"]["1"]["psnr_db"] == 20.5 and tree["video"]["planet"]["1"]["n"] == 2
    )
    assert tree["detector"]["1view"] == tree["detector"]["3views"]
    assert {"ap_25", "ap_50", "mask_iou", "centre_mm"} <= set(tree["detector"]["1view"])
    assert (
        tree["view_prediction"]["psnr_db"] == 21.5
        and tree["view_prediction"]["3views"]["psnr_db"] == 23.5
    )
    assert tree["capture"]["displacement_mm"] == {"1": 10.0, "3": 30.0, "5": 50.0}
    assert tree["capture"]["rod_rms_mm"] == 1.5
    ratio = tree["ratio"]["oes/graph_xyz"]["1view_pred"]["translation_mm"]["5"]
    assert ratio["interval_95"][0] <= ratio["ratio"] == pytest.approx(2.5, rel=0.1)


def test_imagined_futures_are_told_as_means_and_intervals(reports: Path) -> None:
    tree = json.loads((reports / "metrics.json").read_text())["futures"]
    assert set(tree) == set(CFG.tasks) and set(tree["pushing"]) == {
        "renders",
        "consistency",
        "edits",
    }
    ours = tree["falling"]["renders"]["oes"]["5"]
    assert ours == {
        "psnr_db": 20.5,
        "ssim": 0.8,
        "objects_psnr_db": 15.0,
        "feature_error": 0.5,
        "n": 2,
    }
    assert tree["pushing"]["consistency"]["oes"]["1"] == {
        "views_found": 2.5,
        "centre_mm": 9.0,
        "spread_mm": None,
        "n": 2,
    }
    assert tree["pushing"]["edits"]["move"]["graph_xyz"]["5"]["translation_mm"] == 20.0
    lines = (reports / "counterfactuals.md").read_text().splitlines()
    (row,) = [line for line in lines if line.startswith("| falling | one object moved")]
    assert (
        "| 20.0 [20.0, 20.0] | 10.0 [10.0, 10.0] | 10.0 [10.0, 10.0] | 5.0 [5.0, 5.0] | 2 |" in row
    )
    pictures = (reports / "futures.md").read_text()
    assert "| pushing | 3D-OES | 20.5 / 20.5 / 20.5 | 15.0 / 15.0 / 15.0 | 0.800 /" in pictures


def test_metrics_json_tells_of_falls_in_the_same_form(reports: Path) -> None:
    tree = json.loads((reports / "metrics.json").read_text())
    assert set(tree["falling"]) == {"1view_pred", "1view_gt"}
    ours, pushed = tree["falling"]["1view_pred"]["oes"], tree["pushing"]["1view_pred"]["oes"]
    assert ours.keys() == pushed.keys() and ours["moved"].keys() == pushed["moved"].keys()
    assert ours["n"] == 4 * (3 + 4), "the scenes of test3 and test4"
    ratio = tree["ratio_falling"]["oes/graph_xyz"]["1view_pred"]["surface_mm"]["5"]
    assert ratio["ratio"] == pytest.approx(2.5, rel=0.1)
    assert set(tree["falling_by_objects"]) == set("12345") and "by_views_falling" not in tree
    assert tree["capture_falling"] == {
        "displacement_mm": {"1": 10.0, "3": 30.0, "5": 50.0},
        "impact": {"1": 0.25, "5": 1.0},
        "share_object_contact": 0.4,
        "share_moved": 0.9,
    }
    alone, both = tree["detector"]["1view"], tree["detector_falling"]["1view"]
    assert both["objects"] == 2 * alone["objects"] == 8 and both["ap_50"] == alone["ap_50"], (
        "scenes are kept apart"
    )


def test_pushing_alone_is_told_as_before(inputs: Inputs, reports: Path, tmp_path: Path) -> None:
    build(replace(CFG, tasks=("pushing",)), inputs, {"trials": 0}, tmp_path)
    alone, both = (
        json.loads((folder / "metrics.json").read_text()) for folder in (tmp_path, reports)
    )
    more = {"falling", "ratio_falling", "falling_by_objects", "detector_falling", "capture_falling"}
    for key in ("futures", "contact_ratio", "certainty", "sense"):
        assert alone.pop(key) == {"pushing": both.pop(key)["pushing"]}
    assert (
        alone == {key: value for key, value in both.items() if key not in more}
        and more < both.keys()
    )
    assert not list(tmp_path.rglob("*falling*")) and not (tmp_path / "table2.md").exists()
    assert (tmp_path / "table1.md").read_bytes() == (reports / "table1.md").read_bytes()


def test_by_views_counts_random_views_only(inputs: Inputs) -> None:
    rows = read_columns(sorted(inputs.rollouts.glob("pushing-*/errors.csv")), ERRORS)
    found = forecasts(rows, seed=0)
    one = next(
        line
        for line in found.by_views
        if line.group == "1" and line.model == "oes" and line.objects == "all"
    )
    assert one.n == 8, "the fixed view is one view too, but not a random one"


def test_the_same_rows_give_the_same_bytes(inputs: Inputs, reports: Path, tmp_path: Path) -> None:
    build(CFG, inputs, {"trials": 0}, tmp_path)
    names = {path.relative_to(reports) for path in reports.rglob("*") if path.is_file()}
    assert names == {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()}
    for name in names:
        assert (reports / name).read_bytes() == (tmp_path / name).read_bytes(), name
    assert b"<dc:date>" not in (reports / "figures" / "by-views.svg").read_bytes()


def test_detector_figures_by_hand(inputs: Inputs) -> None:
    seen = inputs.objects / "pushing-test2"
    figures = detector_figures(read_detections([seen / "detections.csv"]))["1view"]
    assert figures["ap_25"] == figures["ap_50"] == pytest.approx(0.5), (
        "half of the objects, before any false box"
    )
    assert figures["mask_iou"] == pytest.approx(0.8) and figures["centre_mm"] == 0.0
    assert figures["objects"] == 4 and figures["boxes"] == 4
    assert view_figures(read_columns([seen / "views.csv"], VIEWS))["3views"]["n"] == 2


def test_weights_are_halved_in_a_fixed_order(inputs: Inputs, reports: Path, tmp_path: Path) -> None:
    kept = reports / "models" / "perception" / "perception.safetensors"
    tensors = load_file(kept)
    assert tensors["w"].dtype == np.float16 and tensors["n"].tolist() == [3]
    assert tensors["w"] == pytest.approx(np.linspace(-1, 1, 9), abs=1e-3)
    header = kept.read_bytes()[8:200].decode(errors="replace")
    order = [
        header.index(f'"{key}"') for key in ("__metadata__", "config", "format", "z", "n", "w")
    ]
    assert order == sorted(order)
    assert (
        load_file(reports / "models" / "dynamics" / "pushing-oes" / "model.safetensors")["w"].dtype
        == np.float32
    )
    (tmp_path / "bad.safetensors").write_bytes(b"not weights")
    with pytest.raises(WeightsError, match=r"bad\.safetensors"):
        copy_half(tmp_path / "bad.safetensors", tmp_path / "x")
    save_file({"w": np.array([1e6], np.float32)}, tmp_path / "big.safetensors")
    with pytest.raises(WeightsError, match=r"big.safetensors: does not fit half precision: w"):
        copy_half(tmp_path / "big.safetensors", tmp_path / "x")


def test_broken_cards_and_params_say_so(inputs: Inputs, tmp_path: Path) -> None:
    path = tmp_path / "card.json"
    card = json.loads((inputs.episodes / "falling-train" / "card.json").read_text())
    path.write_text(json.dumps(card))
    with pytest.raises(RowsError, match=r"card.json: no key 'rod_rms_mm'"):
        read_card(path, "pushing")
    path.write_text('{"episodes": 3}')
    with pytest.raises(RowsError, match=r"card.json.*displacement"):
        read_card(path, "pushing")
    params = tmp_path / "params.yaml"
    params.write_text(
        "tables: {seed: 0, profile: x, tasks: [pushing]}\nepisodes: {fit: {seed: 4}, seed: 2}\n"
    )
    with pytest.raises(ParamsError, match=r"tables.scenarios: missing"):
        load(params, "tables", Tables)
    assert read_seeds(params) == {"tables": 0, "episodes.fit": 4, "episodes": 2}


def test_the_machine_is_described_without_its_name() -> None:
    text = describe_machine()
    assert text.count(" cores") == 1 and Path("/etc/hostname").read_text().strip() not in text


def test_rows_as_the_other_stages_write_them_are_read(tmp_path: Path) -> None:
    """The columns that rollouts and objects declare hold all that the report reads."""
    from oes.evaluation.evaluate_forecasts import ERROR_COLUMNS
    from oes.perception.evaluate import DETECTION_COLUMNS, VIEW_COLUMNS
    from oes.trials.results import TRIAL_COLUMNS

    assert set(ERRORS) <= set(ERROR_COLUMNS) and set(TRIALS) == set(TRIAL_COLUMNS)
    assert set(DETECTIONS) <= set(DETECTION_COLUMNS) and set(VIEWS) <= set(VIEW_COLUMNS)
    (tmp_path / "t.csv").write_text(",".join(TRIALS) + "\n")
    with (tmp_path / "t.csv").open() as file:
        assert next(csv.reader(file)) == list(TRIALS)


def test_surfaces_certainty_and_ablations_are_told(reports: Path) -> None:
    """In the made-up rows contact errs seven times as much as what is first in the order, graph_xyz
    twice.
    """
    tree = json.loads((reports / "metrics.json").read_text())
    ratio = tree["contact_ratio"]["falling"]["graph_xyz"]["translation_mm"]["5"]
    assert ratio["interval_95"][0] <= ratio["ratio"] <= ratio["interval_95"][1]
    sizes = [name for name in MODELS if name not in VIDEO_MODELS]
    assert ratio["ratio"] == pytest.approx(
        (sizes.index("contact") + 1) / (sizes.index("graph_xyz") + 1), rel=0.1
    )
    sure = tree["certainty"]["pushing"]["contact"]["1view_pred"]
    assert (
        sure["1"]["within_50"] == 0.0
        and sure["1"]["within_90"] == 1.0
        and sure["5"]["nll_same"] == 3.5
    )
    assert set(tree["certainty"]["pushing"]) == {"contact"}, (
        "only models that tell how sure they are"
    )
    sense = tree["sense"]["falling"]["oes"]
    assert sense["penetration_mm"] == 0.0 and sense["n"] == 28 and sense["n_still"] == 0
    (row,) = [
        line
        for line in (reports / "sense.md").read_text().splitlines()
        if "| falling | 3D-OES |" in line
    ]
    assert "| 0.00 | 0.0% |  | 28 | 0 |" in row
    assert tree["ablations"]["contact_300"]["translation_mm"]["5"]["ratio"] == 1.0
    ablations = (reports / "ablations.md").read_text().splitlines()
    asked = ("3D-OES", "Contact", "+ true surfaces", "300 episodes")
    assert [
        name for name in asked if any(line.startswith(f"| {name} |") for line in ablations)
    ] == list(asked)
    assert "contact_300" not in (reports / "table1.csv").read_text()
