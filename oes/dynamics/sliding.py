"""Objects on a table, pushed by a rod and by each other: rigid bodies in short times, as in Bullet.

Each is an outline with feet, a height, a centre of mass and an inertia. A step of the robot is many short ones; in
each, the places where things are nearest join the contacts that are kept (``oes.dynamics.contacts``), these give
impulses within the cone of friction so that nothing approaches what it touches (``oes.dynamics.impulses``), and all
move. Bodies may tilt a little while they slide, and a step leaves them upright; what rests and is not touched stays
where it is. No gradient runs through it.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.compiled import compiled
from oes.dynamics.bodies import Bodies, Physics, Pose
from oes.dynamics.contacts import keep, none_kept
from oes.dynamics.impulses import strike
from oes.dynamics.touch import Outlines, foot_touches, pair_touches, rod_touches
from oes.episode import Floats
from oes.geom.polar import corners, normals

GRAVITY = 9.81
FAR = 0.02  # how far apart, or past each other, a contact's two sides may be, over the radius of a ball around the body
WAKE_M = 0.002  # how near something must come to what rests
ROD_REACH_M = 0.075  # the radius of a ball around the rod
SLOW_M_S = 1e-6
LEAST_SCENES = 16  # for a thread
FLAT = [0, 1, 5]  # of a velocity and an angular velocity: what happens in the plane


Things = TypeVar("Things", Bodies, Pose)


def slide(bodies: Bodies, pose: Pose, tip_B2: Tensor, action_B2: Tensor, cfg: Physics) -> Pose:
    """Where objects are after the rod has gone from ``tip_B2`` by ``action_B2`` (metres) in ``cfg.step_s`` seconds.

    Scenes are shared out among as many threads as torch has; each scene's answer is the same, however many.
    """
    count = max(1, min(torch.get_num_threads(), len(tip_B2) // LEAST_SCENES))
    bounds = [len(tip_B2) * i // count for i in range(count + 1)]
    parts = [slice(*ends) for ends in pairwise(bounds)]
    order_BN = _order(bodies, pose, action_B2)
    bodies, pose = _picked(bodies, order_BN), _picked(pose, order_BN)
    tasks = [(_part(bodies, part), _part(pose, part), tip_B2[part], action_B2[part], cfg) for part in parts]
    with ThreadPoolExecutor(count) as pool:
        found = list(pool.map(lambda task: _slid(*task), tasks))
    after = Pose(**{name: torch.cat([getattr(part, name) for part in found]) for name in vars(pose)})
    return _picked(after, order_BN.argsort(-1))


def _order(bodies: Bodies, pose: Pose, action_B2: Tensor) -> Tensor:
    """Numbers BN of the objects, from behind forwards: contacts are met one after the other, and the order in which
    objects happen to be told shall not matter."""
    ahead_BN = (pose.place_BN2 * action_B2[:, None]).sum(-1)
    return ahead_BN.masked_fill(~bodies.valid_BN, torch.inf).argsort(dim=-1, stable=True)


def _picked(things: Things, order_BN: Tensor) -> Things:
    """The same objects in another order."""
    scene_B1 = torch.arange(len(order_BN))[:, None]
    return replace(things, **{name: x[scene_B1, order_BN] for name, x in vars(things).items()})


def _part(things: Things, scenes: slice) -> Things:
    """The same of some scenes."""
    return replace(things, **{name: x[scenes] for name, x in vars(things).items()})


def _slid(bodies: Bodies, pose: Pose, tip_B2: Tensor, action_B2: Tensor, cfg: Physics) -> Pose:
    """As ``slide``, in one thread."""
    place_BN3, turn_BN33, twist_BN6 = _upright(bodies, pose)
    rod_B3, speed_B2 = np.concatenate([_array(tip_B2), np.zeros((len(tip_B2), 1))], 1), _array(action_B2) / cfg.step_s
    _advance(outlines_of(bodies), bodies, (place_BN3, turn_BN33, twist_BN6), rod_B3, speed_B2, cfg)
    place_BN2, turn_BN, twist_BN3 = (
        torch.from_numpy(x).to(pose.place_BN2) for x in (place_BN3[..., :2], _yaw(turn_BN33), twist_BN6[..., FLAT])
    )
    turn_BN = pose.turn_BN + torch.remainder(turn_BN - pose.turn_BN + torch.pi, 2 * torch.pi) - torch.pi
    is_there_BN = bodies.valid_BN
    return Pose(
        torch.where(is_there_BN[..., None], place_BN2, pose.place_BN2),
        torch.where(is_there_BN, turn_BN, pose.turn_BN),
        twist_BN3 * is_there_BN[..., None],
    )


def _advance(
    outlines: Outlines,
    bodies: Bodies,
    state: tuple[Floats, Floats, Floats],
    rod_B3: Floats,
    speed_B2: Floats,
    cfg: Physics,
) -> None:
    """Change ``state`` (places, turns, velocities) and ``rod_B3`` as ``cfg.parts`` short times do."""
    place_BN3, turn_BN33, twist_BN6 = state
    h, (batch, num) = cfg.step_s / cfg.parts, bodies.valid_BN.shape
    inertia, height_BN = (_array(bodies.inverse_BN33), _array(bodies.heavy_BN)), _array(bodies.height_BN)
    grip_3 = np.array([cfg.table_friction, cfg.rod_friction, cfg.object_friction])
    grip_BN3 = _array(bodies.rough_BN)[..., None] * grip_3
    far_BN = FAR * np.hypot(outlines.reach_BN, outlines.tall_BN / 2)
    rod_far_BN, ground_B3 = np.minimum(far_BN, FAR * ROD_REACH_M), np.zeros((batch, 3))
    table, rod, rod_m = none_kept(batch, num), none_kept(batch, num), cfg.rod_radius_m + cfg.margin_m
    ahead_B2 = speed_B2 / np.maximum(np.hypot(speed_B2[:, :1], speed_B2[:, 1:]), SLOW_M_S)
    for side_B2 in _sides(ahead_B2):  # at rest all stand on four feet
        feet_BN7 = foot_touches(outlines, place_BN3, turn_BN33, side_B2)
        keep(table, feet_BN7, place_BN3, turn_BN33, ground_B3, far_BN)
    is_awake_BN = (twist_BN6 != 0).any(-1)
    for _ in range(cfg.parts):
        feet_BN7 = foot_touches(outlines, place_BN3, turn_BN33, ahead_B2)
        sides_BN7 = rod_touches(outlines, place_BN3, turn_BN33, rod_B3[:, :2], rod_m, cfg.tip_m)
        keep(table, feet_BN7, place_BN3, turn_BN33, ground_B3, far_BN)
        keep(rod, sides_BN7, place_BN3, turn_BN33, rod_B3, rod_far_BN)
        flat_BN3 = np.concatenate([place_BN3[..., :2], _yaw(turn_BN33)[..., None]], -1)
        pair_BNN9 = pair_touches(outlines, flat_BN3, height_BN, cfg.margin_m)
        is_awake_BN |= (rod.count_BN > 0) | (pair_BNN9[..., 8].min(-1) < WAKE_M)
        twist_BN6[..., 2] -= GRAVITY * h
        strike(table, rod, pair_BNN9, turn_BN33, *inertia, grip_BN3, cfg.spinning_m, speed_B2, h, cfg.rounds, twist_BN6)
        twist_BN6 *= is_awake_BN[..., None]
        _move(place_BN3, turn_BN33, twist_BN6, h)
        rod_B3[:, :2] += speed_B2 * h


@compiled
def _move(place_BN3: Floats, turn_BN33: Floats, twist_BN6: Floats, h: float) -> None:
    """Go on for ``h`` seconds at the velocities there are."""
    for b in range(len(place_BN3)):
        for n in range(place_BN3.shape[1]):
            for k in range(3):
                place_BN3[b, n, k] += twist_BN6[b, n, k] * h
            spin_6, turn_33 = twist_BN6[b, n], turn_BN33[b, n]
            rate = math.sqrt(spin_6[3] * spin_6[3] + spin_6[4] * spin_6[4] + spin_6[5] * spin_6[5])
            if rate > 0:
                x, y, z = spin_6[3] / rate, spin_6[4] / rate, spin_6[5] / rate
                sin, cos = math.sin(rate * h), math.cos(rate * h)
                for k in range(3):  # Rodrigues' formula, for each of the body's axes
                    i, j, m = turn_33[0, k], turn_33[1, k], turn_33[2, k]
                    along = (x * i + y * j + z * m) * (1 - cos)
                    turn_33[0, k] = cos * i + sin * (y * m - z * j) + along * x
                    turn_33[1, k] = cos * j + sin * (z * i - x * m) + along * y
                    turn_33[2, k] = cos * m + sin * (x * j - y * i) + along * z


def _sides(ahead_B2: Floats) -> list[Floats]:
    """A direction, its opposite, and those across."""
    across_B2 = np.stack([-ahead_B2[:, 1], ahead_B2[:, 0]], 1)
    return [ahead_B2, -ahead_B2, across_B2, -across_B2]


def _upright(bodies: Bodies, pose: Pose) -> tuple[Floats, Floats, Floats]:
    """Places BN3 of the centres of mass, turns BN33 and velocities BN6 (linear, angular) of bodies on the table."""
    place_BN3 = _array(torch.cat([pose.place_BN2, bodies.height_BN[..., None]], -1))
    turn_BN = _array(pose.turn_BN)
    turn_BN33 = np.zeros((*turn_BN.shape, 3, 3))
    turn_BN33[..., 0, 0] = turn_BN33[..., 1, 1] = np.cos(turn_BN)
    turn_BN33[..., 1, 0], turn_BN33[..., 0, 1] = np.sin(turn_BN), -np.sin(turn_BN)
    turn_BN33[..., 2, 2] = 1
    twist_BN6 = np.zeros((*turn_BN.shape, 6))
    twist_BN6[..., FLAT] = _array(pose.twist_BN3)
    return place_BN3, turn_BN33, twist_BN6


def _yaw(turn_BN33: Floats) -> NDArray[np.float64]:
    """The angles BN of the turns about the vertical that come nearest to rotations."""
    return np.arctan2(turn_BN33[..., 1, 0] - turn_BN33[..., 0, 1], turn_BN33[..., 0, 0] + turn_BN33[..., 1, 1])


def outlines_of(bodies: Bodies) -> Outlines:
    """What touches are found from."""
    rod_corner, corner = (corners(x) - bodies.mass_BN2[..., None, :] for x in (bodies.rod_BNK, bodies.whole_BNK))
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
