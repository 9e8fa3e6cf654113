"""metadata.yaml of a rosbag2 folder, version 8 (readable by Humble and every later ROS 2)."""

from dataclasses import dataclass

import yaml

from oes.record.messages import type_hash

MCAP_SUFFIX = "_0.mcap"
VERSION = 8


@dataclass(frozen=True)
class Contents:
    """Contents of one bag: type and number of messages by topic, first and last stamp (ns)."""

    types: dict[str, str]
    counts: dict[str, int]
    start_ns: int
    end_ns: int


def metadata_text(bag_name: str, contents: Contents) -> str:
    """The text of metadata.yaml for a folder whose one MCAP file is ``bag_name``."""
    span = {
        "starting_time": {"nanoseconds_since_epoch": contents.start_ns},
        "duration": {"nanoseconds": contents.end_ns - contents.start_ns},
        "message_count": sum(contents.counts.values()),
    }
    information = {
        "version": VERSION,
        "storage_identifier": "mcap",
        **span,
        "topics_with_message_count": [_topic(contents, topic) for topic in contents.types],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [bag_name],
        "files": [{"path": bag_name, **span}],
        "custom_data": None,
        "ros_distro": "humble",
    }
    return yaml.dump({"rosbag2_bagfile_information": information}, Dumper=_Plain, sort_keys=False)


def _topic(contents: Contents, topic: str) -> dict[str, object]:
    typename = contents.types[topic]
    metadata = {
        "name": topic,
        "type": typename,
        "serialization_format": "cdr",
        "offered_qos_profiles": "",
        "type_description_hash": type_hash(typename),
    }
    return {"topic_metadata": metadata, "message_count": contents.counts[topic]}


class _Plain(yaml.CSafeDumper):
    """Writes equal values out instead of as YAML aliases, which people find hard to read."""

    def ignore_aliases(self, data: object) -> bool:
        return True
