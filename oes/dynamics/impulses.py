"""What contacts do to the velocities of rigid bodies in a short time: impulses. Compiled, over all scenes."""

import math
from typing import NamedTuple

import numpy as np

from oes.compiled import compiled
from oes.dynamics.contacts import MOST, Counts, Kept
from oes.episode import Floats

PARTED = 0.08  # how much of an overlap is undone in one short time, as in Bullet
STEEP = 0.7
NONE = -1


class Rows(NamedTuple):
    """R contacts of one scene: the normal towards the first body and two sides across it R33; per axis of those, what a
    unit of it does to the first body's and the second's rotation, as torque R233 and as angular velocity R233; how soft
    the contact is along each R3; gap, friction and inverse masses R4; the velocity of what has none of its own R2;
    which bodies R2 (``NONE``: table or rod); and the angular velocity that a unit of torque about the normal gives the
    first body, and its share about the normal R4."""

    axis_R33: Floats
    torque_R233: Floats
    spin_R233: Floats
    soft_R3: Floats
    number_R4: Floats
    drift_R2: Floats
    body_R2: Counts
    twirl_R4: Floats


@compiled
def strike(
    table: Kept,
    rod: Kept,
    pair_BNN9: Floats,
    turn_BN33: Floats,
    inertia: tuple[Floats, Floats],
    grip_BN3: Floats,
    rod_speed_B2: Floats,
    numbers: tuple[float, float, int],
    twist_BN6: Floats,
) -> None:
    """Velocities ``twist_BN6`` (of the centre of mass, then angular) such that nothing approaches what it touches in
    ``h`` seconds, and slips along it only where friction (within its cone) is too weak: rounds of one contact after the
    other (projected Gauss-Seidel).

    ``inertia``: inverse inertia BN33 in own axes, for a mass of 1, and masses BN; ``grip_BN3`` friction with table, rod
    and other bodies; ``numbers``: the lever of friction about the normal of one contact, ``h`` and how many rounds;
    ``pair_BNN9`` see ``oes.dynamics.touch``.
    """
    (inverse_BN33, heavy_BN), (spinning_m, h, rounds) = inertia, numbers
    num = twist_BN6.shape[1]
    most = num * (2 * MOST + num)
    rows = Rows(
        np.empty((most, 3, 3)),
        np.zeros((most, 2, 3, 3)),
        np.zeros((most, 2, 3, 3)),
        np.empty((most, 3)),
        np.empty((most, 4)),
        np.empty((most, 2)),
        np.empty((most, 2), np.int64),
        np.empty((most, 4)),
    )
    inverse_N33, pushed_R4, still_2 = np.empty((num, 3, 3)), np.empty((most, 4)), np.zeros(2)
    for b in range(len(twist_BN6)):
        for n in range(num):
            _turned(turn_BN33[b, n], inverse_BN33[b, n], heavy_BN[b, n], inverse_N33[n])
        count = 0
        for n in range(num):
            count = _add_own(rows, count, table, b, n, turn_BN33[b, n], grip_BN3[b, n, 0], still_2)
            count = _add_own(rows, count, rod, b, n, turn_BN33[b, n], grip_BN3[b, n, 1], rod_speed_B2[b])
            count = _add_pairs(rows, count, n, pair_BNN9[b, n], grip_BN3[b, n, 2])
        for r in range(count):
            _prepare(rows, r, inverse_N33, heavy_BN[b])
        pushed_R4[:count] = 0
        for _ in range(rounds):
            _round(rows, count, spinning_m, h, pushed_R4, twist_BN6[b])


@compiled
def _round(rows: Rows, count: int, spinning_m: float, h: float, pushed_R4: Floats, twist_N6: Floats) -> None:
    """Every contact once."""
    for r in range(count):
        _push(rows, r, h, pushed_R4, twist_N6)
    for r in range(count):
        _rub(rows, r, pushed_R4, twist_N6)
        if rows.body_R2[r, 1] == NONE:
            _twirl(rows, r, spinning_m, pushed_R4, twist_N6)


@compiled
def _turned(turn_33: Floats, inverse_33: Floats, heavy: float, found_33: Floats) -> None:
    """Inverse inertia in the world's axes."""
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += turn_33[i, k] * inverse_33[k, m] * turn_33[j, m]
            found_33[i, j] = total / heavy


@compiled
def _add_own(rows: Rows, count: int, kept: Kept, b: int, n: int, turn_33: Floats, grip: float, drift_2: Floats) -> int:
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


@compiled
def _add_pairs(rows: Rows, count: int, n: int, pair_N9: Floats, grip: float) -> int:
    """Contacts of a body with others; the number of rows with them."""
    for other in range(len(pair_N9)):
        pair_9 = pair_N9[other]
        if pair_9[8] < np.inf:
            rows.axis_R33[count, 0, 0], rows.axis_R33[count, 0, 1], rows.axis_R33[count, 0, 2] = pair_9[0], pair_9[1], 0
            rows.torque_R233[count, 0, 0], rows.torque_R233[count, 1, 0] = pair_9[2:5], pair_9[5:8]
            rows.number_R4[count, 0], rows.number_R4[count, 1] = pair_9[8], grip
            rows.drift_R2[count] = 0.0
            rows.body_R2[count, 0], rows.body_R2[count, 1] = n, other
            count += 1
    return count


