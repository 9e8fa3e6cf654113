"""Surfaces as outlines and as points: the true ones of posed meshes, and those that an outline
stands for.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from torch import Tensor

from oes.episode import Body, Episode, Floats
from oes.geom.polar import directions, profile_normals
from oes.meshes.catalogue import Catalogue
from oes.objects import LAYERS
from oes.perception.surface import PRESENCE, RADIUS, Cylinder

RAYS_A_BAND = 4
FOOT_RAYS_M = (
    0.0005,
    0.0015,
)  # how far above its lowest point an object is taken to stand on the table
RAY_START_FACTOR = 1.3  # rays start so much beyond the cylinder
MIN_PRESENCE_PROFILE = 0.5


@dataclass(frozen=True)
class GroundTruthProfiles:
    """True outlines of the bodies of a catalogue, by casting rays at their meshes."""

    catalogue: Catalogue
    cylinder: Cylinder

    def outlines(
        self, episode: Episode, step_i: int, foot_N3: Floats, object_is: Sequence[int]
    ) -> tuple[Floats, Floats]:
        """Radii NRK (metres; 0 where there is nothing) of some objects of a recorded state around
        the vertical axes through ``foot_N3``, from its height upwards; and where their centres of
        mass are, N3 (world).
        """
        poses_N44 = episode.steps[step_i].world_T_obj_N44
        radii = [
            self.outline(episode.bodies[i], poses_N44[i], foot_3)
            for i, foot_3 in zip(object_is, foot_N3, strict=True)
        ]
        mass = [self._mass(episode.bodies[i], poses_N44[i]) for i in object_is]
        rows, count = self.cylinder.rows, self.cylinder.directions
        return np.array(radii).reshape(-1, rows, count), np.array(mass).reshape(-1, 3)

    def outline(self, body: Body, world_T_obj_44: Floats, foot_3: Floats) -> Floats:
        """Radii RK of one body."""
        cylinder, mesh = self.cylinder, self.catalogue.meshes[body.mesh].visual
        side_K2 = directions(cylinder.directions).double().numpy()
        R, t = world_T_obj_44[:3, :3], world_T_obj_44[:3, 3]
        lowest_m = (mesh.vertices * body.scale_3 @ R[2]).min() + t[2] - foot_3[2]
        height_H = (np.arange(cylinder.bands * RAYS_A_BAND) + 0.5) * cylinder.band_m / RAYS_A_BAND
        height_H = np.concatenate([lowest_m + np.array(FOOT_RAYS_M), height_H])
        start_m = cylinder.reach_m * RAY_START_FACTOR
        start_HK3 = np.zeros((len(height_H), len(side_K2), 3))
        start_HK3[..., :2] = side_K2 * start_m
        start_HK3[..., 2] = height_H[:, None]
        inward_HK3 = np.broadcast_to(
            np.append(-side_K2, np.zeros((len(side_K2), 1)), 1), start_HK3.shape
        )
        start_obj = (start_HK3 + foot_3 - t) @ R / body.scale_3
        inward_obj = inward_HK3 @ R / body.scale_3
        radius_HK = start_m - _first_hits(
            mesh, start_obj.reshape(-1, 3), inward_obj.reshape(-1, 3)
        ).reshape(len(height_H), -1)
        foot_FK, side_HK = np.split(np.clip(radius_HK, 0, cylinder.reach_m), [len(FOOT_RAYS_M)])
        radius_BK = side_HK.reshape(cylinder.bands, RAYS_A_BAND, -1).max(1)
        return np.stack([radius_BK.max(0), radius_BK[1:].max(0), foot_FK.max(0), *radius_BK])

    def _mass(self, body: Body, world_T_obj_44: Floats) -> Floats:
        com_3 = self.catalogue.meshes[body.mesh].com_obj_3 * body.scale_3
        place: Floats = world_T_obj_44[:3, :3] @ com_3 + world_T_obj_44[:3, 3]
        return place


def _first_hits(mesh: trimesh.Trimesh, start_P3: Floats, direction_P3: Floats) -> Floats:
    """How many ``direction_P3`` (of any length) from each start the mesh is first hit, P; infinite
    where it is not.
    """
    length_P = np.linalg.norm(direction_P3, axis=-1)
    unit_P3 = direction_P3 / length_P[:, None]
    hit_Q3, ray_Q, _ = mesh.ray.intersects_location(start_P3, unit_P3, multiple_hits=False)
    times_P = np.full(len(start_P3), np.inf)
    times_P[ray_Q] = ((hit_Q3 - start_P3[ray_Q]) * unit_P3[ray_Q]).sum(-1) / length_P[ray_Q]
    return times_P


def profile_to_point_cloud(
    outline_RK3: Tensor, cylinder: Cylinder, top_m: float
) -> tuple[Tensor, Tensor]:
    """The surface that an outline stands for: points P3 from the middle of its foot, and outward
    unit normals P3.

    Its sides are the bands; where the next band up (down) is narrower or absent, a lid (a bottom)
    closes the step. ``top_m`` is the height of the object: bands end there.
    """
    radius_BK = outline_RK3[LAYERS:, :, RADIUS] * (
        outline_RK3[LAYERS:, :, PRESENCE] > MIN_PRESENCE_PROFILE
    )
    side_K2 = directions(radius_BK.shape[1])
    sides, lids = [], []
    for band_i, radius_K in enumerate(radius_BK):
        low, high = band_i * cylinder.band_m, min((band_i + 1) * cylinder.band_m, top_m)
        if high <= low or not (radius_K > 0).any():
            continue
        sides += [
            _side(radius_K, side_K2, low + share * (high - low)) for share in (0.17, 0.5, 0.83)
        ]
        above_K = (
            radius_BK[band_i + 1]
            if high < top_m and band_i + 1 < len(radius_BK)
            else torch.zeros_like(radius_K)
        )
        below_K = radius_BK[band_i - 1] if band_i else torch.zeros_like(radius_K)
        lids += [
            _lid(radius_K, above_K, side_K2, high, 1.0),
            _lid(radius_K, below_K, side_K2, low, -1.0),
        ]
    parts = [part for part in sides + lids if len(part[0])]
    if not parts:
        return torch.zeros(1, 3), torch.tensor([[0.0, 0.0, 1.0]])
    return torch.cat([points for points, _ in parts]), torch.cat([normal for _, normal in parts])


def _side(radius_K: Tensor, side_K2: Tensor, height_m: float) -> tuple[Tensor, Tensor]:
    """One ring of points."""
    there_K = radius_K > 0
    points_K3 = _raised(radius_K[:, None] * side_K2, height_m)
    return points_K3[there_K], _raised(profile_normals(radius_K), 0.0)[there_K]


def _lid(
    outer_K: Tensor, inner_K: Tensor, side_K2: Tensor, height_m: float, up: float
) -> tuple[Tensor, Tensor]:
    """Points between two outlines at one height, as dense towards the axis as away from it."""
    share_S = torch.linspace(0.1, 0.9, 5).sqrt()
    radius_SK = (
        inner_K.square()
        + (outer_K.square() - inner_K.square()).clamp(min=0) * share_S[:, None].square()
    ).sqrt()
    is_open_SK = (outer_K > inner_K + 1e-3).expand_as(radius_SK)
    points_P3 = _raised((radius_SK[..., None] * side_K2)[is_open_SK], height_m)
    return points_P3, torch.tensor([0.0, 0.0, up]).expand_as(points_P3)


def _raised(xy_P2: Tensor, z: float) -> Tensor:
    """Points P2 with a height."""
    return torch.cat([xy_P2, torch.full_like(xy_P2[:, :1], z)], -1)
