"""Small random episodes for tests."""

import numpy as np

from oes.episode import SEG_FIRST_OBJECT, SEG_TABLE, Body, Camera, Episode, Frames, Step
from oes.geom.camera import intrinsics, look_at
from oes.geom.se3 import rigid, rotation_z

NUM_CAMERAS, NUM_LINKS, NUM_JOINTS = 27, 9, 7
HOLES = 0.05


def make_episode(
    seed: int = 0, num_steps: int = 3, num_objects: int = 2, size_px: int = 32
) -> Episode:
    """A random episode of 27 cameras whose every field has a value of its own."""
    rng = np.random.default_rng(seed)
    bodies = tuple(
        Body(
            f"mesh_{i}",
            "mug",
            rng.uniform(0.8, 1.2, 3),
            rng.uniform(0.1, 1),
            rng.uniform(0.3, 0.9),
            texture_seed=i + 5,
        )
        for i in range(num_objects)
    )
    steps = tuple(_step(rng, step_i, num_objects, size_px) for step_i in range(num_steps))
    actions_T3 = rng.uniform(-0.06, 0.06, (num_steps - 1, 3)) * [1, 1, 0]
    return Episode(
        "pushing",
        "train",
        7 + seed,
        seed,
        bodies,
        actions_T3,
        steps,
        rod_rms_m=rng.uniform(0, 0.003),
    )


def make_frames(episode: Episode, seed: int = 0) -> list[Frames]:
    """Images of every step: noisy colour, depth in whole millimetres with holes, segmentation with
    every id.
    """
    rng = np.random.default_rng(seed)
    shape = (
        len(episode.steps[0].cameras),
        episode.steps[0].cameras[0].height_px,
        episode.steps[0].cameras[0].width_px,
    )
    return [_frames(rng, shape, len(episode.bodies)) for _ in episode.steps]


def _step(rng: np.random.Generator, step_i: int, num_objects: int, size_px: int) -> Step:
    poses = [
        rigid(rotation_z(rng.uniform(-3, 3)), rng.uniform(-0.2, 0.2, 3))
        for _ in range(num_objects + NUM_LINKS)
    ]
    touched = rng.random((num_objects + 2, num_objects + 2)) < (0.3 if step_i else 0.0)
    K_33 = intrinsics(42.0, size_px, size_px)
    cameras = tuple(
        Camera(f"cam_{i:02d}", K_33, _pose(rng), size_px, size_px) for i in range(NUM_CAMERAS)
    )
    return Step(
        t_ns=step_i * 200_000_000,
        world_T_obj_N44=np.array(poses[:num_objects]).reshape(num_objects, 4, 4),
        center_N3=rng.uniform(-0.2, 0.2, (num_objects, 3)),
        size_N3=rng.uniform(0.05, 0.1, (num_objects, 3)),
        tip_world_3=rng.uniform(-0.2, 0.2, 3),
        joints_rad_J=rng.uniform(-2, 2, NUM_JOINTS),
        world_T_link_L44=np.array(poses[num_objects:]),
        contact_AA=touched | touched.T,
        cameras=cameras,
    )


def _pose(rng: np.random.Generator) -> np.ndarray:
    azimuth, elevation = rng.uniform(-1.5, 1.5), rng.uniform(0.3, 1.0)
    direction = np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    target = np.array([0.0, 0.0, 0.1])
    return look_at(target + direction, target)


def _frames(rng: np.random.Generator, shape: tuple[int, int, int], num_objects: int) -> Frames:
    num_views, height, width = shape
    ramp = np.add.outer(np.arange(height), np.arange(width))
    color = (
        rng.integers(0, 255, (num_views, 1, 1, 3))
        + ramp[None, :, :, None]
        + rng.integers(0, 40, (*shape, 3))
    )
    depth_mm = rng.integers(600, 1400, (num_views, 1, 1)) + ramp
    seg = np.full(shape, SEG_TABLE, np.uint8)
    for object_i in range(num_objects):
        row = rng.integers(0, height // 2)
        seg[:, row : row + height // 4, : width // 2] = SEG_FIRST_OBJECT + object_i
    holes = rng.random(shape) < HOLES
    depth_m = np.where(holes, 0, depth_mm).astype(np.float32) / np.float32(1000)
    return Frames((color % 256).astype(np.uint8), depth_m, np.where(holes, 0, seg).astype(np.uint8))