@compiled
def _prepare(rows: Rows, r: int, inverse_N33: Floats, heavy_N: Floats) -> None:
    """Everything that follows from the normal and the levers (which stand where torques along the normal will)."""
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


@compiled
def _prepare_side(rows: Rows, r: int, side: int, inverse_33: Floats) -> None:
    """What impulses along the three axes do to the first or the second body."""
    torque_33, spin_33, axis_33 = rows.torque_R233[r, side], rows.spin_R233[r, side], rows.axis_R33[r]
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


@compiled
def _cross(a_3: Floats, b_3: Floats, found_3: Floats) -> None:
    found_3[0] = a_3[1] * b_3[2] - a_3[2] * b_3[1]
    found_3[1] = a_3[2] * b_3[0] - a_3[0] * b_3[2]
    found_3[2] = a_3[0] * b_3[1] - a_3[1] * b_3[0]


@compiled
def _push(rows: Rows, r: int, h: float, pushed_R4: Floats, twist_N6: Floats) -> None:
    """Along the normal: never pulling."""
    gap, old = rows.number_R4[r, 0], pushed_R4[r, 0]
    aim = -gap / h if gap > 0 else -PARTED * gap / h
    new = max(old + (aim - _speed(rows, r, 0, twist_N6)) / rows.soft_R3[r, 0], 0.0)
    if new != old:
        _kick(rows, r, 0, new - old, twist_N6)
        pushed_R4[r, 0] = new


@compiled
def _rub(rows: Rows, r: int, pushed_R4: Floats, twist_N6: Floats) -> None:
    """Across the normal: within the cone of friction."""
    first = pushed_R4[r, 1] - _speed(rows, r, 1, twist_N6) / rows.soft_R3[r, 1]
    second = pushed_R4[r, 2] - _speed(rows, r, 2, twist_N6) / rows.soft_R3[r, 2]
    most, length = rows.number_R4[r, 1] * pushed_R4[r, 0], math.sqrt(first * first + second * second)
    if length > most:
        first, second = first * most / length, second * most / length
    if first != pushed_R4[r, 1] or second != pushed_R4[r, 2]:
        _kick(rows, r, 1, first - pushed_R4[r, 1], twist_N6)
        _kick(rows, r, 2, second - pushed_R4[r, 2], twist_N6)
        pushed_R4[r, 1], pushed_R4[r, 2] = first, second


@compiled
def _twirl(rows: Rows, r: int, spinning_m: float, pushed_R4: Floats, twist_N6: Floats) -> None:
    """About the normal: a contact is a spot that resists turning, not a point."""
    n, old, most = rows.body_R2[r, 0], pushed_R4[r, 3], spinning_m * pushed_R4[r, 0]
    rate = 0.0
    for i in range(3):
        rate += twist_N6[n, 3 + i] * rows.axis_R33[r, 0, i]
    new = min(max(old - rate / rows.twirl_R4[r, 3], -most), most)
    for i in range(3):
        twist_N6[n, 3 + i] += (new - old) * rows.twirl_R4[r, i]
    pushed_R4[r, 3] = new


@compiled
def _speed(rows: Rows, r: int, k: int, twist_N6: Floats) -> float:
    """How fast the first body's point moves along an axis, as the other sees it."""
    found: float = -rows.drift_R2[r, 0] * rows.axis_R33[r, k, 0] - rows.drift_R2[r, 1] * rows.axis_R33[r, k, 1]
    n, other = rows.body_R2[r, 0], rows.body_R2[r, 1]
    for i in range(3):
        found += twist_N6[n, i] * rows.axis_R33[r, k, i] + twist_N6[n, 3 + i] * rows.torque_R233[r, 0, k, i]
    if other != NONE:
        for i in range(3):
            found -= twist_N6[other, i] * rows.axis_R33[r, k, i]
            found -= twist_N6[other, 3 + i] * rows.torque_R233[r, 1, k, i]
    return found


@compiled
def _kick(rows: Rows, r: int, k: int, impulse: float, twist_N6: Floats) -> None:
    """An impulse along an axis on the first body, its opposite on the second."""
    n, other = rows.body_R2[r, 0], rows.body_R2[r, 1]
    for i in range(3):
        twist_N6[n, i] += impulse * rows.number_R4[r, 2] * rows.axis_R33[r, k, i]
        twist_N6[n, 3 + i] += impulse * rows.spin_R233[r, 0, k, i]
    if other != NONE:
        for i in range(3):
            twist_N6[other, i] -= impulse * rows.number_R4[r, 3] * rows.axis_R33[r, k, i]
            twist_N6[other, 3 + i] -= impulse * rows.spin_R233[r, 1, k, i]
