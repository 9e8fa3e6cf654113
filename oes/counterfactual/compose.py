"""Scene synthesis: the features of each object, masked, moved and drawn over the scene without
objects (paper 3.2).

The paper's sum of Draw(Rotate(m) * Rotate(M), p): the map is resampled once, from where each
voxel's content was at first, and where masks overlap they share the voxel.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from oes.geom.voxels import Grid, centers, sample
from oes.objects import Objects
from oes.perception.network import SceneFeatures
from oes.perception.perceiver import Perceiver
from oes.perception.rays import CLEAR_LOGIT, Field

FLOOR_M = 0.0  # the table's top: nothing below belongs to an object


@dataclass(frozen=True)
class DecomposedScene:
    """One scene as first seen, taken apart: its map CXYZ, the same without objects, what surrounds
    it, and for each of N objects its mask, a voxel wider than perceived, on ``window`` centred at
    ``center_N3``.
    """

    map: Tensor
    bare: Tensor
    grid: Grid
    backdrop: Field
    mask_NXYZ: Tensor
    center_N3: Tensor
    window: Grid


@dataclass(frozen=True)
class PoseTable:
    """What is drawn: for each of M drawn objects, which of the scene's N it looks like, its
    rotation about its first centre and its displacement (world axes, since the first frame), and
    its size over that at first.
    """

    which_M: Tensor
    rotation_M33: Tensor
    translation_M3: Tensor
    scale_M: Tensor


def initial_poses(count: int) -> PoseTable:
    """All objects where they were."""
    return PoseTable(
        torch.arange(count),
        torch.eye(3).expand(count, 3, 3),
        torch.zeros(count, 3),
        torch.ones(count),
    )


def forecast_poses(poses: PoseTable, rotation_M33: Tensor, translation_M3: Tensor) -> PoseTable:
    """After drawn objects have turned about the centres they had in ``poses``, and shifted."""
    return PoseTable(
        poses.which_M,
        rotation_M33 @ poses.rotation_M33,
        poses.translation_M3 + translation_M3,
        poses.scale_M,
    )


@torch.inference_mode()
def decompose(perceiver: Perceiver, scene: SceneFeatures, objects: Objects) -> DecomposedScene:
    """Split one scene (B = 1) into its objects and the rest."""
    near, backdrop = perceiver.fields(scene)
    volume, grid, window = near.volume_BCXYZ[0], near.grid, perceiver.net.roi.window
    mask_NXYZ = F.max_pool3d(
        objects.crop_NCXYZ[:, 0].float().to(volume.device), 3, stride=1, padding=1
    )
    center_N3 = objects.center_N3.to(volume.device)
    still = DecomposedScene(volume, volume, grid, backdrop, mask_NXYZ, center_N3, window)
    if not len(center_N3):
        return still
    hole_XYZ = _weights(still, initial_poses(len(center_N3))).amax(0).reshape(grid.shape)
    density = volume[0].lerp(volume[0].median(), hole_XYZ)  # most of the map is air
    return DecomposedScene(**vars(still) | {"bare": torch.cat([density[None], volume[1:]])})


@torch.inference_mode()
def compose(still: DecomposedScene, poses: PoseTable) -> Field:
    """The synthesised map (B = 1)."""
    if not len(poses.which_M):
        return Field(still.bare[None], still.grid)
    weight_MP = _weights(still, poses)
    where_Q = (weight_MP.amax(0) > 0).nonzero()[:, 0]  # objects fill little of the map
    points_Q3 = centers(still.grid, still.map.device).reshape(-1, 3)[where_Q]
    source_MQ3 = _sources(still, poses, points_Q3) + still.center_N3[poses.which_M][:, None]
    moved_MQC = sample(still.map.expand(len(source_MQ3), -1, -1, -1, -1), still.grid, source_MQ3)
    weight_MQ = weight_MP[:, where_Q]
    total_Q = weight_MQ.sum(0)
    drawn_CQ = torch.einsum("mq,mqc->cq", weight_MQ, moved_MQC) / total_Q.clamp(min=1)
    made_CP = still.bare.flatten(1).clone()
    made_CP[:, where_Q] = made_CP[:, where_Q] * (1 - total_Q.clamp(max=1)) + drawn_CQ
    return Field(made_CP.reshape(1, *still.bare.shape), still.grid)


def _weights(still: DecomposedScene, poses: PoseTable) -> Tensor:
    """How much of each map voxel belongs to each drawn object: MP."""
    points = centers(still.grid, still.map.device).reshape(-1, 3)
    masks = still.mask_NXYZ[poses.which_M][:, None]
    weight = sample(masks, still.window, _sources(still, poses, points))[..., 0]
    return weight * (points[:, 2] > FLOOR_M)


def _sources(still: DecomposedScene, poses: PoseTable, points_P3: Tensor) -> Tensor:
    """Where the content of points came from, MP3, from its object's first centre."""
    center_M3 = still.center_N3[poses.which_M] + poses.translation_M3
    turned_back = (points_P3 - center_M3[:, None]) @ poses.rotation_M33
    return turned_back / poses.scale_M[:, None, None]


def visible(near: Field) -> Tensor:
    """What can be seen of each voxel, CXYZ: its opacity over one voxel's length, and its features
    as far as opaque.
    """
    opacity = 1 - torch.exp(-F.softplus(near.volume_BCXYZ[0, :1] - CLEAR_LOGIT))
    return torch.cat([opacity, opacity * near.volume_BCXYZ[0, 1:]])
