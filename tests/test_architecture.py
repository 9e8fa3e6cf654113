"""The map is the territory: every guard passes here, and is seen to fail on a planted fault."""

import importlib
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import get_type_hints

import pytest

from oes.config import load
from tests import architecture as arch

ROOT = Path(__file__).parents[1]
Guard = Callable[[Path], Iterator[str]]
GUARDS: list[Guard] = [
    arch.layers, arch.rules, arch.owners, arch.isolation, arch.stage_names, arch.deps,
    arch.commands, arch.produced, arch.profiles,
]  # fmt: skip
TOY = {
    "oes/__init__.py": '"""Toy."""\n',
    "oes/config.py": "import yaml\n",
    "oes/geom/__init__.py": "",
    "oes/geom/se3.py": "import numpy\n",
    "oes/sim/__init__.py": "import pybullet\n",
    "oes/sim/world.py": "from oes.geom import se3\n",
    "oes/mpc/__init__.py": "",
    "oes/mpc/search.py": "from oes.geom.se3 import rigid\n",
    "oes/training/loop.py": "",
    "oes/report/__init__.py": "import matplotlib.pyplot\n",
    "stages/count.py": "from oes.sim import world\ndef main(cfg: int, task: str, out: Path): ...\n",
    "stages/total.py": "import oes.config\ndef main(cfg: object, counts: Path, out: Path): ...\n",
    "params.yaml": "count: {a: {b: 1}}\ntotal: {c: [1]}\n",
    "params.smoke.yaml": "count: {a: {b: 2}}\ntotal: {c: [1, 2]}\n",
    "params.paper.yaml": "count: {a: {b: 3}}\ntotal: {c: []}\n",
    "dvc.yaml": """\
stages:
  count:
    matrix:
      task: [up, down]
    cmd: python -m stages.count --task ${item.task} --out datasets/count/${item.task}
    deps:
      - stages/count.py
      - oes/geom
      - oes/sim
    outs:
      - datasets/count/${item.task}
  total:
    cmd: python -m stages.total --counts datasets/count --out reports
    deps:
      - stages/total.py
      - oes/config.py
      - datasets/count/up
      - datasets/count/down
    outs:
      - reports: {cache: false}
""",
}


@pytest.mark.parametrize("guard", GUARDS, ids=lambda guard: guard.__name__)
def test_repository(guard: Guard) -> None:
    complaints = list(guard(ROOT))
    assert not complaints, "\n".join(complaints)


@pytest.mark.parametrize("profile", arch.PROFILES)
def test_every_section_loads(profile: str) -> None:
    for word in arch.written(ROOT):
        main = importlib.import_module(f"stages.{word}").main
        cfg_class = next(iter(get_type_hints(main).values()))
        assert load(ROOT / profile, word, cfg_class)


def test_dvc_reads_the_pipeline() -> None:
    assert not (ROOT / "dvc.yaml").is_symlink(), "DVC reads dvc.yaml of git's revisions"
    assert (ROOT / "pipeline.yaml").readlink() == Path("dvc.yaml")


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    for name, text in TOY.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def test_a_sound_repository_passes(toy: Path) -> None:
    assert [complaint for guard in GUARDS for complaint in guard(toy)] == []


