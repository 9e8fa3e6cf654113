"""Recorded episodes for training: all states in memory, images at random."""

from collections.abc import Sequence
from pathlib import Path

from oes.episode import Camera, Episode, Frames
from oes.record.reader import list_episodes, read_episode, read_frames


def read_states(folder: Path) -> list[Episode]:
    """Every episode of a split, in the order of ``list_episodes``. Raises EpisodeError for the
    first broken one.

    One process reads about 300 a second, faster than several can hand their results over.
    """
    return [read_episode(path) for path in list_episodes(folder)]


class FrameSource:
    """Images of one split (or of one episode) by position: (episode, state, cameras). Cheap to send
    to another process.

    Several splits are mixed evenly: any run of neighbours holds of each what the whole holds of it.
    """

    def __init__(self, *folders: Path) -> None:
        found = [(at, path) for folder in folders for at, path in _placed(_episodes(folder))]
        self.folders = [path for _, path in sorted(found, key=lambda each: each[0])]
        self.episodes = [read_episode(path) for path in self.folders]

    def __len__(self) -> int:
        return len(self.folders)

    def read(
        self, episode_i: int, step_i: int, camera_is: Sequence[int]
    ) -> tuple[Frames, tuple[Camera, ...]]:
        """Images of some cameras at one state, and those cameras as they stood then. Raises
        EpisodeError.
        """
        frames = read_frames(self.folders[episode_i], step_i, camera_is)
        cameras = self.episodes[episode_i].steps[step_i].cameras
        return frames, tuple(cameras[camera_i] for camera_i in camera_is)


def _episodes(folder: Path) -> list[Path]:
    """Those of a split; or the folder itself, if it is an episode."""
    return [folder] if any(folder.glob("*.mcap")) else list_episodes(folder)


def _placed(paths: Sequence[Path]) -> list[tuple[float, Path]]:
    """Each path with its place among them, from 0 to 1."""
    return [((i + 0.5) / len(paths), path) for i, path in enumerate(paths)]
