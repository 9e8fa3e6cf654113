"""Where rigid bodies in the plane touch a rod and each other. Everything is batched over scenes and objects."""

from dataclasses import dataclass

import torch
from torch import Tensor

from oes.dynamics.bodies import Bodies, Physics, Pose, turned
from oes.geom.polar import corners, normals, radius_at

FAR_M = 10.0
TINY_M = 1e-6


@dataclass(frozen=True)
class Touch:
    """One contact for each of ... bodies: outward normal ...2 of the body, lever ...2 from its centre of mass, gap
    ... (metres; negative where they overlap)."""

    normal_2: Tensor
    lever_2: Tensor
    gap: Tensor


def rod_touch(bodies: Bodies, pose: Pose, rod_B2: Tensor, cfg: Physics) -> Touch:
    """Where the rod, a circle, is closest to each object's outline: BN."""
    corner_BNK2 = corners(bodies.rod_BNK) - bodies.mass_BN2[..., None, :]
    side_BNK2 = corner_BNK2.roll(-1, -2) - corner_BNK2
    away_BN2 = turned(rod_B2[:, None] - pose.place_BN2, -pose.turn_BN)
    along_BNK = ((away_BN2[..., None, :] - corner_BNK2) * side_BNK2).sum(-1)
    along_BNK = (along_BNK / side_BNK2.square().sum(-1).clamp(min=TINY_M**2)).clamp(0, 1)
    nearest_BNK2 = corner_BNK2 + along_BNK[..., None] * side_BNK2
    distance_BN, k_BN = (away_BN2[..., None, :] - nearest_BNK2).norm(dim=-1).min(-1)
    lever_BN2 = nearest_BNK2.gather(-2, k_BN[..., None, None].expand(*k_BN.shape, 1, 2))[..., 0, :]
    from_axis_BN2 = away_BN2 + bodies.mass_BN2
    inside_BN = from_axis_BN2.norm(dim=-1) < radius_at(
        bodies.rod_BNK.flatten(0, 1), from_axis_BN2.flatten(0, 1)[:, None]
    )[:, 0].reshape(k_BN.shape)
    sign_BN = torch.where(inside_BN, -1.0, 1.0)
    normal_BN2 = (away_BN2 - lever_BN2) * (sign_BN / distance_BN.clamp(min=TINY_M))[..., None]
    gap_BN = sign_BN * distance_BN - cfg.rod_radius_m - cfg.margin_m
    there_BN = bodies.valid_BN & (bodies.rod_BNK > 0).any(-1)
    gap_BN = torch.where(there_BN, gap_BN, FAR_M)
    return Touch(turned(normal_BN2, pose.turn_BN), turned(lever_BN2, pose.turn_BN), gap_BN)


def pair_touch(bodies: Bodies, pose: Pose) -> tuple[Touch, Tensor]:
    """For ordered pairs BNN: the point of the first object deepest inside the second, with the second's normal there
    (turned to point out of the first); and the lever BNN2 of that point on the second."""
    corner_BNK2 = corners(bodies.whole_BNK) - bodies.mass_BN2[..., None, :]
    lever_BNK2 = turned(corner_BNK2, pose.turn_BN[..., None])
    apart_BNN2 = pose.place_BN2[:, :, None] - pose.place_BN2[:, None]
    on_other_BNNK2 = lever_BNK2[:, :, None] + apart_BNN2[..., None, :]
    own_BNNK2 = turned(on_other_BNNK2, -pose.turn_BN[:, None, :, None]) + bodies.mass_BN2[:, None, :, None]
    num = pose.turn_BN.shape[1]
    outline_PK = bodies.whole_BNK[:, None].expand(-1, num, -1, -1).flatten(0, 2)
    reach_BNNK = radius_at(outline_PK, own_BNNK2.flatten(0, 2)).reshape(own_BNNK2.shape[:-1])
    depth_BNN, k_BNN = (reach_BNNK - own_BNNK2.norm(dim=-1)).max(-1)
    pick = k_BNN[..., None, None].expand(*k_BNN.shape, 1, 2)
    spot_BNN2 = own_BNNK2.gather(-2, pick)[..., 0, :]
    facing_BNN2 = _normal_at(bodies.whole_BNK, spot_BNN2)
    slant_BNN = (facing_BNN2 * spot_BNN2).sum(-1) / spot_BNN2.norm(dim=-1).clamp(min=TINY_M)
    is_pair_BNN = bodies.valid_BN[:, None] & bodies.valid_BN[:, :, None] & ~torch.eye(num, dtype=torch.bool)
    gap_BNN = torch.where(is_pair_BNN, -depth_BNN * slant_BNN.clamp(min=0.1), FAR_M)
    lever_BNN2 = lever_BNK2[:, :, None].expand_as(on_other_BNNK2).gather(-2, pick)[..., 0, :]
    on_other_BNN2 = on_other_BNNK2.gather(-2, pick)[..., 0, :]
    return Touch(-turned(facing_BNN2, pose.turn_BN[:, None]), lever_BNN2, gap_BNN), on_other_BNN2


def _normal_at(radius_BNK: Tensor, spot_BNN2: Tensor) -> Tensor:
    """Outward normals BNN2 of the second of each pair's outline, in its axes, towards a spot."""
    count = radius_BNK.shape[-1]
    place_BNN = torch.atan2(spot_BNN2[..., 1], spot_BNN2[..., 0]) * (count / (2 * torch.pi))
    k_BNN = place_BNN.round().long() % count
    normal_BNK2 = normals(radius_BNK)[:, None].expand(-1, k_BNN.shape[1], -1, -1, -1)
    return normal_BNK2.gather(-2, k_BNN[..., None, None].expand(*k_BNN.shape, 1, 2))[..., 0, :]
