"""``make evaluate`` and ``make demo`` as users run them, with untrained weights: what they write,
what they refuse.
"""

import csv
from pathlib import Path

import av
import pytest
import trimesh
import yaml

from oes.apps import demo, evaluate
from oes.apps.assets import WeightsMissing, find_catalogue, find_weights
from oes.apps.demo import DemoConfig
from oes.apps.evaluate import EvaluateConfig
from oes.apps.view import record_episode
from oes.config import PARAMS, load
from oes.meshes.catalogue import CatalogueError
from oes.sim.simulate import EpisodesConfig
from tests.blocks import SMOKE, make_catalogue, make_weights


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with params.yaml (smoke, in this process) and weights as git keeps
    them.
    """
    make_weights(tmp_path / "reports" / "models")
    sections = yaml.safe_load(SMOKE.read_text())
    for name in ("episodes", "rollouts", "trials"):
        sections[name]["num_workers"] = 1
    sections["trials"]["scenarios"]["targets"]["max_steps"] = 2
    sections["evaluate"]["episodes"] = 2
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(sections))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_evaluate_reports_on_a_folder_of_meshes(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (study / "mine").mkdir()
    trimesh.creation.box((0.08, 0.06, 0.05)).export(study / "mine" / "brick.stl")
    trimesh.creation.cylinder(0.04, 0.05).export(study / "mine" / "puck.obj")
    (study / "mine" / "broken.stl").write_text("not a mesh")
    cfg = load(study / "params.yaml", "evaluate", EvaluateConfig)
    evaluate.main(cfg, study / "mine", episodes=2, keep_episodes=True)
    out = study / "build" / "evaluate-mine-2"
    printed = capsys.readouterr().out
    assert printed == (out / "report.md").read_text()
    assert "Profile meshes of mine; episodes: 2 test" in printed
    assert "2 meshes accepted" in printed and "1 rejected" in printed
    for label in ("1 view, predicted boxes", "graph-XYZ", "3D-OES / graph-XYZ", "AP at IoU 0.5"):
        assert label in printed
    for name in ("table1", "ratios", "errors", "detector", "detections", "views"):
        assert (out / f"{name}.csv").is_file()
    with (out / "table1.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["model"] for row in rows} == {"oes", "graph_xyz"}
    assert {row["n"] for row in rows} <= {"1", "2", "3", "4"}
    assert "broken.stl" in (out / "rejected.csv").read_text()
    assert len(list((out / "episodes").rglob("*.mcap"))) == 2
    assert not list((study / ".work").rglob("*.mcap"))


def test_evaluate_refuses_what_it_cannot_use(study: Path) -> None:
    cfg = load(study / "params.yaml", "evaluate", EvaluateConfig)
    (study / "junk").mkdir()
    (study / "junk" / "broken.stl").write_text("not a mesh")
    with pytest.raises(CatalogueError, match="none of 1 meshes is usable"):
        evaluate.main(cfg, study / "junk")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        evaluate.main(cfg, study / "nowhere")
    with pytest.raises(WeightsMissing, match=r"no trained weights in datasets or .*make all"):
        find_weights((Path("datasets"), study), ())
    with pytest.raises(WeightsMissing, match="no trained weights"):
        find_weights((study / "reports" / "models",), ("graph_xyz_image",))


def test_demo_shows_forecast_beside_execution(study: Path) -> None:
    make_catalogue(study / "datasets" / "meshes")
    demo.main(load(study / "params.yaml", "demo", DemoConfig))
    with av.open(str(study / "demo.mp4")) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    height, width, _ = frames[0].shape
    assert width == 2 * height and len(frames) >= 5
    assert frames[0][:, : width // 2].std() > 10 and frames[0][:, width // 2 :].std() > 10


def test_demo_without_a_catalogue_makes_novel_plates_to_push(study: Path) -> None:
    catalogue = find_catalogue()
    train, test = catalogue.split("train"), catalogue.split("test")
    assert {mesh.category for mesh in train + test} == {"mit_push"}
    assert (len(train), len(test)) == (8, 3)
    assert find_catalogue().meshes.keys() == catalogue.meshes.keys()


def test_the_example_of_the_readme_runs(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    readme = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    code = readme.split("```python\n")[1].split("```")[0]
    record_episode(
        make_catalogue(study / "datasets/meshes"), load(PARAMS, "episodes", EpisodesConfig)
    )
    exec(compile(code, "README.md", "exec"), {})
    assert "tensor" in capsys.readouterr().out
