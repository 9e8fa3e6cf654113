"""ROS 2 messages to Episode and Frames."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oes.episode import Body, Camera, Episode, Floats, Frames, Step
from oes.record.encode import MM_PER_M
from oes.record.messages import INFO, SCENE_TYPES, STATE_TOPICS, decode

ENCODINGS = {"rgb8": (np.uint8, 3), "16UC1": (np.dtype("<u2"), 1), "mono8": (np.uint8, 1)}


def episode_from(messages: Mapping[str, Sequence[memoryview]]) -> Episode:
    """An Episode from the serialized messages of its three topics, each in order.

    Raises ValueError if their number or order is not the one that EpisodeInfo announces, or an
    array has another length.
    """
    infos, states, actions = (
        [decode(SCENE_TYPES[topic], data) for data in messages[topic]] for topic in STATE_TOPICS
    )
    if len(infos) != 1:
        raise ValueError(f"{len(infos)} messages of {INFO} where one is expected")
    [info] = infos
    if [state.step_i for state in states] != list(range(info.num_steps)) or info.num_steps == 0:
        raise ValueError(f"{len(states)} states where {info.num_steps} are announced")
    if [action.step_i for action in actions] != list(range(info.num_steps - 1)):
        raise ValueError(f"{len(actions)} actions between {info.num_steps} states")
    bodies = tuple(_body(body) for body in info.bodies)
    return Episode(
        task=info.task,
        split=info.split,
        index=info.index,
        seed=info.seed,
        bodies=bodies,
        actions_T3=np.array([action.displacement_m for action in actions]).reshape(-1, 3),
        steps=tuple(_step(state, len(bodies), info.camera_names) for state in states),
        rod_rms_m=info.rod_rms_m,
    )


def frames_from(images: Sequence[Any]) -> Frames:
    """Frames from Image messages: colour, depth and segmentation of each camera in turn.

    Raises ValueError for images of another encoding or size.
    """
    rgb_VHW3, depth_mm_VHW, seg_VHW = (
        np.stack([_pixels(image, encoding) for image in images[layer_i::3]])
        for layer_i, encoding in enumerate(ENCODINGS)
    )
    return Frames(rgb_VHW3, depth_mm_VHW.astype(np.float32) / np.float32(MM_PER_M), seg_VHW)


def _body(body: Any) -> Body:
    scale_3 = np.array(body.scale)
    return Body(body.mesh, body.category, scale_3, body.mass_kg, body.friction, body.texture_seed)


def _step(state: Any, num_objects: int, camera_names: Sequence[str]) -> Step:
    objects = state.objects
    if len(objects) != num_objects:
        counts = f"{len(objects)} objects, the episode has {num_objects}"
        raise ValueError(f"state {state.step_i} has {counts}")
    num_bodies = num_objects + 2
    return Step(
        t_ns=state.t_ns,
        world_T_obj_N44=_stack([item.world_from_obj for item in objects], (num_objects, 4, 4)),
        center_N3=_stack([item.center_m for item in objects], (num_objects, 3)),
        size_N3=_stack([item.size_m for item in objects], (num_objects, 3)),
        tip_world_3=np.array(state.tip_m),
        joints_rad_J=np.array(state.joints_rad),
        world_T_link_L44=np.array(state.world_from_links).reshape(-1, 4, 4),
        contact_AA=state.touched.reshape(num_bodies, num_bodies).astype(np.bool_),
        cameras=_cameras(state, camera_names),
    )


def _stack(arrays: list[Floats], shape: tuple[int, ...]) -> Floats:
    return np.array(arrays, np.float64).reshape(shape)  # keeps the rank where there is no object


def _cameras(state: Any, names: Sequence[str]) -> tuple[Camera, ...]:
    K_V33 = np.array(state.intrinsics).reshape(len(names), 3, 3)
    world_T_cam_V44 = np.array(state.world_from_cams).reshape(len(names), 4, 4)
    widths_px, heights_px = state.widths_px.tolist(), state.heights_px.tolist()
    fields = zip(names, K_V33, world_T_cam_V44, widths_px, heights_px, strict=True)
    return tuple(Camera(*each) for each in fields)


def _pixels(image: Any, encoding: str) -> NDArray[Any]:
    """The pixels H W (or H W 3) of an Image message, a view of its bytes."""
    dtype, channels = ENCODINGS[encoding]
    if image.encoding != encoding or image.is_bigendian:
        raise ValueError(f"an image of encoding {image.encoding!r} where {encoding!r} is expected")
    shape = (image.height, image.width) + ((channels,) if channels > 1 else ())
    pixels: NDArray[Any] = image.data.view(dtype).reshape(shape)
    return pixels
