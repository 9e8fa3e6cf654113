"""View prediction: rays composited through a map of known solids end where the image's depth
says.
"""

import numpy as np
import torch

from oes.geom.se3 import inverse, transform
from oes.geom.voxels import centers
from oes.perception.rays import (
    Field,
    alpha_composite,
    camera_rays,
    ray_box_intersection,
    sample_along_rays,
)
from tests.perception_scenes import GRID, SIZES, TABLE, BoxWorld


def test_rays_stop_at_the_surfaces_that_the_camera_sees() -> None:
    world = BoxWorld(1, seed=3)
    episode = world.episodes[0]
    frames, (camera,) = world.read(0, 0, [2])
    voxels = centers(GRID).reshape(-1, 3).double().numpy()
    poses = zip(episode.bodies, episode.steps[0].world_T_obj_N44, strict=True)
    is_solid = np.zeros(len(voxels), dtype=bool)
    for size, pose in [TABLE[:2], *((np.array(SIZES[body.mesh]), pose) for body, pose in poses)]:
        is_solid |= (np.abs(transform(inverse(pose), voxels)) <= size / 2).all(axis=1)
    density = torch.from_numpy(np.where(is_solid, 60.0, -60.0)).float().reshape(1, 1, *GRID.shape)
    K, pose = (
        torch.from_numpy(camera.K_33).float()[None],
        torch.from_numpy(camera.world_T_cam_44).float()[None],
    )
    rays = camera_rays(K, pose, (64, 64), 1)
    field = Field(torch.cat([density, density], dim=1), GRID)
    _, distance, opacity = alpha_composite(
        *sample_along_rays(field, rays, ray_box_intersection(rays, GRID), 128)
    )
    depth = (distance * (rays.direction_BP3[0] @ pose[0, :3, 2])).reshape(64, 64)
    seen = torch.from_numpy(frames.depth_m_VHW[0])
    both = (opacity.reshape(64, 64) > 0.99) & (seen > 0)
    assert both.float().mean() > 0.25
    assert (depth - seen)[both].abs().median() < 0.006


def test_what_stands_in_front_hides_what_stands_behind_and_nothing_lets_all_through() -> None:
    features = torch.tensor([1.0, 2.0, 3.0]).reshape(1, 1, 3, 1)
    distance = torch.tensor([0.5, 1.0, 1.5]).reshape(1, 1, 3)
    seen, far, opacity = alpha_composite(
        features, torch.tensor([0.0, 50.0, 50.0]).reshape(1, 1, 3), distance
    )
    torch.testing.assert_close(
        torch.stack([seen[0, 0, 0], far[0, 0], opacity[0, 0]]), torch.tensor([2.0, 1.0, 1.0])
    )
    assert alpha_composite(features, torch.zeros(1, 1, 3), distance)[2].item() == 0
