"""Analytic scenes for tests of perception: ray-cast coloured boxes on a table, in memory."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import cast

import numpy as np
import trimesh

from oes.episode import Body, Camera, Episode, Frames, Step
from oes.geom.boxes import aabb
from oes.geom.camera import intrinsics, look_at
from oes.geom.se3 import inverse, rigid, rotation_z, transform
from oes.geom.voxels import Grid
from oes.meshes.catalogue import Catalogue
from oes.perception.decoder import BackgroundConfig, DecoderConfig
from oes.perception.detector import DetectorConfig
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.lift import LiftConfig
from oes.perception.network import PerceptionNetConfig
from oes.perception.roi import RoiConfig
from oes.perception.samples import Sampling
from oes.perception.solids import Solids, sample_surface, solid_points
from oes.perception.surface import Cylinder, SurfaceHeadConfig

SIZES = {"brick": (0.12, 0.06, 0.06), "tile": (0.1, 0.1, 0.04)}
GRID = Grid(min_m=(-0.32, -0.32, -0.04), shape=(64, 64, 32), voxel_m=0.01)
CYLINDER = Cylinder(
    num_directions=32, num_radii=24, radial_step_m=0.004, num_layers=4, layer_height_m=0.02
)
TABLE = (
    np.array([0.6, 0.6, 0.04]),
    rigid(np.eye(3), np.array([0.0, 0.0, -0.02])),
    np.array([150, 140, 130]),
)


def cameras(count: int = 6, size_px: int = 64) -> tuple[Camera, ...]:
    """Cameras 1 m from the table, spread over azimuths, elevations 25 to 55 degrees."""
    result = []
    for camera_i, azimuth in enumerate(np.linspace(-1.5, 1.5, count)):
        elevation = np.radians(25 + 15 * (camera_i % 3))
        level = np.cos(elevation)
        eye = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
        target = np.array([0.0, 0.0, 0.1])
        pose = look_at(eye + target, target)
        result.append(
            Camera(
                f"cam_{camera_i:02d}", intrinsics(42.0, size_px, size_px), pose, size_px, size_px
            )
        )
    return tuple(result)


def ray_cast(
    camera: Camera, solids: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """RGB and z-depth of boxes given by size, world_T_box and colour, on a black background."""
    v, u = np.meshgrid(
        np.arange(camera.height_px) + 0.5, np.arange(camera.width_px) + 0.5, indexing="ij"
    )
    rays_cam = (
        np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3) @ np.linalg.inv(camera.K_33).T
    )
    depth, rgb = np.full(len(rays_cam), np.inf), np.zeros((len(rays_cam), 3))
    for size, world_T_box, color in solids:
        box_T_cam = inverse(world_T_box) @ camera.world_T_cam_44
        origin, ray = box_T_cam[:3, 3], rays_cam @ box_T_cam[:3, :3].T
        hits = np.sort(np.stack([(-size / 2 - origin) / ray, (size / 2 - origin) / ray]), axis=0)
        near, far = hits[0].max(axis=1), hits[1].min(axis=1)
        is_nearer = (near < far) & (near > 0) & (near < depth)
        depth[is_nearer], rgb[is_nearer] = near[is_nearer], color
    depth[np.isinf(depth)] = 0
    shape = (camera.height_px, camera.width_px)
    return rgb.reshape(*shape, 3).astype(np.uint8), depth.reshape(shape).astype(np.float32)


class BoxWorld:
    """A source in memory of one-state episodes with one or two boxes each, side by side."""

    def __init__(self, count: int, seed: int = 0, size_px: int = 64) -> None:
        self.episodes = [
            _episode(np.random.default_rng((seed, i)), i, size_px) for i in range(count)
        ]

    def read(
        self, episode_i: int, step_i: int, camera_is: Sequence[int]
    ) -> tuple[Frames, tuple[Camera, ...]]:
        """Ray-cast images of one state, and their cameras."""
        episode = self.episodes[episode_i]
        step = episode.steps[step_i]
        cameras = tuple(step.cameras[i] for i in camera_is)
        colors = [
            np.random.default_rng(body.texture_seed).integers(60, 255, 3) for body in episode.bodies
        ]
        sizes = [np.array(SIZES[body.mesh]) for body in episode.bodies]
        images = [
            ray_cast(camera, [TABLE, *zip(sizes, step.world_T_obj_N44, colors, strict=True)])
            for camera in cameras
        ]
        rgb, depth = (np.stack(values) for values in zip(*images, strict=True))
        return Frames(rgb, depth, np.zeros(depth.shape, np.uint8)), cameras


def box_solids(count: int = 2048) -> Solids:
    """Point clouds that fill the two meshes."""
    boxes = {name: trimesh.creation.box(size) for name, size in SIZES.items()}
    return Solids(
        {name: solid_points(box, (box,), count) for name, box in boxes.items()},
        {name: sample_surface(box, count) for name, box in boxes.items()},
    )


def box_gt_profiles() -> GroundTruthProfiles:
    """Ground-truth radial profiles of the two meshes."""
    meshes = {
        name: SimpleNamespace(visual=trimesh.creation.box(size), com_obj_3=np.zeros(3))
        for name, size in SIZES.items()
    }
    return GroundTruthProfiles(cast(Catalogue, SimpleNamespace(meshes=meshes)), CYLINDER)


def small_network() -> PerceptionNetConfig:
    """A network that runs in milliseconds: its scene map has voxels of 2 cm."""
    return PerceptionNetConfig(
        grid=Grid(min_m=GRID.min_m, shape=(32, 32, 16), voxel_m=0.02),
        lift=LiftConfig(truncation_m=0.03),
        image_features=2,
        channels=(16, 32),
        blocks=(1, 1),
        map_features=4,
        detector=DetectorConfig(
            channels=16, anchor_m=0.12, sigma_m=0.04, num_peaks=4, min_score=0.3, max_iou=0.25
        ),
        roi=RoiConfig(count=16, voxel_m=0.01, channels=(16, 32), blocks=(1, 1), hidden=32),
        decoder=DecoderConfig(
            stride_px=2,
            num_samples=16,
            channels=16,
            background=BackgroundConfig(
                grid=Grid(min_m=(-0.8, -0.8, -0.3), shape=(16, 16, 12), voxel_m=0.1),
                lift=LiftConfig(truncation_m=0.15),
                channels=(8, 16),
                blocks=(1, 1),
                num_samples=4,
            ),
        ),
        surface=SurfaceHeadConfig(
            cylinder=CYLINDER, channels=(8, 8), width=16, direction_features=16
        ),
    )


def sampling() -> Sampling:
    """One or two views, and small random transforms of the world."""
    return Sampling(
        views_share=(0.5, 0.5),
        center_jitter_m=0.01,
        size_jitter=0.1,
        scale=(0.9, 1.1),
        shift_m=0.03,
    )


def _episode(rng: np.random.Generator, index: int, size_px: int) -> Episode:
    count = int(rng.integers(1, 3))
    names = rng.choice(list(SIZES), count).tolist()
    side = [-1.0, 1.0]  # of the table, so that boxes do not overlap
    poses = [
        rigid(
            rotation_z(rng.uniform(0, 3)),
            np.array(
                [rng.uniform(-0.15, 0.15), side[i] * rng.uniform(0.08, 0.16), SIZES[name][2] / 2]
            ),
        )
        for i, name in enumerate(names)
    ]
    boxes = [aabb(transform(pose, _corners(name))) for name, pose in zip(names, poses, strict=True)]
    bodies = tuple(
        Body(name, "box", np.ones(3), 0.2, 0.5, int(rng.integers(1000))) for name in names
    )
    step = Step(
        t_ns=0,
        world_T_obj_N44=np.stack(poses),
        center_N3=np.stack([center for center, _ in boxes]),
        size_N3=np.stack([size for _, size in boxes]),
        tip_world_3=np.zeros(3),
        joints_rad_J=np.zeros(7),
        world_T_link_L44=np.zeros((0, 4, 4)),
        contact_AA=np.zeros((count + 2, count + 2), dtype=bool),
        cameras=cameras(size_px=size_px),
    )
    return Episode("pushing", "train", index, 0, bodies, np.zeros((0, 3)), (step,), 0.0)


def _corners(name: str) -> np.ndarray:
    return np.asarray(trimesh.creation.box(SIZES[name]).vertices)
