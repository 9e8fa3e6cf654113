"""Episodes from disk. Every defect of a file becomes an EpisodeError that names the file."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from oes.episode import Episode, Frames
from oes.record import messages as ros
from oes.record.bag import Bag, Summary
from oes.record.decode import episode_from, frames_from
from oes.record.errors import EpisodeError, episode_errors

EPISODE_GLOB = "traj_*"


def list_episodes(folder: Path) -> list[Path]:
    """The episode folders of a split, sorted; an episode's number is its position in this list."""
    return sorted(path for path in folder.glob(EPISODE_GLOB) if path.is_dir())


def bag_path(folder: Path) -> Path:
    """The MCAP file of an episode folder. Raises EpisodeError unless there is exactly one."""
    paths = sorted(folder.glob("*.mcap"))
    if len(paths) != 1:
        raise EpisodeError(folder, f"{len(paths)} MCAP files where one is expected")
    return paths[0]


def read_episode(folder: Path) -> Episode:
    """Read states, actions and cameras of an episode, no images: one small chunk is unpacked.

    Raises EpisodeError for a missing, truncated, corrupted, foreign or incomplete file.
    """
    path = bag_path(folder)
    with Bag(path) as bag, episode_errors(path):
        summary = bag.summary()
        messages: dict[str, list[memoryview]] = {topic: [] for topic in ros.STATE_TOPICS}
        for topic, _, data in _messages(bag, summary, set(ros.STATE_TOPICS), None):
            messages[topic].append(data)
        episode = episode_from(messages)
        check_counts(path, summary.counts, episode)
        return episode


def read_frames(folder: Path, step_i: int, camera_is: Sequence[int] | None) -> Frames:
    """Read the images of one state from some cameras, in the order given (None: all cameras).

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
        topics = ros.image_topics([names[camera_i] for camera_i in wanted])
        found = {
            topic: ros.decode(ros.IMAGE_TYPE, data)
            for topic, sequence, data in _messages(bag, summary, set(topics), step_i)
            if sequence == step_i
        }
        if missing := set(topics) - found.keys():
            raise EpisodeError(path, f"state {step_i} has no {', '.join(sorted(missing))}")
        return frames_from([found[topic] for topic in topics])


def camera_names(summary: Summary) -> tuple[str, ...]:
    """The names of the cameras of a file, in the order of Step.cameras."""
    ending = f"/{ros.IMAGE_KINDS[0]}"
    topics = [summary.channels[i].topic for i in sorted(summary.channels)]
    return tuple(topic[1 : -len(ending)] for topic in topics if topic.endswith(ending))


def channel_ids(summary: Summary, topics: set[str]) -> dict[int, str]:
    """Channel id -> topic of some topics. Raises ValueError for one that is missing or foreign."""
    known = {
        schema_id: schema.name
        for schema_id, schema in summary.schemas.items()
        if schema.name in ros.KNOWN_TYPES and schema.data.decode() == ros.definition(schema.name)
    }
    ids = {}
    for channel_id, channel in summary.channels.items():
        if channel.topic in topics:
            expected = ros.topic_type(channel.topic)
            if known.get(channel.schema_id) != expected:
                raise ValueError(f"the type of {channel.topic} is not our {expected}")
            ids[channel_id] = channel.topic
    if missing := topics - set(ids.values()):
        raise ValueError(f"no topic {', '.join(sorted(missing))}")
    return ids


def check_counts(path: Path, counts: Mapping[str, int], episode: Episode) -> None:
    """Raise EpisodeError if a topic has another number of messages than the episode's states."""
    names = tuple(camera.name for camera in episode.steps[0].cameras)
    for topic, expected in ros.topic_counts(names, len(episode.steps)).items():
        if (count := counts.get(topic, 0)) != expected:
            raise EpisodeError(path, f"{count} messages of {topic} where {expected} are expected")


def _messages(
    bag: Bag, summary: Summary, topics: set[str], step_i: int | None
) -> Iterator[tuple[str, int, memoryview]]:
    """Topic, sequence number and bytes of the messages of some topics, in file order.

    If ``step_i`` is given, only from the chunks of that state: a chunk with images holds those of
    one state only.
    """
    ids = channel_ids(summary, topics)
    chunks = [chunk for chunk in summary.chunks if ids.keys() & chunk.message_index_offsets.keys()]
    if step_i is not None:
        stamps_ns = sorted({chunk.message_start_time for chunk in chunks})
        if not 0 <= step_i < len(stamps_ns):
            raise EpisodeError(bag.path, f"no state {step_i}: it has {len(stamps_ns)}")
        chunks = [each for each in chunks if each.message_start_time == stamps_ns[step_i]]
    for chunk in chunks:
        for message in bag.messages(chunk):
            if message.channel_id in ids:
                yield ids[message.channel_id], message.sequence, message.data
