"""Outputs that appear whole, from work that survives a kill.

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
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from oes.config import to_json

log = logging.getLogger(__name__)

ENDS_BYTES = 65536
STAMPS = r"[0-9a-f]{16}|replaced"


class StageError(ValueError):
    """A stage that cannot run: a wrong flag, or another process makes the same output."""


@contextmanager
def work_dir(out: Path, stamp_of: Sequence[object]) -> Iterator[Path]:
    """The folder of the unfinished ``out``; the next run with the same stamp finds it again.

    ``stamp_of`` is everything that the work depends on: ``(cfg, [input paths], names...)``. The
    source code that cfg's class and the running stage import is added. Work under another stamp is
    deleted, and so is the folder on leaving without an error. Raises StageError when another
    process works on the same output.
    """
    stamp = _stamp(stamp_of)
    home = _work_home(out)
    home.mkdir(parents=True, exist_ok=True)
    with (home / "lock").open("a+") as lock:
        _acquire(lock.fileno(), out)
        for other in home.iterdir():
            if other.name != stamp and re.fullmatch(STAMPS, other.name):
                log.info("%s: settings, code or inputs changed: unfinished work is deleted", out)
                shutil.rmtree(other)
        work = home / stamp
        if work.exists():
            log.info("%s: resuming from %s", out, work)
        work.mkdir(exist_ok=True)
        yield work
        shutil.rmtree(work, ignore_errors=True)


def publish(work: Path, out: Path) -> None:
    """Rename the finished ``work``, or a folder in it, to ``out`` and delete an earlier ``out``."""
    old = work.with_name("replaced")
    if out.exists():
        os.replace(out, old)
    out.parent.mkdir(parents=True, exist_ok=True)
    os.replace(work, out)
    shutil.rmtree(old, ignore_errors=True)


def reached(start: Iterable[Path], root: Path) -> set[Path]:
    """The files of ``oes`` and ``stages`` under ``root`` that ``start`` imports, lazily or not.

    They are found in the source (``ast``), so that the result does not depend on the modules that
    this process happens to have imported.
    """
    files: set[Path] = set()
    todo = [path.resolve() for path in start]
    while todo:
        path = todo.pop()
        if path not in files:
            files.add(path)
            todo += [module for name in imports(path) for module in _modules(name, root.resolve())]
    return files


def imports(path: Path) -> set[str]:
    """All dotted names that a source file imports; ``from a import b`` gives ``a`` and ``a.b``."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def digest(path: Path) -> str:
    """A cheap digest of a file or folder: names, sizes, and both ends (64 KiB) of every file.

    The ends are enough: small files are covered whole, an MCAP file ends in its checksums and
    chunk index, and retrained weights differ from their first tensor on.
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
                    f"stamp_of: {item!r} is no params dataclass, Path, str, int or list"
                )
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _code_digest(cls: type) -> str:
    """Digest of the source that the class's module and the running stage (if any) import."""
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
    """The files that importing a dotted name executes: the module, and all packages above it."""
    parts = name.split(".")
    if parts[0] not in ("oes", "stages"):
        return []
    folders = [root.joinpath(*parts[: i + 1]) for i in range(len(parts))]
    candidates = [folder / "__init__.py" for folder in folders] + [folders[-1].with_suffix(".py")]
    return [path for path in candidates if path.is_file()]


def _work_home(out: Path) -> Path:
    """``datasets/objects/x`` -> ``.work/objects/x``; beside ``out`` if it is outside this folder.

    The same file system holds both, so that publishing is a rename.
    """
    here, there = Path.cwd(), out.absolute()
    if there.is_relative_to(here) and len(there.relative_to(here).parts) > 1:
        return here.joinpath(".work", *there.relative_to(here).parts[1:])
    return there.parent / ".work" / there.name


def _acquire(lock_fd: int, out: Path) -> None:
    """Hold the lock while the file is open; the system releases it when the process ends."""
    try:
        fcntl.flock(lock_fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        owner = os.pread(lock_fd, 32, 0).decode() or "another process"
        raise StageError(f"{out}: process {owner} is making it: wait for it or stop it") from error
    os.ftruncate(lock_fd, 0)
    os.pwrite(lock_fd, str(os.getpid()).encode(), 0)
