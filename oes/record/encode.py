"""Episode and Frames to ROS 2 messages."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from oes.episode import Episode, Frames, Step
from oes.record import messages as ros

EPOCH_NS = 1_000_000_000
MM_PER_M = 1000.0
MAX_DEPTH_MM = 65535


def stamp_of(step: Step) -> int:
    """Stamp of a state: simulated time after an epoch of 1 s, as players take time 0 for unset."""
    return EPOCH_NS + step.t_ns


def state_messages(episode: Episode) -> Iterator[ros.Encoded]:
    """All the messages that make an Episode: its description, its states and its actions."""
    yield ros.encode(ros.INFO, stamp_of(episode.steps[0]), _info(episode))
    for step_i, step in enumerate(episode.steps):
        yield ros.encode(ros.STATE, stamp_of(step), _state(step_i, step))
    for step_i, action in enumerate(episode.actions_T3):
        stamp_ns = stamp_of(episode.steps[step_i])
        message = ros.make(
            ros.SCENE_TYPES[ros.ACTION],
            header=ros.header(stamp_ns, "world"),
            step_i=step_i,
            displacement_m=ros.flat(action),
        )
        yield ros.encode(ros.ACTION, stamp_ns, message)


def image_messages(step: Step, frames: Frames) -> Iterator[ros.Encoded]:
    """The images of one state, camera by camera; depth in whole millimetres.

    Raises ValueError if the images do not fit the step's cameras, or a depth exceeds 16 bits.
    """
    expected = {(len(step.cameras), camera.height_px, camera.width_px) for camera in step.cameras}
    shapes = {frames.rgb_VHW3.shape[:3], frames.depth_m_VHW.shape, frames.seg_VHW.shape}
    if shapes != expected:
        raise ValueError(f"images {frames.rgb_VHW3.shape} do not fit the cameras {expected}")
    depth_mm_VHW = np.rint(frames.depth_m_VHW * np.float32(MM_PER_M))
    if not (depth_mm_VHW.min() >= 0 and depth_mm_VHW.max() <= MAX_DEPTH_MM):  # refuses NaN too
        raise ValueError(f"depth outside 0..{MAX_DEPTH_MM} mm")
    layers = (frames.rgb_VHW3, depth_mm_VHW.astype("<u2"), frames.seg_VHW)
    images = [
        _image(ros.header(stamp_of(step), camera.name), encoding, layer[camera_i])
        for camera_i, camera in enumerate(step.cameras)
        for encoding, layer in zip(("rgb8", "16UC1", "mono8"), layers, strict=True)
    ]
    topics = ros.image_topics([camera.name for camera in step.cameras])
    for topic, image in zip(topics, images, strict=True):
        yield ros.encode(topic, stamp_of(step), image)


def _info(episode: Episode) -> object:
    bodies = []
    for body in episode.bodies:
        fields = dict(vars(body))
        fields["scale"] = ros.flat(fields.pop("scale_3"))
        bodies.append(ros.make("oes_msgs/msg/Body", **fields))
    return ros.make(
        ros.SCENE_TYPES[ros.INFO],
        task=episode.task,
        split=episode.split,
        index=episode.index,
        seed=episode.seed,
        num_steps=len(episode.steps),
        rod_rms_m=episode.rod_rms_m,
        bodies=bodies,
        camera_names=[camera.name for camera in episode.steps[0].cameras],
    )


def _state(step_i: int, step: Step) -> object:
    boxes = zip(step.world_T_obj_N44, step.center_N3, step.size_N3, strict=True)
    objects = [
        ros.make(
            "oes_msgs/msg/ObjectState",
            world_from_obj=ros.flat(pose),
            center_m=ros.flat(center),
            size_m=ros.flat(size),
        )
        for pose, center, size in boxes
    ]
    return ros.make(
        ros.SCENE_TYPES[ros.STATE],
        header=ros.header(stamp_of(step), "world"),
        step_i=step_i,
        t_ns=step.t_ns,
        objects=objects,
        tip_m=ros.flat(step.tip_world_3),
        joints_rad=ros.flat(step.joints_rad_J),
        world_from_links=ros.flat(step.world_T_link_L44),
        touched=np.ascontiguousarray(step.contact_AA, np.uint8).reshape(-1),
        intrinsics=ros.flat([camera.K_33 for camera in step.cameras]),
        world_from_cams=ros.flat([camera.world_T_cam_44 for camera in step.cameras]),
        widths_px=np.array([camera.width_px for camera in step.cameras], np.uint32),
        heights_px=np.array([camera.height_px for camera in step.cameras], np.uint32),
    )


def _image(image_header: object, encoding: str, image: NDArray[np.generic]) -> object:
    return ros.make(
        ros.IMAGE_TYPE,
        header=image_header,
        height=image.shape[0],
        width=image.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=image[0].nbytes,
        data=np.ascontiguousarray(image).reshape(-1).view(np.uint8),
    )
