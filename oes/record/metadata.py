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
    information = {
        "version": VERSION,
        "storage_identifier": "mcap",
        **_span(contents),
        "topics_with_message_count": [
            {"topic_metadata": _topic(topic, typename), "message_count": contents.counts[topic]}
            for topic, typename in contents.types.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [bag_name],
        "files": [{"path": bag_name, **_span(contents)}],
        "custom_data": None,
        "ros_distro": "humble",
    }
    tree = {"rosbag2_bagfile_information": information}
    return yaml.dump(tree, Dumper=yaml.CSafeDumper, sort_keys=False)


def _span(contents: Contents) -> dict[str, object]:
    # Made anew for each use: YAML writes a dictionary that occurs twice as an alias.
    return {
        "starting_time": {"nanoseconds_since_epoch": contents.start_ns},
        "duration": {"nanoseconds": contents.end_ns - contents.start_ns},
        "message_count": sum(contents.counts.values()),
    }


def _topic(topic: str, typename: str) -> dict[str, str]:
    return {
        "name": topic,
        "type": typename,
        "serialization_format": "cdr",
        "offered_qos_profiles": "",
        "type_description_hash": type_hash(typename),
    }
