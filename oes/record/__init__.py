"""Episodes on disk: one rosbag2 directory (MCAP, ROS 2 messages) each. The only package that knows
mcap and rosbags.
"""

from oes.record.errors import EpisodeError
from oes.record.reader import list_episodes, read_episode, read_frames
from oes.record.writer import write_episode

__all__ = ["EpisodeError", "list_episodes", "read_episode", "read_frames", "write_episode"]
