"""Episodes on disk: each a rosbag2 folder (MCAP, ROS 2 messages). Alone in importing mcap, rosbags.

Reading order: ``messages`` (topics and types), ``encode`` and ``writer``, ``bag`` (the container),
``decode`` and ``reader``; then ``check``, ``recover`` and the command ``doctor``.
"""

from oes.record.errors import EpisodeError
from oes.record.reader import list_episodes, read_episode, read_frames
from oes.record.writer import write_episode

__all__ = ["EpisodeError", "list_episodes", "read_episode", "read_frames", "write_episode"]
