"""Scene composition: the feature map with its objects moved (paper 3.2).

The paper sums Draw(Rotate(m) * Rotate(M), p) over objects. Here every voxel samples the map at the
initial position of its content. Overlapping objects are averaged.
"""

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from oes.geom.voxels import Grid, centers, sample
from oes.objects import Objects
from oes.perception.network import SceneFeatures
from oes.perception.perceiver import Perceiver
from oes.perception.rays import DENSITY_SHIFT, Field

TABLE_Z_M = 0.0  # voxels below belong to no object


@dataclass(frozen=True)
class DecomposedScene:
    """The feature map of the first state (channel 0: density logit), split into N objects and rest.

    ``background_CXYZ``: the map with free space in place of the objects. ``far_field``: the content
    outside ``grid``. ``mask_NXYZ``: occupancy on ``window`` centred at ``center_N3``, dilated by a
    voxel.
    """

    map_CXYZ: Tensor
    background_CXYZ: Tensor
    grid: Grid
    far_field: Field
    mask_NXYZ: Tensor
    center_N3: Tensor
    window: Grid


@dataclass(frozen=True)
class PoseTable:
    """Poses of the N objects to compose.

    ``source_N``: the object of the decomposed scene with this appearance. ``rotation_N33``: about
    its first centre. ``translation_N3``: displacement since the first state (world, metres).
    ``scale_N``: size relative to the first state.
    """

    source_N: Tensor
    rotation_N33: Tensor
    translation_N3: Tensor
    scale_N: Tensor


def initial_poses(count: int) -> PoseTable:
    """All objects as in the first state."""
    eye_N33 = torch.eye(3).expand(count, 3, 3)
    return PoseTable(torch.arange(count), eye_N33, torch.zeros(count, 3), torch.ones(count))


@torch.inference_mode()
def decompose_scene(
    perceiver: Perceiver, scene: SceneFeatures, objects: Objects
) -> DecomposedScene:
    """Split one scene (B = 1) into its objects and the background."""
    near, far = perceiver.fields(scene)
    map_CXYZ, grid, window = near.volume_BCXYZ[0], near.grid, perceiver.net.roi.window
    mask_NXYZ = objects.crop_NCXYZ[:, 0].float().to(map_CXYZ.device)
    mask_NXYZ = F.max_pool3d(mask_NXYZ, 3, stride=1, padding=1)
    center_N3 = objects.center_N3.to(map_CXYZ.device)
    whole = DecomposedScene(map_CXYZ, map_CXYZ, grid, far, mask_NXYZ, center_N3, window)
    if not len(center_N3):
        return whole
    removed_XYZ = _weights(whole, initial_poses(len(center_N3))).amax(0).reshape(grid.shape)
    # Most of the map is free space, so the median is its density logit.
    density = map_CXYZ[0].lerp(map_CXYZ[0].median(), removed_XYZ)
    return replace(whole, background_CXYZ=torch.cat([density[None], map_CXYZ[1:]]))


@torch.inference_mode()
def compose(scene: DecomposedScene, poses: PoseTable) -> Field:
    """The feature map (B = 1) with the objects at ``poses``."""
    if not len(poses.source_N):
        return Field(scene.background_CXYZ[None], scene.grid)
    weight_NP = _weights(scene, poses)
    # Objects fill few voxels: features are sampled only there.
    occupied_Q = (weight_NP.amax(0) > 0).nonzero()[:, 0]
    points_Q3 = centers(scene.grid, scene.map_CXYZ.device).reshape(-1, 3)[occupied_Q]
    origin_NQ3 = _origins(scene, poses, points_Q3) + scene.center_N3[poses.source_N][:, None]
    maps = scene.map_CXYZ.expand(len(origin_NQ3), -1, -1, -1, -1)
    moved_NQC = sample(maps, scene.grid, origin_NQ3)
    weight_NQ = weight_NP[:, occupied_Q]
    total_Q = weight_NQ.sum(0)
    objects_CQ = torch.einsum("nq,nqc->cq", weight_NQ, moved_NQC) / total_Q.clamp(min=1)
    result_CP = scene.background_CXYZ.flatten(1).clone()
    free_Q = 1 - total_Q.clamp(max=1)
    result_CP[:, occupied_Q] = result_CP[:, occupied_Q] * free_Q + objects_CQ
    return Field(result_CP.reshape(1, *scene.background_CXYZ.shape), scene.grid)


def _weights(scene: DecomposedScene, poses: PoseTable) -> Tensor:
    """Occupancy NP of the voxels of the map by each object."""
    points = centers(scene.grid, scene.map_CXYZ.device).reshape(-1, 3)
    masks = scene.mask_NXYZ[poses.source_N][:, None]
    weight = sample(masks, scene.window, _origins(scene, poses, points))[..., 0]
    return weight * (points[:, 2] > TABLE_Z_M)


def _origins(scene: DecomposedScene, poses: PoseTable, points_P3: Tensor) -> Tensor:
    """Initial positions NP3, relative to each object's centre, of points that move with it."""
    center_N3 = scene.center_N3[poses.source_N] + poses.translation_N3
    rotated_back = (points_P3 - center_N3[:, None]) @ poses.rotation_N33
    return rotated_back / poses.scale_N[:, None, None]


def visible_features(near: Field) -> Tensor:
    """Opacity over one voxel's length, and features times opacity: CXYZ."""
    opacity = 1 - torch.exp(-F.softplus(near.volume_BCXYZ[0, :1] - DENSITY_SHIFT))
    return torch.cat([opacity, opacity * near.volume_BCXYZ[0, 1:]])
