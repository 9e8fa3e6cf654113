"""Lifting posed RGB-D views to points in the world: signed distance along the ray, free space, and
surface features.

Every view is read where a point projects to, so that the cost after lifting does not depend on the
number of views.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from oes.config import params
from oes.episode import Camera, Frames
from oes.geom.se3 import inverse

NUM_GEOMETRY = 4
SIGNED, UNSEEN = 0, 3
ONE_SURFACE_M = 0.02  # pixels side by side whose depths differ by less show one surface


@params
class LiftConfig:
    """``truncation_m``: how far from a surface, along z, its distance and its features still
    reach.
    """

    truncation_m: float


@dataclass(frozen=True)
class Views:
    """V posed RGB-D images of each of B scenes. RGB in [0, 1]; depth is z in metres, 0 where
    nothing returned.
    """

    rgb_BVHW3: Tensor
    depth_m_BVHW: Tensor
    K_BV33: Tensor
    world_T_cam_BV44: Tensor

    def first(self, count: int) -> "Views":
        """The views of the first ``count`` scenes."""
        return Views(**{name: value[:count] for name, value in vars(self).items()})

    def to(self, device: torch.device | str) -> "Views":
        """The same views on another device."""
        return Views(**{name: value.to(device) for name, value in vars(self).items()})


def views_of(frames: Frames, cameras: tuple[Camera, ...] | list[Camera]) -> Views:
    """One scene's images (all V of ``frames``, in the order of ``cameras``) as a batch of one.

    Raises ValueError where the counts differ or there is no view.
    """
    if not len(cameras) == len(frames.rgb_VHW3) > 0:
        raise ValueError(
            f"views_of: {len(frames.rgb_VHW3)} images for {len(cameras)} cameras; at least one is needed"
        )
    K = np.stack([camera.K_33 for camera in cameras])
    world_T_cam = np.stack([camera.world_T_cam_44 for camera in cameras])
    return Views(
        rgb_BVHW3=torch.from_numpy(np.ascontiguousarray(frames.rgb_VHW3)).float()[None] / 255,
        depth_m_BVHW=torch.from_numpy(np.ascontiguousarray(frames.depth_m_VHW)).float()[None],
        K_BV33=torch.from_numpy(K).float()[None],
        world_T_cam_BV44=torch.from_numpy(world_T_cam).float()[None],
    )


def lift(
    cfg: LiftConfig,
    views: Views,
    features_BVHWC: Tensor,
    points_BP3: Tensor,
    *,
    between_pixels: bool = False,
) -> Tensor:
    """What the views say about each point, BP(4+C), the mean over the views that see it; if
    ``between_pixels``, with the depth between pixels of one surface in place of that of the
    nearest.

    Channels: signed distance in [-1, 1] (units of the truncation, positive in front, 0 where
    unseen), nearness of a surface (1 on it), seen to be free, unseen by every view; then the
    features of surfaces in reach (0 where none is).
    """
    batch, points = points_BP3.shape[:2]
    distance, seen, near, free = points_BP3.new_zeros(4, batch, points).unbind(0)
    features = features_BVHWC.new_zeros(batch * points, features_BVHWC.shape[-1])
    for view in range(views.depth_m_BVHW.shape[1]):
        pixel, depth, inside = _look_up(views, view, points_BP3, between_pixels)
        signed = (depth / cfg.truncation_m).clamp(-1, 1)
        visible = (inside & (signed > -1)).float()
        weight = (1 - signed.abs()) * visible
        distance, seen, near = distance + signed * visible, seen + visible, near + weight
        free = torch.maximum(free, visible * (signed >= 1))
        chosen = weight.flatten().nonzero()[:, 0]
        gathered = features_BVHWC[:, view].reshape(-1, features.shape[1])[pixel.flatten()[chosen]]
        features = features.index_add(
            0, chosen, gathered * weight.flatten()[chosen, None].to(gathered.dtype)
        )
    mean = seen.clamp(min=1)
    geometry = torch.stack([distance / mean, near / mean, free, (seen == 0).float()], dim=-1)
    surface = features.reshape(batch, points, features.shape[1]) / near.clamp(min=1e-3)[
        ..., None
    ].to(features.dtype)
    return torch.cat([geometry.to(features.dtype), surface], dim=-1)


def _look_up(
    views: Views, view: int, points_BP3: Tensor, between_pixels: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """For points BP3: flat pixel index over B H W, distance in front of the surface seen there, and
    if in the image.
    """
    depth_BHW = views.depth_m_BVHW[:, view]
    batch, height, width = depth_BHW.shape
    with torch.autocast(
        depth_BHW.device.type, enabled=False
    ):  # bfloat16 has no half pixels past 128
        cam_T_world = inverse(views.world_T_cam_BV44[:, view])
        pix_T_world = views.K_BV33[:, view] @ cam_T_world[:, :3]
        u, v, z = torch.baddbmm(
            pix_T_world[..., 3:], pix_T_world[..., :3], points_BP3.transpose(1, 2)
        ).unbind(1)
    safe = z.clamp(min=1e-3)
    u, v = u / safe, v / safe
    inside = (z > 1e-3) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    column, row = u.clamp(0, width - 1).long(), v.clamp(0, height - 1).long()
    pixel = torch.arange(batch, device=z.device)[:, None] * (height * width) + row * width + column
    depth = depth_BHW.flatten()[pixel]
    if between_pixels:
        depth = _between(depth_BHW, u, v, depth)
    return pixel, torch.where(depth > 0, depth, torch.inf) - z, inside


def _between(depth_BHW: Tensor, u_BP: Tensor, v_BP: Tensor, nearest_BP: Tensor) -> Tensor:
    """Depths BP at places in the images: on the plane through the four pixels around, where these
    are one surface.
    """
    batch, height, width = depth_BHW.shape
    column, row = (u_BP - 0.5).clamp(0, width - 1.001), (v_BP - 0.5).clamp(0, height - 1.001)
    left, top = column.floor(), row.floor()
    across, down = column - left, row - top
    corner = (
        torch.arange(batch, device=u_BP.device)[:, None] * (height * width)
        + (top * width + left).long()
    )
    flat = depth_BHW.flatten()
    four_4BP = torch.stack([flat[corner + offset] for offset in (0, 1, width, width + 1)])
    share_4BP = torch.stack(
        [(1 - across) * (1 - down), across * (1 - down), (1 - across) * down, across * down]
    )
    is_one_BP = (four_4BP > 0).all(0) & ((four_4BP - nearest_BP).abs().amax(0) < ONE_SURFACE_M)
    return torch.where(is_one_BP, 1 / (share_4BP / four_4BP.clamp(min=1e-3)).sum(0), nearest_BP)
