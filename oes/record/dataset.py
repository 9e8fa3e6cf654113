"""Recorded episodes for training: all states in memory, images at random."""

from collections.abc import Sequence
from pathlib import Path

from oes.episode import Camera, Episode, Frames
from oes.record.reader import list_episodes, read_episode, read_frames


def read_states(folder: Path) -> list[Episode]:
    """Every episode of a split, in the order of ``list_episodes``. Raises EpisodeError for the first broken one.

    One process reads about 300 a second, faster than several can hand their results over.
    """
    return [read_episode(path) for path in list_episodes(folder)]


class FrameSource:
    """Images of one split by position: (episode, state, cameras). Cheap to send to another process."""

    def __init__(self, folder: Path) -> None:
        self.folders = list_episodes(folder)
        self.episodes = read_states(folder)

    def __len__(self) -> int:
        return len(self.folders)

    def read(self, episode_i: int, step_i: int, camera_is: Sequence[int]) -> tuple[Frames, tuple[Camera, ...]]:
        """Images of some cameras at one state, and those cameras as they stood then. Raises EpisodeError."""
        frames = read_frames(self.folders[episode_i], step_i, camera_is)
        cameras = self.episodes[episode_i].steps[step_i].cameras
        return frames, tuple(cameras[camera_i] for camera_i in camera_is)
