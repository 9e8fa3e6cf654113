"""Symmetries of a table top: a turn about the vertical, a mirror image, and the choice of reference
point.

Each acts on everything a model sees and everything it must forecast, so that a scene stays a true
scene.
"""

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from oes.config import params
from oes.geom.polar import directions, radius_in
from oes.objects import Objects

HALF = 0.5
CAMERA_MIRROR = (-1.0, 1.0, 1.0)


@params
class Augment:
    """Whether to turn and to mirror scenes, and the standard deviation of the shift of reference
    points.
    """

    turn: bool
    mirror: bool
    shift_m: float


@dataclass(frozen=True)
class DynamicsBatch:
    """B scenes and their true futures; world frame, metres. ``objects`` carries a leading B.

    The futures are of the perceived reference point (``objects.center``) as if fixed to the true
    body.
    """

    objects: Objects
    tip_B3: Tensor
    actions_BT3: Tensor
    translation_BTN3: Tensor
    rotation_BTN33: Tensor


def augment(
    batch: DynamicsBatch, cfg: Augment, voxel_m: float, generator: torch.Generator
) -> DynamicsBatch:
    """A random turn and mirror of every scene, a random horizontal shift (at most two sd) of every
    reference point.
    """
    scenes = len(batch.tip_B3)
    angle_B = torch.rand(scenes, generator=generator) * 2 * torch.pi * cfg.turn
    flip_B = (torch.rand(scenes, generator=generator) < HALF) & cfg.mirror
    shift_BN3 = (
        torch.randn(batch.objects.center_N3.shape, generator=generator).clamp(-2, 2) * cfg.shift_m
    )
    shift_BN3[..., 2] = 0
    return transform_batch(batch, turn_flip(angle_B, flip_B), shift_BN3, voxel_m)


def turn_flip(angle_B: Tensor, flip_B: Tensor) -> Tensor:
    """Matrices B33: reflect y where ``flip_B``, then turn by ``angle_B`` (radians) about the
    vertical.
    """
    cos, sin, zero, one = (
        angle_B.cos(),
        angle_B.sin(),
        torch.zeros_like(angle_B),
        torch.ones_like(angle_B),
    )
    sign = torch.where(flip_B, -one, one)
    return torch.stack(
        [cos, -sin * sign, zero, sin, cos * sign, zero, zero, zero, one], -1
    ).reshape(-1, 3, 3)


def transform_batch(
    batch: DynamicsBatch, new_M_old_B33: Tensor, shift_BN3: Tensor, voxel_m: float
) -> DynamicsBatch:
    """Shift the reference points (old axes, horizontal), then map the world by ``new_M_old_B33`` of
    ``turn_flip``.

    A rotation R becomes M R M'; the future of a shifted point is that of the body it is fixed to.
    """
    M, back_B33 = new_M_old_B33, new_M_old_B33.transpose(-1, -2)
    R = batch.rotation_BTN33
    translation = (
        batch.translation_BTN3 + (R @ shift_BN3[:, None, ..., None])[..., 0] - shift_BN3[:, None]
    )
    return DynamicsBatch(
        objects=transform_objects(batch.objects, M, shift_BN3, voxel_m),
        tip_B3=(batch.tip_B3[:, None] @ back_B33)[:, 0],
        actions_BT3=batch.actions_BT3 @ back_B33,
        translation_BTN3=translation @ back_B33[:, None],
        rotation_BTN33=M[:, None, None] @ R @ back_B33[:, None, None],
    )


def transform_objects(
    seen: Objects, new_M_old_B33: Tensor, shift_BN3: Tensor, voxel_m: float
) -> Objects:
    """The objects (leading B) of ``transform_batch``: everything that a model sees of them."""
    M = new_M_old_B33
    flip_B = torch.linalg.det(M) < 0
    return replace(
        seen,
        center_N3=(seen.center_N3 + shift_BN3) @ M.mT,
        crop_NCXYZ=_resampled(seen.crop_NCXYZ, M, shift_BN3 / voxel_m),
        image_NV3HW=torch.where(
            flip_B[:, None, None, None, None, None], seen.image_NV3HW.flip(-1), seen.image_NV3HW
        ),
        camera_NV12=_cameras(seen.camera_NV12, M, flip_B),
        radial_profile_NRD3=_outlines(seen.radial_profile_NRD3, M, shift_BN3),
        com_offset_N3=(seen.com_offset_N3 - shift_BN3) @ M.mT,
    )


