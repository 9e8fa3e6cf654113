"""Readers that we did not write see the same pixels and states: rosbags, and the MCAP packages of
Foxglove.
"""

import json
import shutil
import subprocess
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from oes.record import write_episode
from oes.record.messages import topic_counts
from tests.factories import make_episode, make_frames

JS = Path(__file__).parent / "js"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    episode = make_episode()
    path = tmp_path_factory.mktemp("readers") / "traj_000000"
    write_episode(episode, make_frames(episode), path)
    return path


def expected_counts() -> dict[str, int]:
    return topic_counts(
        tuple(camera.name for camera in make_episode(num_steps=1).steps[0].cameras), 3
    )


def pixel_digests() -> dict[str, str]:
    """sha256 over the steps of what each camera's three image topics must hold, from memory."""
    digests = {}
    frames = make_frames(make_episode())
    for camera_i, camera in enumerate(make_episode(num_steps=1).steps[0].cameras):
        rgb = [step.rgb_VHW3[camera_i].tobytes() for step in frames]
        depth = [
            np.rint(step.depth_m_VHW[camera_i] * 1000).astype("<u2").tobytes() for step in frames
        ]
        seg = [step.seg_VHW[camera_i].tobytes() for step in frames]
        kinds = {
            "color/image_raw": rgb,
            "depth/image_rect_raw": depth,
            "segmentation/image_raw": seg,
        }
        digests |= {
            f"/{camera.name}/{kind}": sha256(b"".join(each)).hexdigest()
            for kind, each in kinds.items()
        }
    return digests


def test_rosbags_reads_every_message_by_the_definitions_in_the_file(folder: Path) -> None:
    store = get_typestore(Stores.EMPTY)
    with Reader(folder) as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == expected_counts()
        for typename, text in {c.msgtype: c.msgdef.data for c in reader.connections}.items():
            store.register(get_types_from_msg(text, typename))
        stamps_ns = {step.t_ns + 1_000_000_000 for step in make_episode().steps}
        pixels: dict[str, bytes] = {}
        latest: dict[str, object] = {}
        for connection, stamp_ns, raw in reader.messages():
            content = store.deserialize_cdr(raw, connection.msgtype)
            latest[connection.topic] = content
            assert stamp_ns in stamps_ns
            if connection.msgtype == "sensor_msgs/msg/Image":
                pixels[connection.topic] = (
                    pixels.get(connection.topic, b"") + content.data.tobytes()
                )
    assert {topic: sha256(data).hexdigest() for topic, data in pixels.items()} == pixel_digests()
    check_drawn(latest)


def check_drawn(latest: dict) -> None:
    """The standard messages of the last state agree with it: camera pose and intrinsics, boxes,
    joints.
    """
    step = make_episode().steps[-1]
    transforms = {t.child_frame_id: t for t in latest["/tf"].transforms}
    assert len(transforms) == 27 + 2 + 9
    pose = transforms["cam_05"].transform
    q, t = pose.rotation, pose.translation
    world_R_cam = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    np.testing.assert_allclose(world_R_cam, step.cameras[5].world_T_cam_44[:3, :3], atol=1e-12)
    np.testing.assert_array_equal([t.x, t.y, t.z], step.cameras[5].world_T_cam_44[:3, 3])
    np.testing.assert_array_equal(
        latest["/cam_05/depth/camera_info"].k.reshape(3, 3), step.cameras[5].K_33
    )
    marker = latest["/objects/markers"].markers[1]
    np.testing.assert_array_equal([marker.scale.x, marker.scale.y, marker.scale.z], step.size_N3[1])
    np.testing.assert_array_equal(
        [marker.pose.position.x, marker.pose.position.y], step.center_N3[1, :2]
    )
    np.testing.assert_array_equal(latest["/joint_states"].position, step.joints_rad_J)


def test_metadata_is_version_8(folder: Path) -> None:
    information = yaml.safe_load((folder / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert information["version"] == 8
    assert information["relative_file_paths"] == ["traj_000000_0.mcap"]
    topics = [topic["topic_metadata"] for topic in information["topics_with_message_count"]]
    assert {topic["offered_qos_profiles"] for topic in topics} == {""}
    with Reader(folder) as reader:
        assert reader.message_count == sum(expected_counts().values())
        assert (reader.start_time, reader.duration) == (1_000_000_000, 400_000_001)


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
@pytest.mark.skipif(not (JS / "node_modules").is_dir(), reason="run: npm ci --prefix tests/js")
def test_javascript_reads_the_same(folder: Path) -> None:
    command = ["node", str(JS / "read.mjs"), str(folder / "traj_000000_0.mcap")]
    seen = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert seen["profile"] == "ros2"
    assert seen["counts"] == expected_counts()
    assert seen["pixels"] == pixel_digests()
    for state, step in zip(seen["states"], make_episode().steps, strict=True):
        assert state["tip_m"] == step.tip_world_3.tolist()
        assert state["objects"] == step.world_T_obj_N44.reshape(-1, 16).tolist()
