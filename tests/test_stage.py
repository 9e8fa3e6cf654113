"""A stage's entry, its resumable work folder and what its stamp depends on, on toy stages in a
scratch repository.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from oes.config import params
from oes.stage import StageError, digest, publish, reached, work_dir

ROOT = Path(__file__).parents[1]

COUNT = '''
"""count: writes one file a number."""
import time
from pathlib import Path
from typing import Annotated
from oes.config import params
from oes.cli import run
from oes.stage import publish, work_dir

@params
class Count:
    total: int
    scale: float

class CountError(ValueError):
    pass

def main(
    cfg: Count, word: Annotated[str, "a word"], source: Annotated[Path, "a file"], out: Path
) -> None:
    if word == "typed":
        raise CountError("source:\\n  broken")
    if word == "bug":
        raise ValueError("a bug")
    with work_dir(out, (cfg, [source], word)) as work:
        for i in range(cfg.total):
            if not (work / f"{i}.txt").exists():
                while i == 3 and not Path("go").exists():
                    time.sleep(0.02)
                (work / f"{i}.part").write_text(f"{word} {i}")
                (work / f"{i}.part").rename(work / f"{i}.txt")
                with Path("made.log").open("a") as made:
                    made.write(f"{i}\\n")
        publish(work, out)

if __name__ == "__main__":
    run(main)
'''


@params
class Small:
    size: int


@pytest.fixture
def repo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scratch repository with the real modules that stages import and one toy stage."""
    (tmp_path / "oes").mkdir()
    (tmp_path / "stages").mkdir()
    for name in ("__init__", "cli", "config", "episode", "stage"):
        (tmp_path / f"oes/{name}.py").write_text(
            (ROOT / f"oes/{name}.py").read_text(encoding="utf-8"), encoding="utf-8"
        )
    (tmp_path / "stages/count.py").write_text(COUNT, encoding="utf-8")
    (tmp_path / "params.yaml").write_text("count: {total: 6, scale: 1}\n", encoding="utf-8")
    (tmp_path / "source.txt").write_text("source", encoding="utf-8")
    (tmp_path / "go").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def start(word: str = "one", source: str = "source.txt") -> subprocess.Popen[str]:
    flags = ["--word", word, "--source", source, "--out", "datasets/count/one"]
    command = [sys.executable, "-m", "stages.count", *flags]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    out, err = process.communicate(timeout=60)
    return process.returncode, out + err


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def start_and_hold(repo: Path) -> subprocess.Popen[str]:
    """A stage that waits, with three of its six files written, until it is ended."""
    (repo / "go").unlink()
    process = start()
    wait_for(lambda: len(list(repo.glob(".work/count/one/*/*.txt"))) == 3)
    return process


def end(process: subprocess.Popen[str], name: signal.Signals) -> tuple[int, str]:
    process.send_signal(name)
    result = finish(process)
    Path("go").touch()
    return result


def test_output_appears_and_work_is_gone(repo: Path) -> None:
    assert finish(start()) == (0, "")
    out = repo / "datasets/count/one"
    assert [(out / f"{i}.txt").read_text() for i in range(6)] == [f"one {i}" for i in range(6)]
    assert [p.name for p in (repo / ".work/count/one").iterdir()] == ["lock"]
    assert finish(start("two"))[0] == 0
    assert (out / "0.txt").read_text() == "two 0"
    assert [p.name for p in (repo / ".work/count/one").iterdir()] == ["lock"]


def test_killed_stage_resumes(repo: Path) -> None:
    process = start_and_hold(repo)
    status, text = finish(start())
    assert (status, "is making it" in text, str(process.pid) in text) == (1, True, True)
    assert end(process, signal.SIGKILL)[0] == -signal.SIGKILL
    assert not (repo / "datasets").exists()
    status, text = finish(start())
    assert status == 0
    assert "resuming from" in text
    assert (repo / "made.log").read_text().split() == [str(i) for i in range(6)]
    assert len(list((repo / "datasets/count/one").iterdir())) == 6


