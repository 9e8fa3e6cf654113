"""Checks every episode under a folder: ``python -m oes.record.doctor FOLDER [--recover OUT]``.

Prints the broken ones and exits 1 where there are any. ``--recover OUT`` writes what they still
hold into OUT.
"""

import argparse
import os
import resource
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from joblib import Parallel, delayed
from tqdm import tqdm

from oes.record.check import check_episode
from oes.record.errors import EpisodeError
from oes.record.reader import EPISODE_GLOB
from oes.record.recover import recover

EXTRA_BYTES = 1 << 30
PAGES = Path("/proc/self/statm")


def find_episodes(folder: Path) -> list[Path]:
    """The episode directories at any depth under ``folder``, or ``folder`` itself where it is
    one.
    """
    if folder.match(EPISODE_GLOB):
        return [folder]
    return sorted(path for path in folder.rglob(EPISODE_GLOB) if path.is_dir())


def problems(folders: Sequence[Path], num_jobs: int) -> Iterator[EpisodeError | None]:
    """Check episodes on ``num_jobs`` processes of bounded memory, in order: what is wrong with
    each, or None.
    """
    results = Parallel(n_jobs=num_jobs, return_as="generator")(
        delayed(_check)(folder) for folder in folders
    )
    yield from tqdm(results, total=len(folders), desc="checking", unit="episode", disable=None)


@contextmanager
def limited_memory(extra_bytes: int) -> Iterator[None]:
    """Within, this process maps at most ``extra_bytes`` more than it did (where the system tells:
    Linux).
    """
    if not PAGES.exists():
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    mapped = int(PAGES.read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + extra_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _check(folder: Path) -> EpisodeError | None:
    """What is wrong with one episode. Our own size checks bound memory; the limit is there should
    they fail.
    """
    with limited_memory(EXTRA_BYTES):
        try:
            check_episode(folder)
        except EpisodeError as error:
            return error
    return None


def _rescue(folder: Path, out: Path) -> str:
    """Recover one episode; a line that says how much of it survived."""
    try:
        kept = recover(folder, out)
    except (EpisodeError, FileExistsError) as error:
        return f"not recovered: {error}"
    return f"{out}: {kept.steps} of {kept.steps_due} states whole, {kept.messages} of {kept.messages_due} messages read"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m oes.record.doctor", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--recover", type=Path, metavar="OUT", help="write what broken episodes still hold into OUT"
    )
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count(), help="processes (default: all cores)"
    )
    args = parser.parse_args(arguments)
    folders = find_episodes(args.folder)
    if not folders:
        print(f"{args.folder}: no episodes", file=sys.stderr)
        return 1
    broken = [
        (folder, error)
        for folder, error in zip(folders, problems(folders, args.jobs), strict=True)
        if error
    ]
    width = max((len(str(folder)) for folder, _ in broken), default=0)
    for folder, error in broken:
        print(f"{folder!s:<{width}}  {error.path.name}: {error.reason}")
        if args.recover is not None:
            print(
                f"{'':<{width}}  {_rescue(folder, args.recover / folder.parent.name / folder.name)}"
            )
    print(f"{len(folders)} episodes checked, {len(broken)} broken")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
