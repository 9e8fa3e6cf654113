"""Group axioms of rigid motions, project(unproject) = identity, hand-computed box overlaps."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from oes.geom.boxes import aabb, iou, support_height
from oes.geom.camera import intrinsics, look_at, project, unproject
from oes.geom.se3 import from_quat_xyzw, inverse, quat_xyzw, rigid, rotation_z, transform

RNG = np.random.default_rng(7)


def random_transforms(count: int) -> np.ndarray:
    return rigid(Rotation.random(count, random_state=3).as_matrix(), RNG.normal(size=(count, 3)))


def test_inverse_composes_to_identity_for_numpy_and_torch() -> None:
    world_T_obj = random_transforms(20)
    np.testing.assert_allclose(
        inverse(world_T_obj) @ world_T_obj, np.tile(np.eye(4), (20, 1, 1)), atol=1e-12
    )
    same = inverse(torch.from_numpy(world_T_obj))
    np.testing.assert_allclose(same.numpy(), inverse(world_T_obj), atol=1e-12)


def test_transform_is_associative_with_composition() -> None:
    a_T_b, b_T_c = random_transforms(2)
    points = RNG.normal(size=(50, 3))
    np.testing.assert_allclose(
        transform(a_T_b @ b_T_c, points), transform(a_T_b, transform(b_T_c, points)), atol=1e-12
    )


def test_rotation_z_is_counter_clockwise_seen_from_above() -> None:
    np.testing.assert_allclose(rotation_z(np.pi / 2) @ [1.0, 0.0, 0.5], [0.0, 1.0, 0.5], atol=1e-12)


def test_quaternions_round_trip_with_the_real_part_last() -> None:
    R = Rotation.random(9, random_state=1).as_matrix().reshape(3, 3, 3, 3)
    np.testing.assert_allclose(from_quat_xyzw(quat_xyzw(R)), R, atol=1e-12)
    np.testing.assert_allclose(quat_xyzw(np.eye(3)), [0, 0, 0, 1], atol=1e-12)


def test_the_target_of_look_at_projects_to_the_image_centre_with_up_upwards() -> None:
    K = intrinsics(42.0, 128, 128)
    eye, target = np.array([0.5, -0.6, 0.8]), np.array([0.0, 0.0, 0.1])
    uv, depth = project(
        K, look_at(eye, target), np.stack([target, target + np.array([0, 0, 0.05])])
    )
    np.testing.assert_allclose(uv[0], [64, 64], atol=1e-9)
    assert depth[0] == pytest.approx(np.linalg.norm(target - eye))
    assert uv[1, 1] < 64


def test_a_vertical_line_of_sight_is_refused() -> None:
    with pytest.raises(ValueError, match="vertical"):
        look_at(np.array([0.0, 0.0, 1.0]), np.zeros(3))


def test_project_undoes_unproject_at_every_pixel_centre() -> None:
    K, world_T_cam = (
        intrinsics(42.0, 16, 12),
        look_at(np.array([1.0, 0.2, 0.7]), np.array([0.0, 0.0, 0.1])),
    )
    depth = torch.rand(12, 16, dtype=torch.float64) + 0.5
    points = unproject(torch.from_numpy(K), torch.from_numpy(world_T_cam), depth)
    uv, z = project(K, world_T_cam, points.reshape(-1, 3).numpy())
    v, u = np.meshgrid(np.arange(12) + 0.5, np.arange(16) + 0.5, indexing="ij")
    np.testing.assert_allclose(uv, np.stack([u, v], axis=-1).reshape(-1, 2), atol=1e-9)
    np.testing.assert_allclose(z, depth.flatten().numpy(), atol=1e-12)


def test_boxes_whose_bottom_is_near_the_table_stand_on_it() -> None:
    center, size = torch.tensor([[0.0, 0.0, 0.03]]).repeat(4, 1), torch.zeros(4, 3)
    size[:, 2] = torch.tensor([0.07, 0.06, 0.04, 0.03])
    torch.testing.assert_close(support_height(center, size), torch.tensor([0.0, 0.0, 0.0, 0.015]))


def test_aabb_and_iou_match_hand_computed_boxes() -> None:
    center, size = aabb(np.array([[0.0, 0, 0], [2, 4, 6], [1, 1, 1]]))
    np.testing.assert_allclose((center, size), ([1, 2, 3], [2, 4, 6]))
    unit = np.ones(3)
    shifted = np.array([[0.5, 0, 0], [1.0, 0, 0], [3.0, 0, 0], [0.0, 0, 0]])
    np.testing.assert_allclose(iou(np.zeros(3), unit, shifted, unit), [1 / 3, 0, 0, 1], atol=1e-9)
    as_torch = iou(torch.zeros(3), torch.ones(3), torch.from_numpy(shifted).float(), torch.ones(3))
    np.testing.assert_allclose(as_torch.numpy(), [1 / 3, 0, 0, 1], atol=1e-6)
