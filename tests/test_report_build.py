"""The whole of reports/ from a small, complete set of rows; and again, with the same bytes."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from oes.config import ParamsError, load
from oes.report.build import Inputs, Tables, build, forecasts
from oes.report.bundle import WeightsError, copy_half
from oes.report.card import read_card
from oes.report.names import MODELS, SETTINGS
from oes.report.perception import BOX, DETECTIONS, VIEWS, detector_figures, view_figures
from oes.report.provenance import describe_machine, read_seeds
from oes.report.rows import ERRORS, TRIALS, RowsError, read_columns
from oes.rows import write_csv

CFG = Tables(seed=0, profile="test", scenarios=("targets",))


def _write_errors(folder: Path) -> None:
    """Errors that grow with the model's place in the order, the number of objects, and fall with views."""
    rng = np.random.default_rng(0)
    scenes = [(2, "test2", setting) for setting in (*SETTINGS, "2views_pred", "3views_pred", "5views_pred")]
    scenes += [(n, f"test{n}", "1view_pred") for n in (1, 3, 4, 5)]
    for size, model in enumerate(MODELS, start=1):
        rows = []
        for num_objects, split, setting in scenes:
            num_views = int(setting[0]) if setting[0].isdigit() else 1
            for episode_i in range(4):
                for object_i in range(num_objects):
                    for T in (1, 2, 3, 4, 5):
                        error = size * T * num_objects / num_views * rng.uniform(0.9, 1.1)
                        values = (
                            setting,
                            split,
                            episode_i,
                            object_i,
                            num_objects,
                            num_views,
                            T,
                            error,
                            error / 2,
                            1,
                            1,
                        )
                        names = [name for name in ERRORS if name != "model"]
                        rows.append({"model": model} | dict(zip(names, values, strict=True)))
        (folder / f"pushing-{model}").mkdir(parents=True)
        write_csv(folder / f"pushing-{model}" / "errors.csv", rows, list(ERRORS))


def _write_perception(folder: Path) -> None:
    """Two true objects in each of two states: one found exactly, one missed; one false box with a low score."""
    folder.mkdir(parents=True)
    rows = []
    for num_views in (1, 3):
        for episode in (0, 1):
            base = {"episode": episode, "step": 0, "num_views": num_views}
            box = dict(zip(BOX, (0.1, 0, 0.02, 0.05, 0.05, 0.04), strict=True))
            true = {f"true_{name}": value for name, value in box.items()}
            rows.append(base | box | true | {"score": 0.9, "iou": 1.0, "centre_mm": 0.0, "mask_iou": 0.8})
            rows.append(base | true | {"true_x_m": -0.1})
            rows.append(base | box | {"x_m": 0.25, "score": 0.3})
    write_csv(folder / "detections.csv", rows, [*DETECTIONS, "iou"])
    views = [
        {"episode": 0, "step": 0, "num_views": n, "camera": 3, "psnr_db": 20 + n + i, "ssim": 0.8}
        for n in (1, 3)
        for i in (0, 1)
    ]
    write_csv(folder / "views.csv", views, list(views[0]))


