"""Ground-truth radial profiles of posed meshes, and the point cloud that a profile describes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
import trimesh
from torch import Tensor

from oes.episode import Body, Floats
from oes.geom.polar import directions, profile_normals
from oes.meshes.catalogue import Catalogue
from oes.objects import LAYERS
from oes.perception.surface import PRESENCE, RADIUS, Cylinder

RAYS_PER_LAYER = 4
SUPPORT_HEIGHTS_M = (0.0005, 0.0015)  # of the support's rays above the lowest point of an object
RAY_START_FACTOR = 1.3  # start of the rays over the radius of the grid
PRESENCE_THRESHOLD = 0.5
RING_HEIGHTS = (0.17, 0.5, 0.83)  # of the rings of points on a layer's side, over its height


@dataclass(frozen=True)
class GroundTruthProfiles:
    """Radial profiles of the bodies of a catalogue, by ray casting against their meshes."""

    catalogue: Catalogue
    cylinder: Cylinder

    def of_bodies(
        self, bodies: Sequence[Body], poses: Floats, support_N3: Floats
    ) -> tuple[Floats, Floats]:
        """Radii NRD (metres; 0: no surface) and centres of mass N3 (world) of posed bodies.

        ``poses``: world_T_obj N44. ``support_N3``: origins of the cylindrical grids (world).
        """
        radii = list(map(self.radii, bodies, poses, support_N3))
        coms = [
            pose[:3, :3] @ (self.catalogue.meshes[body.mesh].com_obj_3 * body.scale_3) + pose[:3, 3]
            for body, pose in zip(bodies, poses, strict=True)
        ]
        shape = (-1, self.cylinder.num_rows, self.cylinder.num_directions)
        return np.array(radii).reshape(shape), np.array(coms).reshape(-1, 3)

    def radii(self, body: Body, world_T_obj_44: Floats, support_3: Floats) -> Floats:
        """Radii RD of one body."""
        cylinder, mesh = self.cylinder, self.catalogue.meshes[body.mesh].visual
        unit_D2 = directions(cylinder.num_directions).double().numpy()
        R, t = world_T_obj_44[:3, :3], world_T_obj_44[:3, 3]
        # The support is measured at the mesh itself: its box may be off by some millimetres.
        lowest_m = (mesh.vertices * body.scale_3 @ R[2]).min() + t[2] - support_3[2]
        height_Q = np.arange(cylinder.num_layers * RAYS_PER_LAYER) + 0.5
        height_Q = height_Q * cylinder.layer_height_m / RAYS_PER_LAYER
        height_Q = np.concatenate([lowest_m + np.array(SUPPORT_HEIGHTS_M), height_Q])
        start_m = cylinder.max_radius_m * RAY_START_FACTOR
        start_QD3 = np.zeros((len(height_Q), len(unit_D2), 3))
        start_QD3[..., :2] = unit_D2 * start_m
        start_QD3[..., 2] = height_Q[:, None]
        inward_QD3 = np.broadcast_to(np.pad(-unit_D2, ((0, 0), (0, 1))), start_QD3.shape)
        # Rays are cast inwards in the mesh's frame, so that the first hit is the outermost surface.
        start_obj = (start_QD3 + support_3 - t) @ R / body.scale_3
        inward_obj = inward_QD3 @ R / body.scale_3
        hit_P = _first_hits(mesh, start_obj.reshape(-1, 3), inward_obj.reshape(-1, 3))
        radius_QD = np.clip(start_m - hit_P.reshape(len(height_Q), -1), 0, cylinder.max_radius_m)
        support_QD, side_QD = np.split(radius_QD, [len(SUPPORT_HEIGHTS_M)])
        radius_ZD = side_QD.reshape(cylinder.num_layers, RAYS_PER_LAYER, -1).max(1)
        summary = radius_ZD.max(0), radius_ZD[1:].max(0), support_QD.max(0)
        return np.stack([*summary, *radius_ZD])


def _first_hits(mesh: trimesh.Trimesh, start_P3: Floats, direction_P3: Floats) -> Floats:
    """Ray parameters P of the first hits, in lengths of ``direction_P3``; infinite without one."""
    length_P = np.linalg.norm(direction_P3, axis=-1)
    unit_P3 = direction_P3 / length_P[:, None]
    hit_Q3, ray_Q, _ = mesh.ray.intersects_location(start_P3, unit_P3, multiple_hits=False)
    times_P = np.full(len(start_P3), np.inf)
    times_P[ray_Q] = ((hit_Q3 - start_P3[ray_Q]) * unit_P3[ray_Q]).sum(-1) / length_P[ray_Q]
    return times_P


def profile_to_point_cloud(
    radial_profile_RD3: Tensor, cylinder: Cylinder, top_m: float
) -> tuple[Tensor, Tensor]:
    """Points P3 of the surface of a profile, relative to its support point, and unit normals P3.

    Layers end at the object's height ``top_m``. Horizontal lids close the steps between layers of
    different radii.
    """
    is_present_ZD = radial_profile_RD3[LAYERS:, :, PRESENCE] > PRESENCE_THRESHOLD
    radius_ZD = radial_profile_RD3[LAYERS:, :, RADIUS] * is_present_ZD
    padded_ZD = F.pad(radius_ZD, (0, 0, 1, 1))
    unit_D2 = directions(radius_ZD.shape[1])
    sides, lids = [], []
    for layer_i, radius_D in enumerate(radius_ZD):
        low = layer_i * cylinder.layer_height_m
        high = min((layer_i + 1) * cylinder.layer_height_m, top_m)
        is_present_D = radius_D > 0
        if high <= low or not is_present_D.any():
            continue
        xy_P2 = (radius_D[:, None] * unit_D2)[is_present_D]
        normal_P3 = F.pad(profile_normals(radius_D), (0, 1))[is_present_D]
        for share in RING_HEIGHTS:
            points_P3 = F.pad(xy_P2, (0, 1), value=low + share * (high - low))
            sides.append((points_P3, normal_P3))
        above_D = padded_ZD[layer_i + 2] * (high < top_m)
        lids.append(_lid(radius_D, above_D, high, 1.0))
        lids.append(_lid(radius_D, padded_ZD[layer_i], low, -1.0))
    if not sides:
        return torch.zeros(1, 3), torch.tensor([[0.0, 0.0, 1.0]])
    points, point_normals = zip(*sides, *lids, strict=True)
    return torch.cat(points), torch.cat(point_normals)


def _lid(outer_D: Tensor, inner_D: Tensor, z_m: float, normal_z: float) -> tuple[Tensor, Tensor]:
    """Points between two horizontal outlines and their normals."""
    # Square roots of even steps give points of the same density at all radii.
    share_Q1 = torch.linspace(0.1, 0.9, 5).sqrt()[:, None]
    ring_D = (outer_D.square() - inner_D.square()).clamp(min=0)
    radius_QD = (inner_D.square() + ring_D * share_Q1.square()).sqrt()
    is_open_QD = (outer_D > inner_D + 1e-3).expand_as(radius_QD)
    xy_QD2 = radius_QD[..., None] * directions(len(outer_D))
    points_P3 = F.pad(xy_QD2[is_open_QD], (0, 1), value=z_m)
    return points_P3, torch.tensor([0.0, 0.0, normal_z]).expand_as(points_P3)
