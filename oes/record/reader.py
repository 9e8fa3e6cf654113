"""Episodes from disk. Whatever is wrong with a file becomes an EpisodeError that names it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from oes.episode import Episode, Frames
from oes.record.bag import Bag, Summary
from oes.record.decode import episode_from, frames_from
from oes.record.errors import EpisodeError, episode_errors
from oes.record.messages import (
    IMAGE_KINDS,
    IMAGE_TYPE,
    KNOWN_TYPES,
    STATE_TOPICS,
    decode,
    definition,
    image_topic,
    topic_counts,
    topic_type,
)

EPISODE_GLOB = "traj_*"


def list_episodes(folder: Path) -> list[Path]:
    """The episode directories of a split, sorted; the position in this list is the episode's number
    everywhere.
    """
    return sorted(path for path in folder.glob(EPISODE_GLOB) if path.is_dir())


def bag_path(folder: Path) -> Path:
    """The one MCAP file of an episode directory. Raises EpisodeError where there is none, or more
    than one.
    """
    paths = sorted(folder.glob("*.mcap"))
    if len(paths) != 1:
        raise EpisodeError(folder, f"{len(paths)} MCAP files where one is due")
    return paths[0]


def read_episode(folder: Path) -> Episode:
    """States, actions and cameras of an episode, no images: one small chunk is unpacked.

    Raises EpisodeError for a missing, truncated, corrupted, foreign or incomplete file.
    """
    path = bag_path(folder)
    with Bag(path) as bag, episode_errors(path):
        summary = bag.summary()
        episode = episode_from(_messages(bag, summary, set(STATE_TOPICS)))
        check_counts(path, summary.counts, episode)
        return episode


def read_frames(folder: Path, step_i: int, camera_is: Sequence[int] | None) -> Frames:
    """The images of one state from some cameras, in the order asked for (None: all).

    Unpacks only the chunks that hold them, and verifies their checksums. Raises EpisodeError as
    ``read_episode``, and for a state or a camera that the episode does not have.
    """
    path = bag_path(folder)
    with Bag(path) as bag, episode_errors(path):
        summary = bag.summary()
        names = camera_names(summary)
        wanted = range(len(names)) if camera_is is None else camera_is
        if not all(0 <= camera_i < len(names) for camera_i in wanted):
            raise EpisodeError(path, f"no camera {list(wanted)}: it has {len(names)}")
        topics = [
            [image_topic(names[camera_i], kind) for kind in IMAGE_KINDS] for camera_i in wanted
        ]
        images = _images(bag, summary, {topic for three in topics for topic in three}, step_i)
        return frames_from(
            [(images[color], images[depth], images[seg]) for color, depth, seg in topics]
        )


def camera_names(summary: Summary) -> tuple[str, ...]:
    """The names of the cameras of a file, in the order of Step.cameras."""
    ending = f"/{IMAGE_KINDS[0]}"
    topics = [summary.channels[i].topic for i in sorted(summary.channels)]
    return tuple(topic[1 : -len(ending)] for topic in topics if topic.endswith(ending))


def _messages(bag: Bag, summary: Summary, topics: set[str]) -> dict[str, list[memoryview]]:
    """All messages of some topics, in file order."""
    ids = channel_ids(summary, topics)
    found: dict[str, list[memoryview]] = {topic: [] for topic in topics}
    for chunk in summary.chunks:
        if ids.keys() & chunk.message_index_offsets.keys():
            for message in bag.messages(chunk):
                if message.channel_id in ids:
                    found[ids[message.channel_id]].append(message.data)
    return found


def _images(bag: Bag, summary: Summary, topics: set[str], step_i: int) -> dict[str, Any]:
    """The Image message of each topic at one state; a chunk with images holds those of one state
    only.
    """
    ids = channel_ids(summary, topics)
    chunks = [chunk for chunk in summary.chunks if ids.keys() & chunk.message_index_offsets.keys()]
    stamps_ns = sorted({chunk.message_start_time for chunk in chunks})
    if not 0 <= step_i < len(stamps_ns):
        raise EpisodeError(bag.path, f"no state {step_i}: it has {len(stamps_ns)}")
    found = {}
    for chunk in chunks:
        if chunk.message_start_time == stamps_ns[step_i]:
            for message in bag.messages(chunk):
                if message.channel_id in ids and message.sequence == step_i:
                    found[ids[message.channel_id]] = decode(IMAGE_TYPE, message.data)
    if missing := topics - found.keys():
        raise EpisodeError(bag.path, f"state {step_i} has no {', '.join(sorted(missing))}")
    return found


def channel_ids(summary: Summary, topics: set[str]) -> dict[int, str]:
    """Channel id -> topic of some topics. Raises ValueError where one is missing or its type is not
    ours.
    """
    known = {
        schema_id: schema.name
        for schema_id, schema in summary.schemas.items()
        if schema.name in KNOWN_TYPES and schema.data.decode() == definition(schema.name)
    }
    ids = {}
    for channel_id, channel in summary.channels.items():
        if channel.topic in topics:
            if known.get(channel.schema_id) != topic_type(channel.topic):
                raise ValueError(
                    f"the type of {channel.topic} is not our {topic_type(channel.topic)}"
                )
            ids[channel_id] = channel.topic
    if missing := topics - set(ids.values()):
        raise ValueError(f"no topic {', '.join(sorted(missing))}")
    return ids


def check_counts(path: Path, counts: Mapping[str, int], episode: Episode) -> None:
    """Raises EpisodeError where a topic has fewer or more messages than the episode's states ask
    for.
    """
    names = tuple(camera.name for camera in episode.steps[0].cameras)
    for topic, due in topic_counts(names, len(episode.steps)).items():
        if counts.get(topic, 0) != due:
            raise EpisodeError(
                path, f"{counts.get(topic, 0)} messages of {topic} where {due} are due"
            )
