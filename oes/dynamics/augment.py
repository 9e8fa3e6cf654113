"""Augmentation by symmetries of a table top: rotation, mirroring, choice of reference points.

Each symmetry maps the inputs of a model and its targets alike.
"""

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Generator, Tensor

from oes.config import params
from oes.dynamics.graph import yaw_rotation
from oes.geom.polar import directions, radius_at
from oes.objects import Objects

MIRROR_PROBABILITY = 0.5
CAMERA_MIRROR = (-1.0, 1.0, 1.0)


@params
class Augment:
    """Whether to rotate and mirror scenes; standard deviation of reference points' shifts."""

    rotate: bool
    mirror: bool
    shift_sigma_m: float


@dataclass(frozen=True)
class DynamicsBatch:
    """B scenes and their true futures, in world axes and metres; ``objects`` carry a leading B.

    The futures are of the perceived reference points, as if fixed to the true bodies.
    """

    objects: Objects
    tip_B3: Tensor
    actions_BT3: Tensor
    translation_BTN3: Tensor
    rotation_BTN33: Tensor


def augment(batch: DynamicsBatch, cfg: Augment, voxel_m: float, rng: Generator) -> DynamicsBatch:
    """Rotate and mirror every scene, and shift every reference point horizontally, at random."""
    scenes = len(batch.tip_B3)
    angle_B = torch.rand(scenes, generator=rng) * 2 * torch.pi * cfg.rotate
    flip_B = (torch.rand(scenes, generator=rng) < MIRROR_PROBABILITY) & cfg.mirror
    normal_BN3 = torch.randn(batch.objects.center_N3.shape, generator=rng)
    # Clamped at two standard deviations: a reference point far outside its object never occurs.
    shift_BN3 = normal_BN3.clamp(-2, 2) * cfg.shift_sigma_m
    shift_BN3[..., 2] = 0
    return transform_batch(batch, rotate_flip(angle_B, flip_B), shift_BN3, voxel_m)


def rotate_flip(angle_B: Tensor, flip_B: Tensor) -> Tensor:
    """Matrices B33: reflect y where ``flip_B``, then rotate by ``angle_B`` about the vertical."""
    sign_B3 = torch.ones(len(angle_B), 3)
    sign_B3[flip_B, 1] = -1
    return yaw_rotation(angle_B) * sign_B3[:, None]


def transform_batch(
    batch: DynamicsBatch, new_M_old_B33: Tensor, shift_BN3: Tensor, voxel_m: float
) -> DynamicsBatch:
    """Shift the reference points (old axes, horizontally), then map the world by ``new_M_old``.

    A rotation R becomes M R M'; a shifted reference point stays fixed to its body.
    """
    M_B33, back_B33 = new_M_old_B33, new_M_old_B33.mT
    R_BTN33, shift_B1N3 = batch.rotation_BTN33, shift_BN3[:, None]
    rotated_BTN3 = (R_BTN33 @ shift_B1N3[..., None])[..., 0]
    translation_BTN3 = batch.translation_BTN3 + rotated_BTN3 - shift_B1N3
    return DynamicsBatch(
        objects=transform_objects(batch.objects, M_B33, shift_BN3, voxel_m),
        tip_B3=(batch.tip_B3[:, None] @ back_B33)[:, 0],
        actions_BT3=batch.actions_BT3 @ back_B33,
        translation_BTN3=translation_BTN3 @ back_B33[:, None],
        rotation_BTN33=M_B33[:, None, None] @ R_BTN33 @ back_B33[:, None, None],
    )


def transform_objects(
    objects: Objects, new_M_old_B33: Tensor, shift_BN3: Tensor, voxel_m: float
) -> Objects:
    """Batched objects as ``transform_batch`` maps them."""
    M_B33 = new_M_old_B33
    flip_B = torch.linalg.det(M_B33) < 0
    image = objects.image_NV3HW
    return replace(
        objects,
        center_N3=(objects.center_N3 + shift_BN3) @ M_B33.mT,
        crop_NCXYZ=_transform_crops(objects.crop_NCXYZ, M_B33, shift_BN3 / voxel_m),
        image_NV3HW=torch.where(flip_B[:, None, None, None, None, None], image.flip(-1), image),
        camera_NV12=_transform_cameras(objects.camera_NV12, M_B33, flip_B),
        radial_profile_NRD3=_transform_profiles(objects.radial_profile_NRD3, M_B33, shift_BN3),
        com_offset_N3=(objects.com_offset_N3 - shift_BN3) @ M_B33.mT,
    )


