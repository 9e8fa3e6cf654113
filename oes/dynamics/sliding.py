"""Objects that slide on a table, pushed by a rod and by each other, seen from above: rigid bodies in the plane.

Each is an outline with a centre of mass, a radius of gyration and points that it stands on. A step of the robot is
many short ones; in each, the table's friction slows what slides (Coulomb's law at every point of support, implicitly),
contacts give impulses within the cone of friction so that nothing approaches what it touches, all move, and what
overlaps is parted. As in Bullet, whose world this forecasts, contacts are inelastic. No gradient runs through it.
"""

import torch
from torch import Tensor

from oes.dynamics.bodies import Bodies, Physics, Pose
from oes.dynamics.friction import brake
from oes.dynamics.impulses import part_pairs, part_rod, strike_pairs, strike_rod
from oes.dynamics.touch import Outlines, pair_touches, rod_touches
from oes.episode import Floats
from oes.geom.polar import corners, normals

GRAVITY = 9.81


def slide(bodies: Bodies, pose: Pose, tip_B2: Tensor, action_B2: Tensor, cfg: Physics) -> Pose:
    """Where objects are after the rod has gone from ``tip_B2`` by ``action_B2`` (metres) in ``cfg.step_s`` seconds."""
    h, rod_m, outlines = cfg.step_s / cfg.parts, cfg.rod_radius_m + cfg.margin_m, outlines_of(bodies)
    support_BNM2, share_BNM, heavy_BN = map(_array, (bodies.support_BNM2, bodies.share_BNM, bodies.heavy_BN))
    inertia_BN = _array(bodies.gyration_BN) ** 2
    strength_BN = _array(bodies.rough_BN) * (cfg.table_friction * GRAVITY * h)
    pose_BN3 = _array(torch.cat([pose.place_BN2, pose.turn_BN[..., None]], -1))
    twist_BN3, rod_B2, speed_B2 = _array(pose.twist_BN3), _array(tip_B2), _array(action_B2) / cfg.step_s
    for _ in range(cfg.parts):
        brake(support_BNM2, share_BNM, inertia_BN, strength_BN, cfg.lean_m, pose_BN3[..., 2], twist_BN3)
        rod_touch_BN7, touch_BNN7 = rod_touches(outlines, pose_BN3, rod_B2, rod_m), pair_touches(outlines, pose_BN3)
        for _ in range(cfg.rounds):
            strike_rod(rod_touch_BN7, inertia_BN, speed_B2, h, cfg.rod_friction, twist_BN3)
            strike_pairs(touch_BNN7, inertia_BN, heavy_BN, h, cfg.object_friction, twist_BN3)
        pose_BN3 += twist_BN3 * h
        rod_B2 += speed_B2 * h
        for _ in range(cfg.rounds):
            part_rod(rod_touches(outlines, pose_BN3, rod_B2, rod_m), inertia_BN, pose_BN3)
            part_pairs(pair_touches(outlines, pose_BN3), inertia_BN, pose_BN3)
    after_BN3, after_twist_BN3 = (torch.from_numpy(x).to(pose.place_BN2) for x in (pose_BN3, twist_BN3))
    return Pose(after_BN3[..., :2], after_BN3[..., 2], after_twist_BN3)


def outlines_of(bodies: Bodies) -> Outlines:
    """What touches are found from."""
    rod_corner, corner = (corners(x) - bodies.mass_BN2[..., None, :] for x in (bodies.rod_BNK, bodies.whole_BNK))
    return Outlines(
        rod_BNK=_array(bodies.rod_BNK),
        rod_corner_BNK2=_array(rod_corner),
        whole_BNK=_array(bodies.whole_BNK),
        corner_BNK2=_array(corner),
        normal_BNK2=_array(normals(bodies.whole_BNK)),
        mass_BN2=_array(bodies.mass_BN2),
        reach_BN=_array(torch.maximum(rod_corner.norm(dim=-1), corner.norm(dim=-1)).amax(-1)),
        is_there_BN=bodies.valid_BN.cpu().numpy().copy(),
        has_rod_BN=(bodies.valid_BN & (bodies.rod_BNK > 0).any(-1)).cpu().numpy(),
    )


def _array(x: Tensor) -> Floats:
    """A copy, in double precision."""
    return x.double().cpu().contiguous().numpy().copy()
