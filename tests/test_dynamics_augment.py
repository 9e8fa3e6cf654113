"""Augmentation maps scenes consistently: checked on shapes, points and cameras of known motion."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from oes.dynamics.augment import Augment, DynamicsBatch, augment, rotate_flip, transform_batch
from oes.geom.camera import intrinsics, look_at, project
from oes.geom.se3 import rigid, rotation_z
from oes.objects import Objects
from tests.test_dynamics_models import make_actions, make_objects

VOXEL_M = 0.01


def make_batch(objects: Objects) -> DynamicsBatch:
    scenes, num = objects.valid_N.shape
    tip, actions = make_actions(scenes)
    g = torch.Generator().manual_seed(3)
    rotations = [
        torch.from_numpy(rotation_z(float(a))).float()
        for a in torch.rand(scenes * 5 * num, generator=g)
    ]
    translation = torch.randn(scenes, 5, num, 3, generator=g) * 0.05
    return DynamicsBatch(
        objects, tip, actions, translation, torch.stack(rotations).reshape(scenes, 5, num, 3, 3)
    )


def blob(offset_m: Tensor) -> Tensor:
    """A 16^3 crop with a Gaussian of 2 cm at ``offset_m`` from its centre."""
    line = (torch.arange(16) + 0.5 - 8) * VOXEL_M
    grid = torch.stack(torch.meshgrid(line, line, line, indexing="ij"), -1)
    return torch.exp(-((grid - offset_m).square().sum(-1)) / (2 * 0.02**2))


def center_of_mass(crop: Tensor) -> Tensor:
    """Centre of mass of a crop, metres from its centre."""
    line = (torch.arange(16) + 0.5 - 8) * VOXEL_M
    grid = torch.stack(torch.meshgrid(line, line, line, indexing="ij"), -1)
    return (crop[..., None] * grid).sum((0, 1, 2)) / crop.sum()


def test_without_rotation_mirror_and_shift_nothing_changes() -> None:
    batch = make_batch(make_objects())
    same = augment(
        batch,
        Augment(rotate=False, mirror=False, shift_sigma_m=0.0),
        VOXEL_M,
        torch.Generator().manual_seed(0),
    )
    for name, value in vars(batch.objects).items():
        torch.testing.assert_close(getattr(same.objects, name), value, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(same.translation_BTN3, batch.translation_BTN3)


def test_the_crop_rotates_with_the_world_and_moves_against_the_shift() -> None:
    offset, shift = torch.tensor([0.03, -0.01, 0.02]), torch.tensor([0.01, 0.02, 0.0])
    objects = make_objects(scenes=2, num=1)
    objects = replace(objects, crop_NCXYZ=blob(offset).expand(2, 1, 1, 16, 16, 16))
    M = rotate_flip(torch.tensor([0.6, 2.0]), torch.tensor([False, True]))
    found = transform_batch(make_batch(objects), M, shift.expand(2, 1, 3), VOXEL_M)
    for i in range(2):
        expected = M[i] @ (offset - shift)
        torch.testing.assert_close(
            center_of_mass(found.objects.crop_NCXYZ[i, 0, 0]), expected, atol=1e-3, rtol=0
        )
        torch.testing.assert_close(
            found.objects.center_N3[i, 0], M[i] @ (objects.center_N3[i, 0] + shift)
        )


def test_moving_a_body_commutes_with_mapping_the_world() -> None:
    """Moving a point and then mapping it equals mapping it and moving it by the new motion."""
    batch = make_batch(make_objects())
    M = rotate_flip(torch.tensor([0.6, 2.0, -1.0]), torch.tensor([False, True, True]))
    shift = torch.randn(3, 3, 3) * 0.01
    found = transform_batch(batch, M, shift, VOXEL_M)
    point = torch.tensor([0.02, -0.03, 0.05])
    old_center, new_center = batch.objects.center_N3, found.objects.center_N3
    old = (batch.rotation_BTN33 @ (point - old_center)[:, None, ..., None])[..., 0]
    old = old + old_center[:, None] + batch.translation_BTN3
    mapped = (M @ point)[:, None]
    new = (found.rotation_BTN33 @ (mapped - new_center)[:, None, ..., None])[..., 0]
    new = new + new_center[:, None] + found.translation_BTN3
    torch.testing.assert_close(new, old @ M[:, None].mT, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(
        torch.linalg.det(found.rotation_BTN33), torch.ones(3, 5, 3), atol=1e-5, rtol=0
    )
    torch.testing.assert_close(found.tip_B3, (M @ batch.tip_B3[..., None])[..., 0])


def test_mapped_cameras_see_the_mapped_world_in_the_flipped_image() -> None:
    K, width = intrinsics(42.0, 128, 128), 128
    world_T_cam = look_at(np.array([0.8, 0.3, 0.6]), np.array([0.0, 0.0, 0.1]))
    objects = make_objects(scenes=2)
    rows = torch.from_numpy(world_T_cam[:3].reshape(12)).float()
    objects = replace(objects, camera_NV12=rows.expand(objects.camera_NV12.shape))
    flip = torch.tensor([False, True])
    M = rotate_flip(torch.tensor([0.6, 2.0]), flip)
    found = transform_batch(make_batch(objects), M, torch.zeros(2, 3, 3), VOXEL_M)
    point = np.array([[0.05, 0.1, 0.03]])
    (uv,), (depth,) = project(K, world_T_cam, point)
    for i in range(2):
        pose = found.objects.camera_NV12[i, 0, 0].double().numpy().reshape(3, 4)
        assert np.linalg.det(pose[:, :3]) > 0
        (uv_new,), (depth_new,) = project(
            K, rigid(pose[:, :3], pose[:, 3]), point @ M[i].double().numpy().T
        )
        np.testing.assert_allclose(uv_new, [width - uv[0], uv[1]] if flip[i] else uv, atol=1e-3)
        np.testing.assert_allclose(depth_new, depth, atol=1e-5)
    torch.testing.assert_close(found.objects.image_NV3HW[1], objects.image_NV3HW[1].flip(-1))
    torch.testing.assert_close(found.objects.image_NV3HW[0], objects.image_NV3HW[0])