def _write_trials(folder: Path) -> None:
    for model, wins in (("oes", 5), ("graph_xyz", 3), ("graph_xyz_image", 2)):
        (folder / f"targets-{model}").mkdir(parents=True)
        rows = []
        for i in range(6):
            video = f"trial_{i:03d}.mp4" if i in (0, 5) else ""
            values = ("targets", model, i, 1, i < wins, i < wins, 150.0, 20.0 if i < wins else 90.0, 21.0, 6, "", video)
            rows.append(dict(zip(TRIALS, values, strict=True)))
            for suffix in (".mp4", ".gif") if video else ():
                (folder / f"targets-{model}" / f"trial_{i:03d}{suffix}").write_bytes(b"film")
        write_csv(folder / f"targets-{model}" / "trials.csv", rows, list(TRIALS))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Inputs:
    root = tmp_path_factory.mktemp("datasets")
    names = ("meshes", "episodes", "perception", "objects", "dynamics", "rollouts", "trials")
    found = Inputs(**{name: root / name for name in names})
    _write_errors(found.rollouts)
    _write_perception(found.objects / "pushing-test2")
    _write_trials(found.trials)
    for folder in (found.meshes, found.episodes / "pushing-train", found.perception, found.dynamics / "pushing-oes"):
        folder.mkdir(parents=True)
    (found.meshes / "contact_sheet.png").write_bytes(b"picture")
    card = {
        "episodes": 12,
        "displacement_mm": {str(T): {"mean": 10.0 * T} for T in (1, 3, 5)},
        "displacements_mm": {str(T): [5.0 * T, 15.0 * T] for T in (1, 3, 5)},
        "rod_rms_mm": {"mean": 1.5},
        "share_object_contact": 0.4,
        "share_moved": 0.9,
    }
    (found.episodes / "pushing-train" / "card.json").write_text(json.dumps(card))
    about = {"format": "f", "config": "{}", "a": "1", "z": "2"}
    weights = {"w": np.linspace(-1, 1, 9, dtype=np.float32), "n": np.array([3], np.int64)}
    save_file(weights, found.perception / "perception.safetensors", about)
    save_file(weights, found.dynamics / "pushing-oes" / "model.safetensors", about)
    return found


