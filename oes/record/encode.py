"""Episode and Frames to ROS 2 messages."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from oes.episode import Episode, Floats, Frames, Step
from oes.record.messages import (
    ACTION,
    IMAGE_KINDS,
    IMAGE_TYPE,
    INFO,
    SCENE_TYPES,
    STATE,
    Encoded,
    encode,
    header,
    image_topic,
    make,
)

EPOCH_NS = 1_000_000_000
MM_PER_M = 1000.0
MAX_DEPTH_MM = 65535


def stamp_of(step: Step) -> int:
    """The stamp of a state: simulated time after a fixed epoch of 1 s (players do not take time 0
    for a date).
    """
    return EPOCH_NS + step.t_ns


def state_messages(episode: Episode) -> Iterator[Encoded]:
    """Everything that makes an Episode: its description, its states and its actions."""
    yield encode(INFO, stamp_of(episode.steps[0]), SCENE_TYPES[INFO], _info(episode))
    for step_i, step in enumerate(episode.steps):
        yield encode(STATE, stamp_of(step), SCENE_TYPES[STATE], _state(step_i, step))
    for step_i, action in enumerate(episode.actions_T3):
        stamp_ns = stamp_of(episode.steps[step_i])
        fields = {
            "header": header(stamp_ns, "world"),
            "step_i": step_i,
            "displacement_m": flat(action),
        }
        yield encode(ACTION, stamp_ns, SCENE_TYPES[ACTION], make(SCENE_TYPES[ACTION], **fields))


def image_messages(step: Step, frames: Frames) -> Iterator[Encoded]:
    """The images of one state, camera by camera; depth in whole millimetres.

    Raises ValueError where the images do not fit the step's cameras, or a depth does not fit 16
    bits.
    """
    sizes = {(len(step.cameras), camera.height_px, camera.width_px) for camera in step.cameras}
    if (
        not sizes
        == {frames.rgb_VHW3.shape[:3]}
        == {frames.depth_m_VHW.shape}
        == {frames.seg_VHW.shape}
    ):
        raise ValueError(f"images {frames.rgb_VHW3.shape} do not fit the cameras {sizes}")
    depth_mm_VHW = np.rint(frames.depth_m_VHW * np.float32(MM_PER_M))
    if not (depth_mm_VHW.min() >= 0 and depth_mm_VHW.max() <= MAX_DEPTH_MM):
        raise ValueError(f"depth outside 0..{MAX_DEPTH_MM} mm")
    images = (frames.rgb_VHW3, depth_mm_VHW.astype("<u2"), frames.seg_VHW)
    for camera_i, camera in enumerate(step.cameras):
        for kind, encoding, image in zip(
            IMAGE_KINDS, ("rgb8", "16UC1", "mono8"), images, strict=True
        ):
            message = _image(header(stamp_of(step), camera.name), encoding, image[camera_i])
            yield encode(image_topic(camera.name, kind), stamp_of(step), IMAGE_TYPE, message)


def flat(values: Floats) -> Floats:
    """Flat, contiguous float64."""
    return np.ascontiguousarray(values, np.float64).reshape(-1)


def _info(episode: Episode) -> object:
    bodies = [
        make(
            "oes_msgs/msg/Body",
            mesh=body.mesh,
            category=body.category,
            scale=flat(body.scale_3),
            mass_kg=body.mass_kg,
            friction=body.friction,
            texture_seed=body.texture_seed,
        )
        for body in episode.bodies
    ]
    return make(
        SCENE_TYPES[INFO],
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
    objects = [
        make(
            "oes_msgs/msg/ObjectState",
            world_from_obj=flat(pose),
            center_m=flat(center),
            size_m=flat(size),
        )
        for pose, center, size in zip(
            step.world_T_obj_N44, step.center_N3, step.size_N3, strict=True
        )
    ]
    cameras = step.cameras
    return make(
        SCENE_TYPES[STATE],
        header=header(stamp_of(step), "world"),
        step_i=step_i,
        t_ns=step.t_ns,
        objects=objects,
        tip_m=flat(step.tip_world_3),
        joints_rad=flat(step.joints_rad_J),
        world_from_links=flat(step.world_T_link_L44),
        touched=np.ascontiguousarray(step.contact_AA, np.uint8).reshape(-1),
        intrinsics=flat(np.array([camera.K_33 for camera in cameras])),
        world_from_cams=flat(np.array([camera.world_T_cam_44 for camera in cameras])),
        widths_px=np.array([camera.width_px for camera in cameras], np.uint32),
        heights_px=np.array([camera.height_px for camera in cameras], np.uint32),
    )


def _image(
    image_header: object, encoding: str, image: NDArray[np.uint8] | NDArray[np.uint16]
) -> object:
    return make(
        IMAGE_TYPE,
        header=image_header,
        height=image.shape[0],
        width=image.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=image[0].nbytes,
        data=np.ascontiguousarray(image).reshape(-1).view(np.uint8),
    )
