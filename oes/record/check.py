"""Everything that can be checked of one recorded episode."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from oes.episode import Camera, Episode
from oes.record.bag import Bag, Message, Summary
from oes.record.encode import stamp_of
from oes.record.errors import EpisodeError, episode_errors
from oes.record.messages import INFO_KINDS, SCENE_TYPES, decode, topic_type, topics_of
from oes.record.metadata import Contents, metadata_text
from oes.record.reader import bag_path, camera_names, channel_ids, check_counts, read_episode


def check_episode(folder: Path) -> None:
    """Verify every byte of an episode against its checksums, then every message: type, number,
    order, time, size.

    Raises EpisodeError for the first thing that is wrong. Memory stays within one chunk and the
    states.
    """
    path = bag_path(folder)
    with Bag(path) as bag, episode_errors(path):
        bag.verify()
        episode = read_episode(folder)
        summary = bag.summary()
        topics = channel_ids(summary, set(topics_of(camera_names(summary))))
        seen: Counter[str] = Counter()
        for chunk in summary.chunks:
            for message in bag.messages(chunk):
                topic = topics[message.channel_id]
                _check_message(episode, topic, message, seen[topic])
                seen[topic] += 1
        check_counts(path, seen, episode)
    _check_metadata(folder, path, summary)


def _check_message(episode: Episode, topic: str, message: Message, position: int) -> None:
    """Order, time and type of one message; size, encoding and intrinsics where it has a camera."""
    if message.sequence != position or position >= len(episode.steps):
        raise ValueError(f"message {message.sequence} of {topic} in place {position}")
    step = episode.steps[position]
    if message.log_time != stamp_of(step):
        raise ValueError(
            f"message {position} of {topic} has time {message.log_time}, its state {stamp_of(step)}"
        )
    content = decode(topic_type(topic), message.data)
    if topic not in SCENE_TYPES:
        name, kind = topic[1:].split("/", 1)
        camera = next(camera for camera in step.cameras if camera.name == name)
        _check_view(topic, content, camera, kind in INFO_KINDS)


def _check_view(topic: str, content: Any, camera: Camera, is_info: bool) -> None:
    if (size := (content.width, content.height)) != (camera.width_px, camera.height_px):
        raise ValueError(
            f"{topic} has size {size}, its camera {(camera.width_px, camera.height_px)}"
        )
    if is_info and not np.array_equal(content.k.reshape(3, 3), camera.K_33):
        raise ValueError(f"the intrinsics of {topic} differ from those of the state")
    if not is_info and len(content.data) != content.step * content.height:
        raise ValueError(
            f"{topic} has {len(content.data)} bytes, {content.step * content.height} are due"
        )


def _check_metadata(folder: Path, path: Path, summary: Summary) -> None:
    """metadata.yaml says what the MCAP file holds."""
    types = {
        channel.topic: topic_type(channel.topic) for _, channel in sorted(summary.channels.items())
    }
    stamps_ns = [
        stamp
        for chunk in summary.chunks
        for stamp in (chunk.message_start_time, chunk.message_end_time)
    ]
    expected = metadata_text(
        path.name, Contents(types, summary.counts, min(stamps_ns), max(stamps_ns))
    )
    metadata = folder / "metadata.yaml"
    with episode_errors(metadata):
        if (
            metadata.stat().st_size != len(expected)
            or metadata.read_text(encoding="utf-8") != expected
        ):
            raise EpisodeError(metadata, "does not describe the MCAP file beside it")
