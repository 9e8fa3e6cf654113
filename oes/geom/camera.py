"""Pinhole cameras in the conventions of ``oes``: OpenCV axes, z-depth, pixel centres at 0.5."""

import numpy as np
import torch
from torch import Tensor

from oes.episode import Floats
from oes.geom.se3 import Array, inverse, transform


def intrinsics(fov_deg: float, width_px: int, height_px: int) -> Floats:
    """``K_33`` for a vertical field of view, square pixels and a central principal point."""
    focal = height_px / 2 / np.tan(np.radians(fov_deg) / 2)
    return np.array([[focal, 0, width_px / 2], [0, focal, height_px / 2], [0, 0, 1]])


def look_at(eye: Floats, target: Floats) -> Floats:
    """``world_T_cam`` of a camera at ``eye`` that looks at ``target`` without roll.

    Raises ValueError for a vertical viewing direction, which leaves the roll undefined.
    """
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:
        raise ValueError(f"look_at: the line from {eye} to {target} is vertical")
    right = right / np.linalg.norm(right)
    world_T_cam = np.eye(4)
    world_T_cam[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    world_T_cam[:3, 3] = eye
    return world_T_cam


def project(K_33: Array, world_T_cam: Array, points_world: Array) -> tuple[Array, Array]:
    """Pixels ...P2 (pix frame) and depths ...P of points ...P3; depths <= 0 lie behind it."""
    points_cam = transform(inverse(world_T_cam), points_world)
    depth = points_cam[..., 2]
    uvw = points_cam @ K_33.swapaxes(-1, -2)
    # The clip keeps pixels behind the camera finite; callers test the depth.
    return uvw[..., :2] / depth.clip(1e-6)[..., None], depth


def unproject(K_33: Tensor, world_T_cam: Tensor, depth_m_HW: Tensor) -> Tensor:
    """World points ...HW3 of depth images ...HW; a pixel without return gives the camera centre."""
    height, width = depth_m_HW.shape[-2:]
    device = depth_m_HW.device
    axes = (torch.arange(count, device=device) + 0.5 for count in (height, width))
    v, u = torch.meshgrid(*axes, indexing="ij")
    pix = torch.stack([u, v, torch.ones_like(u)], dim=-1).to(depth_m_HW.dtype).reshape(-1, 3)
    rays_cam = pix @ torch.linalg.inv(K_33).transpose(-1, -2)
    points_cam = rays_cam * depth_m_HW.flatten(-2)[..., None]
    points_world: Tensor = transform(world_T_cam, points_cam)
    return points_world.reshape(*points_world.shape[:-2], height, width, 3)