@pytest.fixture(scope="module")
def reports(inputs: Inputs, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "reports"
    build(CFG, inputs, {"trials": 0}, out)
    return out


def test_everything_is_there(reports: Path) -> None:
    for name in ("table1", "table3", "by-objects", "by-views", "detector", "view-prediction"):
        for suffix in ("md", "csv", "tex"):
            text = (reports / f"{name}.{suffix}").read_text()
            assert len(text) > 50, (name, suffix)
        assert "Profile test; episodes: 12 train, 4 test1" in (reports / f"{name}.md").read_text()
        assert "seeds: trials 0; machine: " in (reports / f"{name}.md").read_text()
    figures = {path.name for path in (reports / "figures").iterdir()}
    stems = ("error-over-time", "by-objects", "by-views", "displacement")
    assert figures == {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")}
    films = {path.name for path in (reports / "films").iterdir()}
    assert films == {f"trial_{i}.{kind}" for i in ("000", "005") for kind in ("mp4", "gif")}
    assert (reports / "contact_sheet.png").exists()


def test_the_page_shows_every_table_and_its_links_hold(reports: Path) -> None:
    page = (reports / "README.md").read_text()
    links = [part.split(")")[0] for part in page.split("](")[1:]]
    assert {"table1.csv", "figures/by-views.png", "films/trial_000.gif", "contact_sheet.png"} <= set(links)
    for link in links:
        assert (reports / link).exists(), link
    assert "ratio of mean errors: translation 2." in page, "oes is fifth in the order, graph_xyz second"


def test_metrics_json_has_the_agreed_shape(reports: Path) -> None:
    tree = json.loads((reports / "metrics.json").read_text())
    assert tree["profile"] == "test" and "cores" in tree["machine"]
    assert set(tree["pushing"]) == set(SETTINGS)
    for setting in SETTINGS:
        alone = set() if setting == "fixed_pred" else {"graph_xyz_image_fixed"}
        assert set(tree["pushing"][setting]) == set(MODELS) - alone
    model = tree["pushing"]["1view_pred"]["oes"]
    assert set(model["translation_mm"]) == set(model["rotation_deg"]) == {"1", "3", "5"} and model["n"] == 8
    assert set(tree["by_objects"]) == set("12345") and set(tree["by_views"]) == set("1235")
    assert tree["by_objects"]["5"]["oes"]["n"] == 20
    assert tree["mpc"]["targets"]["oes"]["success"] == pytest.approx(5 / 6, abs=1e-4)
    assert tree["mpc"]["targets"]["oes"]["trials"] == 6
    assert tree["detector"]["1view"] == tree["detector"]["3views"]
    assert {"ap_25", "ap_50", "mask_iou", "centre_mm"} <= set(tree["detector"]["1view"])
    assert tree["view_prediction"]["psnr_db"] == 21.5 and tree["view_prediction"]["3views"]["psnr_db"] == 23.5
    assert tree["capture"]["displacement_mm"] == {"1": 10.0, "3": 30.0, "5": 50.0}
    assert tree["capture"]["rod_rms_mm"] == 1.5
    ratio = tree["ratio"]["oes/graph_xyz"]["1view_pred"]["translation_mm"]["5"]
    assert ratio["interval_95"][0] <= ratio["ratio"] == pytest.approx(2.5, rel=0.1)


def test_by_views_counts_random_views_only(inputs: Inputs) -> None:
    rows = read_columns(sorted(inputs.rollouts.glob("*/errors.csv")), ERRORS)
    found = forecasts(rows, seed=0)
    one = next(line for line in found.by_views if line.group == "1" and line.model == "oes" and line.objects == "all")
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
    figures = detector_figures(read_columns([seen / "detections.csv"], DETECTIONS))["1view"]
    assert figures["ap_25"] == figures["ap_50"] == pytest.approx(0.5), "half of the objects, before any false box"
    assert figures["mask_iou"] == pytest.approx(0.8) and figures["centre_mm"] == 0.0
    assert figures["objects"] == 4 and figures["boxes"] == 4
    assert view_figures(read_columns([seen / "views.csv"], VIEWS))["3views"]["n"] == 2


def test_weights_are_halved_in_a_fixed_order(inputs: Inputs, reports: Path, tmp_path: Path) -> None:
    kept = reports / "models" / "perception" / "perception.safetensors"
    tensors = load_file(kept)
    assert tensors["w"].dtype == np.float16 and tensors["n"].tolist() == [3]
    assert tensors["w"] == pytest.approx(np.linspace(-1, 1, 9), abs=1e-3)
    header = kept.read_bytes()[8:200].decode(errors="replace")
    order = [header.index(f'"{key}"') for key in ("__metadata__", "config", "format", "z", "n", "w")]
    assert order == sorted(order)
    assert load_file(reports / "models" / "dynamics" / "pushing-oes" / "model.safetensors")["w"].dtype == np.float32
    (tmp_path / "bad.safetensors").write_bytes(b"not weights")
    with pytest.raises(WeightsError, match=r"bad\.safetensors"):
        copy_half(tmp_path / "bad.safetensors", tmp_path / "x")
    save_file({"w": np.array([1e6], np.float32)}, tmp_path / "big.safetensors")
    with pytest.raises(WeightsError, match=r"big.safetensors: does not fit half precision: w"):
        copy_half(tmp_path / "big.safetensors", tmp_path / "x")


def test_broken_cards_and_params_say_so(tmp_path: Path) -> None:
    path = tmp_path / "card.json"
    path.write_text('{"episodes": 3}')
    with pytest.raises(RowsError, match=r"card.json.*displacement"):
        read_card(path)
    params = tmp_path / "params.yaml"
    params.write_text("tables: {seed: 0, profile: x}\nepisodes: {fit: {seed: 4}, seed: 2}\n")
    with pytest.raises(ParamsError, match=r"tables.scenarios: missing"):
        load(params, "tables", Tables)
    assert read_seeds(params) == {"tables": 0, "episodes.fit": 4, "episodes": 2}


def test_the_machine_is_described_without_its_name() -> None:
    text = describe_machine()
    assert text.count(" cores") == 1 and Path("/etc/hostname").read_text().strip() not in text


def test_rows_as_the_other_stages_write_them_are_read(tmp_path: Path) -> None:
    """The columns that rollouts and objects declare hold all that the report reads."""
    from oes.percept.evaluate import DETECTION_COLUMNS, VIEW_COLUMNS
    from oes.rollout import COLUMNS
    from oes.trial.contest import ROWS

    assert set(ERRORS) <= set(COLUMNS) and set(TRIALS) == set(ROWS)
    assert set(DETECTIONS) <= set(DETECTION_COLUMNS) and set(VIEWS) <= set(VIEW_COLUMNS)
    (tmp_path / "t.csv").write_text(",".join(TRIALS) + "\n")
    with (tmp_path / "t.csv").open() as file:
        assert next(csv.reader(file)) == list(TRIALS)
