"""Episode to disk: one rosbag2 directory (metadata version 8 and one MCAP file), which appears
whole.
"""

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
    """Write ``episode`` and the images of its steps (one Frames a step, drawn one at a time) as
    ``folder``.

    The folder is written beside its place and renamed; the same input gives the same bytes. Depth
    is kept in whole millimetres. Raises ValueError where frames and steps do not match,
    FileExistsError where ``folder`` exists.
    """
    if folder.exists():
        raise FileExistsError(f"{folder} exists")
    names = _camera_names(episode)
    aside = folder.parent / f".{folder.name}.tmp"
    shutil.rmtree(aside, ignore_errors=True)
    aside.mkdir(parents=True)
    try:
        _write_bag(episode, frames, names, aside, f"{folder.name}{MCAP_SUFFIX}")
        os.replace(aside, folder)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _write_bag(
    episode: Episode, frames: Iterable[Frames], names: tuple[str, ...], aside: Path, bag_name: str
) -> None:
    """The two files of a rosbag2 directory: states first, then what viewers draw, then images state
    by state.
    """
    with (aside / bag_name).open("wb") as file:
        writer = Writer(file, CHUNK_BYTES, CompressionType.ZSTD, enable_data_crcs=True)
        bag = _BagWriter(writer, {topic: topic_type(topic) for topic in topics_of(names)})
        bag.add(state_messages(episode))
        bag.add(message for step in episode.steps for message in viewer_messages(step))
        for step, step_frames in zip(episode.steps, frames, strict=True):
            bag.add(image_messages(step, step_frames))
        contents = bag.finish()
    (aside / "metadata.yaml").write_text(metadata_text(bag_name, contents), encoding="utf-8")


class _BagWriter:
    """Channels and running numbers over one mcap Writer."""

    def __init__(self, writer: Writer, types: dict[str, str]) -> None:
        writer.start(profile="ros2", library=LIBRARY)
        self._writer = writer
        self._types = types
        names = dict.fromkeys(types.values())
        schema_ids = {
            name: writer.register_schema(name, "ros2msg", definition(name).encode())
            for name in names
        }
        self._channels = {
            topic: self._register(topic, name, schema_ids[name]) for topic, name in types.items()
        }
        self._counts = dict.fromkeys(types, 0)
        self._stamps_ns: list[int] = []

    def _register(self, topic: str, typename: str, schema_id: int) -> int:
        metadata = {"offered_qos_profiles": "", "topic_type_hash": type_hash(typename)}
        return self._writer.register_channel(topic, "cdr", schema_id, metadata)

    def add(self, messages: Iterable[Encoded]) -> None:
        """Write messages and close the chunk, so that what is read together lies together."""
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
        """Write the summary; what the file holds."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        return Contents(self._types, self._counts, min(self._stamps_ns), max(self._stamps_ns))


def _camera_names(episode: Episode) -> tuple[str, ...]:
    """The names of the cameras. Raises ValueError where they repeat or differ between steps."""
    names = tuple(camera.name for camera in episode.steps[0].cameras)
    if len(set(names)) != len(names) or any(
        tuple(c.name for c in step.cameras) != names for step in episode.steps
    ):
        raise ValueError("every step needs the same cameras, each with a name of its own")
    if len(episode.actions_T3) != len(episode.steps) - 1:
        raise ValueError(f"{len(episode.actions_T3)} actions for {len(episode.steps)} states")
    if [stamp_of(step) for step in episode.steps] != sorted(
        {stamp_of(step) for step in episode.steps}
    ):
        raise ValueError("the times of the states do not rise")
    return names