@pytest.mark.parametrize(
    ("guard", "name", "old", "new", "says"),
    [
        (
            arch.layers,
            "oes/geom/se3.py",
            "import numpy",
            "import oes.sim.world",
            "oes/geom/se3.py imports upward: oes.sim",
        ),
        (
            arch.layers,
            "oes/geom/se3.py",
            "import numpy",
            "def f():\n  from oes import sim",
            "imports upward: oes.sim",
        ),
        (
            arch.layers,
            "oes/geom/se3.py",
            "import numpy",
            "import stages.count",
            "imports upward: stages.count",
        ),
        (arch.rules, "oes/extra/a.py", "", "", "oes/extra has no place"),
        (arch.rules, "oes/extra.py", "", "", "oes/extra has no place"),
        (arch.rules, "oes/__init__.py", "", "import numpy\n", "more than its docstring"),
        (arch.owners, "oes/geom/se3.py", "numpy", "pybullet", "oes/geom/se3.py imports pybullet"),
        (
            arch.owners,
            "oes/geom/se3.py",
            "import numpy",
            "def f():\n  from mcap.reader import x",
            "imports mcap",
        ),
        (
            arch.owners,
            "stages/total.py",
            "oes.config",
            "rosbags",
            "stages/total.py imports rosbags",
        ),
        (
            arch.owners,
            "oes/sim/world.py",
            "",
            "import matplotlib.pyplot\n",
            "sim/world.py imports matplotlib",
        ),
        (arch.owners, "oes/sim/world.py", "", "import pickle\n", "sim/world.py imports pickle"),
        (
            arch.isolation,
            "oes/mpc/search.py",
            "",
            "import oes.sim\n",
            "oes/mpc reaches sim through oes/sim",
        ),
        (
            arch.isolation,
            "oes/geom/se3.py",
            "",
            "import oes.sim\n",
            "oes/mpc reaches pybullet through oes/sim",
        ),
        (
            arch.isolation,
            "oes/report/table.py",
            "",
            "import oes.mpc, oes.training.loop\n",
            "oes/report reaches training.loop",
        ),
        (
            arch.owners,
            "oes/report/table.py",
            "",
            "import torch.nn\n",
            "oes/report/table.py imports torch",
        ),
        (arch.stage_names, "stages/stray.py", "", "", "stray: in only one of"),
        (arch.stage_names, "params.yaml", "total", "sum", "total: a stage without a section"),
        (arch.stage_names, "params.yaml", "total", "sum", "sum: a section of params.yaml without"),
        (
            arch.deps,
            "oes/geom/se3.py",
            "",
            "import oes.config\n",
            "- oes/config.py\n      - oes/geom",
        ),
        (arch.deps, "oes/sim/world.py", "from oes.geom import se3", "", "- oes/sim\n"),
        (arch.deps, "dvc.yaml", "      - stages/count.py\n", "", "- stages/count.py\n"),
        (
            arch.commands,
            "dvc.yaml",
            "--counts datasets/count",
            "--counts datasets/sums",
            "datasets/sums is in its cmd",
        ),
        (
            arch.commands,
            "dvc.yaml",
            "--counts datasets/count",
            "--counts datasets/sums",
            "count/up is in its deps",
        ),
        (arch.commands, "dvc.yaml", "--task", "--word", "its cmd has flags ['out', 'word']"),
        (
            arch.commands,
            "dvc.yaml",
            "-m stages.total",
            "-m stages.count",
            "does not run stages.total",
        ),
        (
            arch.commands,
            "dvc.yaml",
            "--out reports",
            "--out report",
            "--out report is not in its outs",
        ),
        (
            arch.produced,
            "dvc.yaml",
            "[up, down]",
            "[up]",
            "total: no stage makes datasets/count/down",
        ),
        (
            arch.profiles,
            "params.smoke.yaml",
            "b: 2",
            "",
            "count.a.b: in only one of params.yaml and params.smoke.yaml",
        ),
        (arch.profiles, "params.paper.yaml", "b: 3", "b: {d: 3}", "count.a.b.d: in only one of"),
    ],
)
def test_planted_fault_is_seen(
    toy: Path, guard: Guard, name: str, old: str, new: str, says: str
) -> None:
    path = toy / name
    path.parent.mkdir(exist_ok=True)
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    path.write_text(text.replace(old, new) if old else text + new, encoding="utf-8")
    assert says in "\n".join(guard(toy))


def test_rewriting_mends_the_deps(toy: Path) -> None:
    (toy / "oes/geom/se3.py").write_text("import oes.config\n", encoding="utf-8")
    shutil.rmtree(toy / "oes/report")
    assert list(arch.deps(toy))
    arch.rewrite_deps(toy)
    assert list(arch.deps(toy)) == []
    assert arch.pipeline(toy)["total"] == arch.yaml.safe_load(TOY["dvc.yaml"])["stages"]["total"]
