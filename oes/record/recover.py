"""What a truncated or damaged episode still holds, written as a whole, shorter episode."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from struct import error as StructError
from typing import Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel
from mcap.writer import MCAP0_MAGIC

from oes.episode import Episode, Frames
from oes.record.bag import messages, records, unpack
from oes.record.decode import episode_from, frames_from
from oes.record.errors import EpisodeError, episode_errors
from oes.record.messages import (
    IMAGE_KINDS,
    IMAGE_TYPE,
    STATE_TOPICS,
    decode,
    image_topic,
    topic_counts,
)
from oes.record.reader import bag_path
from oes.record.writer import write_episode

MAX_FILE_BYTES = 1 << 30


@dataclass(frozen=True)
class Recovered:
    """How much of an episode survived: states with all their images, and messages, each of how
    many.
    """

    steps: int
    steps_due: int
    messages: int
    messages_due: int


def recover(folder: Path, out: Path) -> Recovered:
    """Write as ``out`` the states of a damaged episode that come before the first missing image.

    The states lie in the first chunk, so that a truncated file keeps them all. Raises EpisodeError
    where they, or the images of the first state, are lost; FileExistsError where ``out`` exists.
    """
    path = bag_path(folder)
    with episode_errors(path):
        if path.stat().st_size > MAX_FILE_BYTES:
            raise EpisodeError(path, f"larger than {MAX_FILE_BYTES} bytes")
        found = _survivors(path.read_bytes())
        states = {
            topic: [data for _, data in sorted(found.get(topic, {}).items())]
            for topic in STATE_TOPICS
        }
        episode = episode_from(states)
        num_steps = _num_whole_steps(episode, found)
        if num_steps == 0:
            raise EpisodeError(path, "no state has all its images: nothing to recover")
    shorter = replace(
        episode, actions_T3=episode.actions_T3[: num_steps - 1], steps=episode.steps[:num_steps]
    )
    write_episode(shorter, _frames(shorter, found), out)
    due = topic_counts(
        tuple(camera.name for camera in episode.steps[0].cameras), len(episode.steps)
    )
    return Recovered(
        num_steps, len(episode.steps), sum(len(each) for each in found.values()), sum(due.values())
    )


def _survivors(data: bytes) -> dict[str, dict[int, memoryview]]:
    """Topic -> running number -> bytes of every message in a chunk whose checksum holds, up to
    where records end.
    """
    if not data.startswith(MCAP0_MAGIC):
        raise ValueError("does not begin as an MCAP file")
    found: dict[str, dict[int, memoryview]] = {}
    topics: dict[int, str] = {}
    for opcode, body in records(memoryview(data)[len(MCAP0_MAGIC) :]):
        if opcode == Opcode.CHUNK and (chunk := _unpack_or_none(body)) is not None:
            topics |= _topics(chunk)
            for message in messages(chunk):
                found.setdefault(topics.get(message.channel_id, ""), {})[message.sequence] = (
                    message.data
                )
    return found


def _unpack_or_none(body: memoryview) -> memoryview | None:
    """The records of a chunk, or None where its sizes or its checksum are wrong."""
    try:
        return unpack(body)
    except (ValueError, McapError, StructError, zstandard.ZstdError):
        return None


def _topics(chunk: memoryview) -> dict[int, str]:
    """Channel id -> topic of the channels that a chunk declares."""
    bodies = [body for opcode, body in records(chunk) if opcode == Opcode.CHANNEL]
    channels = [Channel.read(ReadDataStream(BytesIO(body))) for body in bodies]
    return {channel.id: channel.topic for channel in channels}


def _num_whole_steps(episode: Episode, found: dict[str, dict[int, memoryview]]) -> int:
    """How many states, from the first on, have the images of every camera."""
    topics = [
        image_topic(camera.name, kind)
        for camera in episode.steps[0].cameras
        for kind in IMAGE_KINDS
    ]
    whole = [
        all(step_i in found.get(topic, {}) for topic in topics)
        for step_i in range(len(episode.steps))
    ]
    return [*whole, False].index(False)


def _frames(episode: Episode, found: dict[str, dict[int, memoryview]]) -> Iterator[Frames]:
    """The surviving images of each step of ``episode``."""
    names = [camera.name for camera in episode.steps[0].cameras]

    def image(name: str, kind: str, step_i: int) -> Any:
        return decode(IMAGE_TYPE, found[image_topic(name, kind)][step_i])

    for step_i in range(len(episode.steps)):
        color, depth, seg = ([image(name, kind, step_i) for name in names] for kind in IMAGE_KINDS)
        yield frames_from(list(zip(color, depth, seg, strict=True)))
