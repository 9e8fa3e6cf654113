"""Volume rendering: the expected depth of rays through known solids equals the true depth."""

import numpy as np
import torch

from oes.geom.se3 import inverse, transform
from oes.geom.voxels import centers
from oes.perception.lift import camera_matrices
from oes.perception.rays import (
    Field,
    alpha_composite,
    camera_rays,
    ray_box_intersection,
    sample_along_rays,
)
from tests.perception_scenes import GRID, SIZES, TABLE, BoxWorld


def test_expected_depth_equals_the_depth_image() -> None:
    world = BoxWorld(1, seed=3)
    episode = world.episodes[0]
    frames, (camera,) = world.read(0, 0, [2])
    voxels = centers(GRID).reshape(-1, 3).double().numpy()
    poses = zip(episode.bodies, episode.steps[0].world_T_obj_N44, strict=True)
    is_solid = np.zeros(len(voxels), dtype=bool)
    for size, pose in [TABLE[:2], *((np.array(SIZES[body.mesh]), pose) for body, pose in poses)]:
        is_solid |= (np.abs(transform(inverse(pose), voxels)) <= size / 2).all(axis=1)
    density = torch.from_numpy(np.where(is_solid, 60.0, -60.0)).float().reshape(1, 1, *GRID.shape)
    K, pose = camera_matrices([camera])
    rays = camera_rays(K, pose, (64, 64), 1)
    field = Field(torch.cat([density, density], dim=1), GRID)
    _, distance, opacity = alpha_composite(
        *sample_along_rays(field, rays, ray_box_intersection(rays, GRID), 128)
    )
    depth = (distance * (rays.direction_BP3[0] @ pose[0, :3, 2])).reshape(64, 64)
    true_depth = torch.from_numpy(frames.depth_m_VHW[0])
    both = (opacity.reshape(64, 64) > 0.99) & (true_depth > 0)
    assert both.float().mean() > 0.25
    assert (depth - true_depth)[both].abs().median() < 0.006


def test_opaque_samples_occlude_later_ones_and_free_space_is_transparent() -> None:
    features = torch.tensor([1.0, 2.0, 3.0]).reshape(1, 1, 3, 1)
    distance = torch.tensor([0.5, 1.0, 1.5]).reshape(1, 1, 3)
    thickness = torch.tensor([0.0, 50.0, 50.0]).reshape(1, 1, 3)
    feature, depth, opacity = alpha_composite(features, thickness, distance)
    result = torch.stack([feature[0, 0, 0], depth[0, 0], opacity[0, 0]])
    torch.testing.assert_close(result, torch.tensor([2.0, 1.0, 1.0]))
    assert alpha_composite(features, torch.zeros(1, 1, 3), distance)[2].item() == 0
