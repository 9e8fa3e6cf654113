"""Standard messages for ROS tools and Foxglove: transforms, joints, boxes and camera models."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from oes.episode import Camera, Floats, Step
from oes.record import messages as ros
from oes.record.encode import stamp_of

MARKER_CUBE = 1
MARKER_RGBA = (0.95, 0.55, 0.10, 0.35)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def viewer_messages(step: Step) -> Iterator[ros.Encoded]:
    """The messages of one state that ROS tools and Foxglove draw."""
    stamp_ns = stamp_of(step)
    yield ros.encode("/tf", stamp_ns, _tf(step))
    joints = ros.make(
        ros.SCENE_TYPES["/joint_states"],
        header=ros.header(stamp_ns, "world"),
        name=[f"joint_{i}" for i in range(len(step.joints_rad_J))],
        position=ros.flat(step.joints_rad_J),
        velocity=np.zeros(0),
        effort=np.zeros(0),
    )
    yield ros.encode("/joint_states", stamp_ns, joints)
    boxes = zip(step.center_N3, step.size_N3, strict=True)
    cubes = [_cube(stamp_ns, object_i, *box) for object_i, box in enumerate(boxes)]
    markers = ros.make(ros.SCENE_TYPES["/objects/markers"], markers=cubes)
    yield ros.encode("/objects/markers", stamp_ns, markers)
    for camera in step.cameras:
        for kind in ros.INFO_KINDS:
            topic = ros.image_topic(camera.name, kind)
            yield ros.encode(topic, stamp_ns, _camera_info(stamp_ns, camera))


def _tf(step: Step) -> object:
    names = [camera.name for camera in step.cameras]
    names += [f"object_{i}" for i in range(len(step.world_T_obj_N44))]
    names += [f"link_{i:02d}" for i in range(len(step.world_T_link_L44))]
    cameras = [camera.world_T_cam_44 for camera in step.cameras]
    poses = np.array([*cameras, *step.world_T_obj_N44, *step.world_T_link_L44])
    # oes.geom has this too, but loads torch, which the doctor's many processes can do without.
    quats_xyzw = Rotation.from_matrix(poses[:, :3, :3]).as_quat().tolist()
    world = ros.header(stamp_of(step), "world")
    transforms = []
    for name, pose, quat in zip(names, poses, quats_xyzw, strict=True):
        offset, rotation = ros.vector(pose[:3, 3]), _quaternion(quat)
        motion = ros.make("geometry_msgs/msg/Transform", translation=offset, rotation=rotation)
        fields = {"header": world, "child_frame_id": name, "transform": motion}
        transforms.append(ros.make("geometry_msgs/msg/TransformStamped", **fields))
    return ros.make(ros.SCENE_TYPES["/tf"], transforms=transforms)


def _quaternion(quat_xyzw: list[float] | tuple[float, ...]) -> object:
    x, y, z, w = quat_xyzw
    return ros.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _cube(stamp_ns: int, object_i: int, center_3: Floats, size_3: Floats) -> object:
    """The axis-aligned bounding box of an object as a translucent cube."""
    red, green, blue, alpha = MARKER_RGBA
    place, no_bytes = ros.vector(center_3, "Point"), np.zeros(0, np.uint8)
    no_image = {"header": ros.header(0, ""), "format": "", "data": no_bytes}
    return ros.make(
        "visualization_msgs/msg/Marker",
        header=ros.header(stamp_ns, "world"),
        ns="hull",
        id=object_i,
        type=MARKER_CUBE,
        action=0,
        pose=ros.make("geometry_msgs/msg/Pose", position=place, orientation=_quaternion(UPRIGHT)),
        scale=ros.vector(size_3),
        color=ros.make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=alpha),
        lifetime=ros.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=ros.make("sensor_msgs/msg/CompressedImage", **no_image),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=ros.make("visualization_msgs/msg/MeshFile", filename="", data=no_bytes),
        mesh_use_embedded_materials=False,
    )


def _camera_info(stamp_ns: int, camera: Camera) -> object:
    roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return ros.make(
        ros.CAMERA_INFO_TYPE,
        header=ros.header(stamp_ns, camera.name),
        height=camera.height_px,
        width=camera.width_px,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=ros.flat(camera.K_33),
        r=ros.flat(np.eye(3)),
        p=ros.flat(np.hstack([camera.K_33, np.zeros((3, 1))])),
        binning_x=0,
        binning_y=0,
        roi=ros.make("sensor_msgs/msg/RegionOfInterest", **roi),
    )
