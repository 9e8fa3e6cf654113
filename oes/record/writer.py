"""Episode to disk: one rosbag2 folder (metadata.yaml and one MCAP file), which appears whole."""

import os
import shutil
from collections.abc import Iterable
from pathlib import Path

from mcap.writer import CompressionType, Writer

from oes.episode import Episode, Frames
from oes.record.encode import image_messages, stamp_of, state_messages
from oes.record.messages import Encoded, definition, topic_type, topics_of, type_hash
from oes.record.metadata import MCAP_SUFFIX, Contents, metadata_text
from oes.record.viewer import viewer_messages

CHUNK_BYTES = 1 << 20
LIBRARY = "3d-oes"


def write_episode(episode: Episode, frames: Iterable[Frames], folder: Path) -> None:
    """Write ``episode`` and the images of its steps (one Frames each, taken one at a time).

    The folder is written beside its place and renamed; equal input gives equal bytes. Depth is kept
    in whole millimetres. Raises ValueError if frames and steps do not match, FileExistsError if
    ``folder`` exists.
    """
    if folder.exists():
        raise FileExistsError(f"{folder} exists")
    _check(episode)
    part = folder.parent / f".{folder.name}.tmp"
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        bag_name = f"{folder.name}{MCAP_SUFFIX}"
        contents = _write_bag(episode, frames, part / bag_name)
        text = metadata_text(bag_name, contents)
        (part / "metadata.yaml").write_text(text, encoding="utf-8")
        os.replace(part, folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _check(episode: Episode) -> None:
    """Raise ValueError for an episode that contradicts itself."""
    names = tuple(camera.name for camera in episode.steps[0].cameras)
    steps_names = {tuple(camera.name for camera in step.cameras) for step in episode.steps}
    if len(set(names)) != len(names) or steps_names != {names}:
        raise ValueError("every step needs the same cameras, each with a name of its own")
    if len(episode.actions_T3) != len(episode.steps) - 1:
        raise ValueError(f"{len(episode.actions_T3)} actions for {len(episode.steps)} states")
    stamps_ns = [stamp_of(step) for step in episode.steps]
    if stamps_ns != sorted(set(stamps_ns)):
        raise ValueError("the times of the states do not rise")


def _write_bag(episode: Episode, frames: Iterable[Frames], path: Path) -> Contents:
    """Write the MCAP file: states first, then messages for viewers, then images state by state."""
    topics = topics_of([camera.name for camera in episode.steps[0].cameras])
    with path.open("wb") as file:
        writer = Writer(file, CHUNK_BYTES, CompressionType.ZSTD, enable_data_crcs=True)
        bag = _BagWriter(writer, {topic: topic_type(topic) for topic in topics})
        bag.add(state_messages(episode))
        bag.add(message for step in episode.steps for message in viewer_messages(step))
        for step, step_frames in zip(episode.steps, frames, strict=True):
            bag.add(image_messages(step, step_frames))
        return bag.finish()


class _BagWriter:
    """Channels and sequence numbers over one mcap Writer."""

    def __init__(self, writer: Writer, types: dict[str, str]) -> None:
        writer.start(profile="ros2", library=LIBRARY)
        self._writer, self._types = writer, types
        schema_ids = {
            name: writer.register_schema(name, "ros2msg", definition(name).encode())
            for name in dict.fromkeys(types.values())
        }
        self._channels = {}
        for topic, name in types.items():
            metadata = {"offered_qos_profiles": "", "topic_type_hash": type_hash(name)}
            channel_id = writer.register_channel(topic, "cdr", schema_ids[name], metadata)
            self._channels[topic] = channel_id
        self._counts = dict.fromkeys(types, 0)
        self._stamps_ns: list[int] = []

    def add(self, messages: Iterable[Encoded]) -> None:
        """Write messages and close the chunk, so that data read together are stored together."""
        for message in messages:
            self._writer.add_message(
                self._channels[message.topic],
                message.stamp_ns,
                message.data,  # type: ignore[arg-type]  # any buffer will do
                message.stamp_ns,
                sequence=self._counts[message.topic],
            )
            self._counts[message.topic] += 1
            self._stamps_ns.append(message.stamp_ns)
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> Contents:
        """Write the summary and return the contents of the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        return Contents(self._types, self._counts, min(self._stamps_ns), max(self._stamps_ns))
