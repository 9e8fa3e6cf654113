"""The one error that reading a recorded episode raises."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from struct import error as StructError

from mcap.exceptions import McapError
from rosbags.serde import SerdeError
from zstandard import ZstdError


class EpisodeError(Exception):
    """A recorded episode that cannot be read: ``path`` names the file, ``reason`` its defect."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(path, reason)
        self.path = path
        self.reason = reason

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"


@contextmanager
def episode_errors(path: Path) -> Iterator[None]:
    """Turn every error that parsing damaged bytes can raise into an EpisodeError of ``path``."""
    try:
        yield
    except (McapError, SerdeError, ZstdError, StructError, OSError) as error:
        raise EpisodeError(path, f"{type(error).__name__}: {error}") from error
    except (ValueError, KeyError, IndexError, MemoryError, OverflowError) as error:
        raise EpisodeError(path, f"malformed ({type(error).__name__}: {error})") from error
