"""Recorded episodes for training: all states in memory, images at random."""

from collections.abc import Sequence
from pathlib import Path

from oes.episode import Camera, Episode, Frames
from oes.record.reader import list_episodes, read_episode, read_frames


def read_states(folder: Path) -> list[Episode]:
    """Read every episode of a split, in the order of ``list_episodes``. Raises EpisodeError."""
    # One process reads 300 a second, faster than several could hand over their results.
    return [read_episode(path) for path in list_episodes(folder)]


class FrameSource:
    """Images of splits (or single episodes) by episode, state and cameras. Cheap to pickle.

    Several splits are mixed evenly: any run of neighbours has the proportions of the whole.
    """

    def __init__(self, *folders: Path) -> None:
        found = []
        for folder in folders:
            is_episode = any(folder.glob("*.mcap"))
            paths = [folder] if is_episode else list_episodes(folder)
            found += [((i + 0.5) / len(paths), path) for i, path in enumerate(paths)]
        # The sort is stable: splits tied at one relative position keep the order given.
        self.folders = [path for _, path in sorted(found, key=lambda each: each[0])]
        self.episodes = [read_episode(path) for path in self.folders]

    def __len__(self) -> int:
        return len(self.folders)

    def read(
        self, episode_i: int, step_i: int, camera_is: Sequence[int]
    ) -> tuple[Frames, tuple[Camera, ...]]:
        """Images of some cameras at one state, and those cameras at that state.

        Raises EpisodeError.
        """
        frames = read_frames(self.folders[episode_i], step_i, camera_is)
        cameras = self.episodes[episode_i].steps[step_i].cameras
        return frames, tuple(cameras[camera_i] for camera_i in camera_is)
