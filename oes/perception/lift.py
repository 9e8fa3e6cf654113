"""Lifting of posed RGB-D views to world points: signed distance, free space, surface features.

Every view is sampled at the projection of each point, so the cost after lifting does not depend on
the number of views.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from oes.config import params
from oes.episode import Camera, Frames
from oes.geom.se3 import inverse

NUM_GEOMETRY = 4
SIGNED_DISTANCE, UNOBSERVED = 0, 3  # channels
MAX_DEPTH_STEP_M = 0.02  # between adjacent pixels of one surface


@params
class LiftConfig:
    """``truncation_m``: range of the signed distance along z (TSDF) and of the features."""

    truncation_m: float


@dataclass(frozen=True)
class Views:
    """V posed RGB-D images of each of B scenes: RGB in [0, 1]; depth along z (0: no return)."""

    rgb_BVHW3: Tensor
    depth_m_BVHW: Tensor
    K_BV33: Tensor
    world_T_cam_BV44: Tensor


def views_of(frames: Frames, cameras: Sequence[Camera]) -> Views:
    """One scene's images and their cameras, in the same order, as a batch of one.

    Raises ValueError where the counts differ or there is no view.
    """
    count, num_cameras = len(frames.rgb_VHW3), len(cameras)
    if not num_cameras == count > 0:
        raise ValueError(f"views_of: {count} images for {num_cameras} cameras; need at least one")
    arrays = frames.rgb_VHW3, frames.depth_m_VHW
    images = (torch.from_numpy(np.ascontiguousarray(array)).float() for array in arrays)
    rgb, depth, K, world_T_cam = (x[None] for x in (*images, *camera_matrices(cameras)))
    return Views(rgb / 255, depth, K, world_T_cam)


def camera_matrices(cameras: Sequence[Camera]) -> tuple[Tensor, Tensor]:
    """Intrinsics V33 and world_T_cam V44 of cameras, in float32."""
    K_V33 = np.stack([camera.K_33 for camera in cameras])
    world_T_cam_V44 = np.stack([camera.world_T_cam_44 for camera in cameras])
    return torch.from_numpy(K_V33).float(), torch.from_numpy(world_T_cam_V44).float()


def lift(
    cfg: LiftConfig,
    views: Views,
    features_BVHWC: Tensor,
    points_BP3: Tensor,
    *,
    interpolate_depth: bool = False,
) -> Tensor:
    """Geometry and features BP(4+C) of points, averaged over the views that observe them.

    Channels: truncated signed distance in [-1, 1] (positive in front of the surface, 0 where
    unobserved), surface weight (1 on a surface), free space, unobserved by every view; then the
    features of the surfaces within the truncation (0 without any). ``interpolate_depth``: bilinear
    instead of nearest depth, within a surface.
    """
    batch, points = points_BP3.shape[:2]
    distance, observed, near, free = points_BP3.new_zeros(4, batch, points).unbind(0)
    features = features_BVHWC.new_zeros(batch * points, features_BVHWC.shape[-1])
    for view in range(views.depth_m_BVHW.shape[1]):
        pixel, in_front_m, is_inside = _project(views, view, points_BP3, interpolate_depth)
        signed = (in_front_m / cfg.truncation_m).clamp(-1, 1)
        visible = (is_inside & (signed > -1)).float()
        weight = (1 - signed.abs()) * visible
        distance, observed = distance + signed * visible, observed + visible
        near = near + weight
        free = torch.maximum(free, visible * (signed >= 1))
        # Few points are near a surface: gathering only those saves most of the memory traffic.
        chosen = weight.flatten().nonzero()[:, 0]
        gathered = features_BVHWC[:, view].reshape(-1, features.shape[1])[pixel.flatten()[chosen]]
        chosen_weight = weight.flatten()[chosen, None].to(gathered.dtype)
        features = features.index_add(0, chosen, gathered * chosen_weight)
    mean = observed.clamp(min=1)
    geometry = torch.stack([distance / mean, near / mean, free, (observed == 0).float()], dim=-1)
    total_weight = near.clamp(min=1e-3)[..., None].to(features.dtype)
    surface = features.reshape(batch, points, features.shape[1]) / total_weight
    return torch.cat([geometry.to(features.dtype), surface], dim=-1)


def _project(
    views: Views, view: int, points_BP3: Tensor, interpolate_depth: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Flat pixel index BP in BHW, depth BP of the surface minus the point's, whether in view."""
    depth_BHW = views.depth_m_BVHW[:, view]
    batch, height, width = depth_BHW.shape
    # The 8 significant bits of bfloat16 cannot tell half pixels apart past 128.
    with torch.autocast(depth_BHW.device.type, enabled=False):
        cam_T_world = inverse(views.world_T_cam_BV44[:, view])
        pix_T_world = views.K_BV33[:, view] @ cam_T_world[:, :3]
        offset, matrix = pix_T_world[..., 3:], pix_T_world[..., :3]
        u, v, z = torch.baddbmm(offset, matrix, points_BP3.transpose(1, 2)).unbind(1)
    safe = z.clamp(min=1e-3)
    u, v = u / safe, v / safe
    is_inside = (z > 1e-3) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    column, row = u.clamp(0, width - 1).long(), v.clamp(0, height - 1).long()
    pixel = torch.arange(batch, device=z.device)[:, None] * (height * width) + row * width + column
    depth = depth_BHW.flatten()[pixel]
    if interpolate_depth:
        depth = _interpolated(depth_BHW, u, v, depth)
    # A pixel without return is free space along its whole ray.
    return pixel, torch.where(depth > 0, depth, torch.inf) - z, is_inside


def _interpolated(depth_BHW: Tensor, u_BP: Tensor, v_BP: Tensor, nearest_BP: Tensor) -> Tensor:
    """Depths BP at subpixel positions; the nearest pixel's where its neighbours show an edge."""
    batch, height, width = depth_BHW.shape
    column, row = (u_BP - 0.5).clamp(0, width - 1.001), (v_BP - 0.5).clamp(0, height - 1.001)
    left, top = column.floor(), row.floor()
    du, dv = column - left, row - top
    start = torch.arange(batch, device=u_BP.device)[:, None] * (height * width)
    corner, flat = start + (top * width + left).long(), depth_BHW.flatten()
    depth_4BP = torch.stack([flat[corner + offset] for offset in (0, 1, width, width + 1)])
    weight_4BP = torch.stack([(1 - du) * (1 - dv), du * (1 - dv), (1 - du) * dv, du * dv])
    is_smooth_BP = (depth_4BP - nearest_BP).abs().amax(0) < MAX_DEPTH_STEP_M
    is_smooth_BP &= (depth_4BP > 0).all(0)
    # A plane is linear in the image in inverse depth, not in depth.
    inverse_depth_BP = (weight_4BP / depth_4BP.clamp(min=1e-3)).sum(0)
    return torch.where(is_smooth_BP, 1 / inverse_depth_BP, nearest_BP)
