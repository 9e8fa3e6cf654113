"""The short times of a step of the robot, one after the other: compiled, over all bodies of all
scenes.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oes.dynamics.rigid_body.contact_cache import Kept, keep
from oes.dynamics.rigid_body.contact_detection import (
    Outlines,
    foot_touches,
    pair_touches,
    rod_touches,
)
from oes.dynamics.rigid_body.impulses import strike
from oes.episode import Floats
from oes.jit import jit

GRAVITY = 9.81
WAKE_M = 0.002  # how near something must come to what rests


class MassProperties(NamedTuple):
    """Of N bodies in B scenes: inverse inertia BN33 in own axes for a mass of 1, mass BN (a
    multiple of the usual), height of the centre of mass BN and friction with table, rod and other
    bodies BN3.
    """

    inverse_BN33: Floats
    heavy_BN: Floats
    height_BN: Floats
    grip_BN3: Floats


class Reach(NamedTuple):
    """How far off contacts are kept, with table and rod BN (metres), and the table's origin B3."""

    far_BN: Floats
    rod_far_BN: Floats
    ground_B3: Floats


class Moving(NamedTuple):
    """What changes: places BN3 of centres of mass, turns BN33 and velocities BN6 (linear, angular)
    of bodies; which no longer rest BN; the rod's place B3; and, unchanged, its velocity B2.
    """

    place_BN3: Floats
    turn_BN33: Floats
    twist_BN6: Floats
    is_awake_BN: NDArray[np.bool_]
    rod_B3: Floats
    speed_B2: Floats


class Substeps(NamedTuple):
    """How many times of ``h`` seconds, and rounds of contacts in each; the lever of friction about
    a contact's normal; the radius of the rod (with the margin at which contacts begin), its height,
    and the margin between bodies.
    """

    h: float
    parts: int
    rounds: int
    spinning_m: float
    rod_m: float
    tip_m: float
    margin_m: float


@jit
def advance_substeps(
    bodies: Outlines,
    heft: MassProperties,
    kept: tuple[Kept, Kept],
    reach: Reach,
    moving: Moving,
    ahead_B2: Floats,
    times: Substeps,
) -> Floats:
    """Change ``moving`` and the contacts ``kept`` with table and rod.

    In each time the nearest places join the contacts, these give impulses, and all that does not
    rest moves. ``ahead_B2``: the rod's direction. Returns where bodies are in the plane, BN3 (x, y,
    angle).
    """
    place_BN3, turn_BN33, twist_BN6, is_awake_BN, rod_B3, speed_B2 = moving
    table, rod = kept
    flat_BN3 = np.empty_like(place_BN3)
    inertia, numbers = (heft.inverse_BN33, heft.heavy_BN), (times.spinning_m, times.h, times.rounds)
    for part in range(times.parts):
        sides_BN7 = rod_touches(bodies, place_BN3, turn_BN33, rod_B3, times.rod_m, times.tip_m)
        keep(rod, sides_BN7, place_BN3, turn_BN33, rod_B3, reach.rod_far_BN)
        _flatten(place_BN3, turn_BN33, flat_BN3)
        pair_BNN9 = pair_touches(
            bodies, flat_BN3, heft.height_BN, times.margin_m, is_awake_BN | (part == 0)
        )
        _wake(rod, pair_BNN9, is_awake_BN)
        is_live_BN = _live(pair_BNN9, is_awake_BN)
        feet_BN7 = foot_touches(bodies, place_BN3, turn_BN33, ahead_B2, is_live_BN)
        keep(table, feet_BN7, place_BN3, turn_BN33, reach.ground_B3, reach.far_BN)
        twist_BN6[..., 2] -= GRAVITY * times.h
        strike(
            table,
            rod,
            pair_BNN9,
            turn_BN33,
            inertia,
            heft.grip_BN3,
            speed_B2,
            numbers,
            is_live_BN,
            twist_BN6,
        )
        _move(moving, times.h)
    _flatten(place_BN3, turn_BN33, flat_BN3)
    return flat_BN3


@jit
def _flatten(place_BN3: Floats, turn_BN33: Floats, flat_BN3: Floats) -> None:
    """Where bodies are in the plane, and the angles of the turns about the vertical that come
    nearest to theirs.
    """
    for b in range(len(place_BN3)):
        for n in range(place_BN3.shape[1]):
            turn_33 = turn_BN33[b, n]
            flat_BN3[b, n, 0], flat_BN3[b, n, 1] = place_BN3[b, n, 0], place_BN3[b, n, 1]
            flat_BN3[b, n, 2] = math.atan2(
                turn_33[1, 0] - turn_33[0, 1], turn_33[0, 0] + turn_33[1, 1]
            )


@jit
def _wake(rod: Kept, pair_BNN9: Floats, is_awake_BN: NDArray[np.bool_]) -> None:
    """What the rod or another body comes near to no longer rests."""
    for b in range(len(pair_BNN9)):
        for n in range(pair_BNN9.shape[1]):
            is_near = rod.count_BN[b, n] > 0
            for other in range(pair_BNN9.shape[1]):
                is_near = is_near or pair_BNN9[b, n, other, 8] < WAKE_M
            is_awake_BN[b, n] = is_awake_BN[b, n] or is_near


@jit
def _live(pair_BNN9: Floats, is_awake_BN: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which bodies BN are awake or near others; nothing happens to the rest, whose contacts need no
    solving.
    """
    is_live_BN = is_awake_BN.copy()
    for b, n, other in np.ndindex(*pair_BNN9.shape[:3]):
        if pair_BNN9[b, n, other, 8] < np.inf:
            is_live_BN[b, n] = is_live_BN[b, other] = True
    return is_live_BN


@jit
def _move(moving: Moving, h: float) -> None:
    """Go on for ``h`` seconds at the velocities there are; what rests has none."""
    place_BN3, turn_BN33, twist_BN6, is_awake_BN, rod_B3, speed_B2 = moving
    for b in range(len(place_BN3)):
        rod_B3[b, 0] += speed_B2[b, 0] * h
        rod_B3[b, 1] += speed_B2[b, 1] * h
        for n in range(place_BN3.shape[1]):
            if not is_awake_BN[b, n]:
                twist_BN6[b, n] = 0.0
                continue
            for k in range(3):
                place_BN3[b, n, k] += twist_BN6[b, n, k] * h
            _turn(turn_BN33[b, n], twist_BN6[b, n], h)


@jit
def _turn(turn_33: Floats, twist_6: Floats, h: float) -> None:
    """Rodrigues' formula, for each of the body's axes."""
    rate = math.sqrt(twist_6[3] * twist_6[3] + twist_6[4] * twist_6[4] + twist_6[5] * twist_6[5])
    if rate > 0:
        x, y, z = twist_6[3] / rate, twist_6[4] / rate, twist_6[5] / rate
        sin, cos = math.sin(rate * h), math.cos(rate * h)
        for k in range(3):
            i, j, m = turn_33[0, k], turn_33[1, k], turn_33[2, k]
            along = (x * i + y * j + z * m) * (1 - cos)
            turn_33[0, k] = cos * i + sin * (y * m - z * j) + along * x
            turn_33[1, k] = cos * j + sin * (z * i - x * m) + along * y
            turn_33[2, k] = cos * m + sin * (x * j - y * i) + along * z
