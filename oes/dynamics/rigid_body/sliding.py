"""Objects on a table, pushed by a rod and by each other: rigid bodies in short times, as in Bullet.

Each is an outline with feet, a height, a centre of mass and an inertia. A step of the robot is many
short ones; in each (``oes.dynamics.rigid_body.substeps``), the places where things are nearest join
the contacts that are kept (``oes.dynamics.rigid_body.contact_cache``), these give impulses within
the cone of friction so that nothing approaches what it touches
(``oes.dynamics.rigid_body.impulses``), and all move. Bodies may tilt a little while they slide, and
a step leaves them upright; what rests and is not touched stays where it is. No gradient runs
through it.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from oes.dynamics.rigid_body.bodies import ContactPhysics, Pose, RigidBodies
from oes.dynamics.rigid_body.contact_cache import keep, none_kept
from oes.dynamics.rigid_body.contact_detection import Outlines, foot_touches
from oes.dynamics.rigid_body.substeps import (
    MassProperties,
    Moving,
    Reach,
    Substeps,
    advance_substeps,
)
from oes.episode import Floats
from oes.geom.polar import corners, normals

FAR = 0.02  # how far apart, or past each other, a contact's two sides may be, over the radius of a ball around the body
ROD_REACH_M = 0.075  # the radius of a ball around the rod
SLOW_M_S = 1e-6
LEAST_SCENES = 16  # for a thread
FLAT = [0, 1, 5]  # of a velocity and an angular velocity: what happens in the plane


Things = TypeVar("Things", RigidBodies, Pose)


def slide(
    bodies: RigidBodies, pose: Pose, tip_B2: Tensor, action_B2: Tensor, cfg: ContactPhysics
) -> Pose:
    """Where objects are after the rod has gone from ``tip_B2`` by ``action_B2`` (metres) in
    ``cfg.step_s`` seconds.

    Scenes are shared out among as many threads as torch has; each scene's answer is the same,
    however many.
    """
    count = max(1, min(torch.get_num_threads(), len(tip_B2) // LEAST_SCENES))
    bounds = [len(tip_B2) * i // count for i in range(count + 1)]
    parts = [slice(*ends) for ends in pairwise(bounds)]
    order_BN = _order(bodies, pose, action_B2)
    bodies, pose = _picked(bodies, order_BN), _picked(pose, order_BN)
    tasks = [
        (_part(bodies, part), _part(pose, part), tip_B2[part], action_B2[part], cfg)
        for part in parts
    ]
    with ThreadPoolExecutor(count) as pool:
        found = list(pool.map(lambda task: _slid(*task), tasks))
    after = Pose(
        **{name: torch.cat([getattr(part, name) for part in found]) for name in vars(pose)}
    )
    return _picked(after, order_BN.argsort(-1))


def _order(bodies: RigidBodies, pose: Pose, action_B2: Tensor) -> Tensor:
    """Numbers BN of the objects, from behind forwards: contacts are met one after the other, and
    the order in which objects happen to be told shall not matter.
    """
    ahead_BN = (pose.place_BN2 * action_B2[:, None]).sum(-1)
    return ahead_BN.masked_fill(~bodies.valid_BN, torch.inf).argsort(dim=-1, stable=True)


def _picked(things: Things, order_BN: Tensor) -> Things:
    """The same objects in another order."""
    scene_B1 = torch.arange(len(order_BN))[:, None]
    return replace(things, **{name: x[scene_B1, order_BN] for name, x in vars(things).items()})


def _part(things: Things, scenes: slice) -> Things:
    """The same of some scenes."""
    return replace(things, **{name: x[scenes] for name, x in vars(things).items()})


def _slid(
    bodies: RigidBodies, pose: Pose, tip_B2: Tensor, action_B2: Tensor, cfg: ContactPhysics
) -> Pose:
    """As ``slide``, in one thread."""
    place_BN3, turn_BN33, twist_BN6 = _upright(bodies, pose)
    rod_B3, speed_B2 = (
        np.concatenate([_array(tip_B2), np.zeros((len(tip_B2), 1))], 1),
        _array(action_B2) / cfg.step_s,
    )
    moving = Moving(place_BN3, turn_BN33, twist_BN6, (twist_BN6 != 0).any(-1), rod_B3, speed_B2)
    flat_BN3 = _advance(bodies, moving, cfg)
    place_BN2, turn_BN, twist_BN3 = (
        torch.from_numpy(x).to(pose.place_BN2)
        for x in (flat_BN3[..., :2], flat_BN3[..., 2], twist_BN6[..., FLAT])
    )
    turn_BN = (
        pose.turn_BN + torch.remainder(turn_BN - pose.turn_BN + torch.pi, 2 * torch.pi) - torch.pi
    )
    is_there_BN = bodies.valid_BN
    return Pose(
        torch.where(is_there_BN[..., None], place_BN2, pose.place_BN2),
        torch.where(is_there_BN, turn_BN, pose.turn_BN),
        twist_BN3 * is_there_BN[..., None],
    )


def _advance(bodies: RigidBodies, moving: Moving, cfg: ContactPhysics) -> Floats:
    """Change ``moving`` as ``cfg.parts`` short times do; where bodies are in the plane afterwards,
    BN3.
    """
    outlines, (batch, num) = outlines_of(bodies), bodies.valid_BN.shape
    grip_3 = np.array([cfg.table_friction, cfg.rod_friction, cfg.object_friction])
    heft = MassProperties(
        inverse_BN33=_array(bodies.inverse_BN33),
        heavy_BN=_array(bodies.heavy_BN),
        height_BN=_array(bodies.height_BN),
        grip_BN3=_array(bodies.rough_BN)[..., None] * grip_3,
    )
    table, rod, speed_B2 = none_kept(batch, num), none_kept(batch, num), moving.speed_B2
    far_BN = FAR * np.hypot(outlines.reach_BN, outlines.tall_BN / 2)
    reach = Reach(far_BN, np.minimum(far_BN, FAR * ROD_REACH_M), np.zeros((batch, 3)))
    ahead_B2 = speed_B2 / np.maximum(np.hypot(speed_B2[:, :1], speed_B2[:, 1:]), SLOW_M_S)
    for side_B2 in _sides(ahead_B2):  # at rest all stand on four feet
        feet_BN7 = foot_touches(
            outlines, moving.place_BN3, moving.turn_BN33, side_B2, outlines.is_there_BN
        )
        keep(table, feet_BN7, moving.place_BN3, moving.turn_BN33, reach.ground_B3, far_BN)
    times = Substeps(
        h=cfg.step_s / cfg.parts,
        parts=cfg.parts,
        rounds=cfg.rounds,
        spinning_m=cfg.spinning_m,
        rod_m=cfg.rod_radius_m + cfg.margin_m,
        tip_m=cfg.tip_m,
        margin_m=cfg.margin_m,
    )
    return advance_substeps(outlines, heft, (table, rod), reach, moving, ahead_B2, times)


def _sides(ahead_B2: Floats) -> list[Floats]:
    """A direction, its opposite, and those across."""
    across_B2 = np.stack([-ahead_B2[:, 1], ahead_B2[:, 0]], 1)
    return [ahead_B2, -ahead_B2, across_B2, -across_B2]


def _upright(bodies: RigidBodies, pose: Pose) -> tuple[Floats, Floats, Floats]:
    """Places BN3 of the centres of mass, turns BN33 and velocities BN6 (linear, angular) of bodies
    on the table.
    """
    place_BN3 = _array(torch.cat([pose.place_BN2, bodies.height_BN[..., None]], -1))
    turn_BN = _array(pose.turn_BN)
    turn_BN33 = np.zeros((*turn_BN.shape, 3, 3))
    turn_BN33[..., 0, 0] = turn_BN33[..., 1, 1] = np.cos(turn_BN)
    turn_BN33[..., 1, 0], turn_BN33[..., 0, 1] = np.sin(turn_BN), -np.sin(turn_BN)
    turn_BN33[..., 2, 2] = 1
    twist_BN6 = np.zeros((*turn_BN.shape, 6))
    twist_BN6[..., FLAT] = _array(pose.twist_BN3)
    return place_BN3, turn_BN33, twist_BN6


def outlines_of(bodies: RigidBodies) -> Outlines:
    """What touches are found from."""
    rod_corner, corner = (
        corners(x) - bodies.mass_BN2[..., None, :] for x in (bodies.rod_BNK, bodies.whole_BNK)
    )
    foot_BNM1 = -bodies.height_BN[..., None, None].expand(*bodies.feet_BNM2.shape[:-1], 1)
    return Outlines(
        rod_BNK=_array(bodies.rod_BNK),
        rod_corner_BNK2=_array(rod_corner),
        whole_BNK=_array(bodies.whole_BNK),
        corner_BNK2=_array(corner),
        normal_BNK2=_array(normals(bodies.whole_BNK)),
        mass_BN2=_array(bodies.mass_BN2),
        reach_BN=_array(torch.maximum(rod_corner.norm(dim=-1), corner.norm(dim=-1)).amax(-1)),
        foot_BNM3=_array(torch.cat([bodies.feet_BNM2, foot_BNM1], -1)),
        rod_low_BNK=_array(bodies.rod_low_BNK),
        rod_high_BNK=_array(bodies.rod_high_BNK),
        tall_BN=_array(bodies.tall_BN),
        is_there_BN=bodies.valid_BN.cpu().numpy().copy(),
        has_rod_BN=(bodies.valid_BN & (bodies.rod_BNK > 0).any(-1)).cpu().numpy(),
    )


def _array(x: Tensor) -> Floats:
    """A copy, in double precision."""
    return x.double().cpu().contiguous().numpy().copy()
