"""The complete check of one recorded episode."""

from collections import Counter
from pathlib import Path

import numpy as np

from oes.episode import Episode
from oes.record import messages as ros
from oes.record.bag import Bag, Message, Summary
from oes.record.encode import stamp_of
from oes.record.errors import EpisodeError, episode_errors
from oes.record.metadata import Contents, metadata_text
from oes.record.reader import bag_path, camera_names, channel_ids, check_counts, read_episode


def check_episode(folder: Path) -> None:
    """Verify the checksums of every byte, then type, number, order, time and size of each message.

    Raises EpisodeError for the first defect. Memory is bounded by one chunk and the states.
    """
    path = bag_path(folder)
    with Bag(path) as bag, episode_errors(path):
        bag.verify()
        episode = read_episode(folder)
        summary = bag.summary()
        topics = channel_ids(summary, set(ros.topics_of(camera_names(summary))))
        counts: Counter[str] = Counter()
        for chunk in summary.chunks:
            for message in bag.messages(chunk):
                topic = topics[message.channel_id]
                _check_message(episode, topic, message, counts[topic])
                counts[topic] += 1
        check_counts(path, counts, episode)
    _check_metadata(folder, path, summary)


def _check_message(episode: Episode, topic: str, message: Message, position: int) -> None:
    """Order, time and type of a message; size, encoding and intrinsics if it is of a camera."""
    if message.sequence != position or position >= len(episode.steps):
        raise ValueError(f"message {message.sequence} of {topic} in place {position}")
    step = episode.steps[position]
    if message.log_time != stamp_of(step):
        times = f"time {message.log_time}, its state {stamp_of(step)}"
        raise ValueError(f"message {position} of {topic} has {times}")
    content = ros.decode(ros.topic_type(topic), message.data)
    if topic in ros.SCENE_TYPES:
        return
    name, kind = topic[1:].split("/", 1)
    camera = next(camera for camera in step.cameras if camera.name == name)
    size, expected = (content.width, content.height), (camera.width_px, camera.height_px)
    if size != expected:
        raise ValueError(f"{topic} has size {size}, its camera {expected}")
    if kind in ros.INFO_KINDS:
        if not np.array_equal(content.k.reshape(3, 3), camera.K_33):
            raise ValueError(f"the intrinsics of {topic} differ from those of the state")
    elif len(content.data) != content.step * content.height:
        num_bytes = content.step * content.height
        raise ValueError(f"{topic} has {len(content.data)} bytes, {num_bytes} are expected")


def _check_metadata(folder: Path, path: Path, summary: Summary) -> None:
    """metadata.yaml must be the one that the writer derives from the MCAP file."""
    channels = [channel for _, channel in sorted(summary.channels.items())]
    types = {channel.topic: ros.topic_type(channel.topic) for channel in channels}
    start_ns = min(chunk.message_start_time for chunk in summary.chunks)
    end_ns = max(chunk.message_end_time for chunk in summary.chunks)
    expected = metadata_text(path.name, Contents(types, summary.counts, start_ns, end_ns))
    metadata = folder / "metadata.yaml"
    with episode_errors(metadata):
        # The size comes first, so that a huge file is not read.
        if (
            metadata.stat().st_size != len(expected)
            or metadata.read_text(encoding="utf-8") != expected
        ):
            raise EpisodeError(metadata, "does not describe the MCAP file beside it")
