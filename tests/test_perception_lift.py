"""The lift: signed distances, free space and features at points around rendered boxes."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from oes.episode import Frames
from oes.geom.se3 import transform
from oes.geom.voxels import centers
from oes.objects import map_tensors
from oes.perception.lift import LiftConfig, Views, lift, views_of
from oes.perception.samples import IDENTITY, Sampler, random_world_transform
from tests.perception_scenes import GRID, BoxWorld, box_solids, sampling

CFG = LiftConfig(truncation_m=0.03)


def lifted(views: Views, points: torch.Tensor) -> torch.Tensor:
    return lift(CFG, views, views.rgb_BVHW3, points)


def test_points_in_front_of_on_and_behind_a_surface_are_distinguished() -> None:
    world = BoxWorld(1)
    step = world.episodes[0].steps[0]
    views = views_of(*world.read(0, 0, [1]))
    top = step.center_N3[0] + [0, 0, step.size_N3[0, 2] / 2]
    eye = step.cameras[1].world_T_cam_44[:3, 3]
    ray = (eye - top) / np.linalg.norm(eye - top)
    points = torch.tensor(np.stack([top + 0.1 * ray, top, top - 0.045 * ray])).float()[None]
    distance, near, free, unobserved = lifted(views, points)[0, :, :4].unbind(-1)
    assert distance[0] == 1 and free.tolist() == [1, 0, 0]
    assert abs(float(distance[1])) < 0.25 and near[1] > 0.75
    assert unobserved.tolist() == [0, 0, 1]


def test_surface_voxels_carry_the_colour_of_the_box() -> None:
    world = BoxWorld(1)
    episode = world.episodes[0]
    color = np.random.default_rng(episode.bodies[0].texture_seed).integers(60, 255, 3) / 255
    top = episode.steps[0].center_N3[0] + [0, 0, episode.steps[0].size_N3[0, 2] / 2]
    result = lifted(views_of(*world.read(0, 0, [1, 2])), torch.tensor(top).float()[None, None])[
        0, 0
    ]
    np.testing.assert_allclose(result[4:], color, atol=0.02)


def test_interpolated_depth_of_a_plane_is_exact() -> None:
    world = BoxWorld(1)
    step = world.episodes[0].steps[0]
    views = views_of(*world.read(0, 0, [1]))
    center, size = step.center_N3[0], step.size_N3[0]
    inner = np.linspace(center - size / 5, center + size / 5, 23)
    top = torch.tensor(
        np.column_stack([inner[:, :2], np.full(len(inner), center[2] + size[2] / 2)])
    ).float()[None]
    nearest, interpolated = (
        lift(CFG, views, views.rgb_BVHW3, top, interpolate_depth=flag)[..., 0].abs()
        * CFG.truncation_m
        for flag in (False, True)
    )
    assert interpolated.max() < 1e-5
    assert nearest.max() > 1e-3


def test_interpolated_depth_keeps_edges_sharp() -> None:
    world = BoxWorld(1)
    views = views_of(*world.read(0, 0, [1]))
    depth = torch.full_like(views.depth_m_BVHW, 0.8)
    middle = depth.shape[-1] // 2
    depth[..., middle:] = 1.0
    edge = replace(views, depth_m_BVHW=depth)
    rays = torch.tensor([[middle + du, 20.2, 1.0] for du in (-1.1, -0.1, 0.1, 1.1)])
    points_cam = rays @ torch.linalg.inv(views.K_BV33[0, 0]).mT * 0.9
    points_world = transform(views.world_T_cam_BV44[:, 0], points_cam[None])
    result = lift(CFG, edge, views.rgb_BVHW3, points_world, interpolate_depth=True)[0]
    # Occluded by the near side, free in front of the far side.
    assert result[:, 3].tolist() == [1, 1, 0, 0]
    assert result[:, 2].tolist() == [0, 0, 1, 1]


def test_the_order_of_views_does_not_matter_and_scenes_are_independent() -> None:
    world = BoxWorld(2)
    points = centers(GRID)[::3, ::3, ::3].reshape(1, -1, 3)
    one, other = views_of(*world.read(0, 0, [0, 3, 5])), views_of(*world.read(0, 0, [5, 0, 3]))
    torch.testing.assert_close(lifted(one, points), lifted(other, points), atol=1e-5, rtol=0)
    second = views_of(*world.read(1, 0, [1, 2, 4]))
    both = map_tensors(one, lambda *x: torch.cat(x), second)
    batched = lifted(both, points.expand(2, -1, -1))
    torch.testing.assert_close(batched[0], lifted(one, points)[0], atol=1e-5, rtol=0)
    torch.testing.assert_close(batched[1], lifted(second, points)[0], atol=1e-5, rtol=0)


def test_the_lift_is_equivariant_to_world_transforms() -> None:
    world, rng = BoxWorld(1), np.random.default_rng(3)
    sampler = Sampler(sampling(), 1, 0, 0, GRID, world, box_solids(), [0])
    motion = random_world_transform(sampler.cfg, rng)
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (500, 3)) * [1, 1, 0.4] + [0, 0, 0.05]
    original = sampler.sample(0, 0, [0, 2], IDENTITY, rng).views
    transformed = sampler.sample(0, 0, [0, 2], motion, rng).views
    scaled = LiftConfig(truncation_m=CFG.truncation_m * motion.scale)
    before = lift(CFG, original, original.rgb_BVHW3, torch.tensor(points).float()[None])
    moved = torch.tensor(motion.points(points)).float()[None]
    after = lift(scaled, transformed, transformed.rgb_BVHW3, moved)
    assert ((before - after).abs().amax(-1) < 1e-3).float().mean() > 0.98


def test_missing_cameras_or_images_are_rejected() -> None:
    frames, cameras = BoxWorld(1).read(0, 0, [0, 1])
    with pytest.raises(ValueError, match="2 images for 1 cameras"):
        views_of(frames, cameras[:1])
    with pytest.raises(ValueError, match="at least one"):
        views_of(Frames(frames.rgb_VHW3[:0], frames.depth_m_VHW[:0], frames.seg_VHW[:0]), ())
