"""Progress with an estimate of the time left, and parallel work that resumes after a stop."""

import logging
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from joblib import Parallel, delayed
from tqdm import tqdm

Item = TypeVar("Item")
Result = TypeVar("Result")

log = logging.getLogger(__name__)

SECONDS_BETWEEN_LINES = 10.0
LINE = "{desc}: {n_fmt} of {total_fmt} {unit}s, {remaining} left{postfix}"


class _LogLines(tqdm):  # type: ignore[misc]
    """A bar for log files: one line every few seconds instead of one that is overwritten."""

    def display(self, *_: Any, **__: Any) -> bool:
        log.info(str(self).strip())
        return True


def progress_bar(
    items: Iterable[Item] | None = None, *, total: int, desc: str, unit: str, initial: int = 0
) -> Any:
    """A tqdm bar on a terminal, log lines elsewhere; both show count, rate and time left."""
    is_terminal = sys.stderr.isatty()
    return (tqdm if is_terminal else _LogLines)(
        items,
        total=total,
        initial=initial,
        desc=desc,
        unit=unit,
        mininterval=1.0 if is_terminal else SECONDS_BETWEEN_LINES,
        bar_format=None if is_terminal else LINE,
    )


def resumable_map(
    make: Callable[[Item, Path], Result],
    items: Mapping[Path, Item],
    *,
    num_workers: int,
    desc: str,
    unit: str,
) -> list[Result]:
    """Call ``make(item, path)`` for every path that does not exist yet, in parallel processes.

    ``make`` writes a file or a folder; it appears under the given path whole, by rename, so that a
    stopped run leaves no partial result. A call that writes nothing is repeated by the next run.
    Returns the results of the calls made, in order of completion.
    """
    for folder in {path.parent for path in items}:
        for leftover in folder.glob("part-*"):  # of a process that was killed
            _remove(leftover)
    todo = {path: item for path, item in items.items() if not path.exists()}
    if len(todo) < len(items):
        log.info("%s: %d of %d %ss are done", desc, len(items) - len(todo), len(items), unit)
    jobs = [delayed(_make_whole)(make, item, path) for path, item in todo.items()]
    results = Parallel(n_jobs=num_workers, return_as="generator_unordered")(jobs)
    return list(progress_bar(results, total=len(jobs), desc=desc, unit=unit))


def _make_whole(make: Callable[[Item, Path], Result], item: Item, path: Path) -> Result:
    # The suffix stays, since writers choose their format by it.
    part = path.with_name(f"part-{os.getpid()}-{path.name}")
    try:
        result = make(item, part)
        if part.exists():
            part.replace(path)
        return result
    finally:
        _remove(part)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