def _transform_profiles(profile_BNRD3: Tensor, M_B33: Tensor, shift_BN3: Tensor) -> Tensor:
    """Profiles around the shifted reference points in the mapped world.

    For each new direction, the intersection of the ray from the shifted point with the old profile
    is found by two fixed-point iterations on its old direction; exact for a shift of 0.
    """
    batch, num, rows, count, _ = profile_BNRD3.shape
    new_BD2 = directions(count) @ M_B33[:, :2, :2]
    # P flattens B and N; radius, scale and probability become 3R rows of one function of direction.
    new_PD2 = new_BD2[:, None].expand(-1, num, -1, -1).flatten(0, 1)
    profile_PCD = profile_BNRD3.flatten(0, 1).movedim(-1, 1).flatten(1, 2)
    shift_P112 = shift_BN3[..., :2].reshape(-1, 1, 1, 2)
    old_PRD2 = new_PD2[:, None].expand(-1, rows, -1, -1)
    for _ in range(2):
        radius_PRD = _interpolate(profile_PCD, 0, old_PRD2)
        hit_PRD2 = radius_PRD[..., None] * old_PRD2 - shift_P112
        miss_PRD2 = new_PD2[:, None] * hit_PRD2.norm(dim=-1, keepdim=True) - hit_PRD2
        aim_PRD2 = old_PRD2 * radius_PRD.clamp(min=1e-3)[..., None] + miss_PRD2
        old_PRD2 = aim_PRD2 / aim_PRD2.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    radius_PRD = _interpolate(profile_PCD, 0, old_PRD2)
    hit_PRD = (radius_PRD[..., None] * old_PRD2 - shift_P112).norm(dim=-1)
    radius_PRD = torch.where(radius_PRD > 0, hit_PRD, radius_PRD)
    others = [_interpolate(profile_PCD, first, old_PRD2) for first in (rows, 2 * rows)]
    return torch.stack([radius_PRD, *others], -1).reshape(batch, num, rows, count, 3)


def _interpolate(profile_PCD: Tensor, first_row: int, direction_PRD2: Tensor) -> Tensor:
    """Values PRD of the R rows from ``first_row`` on, in directions of their own."""
    rows, count = direction_PRD2.shape[1:3]
    row_Q = torch.arange(rows).repeat_interleave(count) + first_row
    row_PQ = row_Q.expand(len(profile_PCD), -1)
    value_PQ = radius_at(profile_PCD, row_PQ, direction_PRD2.flatten(1, 2))
    return value_PQ.reshape(direction_PRD2.shape[:-1])


def _transform_cameras(camera_BNV12: Tensor, M_B33: Tensor, flip_B: Tensor) -> Tensor:
    """Poses of cameras that see the mapped world; mirrored cameras have their x axis reflected."""
    world_T_cam = M_B33[:, None, None] @ torch.unflatten(camera_BNV12, -1, (3, 4))
    mirror_4 = torch.tensor([*CAMERA_MIRROR, 1.0], device=flip_B.device)
    sign_B4 = torch.where(flip_B[:, None], mirror_4, torch.ones_like(mirror_4))
    return (world_T_cam * sign_B4[:, None, None, None]).flatten(-2)


def _transform_crops(crop_BNCXYZ: Tensor, M_B33: Tensor, shift_voxels_BN3: Tensor) -> Tensor:
    """Crops of the mapped world around the shifted points: bilinear in x and y, z unchanged."""
    if crop_BNCXYZ.numel() == 0:
        return crop_BNCXYZ
    side = crop_BNCXYZ.shape[3]
    line = torch.arange(side, device=M_B33.device) + 0.5 - side / 2
    new_XY2 = torch.stack(torch.meshgrid(line, line, indexing="ij"), -1)
    old_B1Q2 = (new_XY2.flatten(0, 1) @ M_B33[:, :2, :2])[:, None]
    old_BNQ2 = old_B1Q2 + shift_voxels_BN3[:, :, None, :2]
    grid_PXY2 = old_BNQ2.flip(-1).reshape(-1, side, side, 2) * (2 / side)
    # Channels and heights become the channels of one image: both are resampled alike.
    planes_BNCZXY = crop_BNCXYZ.permute(0, 1, 2, 5, 3, 4)
    planes_PCXY = planes_BNCZXY.flatten(0, 1).flatten(1, 2)
    resampled_PCXY = F.grid_sample(planes_PCXY, grid_PXY2, align_corners=False)
    return resampled_PCXY.reshape(planes_BNCZXY.shape).permute(0, 1, 2, 4, 5, 3)