def _outlines(outline_BNRK3: Tensor, M_B33: Tensor, shift_BN3: Tensor) -> Tensor:
    """Outlines around the shifted points in the mapped world: where the line from there in each new
    direction meets the old outline is found by two steps of a fixed point, exact for a shift of
    nothing.
    """
    batch, num, rows, count, _ = outline_BNRK3.shape
    wanted_BK2 = directions(count) @ M_B33[:, :2, :2]
    flat_PRKC = outline_BNRK3.flatten(0, 1).movedim(-1, 1).flatten(1, 2)
    wanted_PK2 = wanted_BK2[:, None].expand(-1, num, -1, -1).flatten(0, 1)
    shift_P12 = shift_BN3[..., :2].reshape(-1, 1, 2)
    band_RK = torch.arange(3 * rows)[:, None].expand(-1, count)
    toward_PRK2 = wanted_PK2[:, None].expand(-1, rows, -1, -1)
    for _ in range(2):
        radius_PRK = _read(flat_PRKC, band_RK[:rows], toward_PRK2)
        met_PRK2 = radius_PRK[..., None] * toward_PRK2 - shift_P12[:, None]
        miss_PRK2 = wanted_PK2[:, None] * met_PRK2.norm(dim=-1, keepdim=True) - met_PRK2
        aim_PRK2 = toward_PRK2 * radius_PRK.clamp(min=1e-3)[..., None] + miss_PRK2
        toward_PRK2 = aim_PRK2 / aim_PRK2.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    radius_PRK = _read(flat_PRKC, band_RK[:rows], toward_PRK2)
    met_PRK = (radius_PRK[..., None] * toward_PRK2 - shift_P12[:, None]).norm(dim=-1)
    others = [_read(flat_PRKC, band_RK[i * rows : (i + 1) * rows], toward_PRK2) for i in (1, 2)]
    moved = torch.stack([torch.where(radius_PRK > 0, met_PRK, radius_PRK), *others], -1)
    return moved.reshape(batch, num, rows, count, 3)


def _read(flat_PCK: Tensor, band_RK: Tensor, toward_PRK2: Tensor) -> Tensor:
    """Values PRK of some rows of stacked functions of direction."""
    band_PQ = band_RK.flatten().expand(len(flat_PCK), -1)
    return radius_in(flat_PCK, band_PQ, toward_PRK2.flatten(1, 2)).reshape(toward_PRK2.shape[:-1])


def _cameras(camera_BNV12: Tensor, M_B33: Tensor, flip_B: Tensor) -> Tensor:
    """Poses of the cameras that see the mapped world; a mirrored world is seen by cameras with x of
    cam reflected.
    """
    world_T_cam = M_B33[:, None, None] @ camera_BNV12.reshape(*camera_BNV12.shape[:-1], 3, 4)
    mirror_4 = torch.tensor([*CAMERA_MIRROR, 1.0], device=flip_B.device)
    sign_B4 = torch.where(flip_B[:, None], mirror_4, torch.ones_like(mirror_4))
    return (world_T_cam * sign_B4[:, None, None, None]).flatten(-2)


def _resampled(crop_BNCXYZ: Tensor, M_B33: Tensor, shift_voxels_BN3: Tensor) -> Tensor:
    """Crops of the mapped world around the shifted points: bilinear in x and y, which mix; z stays
    as it is.
    """
    if crop_BNCXYZ.numel() == 0:
        return crop_BNCXYZ
    scenes, num, channels, side = crop_BNCXYZ.shape[:4]
    line = torch.arange(side, device=M_B33.device) + 0.5 - side / 2
    new_XY2 = torch.stack(torch.meshgrid(line, line, indexing="ij"), -1)
    old_BNXY2 = (new_XY2.flatten(0, 1) @ M_B33[:, :2, :2])[:, None] + shift_voxels_BN3[
        :, :, None, :2
    ]
    grid_PXY2 = old_BNXY2.flip(-1).reshape(scenes * num, side, side, 2) * (2 / side)
    planes = crop_BNCXYZ.permute(0, 1, 2, 5, 3, 4).reshape(
        scenes * num, channels * side, side, side
    )
    planes = F.grid_sample(
        planes, grid_PXY2, mode="bilinear", padding_mode="zeros", align_corners=False
    )
    return planes.reshape(scenes, num, channels, side, side, side).permute(0, 1, 2, 4, 5, 3)