@pytest.mark.parametrize("what", ["cfg", "code", "input", "word"])
def test_changed_stamp_deletes_the_work(repo: Path, what: str) -> None:
    end(start_and_hold(repo), signal.SIGKILL)
    if what == "code":
        (repo / "oes/__init__.py").write_text('"""Changed."""\n')
    if what == "input":
        (repo / "source.txt").write_text("SOURCE")
    if what == "cfg":
        (repo / "params.yaml").write_text("count: {total: 6, scale: 2}\n")
    status, text = finish(start("two" if what == "word" else "one"))
    assert status == 0
    assert "unfinished work is deleted" in text
    assert (repo / "made.log").read_text().split() == [str(i) for i in [0, 1, 2, 0, 1, 2, 3, 4, 5]]


@pytest.mark.parametrize(
    ("word", "source", "text", "says"),
    [
        ("typed", "source.txt", None, "count: source: broken\n"),
        ("one", "missing.txt", None, "count: missing.txt: no such input\n"),
        (
            "one",
            "source.txt",
            "count: {total: 6}",
            "count: params.yaml: count.scale: missing; valid keys of count: total, scale\n",
        ),
    ],
)
def test_expected_errors_are_one_line(
    repo: Path, word: str, source: str, text: str | None, says: str
) -> None:
    if text:
        (repo / "params.yaml").write_text(text)
    assert finish(start(word, source)) == (1, says)


def test_bugs_keep_their_traceback(repo: Path) -> None:
    status, text = finish(start("bug"))
    assert status == 1
    assert "Traceback" in text


@pytest.mark.parametrize("name", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_is_one_line(repo: Path, name: signal.Signals) -> None:
    assert end(start_and_hold(repo), name) == (1, "count: stopped; the next run resumes it\n")


def test_missing_flag_is_named(repo: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "stages.count"], capture_output=True, text=True, check=False
    )
    assert result.returncode == 2
    assert "--word, --source, --out" in result.stderr


def test_work_elsewhere_lies_beside_the_output(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with work_dir(out, (Small(1), [])) as work:
        assert work.parent == tmp_path / ".work/out"
        (work / "made").mkdir()
        (work / "made/a").write_text("a")
        (work / "checkpoint").write_text("not part of the output")
        publish(work / "made", out)
    assert [(p.name, p.read_text()) for p in out.iterdir()] == [("a", "a")]
    assert [p.name for p in work.parent.iterdir()] == ["lock"]
    with pytest.raises(StageError, match=r"3\.5"), work_dir(out, (3.5,)):
        pass


def test_neighbour_instances_are_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with (
        work_dir(Path("datasets/episodes/one"), (Small(1),)) as one,
        work_dir(Path("datasets/episodes"), (Small(2),)),
    ):
        assert one.is_dir()


def test_digest_sees_names_sizes_and_both_ends(tmp_path: Path) -> None:
    big = bytearray(os.urandom(300_000))
    path = tmp_path / "a/big.bin"
    path.parent.mkdir()
    seen = set()
    for place in (None, 10, 70_000, 299_999):
        if place is not None:
            big[place] ^= 1
        path.write_bytes(big)
        seen.add(digest(tmp_path / "a"))
    assert len(seen) == 3  # a change deep inside a large file is not looked for
    path.rename(tmp_path / "a/other.bin")
    assert digest(tmp_path / "a") not in seen


def test_reached_follows_lazy_and_package_imports(tmp_path: Path) -> None:
    files = {
        "stages/s.py": "import oes.a.x\n",
        "oes/__init__.py": "",
        "oes/a/__init__.py": "from oes.b import y\n",
        "oes/a/x.py": "def f():\n    from oes import c\n",
        "oes/b/__init__.py": "",
        "oes/b/y.py": "import numpy\n",
        "oes/b/z.py": "",
        "oes/c.py": "import oes.a.x\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    names = {
        str(path.relative_to(tmp_path)) for path in reached([tmp_path / "stages/s.py"], tmp_path)
    }
    assert names == set(files) - {"oes/b/z.py"}


def test_help_names_the_module_and_describes_every_flag(repo: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "stages.count", "--help"], capture_output=True, text=True, check=True
    )
    assert "usage: python -m stages.count" in result.stdout
    assert all(text in result.stdout for text in ("a word", "a file", "folder to write"))
