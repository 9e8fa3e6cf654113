"""What ROS tools and Foxglove draw of a state: transforms, joints, boxes and camera models."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from oes.episode import Camera, Floats, Step
from oes.record.encode import flat, stamp_of
from oes.record.messages import (
    CAMERA_INFO_TYPE,
    INFO_KINDS,
    SCENE_TYPES,
    Encoded,
    encode,
    header,
    image_topic,
    make,
    vector,
)

MARKER_CUBE = 1
MARKER_RGBA = (0.95, 0.55, 0.10, 0.35)


def viewer_messages(step: Step) -> Iterator[Encoded]:
    """What ROS tools and Foxglove draw of one state: transforms, joints, boxes, camera models."""
    stamp_ns = stamp_of(step)
    for topic, message in (
        ("/tf", _tf(step)),
        ("/joint_states", _joints(step)),
        ("/objects/markers", _boxes(step)),
    ):
        yield encode(topic, stamp_ns, SCENE_TYPES[topic], message)
    for camera in step.cameras:
        for kind in INFO_KINDS:
            topic = image_topic(camera.name, kind)
            yield encode(topic, stamp_ns, CAMERA_INFO_TYPE, _camera_info(stamp_ns, camera))


def _tf(step: Step) -> object:
    names = [camera.name for camera in step.cameras]
    names += [f"object_{i}" for i in range(len(step.world_T_obj_N44))]
    names += [f"link_{i:02d}" for i in range(len(step.world_T_link_L44))]
    poses = [
        np.array([camera.world_T_cam_44 for camera in step.cameras]),
        step.world_T_obj_N44,
        step.world_T_link_L44,
    ]
    world_T_frame = np.concatenate([pose.reshape(-1, 4, 4) for pose in poses])
    # oes.geom has this too, but loads torch, which the doctor's many processes can do without.
    quats_xyzw = Rotation.from_matrix(world_T_frame[:, :3, :3]).as_quat().tolist()
    world = header(stamp_of(step), "world")
    transforms = [
        make(
            "geometry_msgs/msg/TransformStamped",
            header=world,
            child_frame_id=name,
            transform=make(
                "geometry_msgs/msg/Transform",
                translation=vector(pose[:3, 3]),
                rotation=_quaternion(quat),
            ),
        )
        for name, pose, quat in zip(names, world_T_frame, quats_xyzw, strict=True)
    ]
    return make(SCENE_TYPES["/tf"], transforms=transforms)


def _quaternion(quat_xyzw: list[float]) -> object:
    x, y, z, w = quat_xyzw
    return make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _joints(step: Step) -> object:
    empty = np.zeros(0)
    names = [f"joint_{i}" for i in range(len(step.joints_rad_J))]
    fields = {
        "header": header(stamp_of(step), "world"),
        "name": names,
        "position": flat(step.joints_rad_J),
    }
    return make(SCENE_TYPES["/joint_states"], velocity=empty, effort=empty, **fields)


def _boxes(step: Step) -> object:
    """The hull of every object as a translucent cube."""
    stamp_ns = stamp_of(step)
    boxes = zip(step.center_N3, step.size_N3, strict=True)
    markers = [
        _cube(stamp_ns, object_i, center, size) for object_i, (center, size) in enumerate(boxes)
    ]
    return make(SCENE_TYPES["/objects/markers"], markers=markers)


def _cube(stamp_ns: int, object_i: int, center_3: Floats, size_3: Floats) -> object:
    red, green, blue, alpha = MARKER_RGBA
    no_bytes = np.zeros(0, np.uint8)
    upright = _quaternion([0.0, 0.0, 0.0, 1.0])
    return make(
        "visualization_msgs/msg/Marker",
        header=header(stamp_ns, "world"),
        ns="hull",
        id=object_i,
        type=MARKER_CUBE,
        action=0,
        pose=make(
            "geometry_msgs/msg/Pose", position=vector(center_3, "Point"), orientation=upright
        ),
        scale=vector(size_3),
        color=make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=alpha),
        lifetime=make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=make(
            "sensor_msgs/msg/CompressedImage", header=header(0, ""), format="", data=no_bytes
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=make("visualization_msgs/msg/MeshFile", filename="", data=no_bytes),
        mesh_use_embedded_materials=False,
    )


def _camera_info(stamp_ns: int, camera: Camera) -> object:
    projection_34 = np.hstack([camera.K_33, np.zeros((3, 1))])
    roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return make(
        CAMERA_INFO_TYPE,
        header=header(stamp_ns, camera.name),
        height=camera.height_px,
        width=camera.width_px,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=flat(camera.K_33),
        r=flat(np.eye(3)),
        p=flat(projection_34),
        binning_x=0,
        binning_y=0,
        roi=make("sensor_msgs/msg/RegionOfInterest", **roi),
    )
