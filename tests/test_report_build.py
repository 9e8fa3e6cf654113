"""The whole of reports/ from a small, complete set of rows; and again, with the same bytes."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from safetensors.numpy import load_file

from oes.config import ParamsError, load
from oes.report.aggregates import detector_metrics, error_aggregates, tidy, view_prediction
from oes.report.build import build
from oes.report.inputs import Inputs, TablesConfig, read_card, read_detections
from oes.report.names import METRICS, SETTINGS
from oes.report.provenance import describe_machine, read_seeds
from oes.report.rows import RowsError, read_rows
from oes.report.table import MAX_COLUMNS
from oes.schema import ERRORS, IMAGE_MODELS, MODEL_LABELS, VIEWS
from tests.report_inputs import make_inputs

CFG = TablesConfig(seed=0, profile="test", tasks=("pushing", "falling"), scenarios=("targets",))
PAGES = {"pushing", "falling", "moved", "uncertainty", "mpc", "perception", "futures", "data"}
GROUPS = {
    *("table1", "table1-moved", "by-objects", "by-views", "ratios", "ablations", "table3"),
    *("table2", "table2-moved", "by-objects-falling", "ratios-falling", "plausibility"),
    *("calibration", "detector", "detector-falling", "view-prediction", "image-forecasts"),
    *("futures", "consistency", "counterfactuals", "data"),
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Inputs:
    return make_inputs(tmp_path_factory.mktemp("datasets"))


@pytest.fixture(scope="module")
def reports(inputs: Inputs, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "reports"
    build(CFG, inputs, {"trials": 0}, out)
    return out


@pytest.fixture(scope="module")
def tree(reports: Path) -> dict[str, dict]:  # type: ignore[type-arg]
    return json.loads((reports / "metrics.json").read_text())


def test_everything_is_there(reports: Path) -> None:
    tables = {path.name for path in (reports / "tables").iterdir()}
    assert tables == {f"{name}.{suffix}" for name in GROUPS for suffix in ("csv", "tex")}
    assert all(len((reports / "tables" / name).read_text()) > 50 for name in tables)
    figures = {path.name for path in (reports / "figures").iterdir()}
    both = ("error-over-time", "by-objects", "displacement")
    trained = ("reliability", "learning-perception", "learning-pushing")
    stems = (*both, *trained, "by-views", *(f"{stem}-falling" for stem in both))
    kinds = ("forecast", "views", "edits")
    gallery = {f"{task}-{kind}-000000.webp" for task in CFG.tasks for kind in kinds}
    photos = {"meshes.webp", "forecasts-planet.webp"}
    assert figures == {f"{stem}.png" for stem in stems} | gallery | photos
    films = {path.name for path in (reports / "films").iterdir()}
    stems = ("targets-trial_000", "targets-trial_005", "rollouts-pushing", "rollouts-falling")
    sides = {f"{task}-views-000000.mp4" for task in CFG.tasks}
    assert films == {f"{stem}.mp4" for stem in stems} | sides | {"push.gif", "rollouts-falling.gif"}
    page = (reports / "index.html").read_text()
    assert page.count("<video ") == len(sides) + 4 and page.count("<img ") == len(figures)
    assert "Pushing: translation error of 3D-OES over graph-XYZ" in page
    assert "Pushing: translation error of Contact over graph-XYZ" in page
    assert "3D-OES: success of 6 trials to targets (shooting)" in page


def test_pages_are_small_with_narrow_tables_and_their_links_hold(reports: Path) -> None:
    pages = {path.stem: path.read_text() for path in reports.glob("*.md")}
    assert pages.keys() == PAGES | {"README"}
    for name, text in pages.items():
        assert len(text.encode()) < 30_000, name
        for link in re.findall(r"\]\(([^)]*)\)", text):
            assert (reports / link).exists(), link
        for line in text.splitlines():
            assert line.count("|") <= MAX_COLUMNS + 1, line
        if name != "README":
            assert "machine: " not in text, "where the numbers are from is in the index alone"
    index = pages["README"]
    assert index.count("Profile test; episodes: 12 pushing train, 4 pushing test1") == 1
    assert index.count("seeds: trials 0; machine: ") == 1
    assert {f"{name}.md" for name in PAGES} <= set(re.findall(r"\]\(([^)]*)\)", index))
    assert "3D-OES over graph-XYZ: pushing 2." in index, "fifth in the order over the second"
    data = "| falling | train | 12 | 10.0 / 30.0 / 50.0 | 40% |"
    assert data in pages["data"]
    for name in ("pushing", "falling", "uncertainty"):
        assert "Contact's prior uses Bullet's solver scheme" in pages[name], name


def test_images_are_small(inputs: Inputs, reports: Path) -> None:
    with Image.open(reports / "figures" / "meshes.webp") as image:
        assert image.format == "WEBP" and image.size == (1200, 30)
    with Image.open(reports / "figures" / "by-views.png") as image:
        assert image.mode == "P" and image.size == (1800, 480)


def test_metrics_json_has_the_agreed_shape(tree: dict[str, dict]) -> None:  # type: ignore[type-arg]
    assert tree["profile"] == "test" and "cores" in tree["machine"]
    assert set(tree["pushing"]) == set(SETTINGS)
    for setting in SETTINGS:
        alone = set() if setting == "fixed_pred" else {"graph_xyz_image_fixed"}
        assert set(tree["pushing"][setting]) == set(MODEL_LABELS) - alone - set(IMAGE_MODELS)
    model = tree["pushing"]["1view_pred"]["oes"]
    shares = {"n", "interval_95", "median", "diverged", "moved", "detected_share"}
    assert set(METRICS) | shares == set(model)
    for metric in METRICS:
        assert set(model[metric]) == set(model["median"][metric]) == {"1", "3", "5"}
    assert model["n"] == 8
    assert set(tree["by_objects"]) == set("12345") and set(tree["by_views"]) == set("1235")
    assert tree["by_objects"]["5"]["oes"]["n"] == 20
    trials = tree["mpc"]["targets"]["oes"]["shooting"]
    assert trials["success"] == pytest.approx(5 / 6, abs=1e-4) and trials["trials"] == 6
    assert tree["video"]["planet"]["1"]["psnr_db"] == 20.5
    assert tree["video"]["planet"]["1"]["n"] == 2
    assert tree["detector"]["1view"] == tree["detector"]["3views"]
    assert {"ap_25", "ap_50", "mask_iou", "centre_mm"} <= set(tree["detector"]["1view"])
    assert tree["view_prediction"]["psnr_db"] == 21.5
    assert tree["view_prediction"]["3views"]["psnr_db"] == 23.5
    assert tree["capture"]["displacement_mm"] == {"1": 10.0, "3": 30.0, "5": 50.0}
    assert tree["capture"]["rod_rms_mm"] == 1.5
    ratio = tree["ratio"]["oes/graph_xyz"]["1view_pred"]["translation_mm"]["5"]
    assert ratio["interval_95"][0] <= ratio["ratio"] == pytest.approx(2.5, rel=0.1)


def test_the_summary_holds_few_numbers_of_metrics_json(
    reports: Path, tree: dict[str, dict]  # type: ignore[type-arg]
) -> None:  # fmt: skip
    found = json.loads((reports / "summary.json").read_text())
    numbers = pd.json_normalize(found).iloc[0]
    assert 20 <= len(numbers) <= 60 and np.isfinite(numbers.astype(float)).all()
    ratio = tree["contact_ratio"]["falling"]["graph_xyz"]["rotation_deg"]["5"]["ratio"]
    assert numbers["falling.contact_over_graph_xyz.rotation"] == ratio
    error = tree["pushing"]["1view_pred"]["oes"]["translation_mm"]["5"]
    assert numbers["pushing.translation_mm.oes"] == error
    assert numbers["pushing.detector.ap_50"] == tree["detector"]["1view"]["ap_50"]
    assert numbers["success.targets.oes_shooting"] == pytest.approx(5 / 6, abs=1e-4)


def test_plots_for_dvc_hold_a_column_per_model(reports: Path, tree: dict[str, dict]) -> None:  # type: ignore[type-arg]
    errors = pd.read_csv(reports / "plots" / "error_over_T.csv", index_col="T")
    assert errors.index.tolist() == [1, 3, 5]
    for column in errors:
        task, model = column.split("_", 1)
        expected = tree[task]["1view_pred"][model]["translation_mm"]
        assert errors[column].tolist() == pytest.approx(list(expected.values()), abs=1e-3)
    learning = (reports / "plots" / "learning.csv").read_text()
    assert learning == "step,pushing_oes\n200,30.0\n"


def test_futures_are_means_and_intervals(reports: Path, tree: dict[str, dict]) -> None:  # type: ignore[type-arg]
    found = tree["futures"]
    assert set(found) == set(CFG.tasks)
    assert set(found["pushing"]) == {"renders", "consistency", "edits"}
    quality = {"psnr_db": 20.5, "ssim": 0.8, "objects_psnr_db": 15.0, "feature_error": 0.5, "n": 2}
    assert found["falling"]["renders"]["oes"]["5"] == quality
    seen = {"views_found": 2.5, "centre_mm": 9.0, "spread_mm": None, "n": 2}
    assert found["pushing"]["consistency"]["oes"]["1"] == seen
    assert found["pushing"]["edits"]["move"]["graph_xyz"]["5"]["translation_mm"] == 20.0
    page = (reports / "futures.md").read_text()
    translation, rotation = re.findall(r"\| falling \| one object moved .*", page)
    assert "| 20.0 [20.0, 20.0] | 10.0 [10.0, 10.0] | 2 |" in translation
    assert "| 10.0 [10.0, 10.0] | 5.0 [5.0, 5.0] | 2 |" in rotation
    assert "| pushing | 3D-OES | 20.5 / 20.5 / 20.5 | 15.0 / 15.0 / 15.0 | 0.800 /" in page
    assert "| 9.0 / 9.0 / 9.0 | - / - / - |" in page, "no spread was measured"


def test_metrics_of_falls_have_the_same_form(tree: dict[str, dict]) -> None:  # type: ignore[type-arg]
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
        "scenes of different splits are kept apart"
    )


def test_pushing_alone_gives_the_same_numbers(
    inputs: Inputs, reports: Path, tree: dict[str, dict], tmp_path: Path  # type: ignore[type-arg]
) -> None:  # fmt: skip
    build(replace(CFG, tasks=("pushing",)), inputs, {"trials": 0}, tmp_path)
    alone, both = json.loads((tmp_path / "metrics.json").read_text()), dict(tree)
    more = {"falling", "ratio_falling", "falling_by_objects", "detector_falling", "capture_falling"}
    for key in ("futures", "contact_ratio", "calibration", "plausibility"):
        assert alone.pop(key) == {"pushing": both.pop(key)["pushing"]}
    rest = {key: value for key, value in both.items() if key not in more}
    assert alone == rest and more < both.keys()
    assert not list(tmp_path.rglob("*falling*")) and not list(tmp_path.rglob("table2*"))
    assert (tmp_path / "pushing.md").read_bytes() == (reports / "pushing.md").read_bytes()


def test_by_views_counts_random_views_only(inputs: Inputs) -> None:
    rows = read_rows(sorted(inputs.rollouts.glob("pushing-*/errors.csv")), ERRORS)
    frame = error_aggregates(rows, seed=0)
    one = frame[(frame["block"] == "by_views") & (frame["group"] == "1")]
    one = one[(one["model"] == "oes") & (one["objects"] == "all")]
    assert set(one["n"]) == {8}, "the fixed view is one view too, but not a random one"


def test_the_same_rows_give_the_same_bytes(inputs: Inputs, reports: Path, tmp_path: Path) -> None:
    build(CFG, inputs, {"trials": 0}, tmp_path)
    names = {path.relative_to(reports) for path in reports.rglob("*") if path.is_file()}
    assert names == {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()}
    for name in names:
        assert (reports / name).read_bytes() == (tmp_path / name).read_bytes(), name


def test_detector_metrics_by_hand(inputs: Inputs) -> None:
    folder = inputs.objects / "pushing-test2"
    rows = read_detections([folder / "detections.csv"])
    found = detector_metrics(rows[rows["num_views"] == 1])
    assert found["ap_25"] == found["ap_50"] == pytest.approx(0.5), (
        "half of the objects, before any false box"
    )
    assert found["mask_iou"] == pytest.approx(0.8) and found["centre_mm"] == 0.0
    assert found["objects"] == 4 and found["boxes"] == 4
    views = tidy(view_prediction(read_rows([folder / "views.csv"], VIEWS)))
    assert set(views.loc[views["group"] == "3views", "n"]) == {2}


def test_large_weights_are_compact_copies(reports: Path) -> None:
    kept = reports / "models" / "perception" / "perception.safetensors"
    tensors = load_file(kept)
    assert tensors["w"].dtype == np.float16 and tensors["n"].tolist() == [3]
    assert tensors["w"] == pytest.approx(np.linspace(-1, 1, 9), abs=1e-3)
    header = kept.read_bytes()[8:200].decode(errors="replace")
    names = ("__metadata__", "config", "format", "z", "n", "w")
    order = [header.index(f'"{key}"') for key in names]
    assert order == sorted(order)
    small = reports / "models" / "dynamics" / "pushing-oes" / "model.safetensors"
    assert load_file(small)["w"].dtype == np.float32


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
        load(params, "tables", TablesConfig)
    assert read_seeds(params) == {"tables": 0, "episodes.fit": 4, "episodes": 2}


def test_the_machine_is_described_without_its_name() -> None:
    text = describe_machine()
    assert text.count(" cores") == 1 and Path("/etc/hostname").read_text().strip() not in text


def test_contact_calibration_and_ablations(reports: Path, tree: dict[str, dict]) -> None:  # type: ignore[type-arg]
    """In the synthetic rows the error of a model grows with its place in the order."""
    ratio = tree["contact_ratio"]["falling"]["graph_xyz"]["translation_mm"]["5"]
    assert ratio["interval_95"][0] <= ratio["ratio"] <= ratio["interval_95"][1]
    sizes = [name for name in MODEL_LABELS if name not in IMAGE_MODELS]
    place = sizes.index("contact") + 1, sizes.index("graph_xyz") + 1
    assert ratio["ratio"] == pytest.approx(place[0] / place[1], rel=0.1)
    found = tree["calibration"]["pushing"]["contact"]["1view_pred"]
    assert found["1"]["within_50"] == 0.0 and found["1"]["within_90"] == 1.0
    assert found["5"]["nll_homoscedastic"] == 3.5
    assert set(tree["calibration"]["pushing"]) == {"contact"}, "only models with an error model"
    falls = tree["plausibility"]["falling"]["oes"]
    assert falls["penetration_mm"] == 0.0 and falls["n"] == 28 and falls["n_still"] == 0
    assert (
        "| falling | 3D-OES | 0.00 | 0.0% |  | 28 | 0 |" in (reports / "uncertainty.md").read_text()
    )
    assert tree["ablations"]["contact_300"]["translation_mm"]["5"]["ratio"] == 1.0
    text = (reports / "pushing.md").read_text()
    ablations = text.split("## Ablations of Contact, pushing")[1].splitlines()
    asked = ("3D-OES", "Contact", "+ ground-truth surfaces", "300 episodes")
    labels = [line.split(" | ")[0].removeprefix("| ") for line in ablations if line.startswith("|")]
    assert [name for name in dict.fromkeys(labels) if name in asked] == list(asked)
    assert "contact_300" not in (reports / "tables" / "table1.csv").read_text()
