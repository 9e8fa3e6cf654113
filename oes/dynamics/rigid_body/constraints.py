"""Contacts of one scene as constraints on the velocities of its bodies: what an impulse at each
would do. Compiled.
"""

import math
from typing import NamedTuple

import numpy as np

from oes.dynamics.rigid_body.contact_cache import MOST, Counts, Kept
from oes.episode import Floats
from oes.jit import jit

STEEP = 0.7
NONE = -1


class ConstraintRows(NamedTuple):
    """R contacts of one scene: the normal towards the first body and two sides across it R33; per
    axis of those, what a unit of it does to the first body's and the second's rotation, as torque
    R233 and as angular velocity R233; how soft the contact is along each R3; gap, friction and
    inverse masses R4; the velocity of what has none of its own R2; which bodies R2 (``NONE``: table
    or rod); and the angular velocity that a unit of torque about the normal gives the first body,
    and its share about the normal R4.
    """

    axis_R33: Floats
    torque_R233: Floats
    spin_R233: Floats
    soft_R3: Floats
    number_R4: Floats
    drift_R2: Floats
    body_R2: Counts
    twirl_R4: Floats


@jit
def no_rows(num: int) -> ConstraintRows:
    """Space for the contacts of ``num`` bodies."""
    most = num * (2 * MOST + num)
    return ConstraintRows(
        np.empty((most, 3, 3)),
        np.zeros((most, 2, 3, 3)),
        np.zeros((most, 2, 3, 3)),
        np.empty((most, 3)),
        np.empty((most, 4)),
        np.empty((most, 2)),
        np.empty((most, 2), np.int64),
        np.empty((most, 4)),
    )


@jit
def turned_inertia(turn_33: Floats, inverse_33: Floats, heavy: float, found_33: Floats) -> None:
    """Inverse inertia in the world's axes."""
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += turn_33[i, k] * inverse_33[k, m] * turn_33[j, m]
            found_33[i, j] = total / heavy


@jit
def add_own(
    rows: ConstraintRows,
    count: int,
    kept: Kept,
    b: int,
    n: int,
    turn_33: Floats,
    grip: float,
    drift_2: Floats,
) -> int:
    """Contacts of a body with table or rod; the number of rows with them."""
    for c in range(kept.count_BN[b, n]):
        point_3 = kept.point_BN43[b, n, c]
        for k in range(3):
            rows.axis_R33[count, 0, k] = kept.normal_BN43[b, n, c, k]
            rows.torque_R233[count, 0, 0, k] = (
                turn_33[k, 0] * point_3[0] + turn_33[k, 1] * point_3[1] + turn_33[k, 2] * point_3[2]
            )
        rows.number_R4[count, 0], rows.number_R4[count, 1] = kept.gap_BN4[b, n, c], grip
        rows.drift_R2[count] = drift_2
        rows.body_R2[count, 0], rows.body_R2[count, 1] = n, NONE
        count += 1
    return count


@jit
def add_pairs(rows: ConstraintRows, count: int, n: int, pair_N9: Floats, grip: float) -> int:
    """Contacts of a body with others; the number of rows with them."""
    for other in range(len(pair_N9)):
        pair_9 = pair_N9[other]
        if pair_9[8] < np.inf:
            rows.axis_R33[count, 0, 0], rows.axis_R33[count, 0, 1], rows.axis_R33[count, 0, 2] = (
                pair_9[0],
                pair_9[1],
                0,
            )
            rows.torque_R233[count, 0, 0], rows.torque_R233[count, 1, 0] = pair_9[2:5], pair_9[5:8]
            rows.number_R4[count, 0], rows.number_R4[count, 1] = pair_9[8], grip
            rows.drift_R2[count] = 0.0
            rows.body_R2[count, 0], rows.body_R2[count, 1] = n, other
            count += 1
    return count


@jit
def prepare_constraints(rows: ConstraintRows, r: int, inverse_N33: Floats, heavy_N: Floats) -> None:
    """Everything that follows from the normal and the levers (which stand where torques along the
    normal will).
    """
    axis_33 = rows.axis_R33[r]
    k = 0 if abs(axis_33[0, 2]) > STEEP else 2
    along = axis_33[0, k]
    across = math.sqrt(1 - along * along)
    for i in range(3):
        axis_33[1, i] = ((1.0 if i == k else 0.0) - along * axis_33[0, i]) / across
        rows.soft_R3[r, i] = 0.0
    _cross(axis_33[0], axis_33[1], axis_33[2])
    for side in range(2):
        n = rows.body_R2[r, side]
        rows.number_R4[r, 2 + side] = 0.0 if n == NONE else 1 / heavy_N[n]
        if n != NONE:
            _prepare_side(rows, r, side, inverse_N33[n])
    if rows.body_R2[r, 1] == NONE:
        n, share = rows.body_R2[r, 0], 0.0
        for i in range(3):
            rate = 0.0
            for k in range(3):
                rate += inverse_N33[n, i, k] * rows.axis_R33[r, 0, k]
            rows.twirl_R4[r, i] = rate
            share += rate * rows.axis_R33[r, 0, i]
        rows.twirl_R4[r, 3] = share


@jit
def _prepare_side(rows: ConstraintRows, r: int, side: int, inverse_33: Floats) -> None:
    """What impulses along the three axes do to the first or the second body."""
    torque_33, spin_33, axis_33 = (
        rows.torque_R233[r, side],
        rows.spin_R233[r, side],
        rows.axis_R33[r],
    )
    x, y, z = torque_33[0, 0], torque_33[0, 1], torque_33[0, 2]
    for k in range(3):
        u, v, w = axis_33[k, 0], axis_33[k, 1], axis_33[k, 2]
        p, q, s = y * w - z * v, z * u - x * w, x * v - y * u
        torque_33[k, 0], torque_33[k, 1], torque_33[k, 2] = p, q, s
        soft = rows.number_R4[r, 2 + side]
        for i in range(3):
            spin_33[k, i] = inverse_33[i, 0] * p + inverse_33[i, 1] * q + inverse_33[i, 2] * s
            soft += torque_33[k, i] * spin_33[k, i]
        rows.soft_R3[r, k] += soft


@jit
def _cross(a_3: Floats, b_3: Floats, found_3: Floats) -> None:
    found_3[0] = a_3[1] * b_3[2] - a_3[2] * b_3[1]
    found_3[1] = a_3[2] * b_3[0] - a_3[0] * b_3[2]
    found_3[2] = a_3[0] * b_3[1] - a_3[1] * b_3[0]
