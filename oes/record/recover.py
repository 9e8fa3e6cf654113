"""Recovery of a truncated or damaged episode, as a whole but shorter one."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from struct import error as StructError

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel
from mcap.writer import MCAP0_MAGIC

from oes.episode import Episode, Frames
from oes.record import messages as ros
from oes.record.bag import messages, records, unpack
from oes.record.decode import episode_from, frames_from
from oes.record.errors import EpisodeError, episode_errors
from oes.record.reader import bag_path
from oes.record.writer import write_episode

MAX_FILE_BYTES = 1 << 30

Survivors = dict[str, dict[int, memoryview]]  # topic -> sequence number -> serialized message


@dataclass(frozen=True)
class Recovered:
    """Number of recovered states (with all images) and messages, and the numbers expected."""

    steps: int
    expected_steps: int
    messages: int
    expected_messages: int


def recover(folder: Path, out: Path) -> Recovered:
    """Write the states of a damaged episode before its first missing image as ``out``.

    The states are in the first chunk, so that a truncated file keeps them all. Raises EpisodeError
    if they, or the images of the first state, are lost; FileExistsError if ``out`` exists.
    """
    path = bag_path(folder)
    with episode_errors(path):
        if path.stat().st_size > MAX_FILE_BYTES:
            raise EpisodeError(path, f"larger than {MAX_FILE_BYTES} bytes")
        found = _survivors(path.read_bytes())
        states = {
            topic: [data for _, data in sorted(found.get(topic, {}).items())]
            for topic in ros.STATE_TOPICS
        }
        episode = episode_from(states)
        names = tuple(camera.name for camera in episode.steps[0].cameras)
        images = [found.get(topic, {}) for topic in ros.image_topics(names)]
        is_whole = [all(i in image for image in images) for i in range(len(episode.steps))]
        num_steps = [*is_whole, False].index(False)
        if num_steps == 0:
            raise EpisodeError(path, "no state has all its images: nothing to recover")
    steps, actions_T3 = episode.steps[:num_steps], episode.actions_T3[: num_steps - 1]
    shorter = replace(episode, actions_T3=actions_T3, steps=steps)
    write_episode(shorter, _frames(shorter, images), out)
    expected = ros.topic_counts(names, len(episode.steps))
    num_messages = sum(len(each) for each in found.values())
    return Recovered(num_steps, len(episode.steps), num_messages, sum(expected.values()))


def _survivors(data: bytes) -> Survivors:
    """Every message of a chunk whose checksum holds, up to where the records end."""
    if not data.startswith(MCAP0_MAGIC):
        raise ValueError("does not begin as an MCAP file")
    found: Survivors = {}
    topics: dict[int, str] = {}
    for opcode, body in records(memoryview(data)[len(MCAP0_MAGIC) :]):
        if opcode == Opcode.CHUNK and (chunk := _unpack_or_none(body)) is not None:
            topics |= _topics(chunk)
            for message in messages(chunk):
                topic = topics.get(message.channel_id, "")
                found.setdefault(topic, {})[message.sequence] = message.data
    return found


def _unpack_or_none(body: memoryview) -> memoryview | None:
    try:
        return unpack(body)
    except (ValueError, McapError, StructError, zstandard.ZstdError):
        return None


def _topics(chunk: memoryview) -> dict[int, str]:
    """Channel id -> topic of the channels that a chunk declares."""
    bodies = [body for opcode, body in records(chunk) if opcode == Opcode.CHANNEL]
    channels = [Channel.read(ReadDataStream(BytesIO(body))) for body in bodies]
    return {channel.id: channel.topic for channel in channels}


def _frames(episode: Episode, images: list[dict[int, memoryview]]) -> Iterator[Frames]:
    for step_i in range(len(episode.steps)):
        yield frames_from([ros.decode(ros.IMAGE_TYPE, image[step_i]) for image in images])
