"""The repository as DVC's users know it, in a scratch clone with real DVC."""

import json
import os
import subprocess
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, get_type_hints

import pytest
import yaml
from dvc.utils.hydra import apply_overrides

from oes.cli import SPLITS
from oes.config import shared_sections
from tests.architecture import written

ROOT = Path(__file__).parents[1]
PROFILES = ("params.yaml", "params.smoke.yaml", "params.paper.yaml")


def run(repo: Path, *command: str) -> str:
    env = os.environ | {"PYTHONPATH": str(repo), "DVC_NO_ANALYTICS": "1"}
    done = subprocess.run(command, cwd=repo, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A git repository of the working tree's files, with one commit."""
    repo = tmp_path_factory.mktemp("clone")
    listed = run(ROOT, "git", "ls-files", "-co", "--exclude-standard", "-z").split("\0")
    names = [name for name in listed if name and os.path.lexists(ROOT / name)]
    archive = subprocess.run(
        ["tar", "-cf", "-", "-C", ROOT, *names], stdout=subprocess.PIPE, check=True
    )
    subprocess.run(["tar", "-xf", "-", "-C", repo], input=archive.stdout, check=True)
    run(repo, "git", "init", "-q")
    run(repo, "git", "config", "user.email", "test@example.org")
    run(repo, "git", "config", "user.name", "test")
    run(repo, "git", "add", "-A")
    run(repo, "git", "commit", "-q", "-m", "published")
    return repo


def leaves(tree: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict) and value:
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


@pytest.mark.parametrize("profile", PROFILES)
def test_every_leaf_of_params_can_be_overridden_alone(profile: str, tmp_path: Path) -> None:
    """With an anchor, two leaves would share one value and could not both take their own."""
    path = tmp_path / "params.yaml"
    path.write_text((ROOT / profile).read_text(encoding="utf-8"), encoding="utf-8")
    names = [name for name, _ in leaves(yaml.safe_load(path.read_text(encoding="utf-8")))]
    wanted = {name: 1000 + i for i, name in enumerate(names)}
    apply_overrides(path, [f"{name}={value}" for name, value in wanted.items()])
    assert dict(leaves(yaml.safe_load(path.read_text(encoding="utf-8")))) == wanted


def test_one_override_changes_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text((ROOT / "params.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    before = dict(leaves(yaml.safe_load(path.read_text(encoding="utf-8"))))
    apply_overrides(path, ["dynamics.pushing.fit.steps=10"])
    after = dict(leaves(yaml.safe_load(path.read_text(encoding="utf-8"))))
    assert after == before | {"dynamics.pushing.fit.steps": 10}


def test_an_experiment_takes_a_leaf_of_every_section(clone: Path) -> None:
    tree = yaml.safe_load((clone / "params.yaml").read_text(encoding="utf-8"))
    wanted = {}
    for section, content in tree.items():
        name, value = next(
            (name, value)
            for name, value in leaves({section: content})
            if isinstance(value, int | float) and not isinstance(value, bool)
        )
        wanted[name] = value + 1
    assert {name.split(".")[0] for name in wanted} == set(tree)
    flags = [flag for name, value in wanted.items() for flag in ("-S", f"{name}={value}")]
    run(clone, "dvc", "exp", "run", "--queue", *flags)
    shown = json.loads(run(clone, "dvc", "exp", "show", "--json"))
    (queued,) = [exp for rev in shown for exp in rev.get("experiments") or []]
    params = dict(leaves(queued["revs"][0]["data"]["params"]["params.yaml"]["data"]))
    assert {name: params[name] for name in wanted} == wanted
    assert {name for name, value in leaves(tree) if params[name] != value} == set(wanted)


def test_an_experiment_runs_a_stage_with_its_setting(clone: Path) -> None:
    run(
        clone,
        "dvc",
        "exp",
        "run",
        "-S",
        "meshes.per_category=0",
        "-S",
        "meshes.tile_px=64",
        "meshes",
    )
    catalogue = (clone / "datasets/meshes/catalogue.csv").read_text(encoding="utf-8")
    assert "mit_rect1" in catalogue and "camera" not in catalogue
    assert "meshes" in yaml.safe_load((clone / "dvc.lock").read_text())["stages"]
    diff = json.loads(run(clone, "dvc", "params", "diff", "--json"))
    assert set(diff["params.yaml"]) == {"meshes.per_category", "meshes.tile_px"}
    run(clone, "git", "checkout", "-q", "params.yaml")


def test_metrics_are_a_short_table_and_compare_revisions(clone: Path) -> None:
    (path,) = yaml.safe_load((clone / "dvc.yaml").read_text(encoding="utf-8"))["metrics"]
    summary = json.loads((clone / path).read_text(encoding="utf-8"))
    numbers = dict(leaves(summary))
    assert 10 <= len(numbers) <= 60 and all(isinstance(x, int | float) for x in numbers.values())
    assert "pushing" in run(clone, "dvc", "metrics", "show")
    name = next(iter(numbers))
    *parents, last = name.split(".")
    place = summary
    for parent in parents:
        place = place[parent]
    place[last] += 1
    (clone / path).write_text(json.dumps(summary), encoding="utf-8")
    diff = json.loads(run(clone, "dvc", "metrics", "diff", "--json"))
    assert diff[path][name]["diff"] == pytest.approx(1)
    run(clone, "git", "checkout", "-q", path)


def test_plots_are_drawn(clone: Path) -> None:
    run(clone, "dvc", "plots", "show", "--out", "plots")
    page = (clone / "plots/index.html").read_text(encoding="utf-8")
    assert "vega" in page and "translation" in page


def test_revisions_before_a_change_of_params_can_be_compared(clone: Path) -> None:
    text = (clone / "params.yaml").read_text(encoding="utf-8")
    (clone / "params.yaml").write_text(text.replace("per_category: 5", "per_category: 4"))
    run(clone, "git", "commit", "-q", "-am", "fewer meshes")
    diff = json.loads(run(clone, "dvc", "params", "diff", "--json", "HEAD~1", "HEAD"))
    change = diff["params.yaml"]["meshes.per_category"]
    assert (change["old"], change["new"]) == (5, 4)
    run(clone, "git", "reset", "-q", "--hard", "HEAD~1")


def test_stages_depend_on_the_shared_sections_they_read() -> None:
    for name, stage in written(ROOT).items():
        hints = get_type_hints(import_module(f"stages.{name}").main)
        declared = {param.split(".")[0] for param in stage["params"]}
        assert declared == {name, *shared_sections(next(iter(hints.values())))}, name


def test_the_splits_of_the_flags_are_those_of_params() -> None:
    tree = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    for splits in tree["episodes"]["splits"].values():
        assert set(splits) == set(SPLITS)
