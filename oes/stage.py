"""Running a stage: params section -> cfg, flags -> paths; and outputs that appear whole and survive
a kill.

A long stage keeps its progress in ``.work/<stage>/<instance>/<stamp>/``, outside its output, and
publishes it by rename at the end. The stamp is a digest of everything the work depends on (config,
code, inputs): work begun under another stamp is deleted, so a resumed stage can never mix old
shards with new ones.
"""

import ast
import dataclasses
import fcntl
import hashlib
import inspect
import logging
import os
import re
import shutil
import signal
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import get_type_hints

from oes.config import load, to_json

log = logging.getLogger(__name__)

PARAMS = Path("params.yaml")
ENDS_BYTES = 65536
STAMPS = r"[0-9a-f]{16}|replaced"


class StageError(ValueError):
    """A stage that cannot run as asked: bad flags of ``work_dir``, or another process is at the
    same work.
    """


def run(main: Callable[..., None]) -> None:
    """Call a stage's ``main(cfg, flag, ...)``; the entry point of every module in ``stages``.

    ``cfg`` is the section of params.yaml named like the module, read as main's first annotation;
    the other arguments are required ``--flags``, each a Path or a str. Expected errors (a
    ValueError of a class of its own, a missing file) and ctrl-C exit with status 1 and one line;
    anything else is a bug and keeps its traceback.
    """
    word = Path(inspect.getfile(main)).stem
    hints = {name: hint for name, hint in get_type_hints(main).items() if name != "return"}
    (cfg_name, cfg_class), *flags = hints.items()
    parser = ArgumentParser(
        prog=f"python -m stages.{word}", description=sys.modules[main.__module__].__doc__
    )
    for name, kind in flags:
        parser.add_argument(
            f"--{name}", required=True, type=kind, metavar="PATH" if kind is Path else "WORD"
        )
    given = vars(parser.parse_args())
    logging.basicConfig(level=logging.WARNING, format=f"{word}: %(message)s")
    for name in ("oes", "stages", "__main__"):
        logging.getLogger(name).setLevel(logging.INFO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        main(**{cfg_name: load(PARAMS, word, cfg_class)}, **given)
    except KeyboardInterrupt:
        sys.exit(f"{word}: stopped; run it again to go on")
    except (ValueError, FileNotFoundError) as error:
        if type(error) is ValueError:
            raise
        log.debug("stage failed", exc_info=True)
        sys.exit(f"{word}: {' '.join(str(error).split())}")


@contextmanager
def work_dir(out: Path, stamp_of: Sequence[object]) -> Iterator[Path]:
    """A folder for the unfinished ``out``, on the same filesystem, found again by the next run with
    the same stamp.

    ``stamp_of`` is everything the work depends on, besides code: ``(cfg, [input paths],
    words...)``. The code that cfg's class and the running stage reach is added. Work under other
    stamps is deleted; so is, on leaving without an error, what ``publish`` left. Raises StageError
    when another process works on the same output.
    """
    stamp = _stamp(stamp_of)
    home = _work_home(out)
    home.mkdir(parents=True, exist_ok=True)
    with (home / "lock").open("a+") as lock:
        _take(lock.fileno(), out)
        for other in home.iterdir():
            if other.name != stamp and re.fullmatch(STAMPS, other.name):
                log.info(
                    "%s: settings, code or inputs changed: earlier unfinished work is dropped", out
                )
                shutil.rmtree(other)
        work = home / stamp
        if work.exists():
            log.info("%s: going on from %s", out, work)
        work.mkdir(exist_ok=True)
        yield work
        shutil.rmtree(work, ignore_errors=True)


def publish(work: Path, out: Path) -> None:
    """Rename the finished ``work``, or a folder in it, to ``out``, which appears whole; an earlier
    one is replaced.
    """
    old = work.with_name("replaced")
    if out.exists():
        os.replace(out, old)
    out.parent.mkdir(parents=True, exist_ok=True)
    os.replace(work, out)
    shutil.rmtree(old, ignore_errors=True)


def reached(start: Iterable[Path], root: Path) -> set[Path]:
    """The files of ``oes`` and ``stages`` under ``root`` that importing ``start`` may execute, lazy
    imports too.

    Judged from the source alone (``ast``), so that it does not depend on what this process happens
    to have imported.
    """
    found: set[Path] = set()
    left = [path.resolve() for path in start]
    while left:
        path = left.pop()
        if path not in found:
            found.add(path)
            left += [module for name in imports(path) for module in _modules(name, root.resolve())]
    return found


def imports(path: Path) -> set[str]:
    """Every dotted name that a source file imports, anywhere in it; ``from a import b`` gives ``a``
    and ``a.b``.
    """
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def digest(path: Path) -> str:
    """A cheap digest of a file or folder: names, sizes, and the first and last 64 KiB of every
    file.

    The ends are enough: small files lie in them whole, an MCAP file ends in its checksums and chunk
    index, and retrained weights differ from their first tensor on.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such input")
    sha = hashlib.sha256()
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for file in files:
        with file.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            sha.update(f"{file.relative_to(path)}\0{size}\0".encode())
            sha.update(stream.read(ENDS_BYTES))
            stream.seek(max(stream.tell(), size - ENDS_BYTES))
            sha.update(stream.read())
    return sha.hexdigest()


def _stamp(stamp_of: Sequence[object]) -> str:
    parts: list[str] = []
    for item in stamp_of:
        match item:
            case Path():
                parts.append(digest(item))
            case str() | int():
                parts.append(repr(item))
            case list() | tuple():
                parts.append(_stamp(item))
            case _ if dataclasses.is_dataclass(item) and not isinstance(item, type):
                parts += [to_json(item), _code_digest(type(item))]
            case _:
                raise StageError(
                    f"stamp_of: {item!r} is neither a params dataclass, a Path, a word nor a list of them"
                )
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _code_digest(cls: type) -> str:
    """Digest of the source that the class's module reaches, and the running stage's, if a stage
    runs.
    """
    root = Path(__file__).resolve().parents[1]
    start = [Path(inspect.getfile(cls))]
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    if spec is not None and spec.origin and spec.name.startswith("stages."):
        start.append(Path(spec.origin))
    sha = hashlib.sha256()
    for path in sorted(reached(start, root)):
        sha.update(path.name.encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()


def _modules(name: str, root: Path) -> list[Path]:
    """The files executed by importing a dotted name of ours: the module and the ``__init__`` of
    every package above.
    """
    parts = name.split(".")
    if parts[0] not in ("oes", "stages"):
        return []
    folders = [root.joinpath(*parts[: i + 1]) for i in range(len(parts))]
    candidates = [folder / "__init__.py" for folder in folders] + [folders[-1].with_suffix(".py")]
    return [path for path in candidates if path.is_file()]


def _work_home(out: Path) -> Path:
    """``datasets/episodes/pushing-train`` -> ``.work/episodes/pushing-train``; beside ``out`` when
    that is not here.
    """
    here, there = Path.cwd(), out.absolute()
    if there.is_relative_to(here) and len(there.relative_to(here).parts) > 1:
        return here.joinpath(".work", *there.relative_to(here).parts[1:])
    return there.parent / ".work" / there.name


def _take(lock_fd: int, out: Path) -> None:
    """Hold the lock for as long as the file is open; it is released by the system when the process
    dies.
    """
    try:
        fcntl.flock(lock_fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        owner = os.pread(lock_fd, 32, 0).decode() or "another process"
        raise StageError(
            f"{out} is already being made by process {owner}: wait for it or stop it"
        ) from error
    os.ftruncate(lock_fd, 0)
    os.pwrite(lock_fd, str(os.getpid()).encode(), 0)
