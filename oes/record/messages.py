"""The ROS 2 messages of an episode: standard types (Humble), our own (msg/), and their topics.

``oes_msgs`` hold every number of an Episode exactly, matrices row-major in float64. ROS field names
are lower case, so ``world_from_obj`` is ``world_T_obj``. The standard messages repeat for viewers
what ``oes_msgs`` hold.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from oes.episode import Floats

MSG_FILES = Path(__file__).parent / "msg"
INFO, ACTION, STATE = "/episode", "/action", "/step"
STATE_TOPICS = (INFO, STATE, ACTION)
IMAGE_KINDS = ("color/image_raw", "depth/image_rect_raw", "segmentation/image_raw")
INFO_KINDS = ("color/camera_info", "depth/camera_info")

SCENE_TYPES = {
    INFO: "oes_msgs/msg/EpisodeInfo",
    STATE: "oes_msgs/msg/StepState",
    ACTION: "oes_msgs/msg/Action",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/objects/markers": "visualization_msgs/msg/MarkerArray",
}
IMAGE_TYPE, CAMERA_INFO_TYPE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
KNOWN_TYPES = {*SCENE_TYPES.values(), IMAGE_TYPE, CAMERA_INFO_TYPE}


@dataclass(frozen=True)
class Encoded:
    """One serialized message: topic, stamp (ns since the epoch of the bag) and CDR bytes."""

    topic: str
    stamp_ns: int
    data: memoryview


def topics_of(camera_names: Sequence[str]) -> tuple[str, ...]:
    """Every topic of an episode, in the order in which channels are numbered."""
    kinds = (*IMAGE_KINDS, *INFO_KINDS)
    return (*SCENE_TYPES, *(image_topic(name, kind) for name in camera_names for kind in kinds))


def topic_type(topic: str) -> str:
    """The type of a topic of an episode."""
    if topic in SCENE_TYPES:
        return SCENE_TYPES[topic]
    return CAMERA_INFO_TYPE if topic.endswith("/camera_info") else IMAGE_TYPE


def topic_counts(camera_names: Sequence[str], num_steps: int) -> dict[str, int]:
    """Number of messages of each topic of a complete episode of ``num_steps`` states."""
    counts = dict.fromkeys(topics_of(camera_names), num_steps)
    return counts | {INFO: 1, ACTION: num_steps - 1}


def image_topic(camera_name: str, kind: str) -> str:
    """The topic of a kind of image or camera_info, such as ``/cam_03/depth/image_rect_raw``."""
    return f"/{camera_name}/{kind}"


def image_topics(camera_names: Sequence[str]) -> list[str]:
    """The image topics of some cameras: colour, depth and segmentation of each."""
    return [image_topic(name, kind) for name in camera_names for kind in IMAGE_KINDS]


@cache
def typestore() -> Typestore:
    """ROS 2 Humble's types and ours; made once a process (0.1 s)."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for path in MSG_FILES.glob("*.msg"):
        text = path.read_text(encoding="utf-8")
        store.register(get_types_from_msg(text, f"oes_msgs/msg/{path.stem}"))
    return store


@cache
def definition(typename: str) -> str:
    """The full text of a type and of all the types it uses, as embedded in the file."""
    return typestore().generate_msgdef(typename, ros_version=2)[0]


@cache
def type_hash(typename: str) -> str:
    """The REP-2016 hash of a type (``RIHS01_...``), which rosbag2 keeps beside its name."""
    return typestore().hash_rihs01(typename)


def make(typename: str, **fields: Any) -> Any:
    """A message of a type such as ``geometry_msgs/msg/Point``; every field must be given."""
    return typestore().types[typename](**fields)


def encode(topic: str, stamp_ns: int, message: object) -> Encoded:
    """Serialize a message of the topic's type to little-endian CDR."""
    data = typestore().serialize_cdr(message, topic_type(topic), little_endian=True)
    return Encoded(topic, stamp_ns, data)


def decode(typename: str, data: bytes | memoryview) -> Any:
    """Deserialize a message; its arrays are views of ``data``. Raises SerdeError if damaged."""
    return typestore().deserialize_cdr(data, typename)


def header(stamp_ns: int, frame_id: str) -> Any:
    """A std_msgs/Header."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    stamp = make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def flat(values: Any) -> Floats:
    """Flat, contiguous float64."""
    return np.ascontiguousarray(values, np.float64).reshape(-1)


def vector(values_3: Floats, kind: str = "Vector3") -> Any:
    """A geometry_msgs Vector3 (or Point) of three numbers."""
    x, y, z = values_3.tolist()
    return make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)
