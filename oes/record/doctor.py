"""Check of all episodes under a folder: ``python -m oes.record.doctor FOLDER [--recover OUT]``.

Prints the broken ones and exits with status 1 if there are any.
"""

import argparse
import os
import resource
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from joblib import Parallel, delayed

from oes.progress import progress_bar
from oes.record.check import check_episode
from oes.record.errors import EpisodeError
from oes.record.reader import EPISODE_GLOB
from oes.record.recover import recover

EXTRA_BYTES = 1 << 30
STATM = Path("/proc/self/statm")


def find_episodes(folder: Path) -> list[Path]:
    """The episode folders at any depth under ``folder``; ``folder`` itself if it is one."""
    if folder.match(EPISODE_GLOB):
        return [folder]
    return sorted(path for path in folder.rglob(EPISODE_GLOB) if path.is_dir())


@contextmanager
def limited_memory(extra_bytes: int) -> Iterator[None]:
    """Let this process map at most ``extra_bytes`` more than now (on Linux; elsewhere no limit)."""
    if not STATM.exists():
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    mapped = int(STATM.read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + extra_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _check(folder: Path) -> EpisodeError | None:
    # The size checks of Bag bound the memory; the limit is a second line of defence.
    with limited_memory(EXTRA_BYTES):
        try:
            check_episode(folder)
        except EpisodeError as error:
            return error
    return None


def _recover(folder: Path, out: Path) -> str:
    try:
        kept = recover(folder, out)
    except (EpisodeError, FileExistsError) as error:
        return f"not recovered: {error}"
    states = f"{kept.steps} of {kept.expected_steps} states whole"
    return f"{out}: {states}, {kept.messages} of {kept.expected_messages} messages read"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m oes.record.doctor", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder that holds episodes, at any depth")
    parser.add_argument(
        "--recover", type=Path, metavar="OUT", help="write the whole states of broken ones to OUT"
    )
    parser.add_argument(
        "--jobs", type=int, metavar="N", default=os.cpu_count(), help="processes (default: cores)"
    )
    args = parser.parse_args(arguments)
    folders = find_episodes(args.folder)
    if not folders:
        print(f"doctor: {args.folder}: no episodes", file=sys.stderr)
        return 1
    jobs = (delayed(_check)(folder) for folder in folders)
    results = Parallel(n_jobs=args.jobs, return_as="generator")(jobs)
    bar = progress_bar(results, total=len(folders), desc="check", unit="episode")
    checked = list(zip(folders, bar, strict=True))
    broken = [(folder, error) for folder, error in checked if error is not None]
    for folder, error in broken:
        print(f"{folder}  {error.path.name}: {error.reason}")
        if args.recover is not None:
            print(f"    {_recover(folder, args.recover / folder.parent.name / folder.name)}")
    print(f"{len(folders)} episodes checked, {len(broken)} broken")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
