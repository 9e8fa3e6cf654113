"""What contacts do to the velocities of rigid bodies in a short time: impulses. Compiled, over all
scenes.
"""

import math

import numpy as np
from numpy.typing import NDArray

from oes.dynamics.rigid_body.constraints import (
    NONE,
    ConstraintRows,
    add_own,
    add_pairs,
    no_rows,
    prepare_constraints,
    turned_inertia,
)
from oes.dynamics.rigid_body.contact_cache import Kept
from oes.episode import Floats
from oes.jit import jit

PARTED = 0.08  # how much of an overlap is undone in one short time, as in Bullet


@jit
def strike(
    table: Kept,
    rod: Kept,
    pair_BNN9: Floats,
    turn_BN33: Floats,
    inertia: tuple[Floats, Floats],
    grip_BN3: Floats,
    rod_speed_B2: Floats,
    numbers: tuple[float, float, int],
    is_live_BN: NDArray[np.bool_],
    twist_BN6: Floats,
) -> None:
    """Velocities ``twist_BN6`` (of the centre of mass, then angular) such that nothing approaches
    what it touches in ``h`` seconds, and slips along it only where friction (within its cone) is
    too weak: rounds of one contact after the other (projected Gauss-Seidel).

    ``inertia``: inverse inertia BN33 in own axes, for a mass of 1, and masses BN; ``grip_BN3``
    friction with table, rod and other bodies; ``numbers``: the lever of friction about the normal
    of one contact, ``h`` and how many rounds; ``pair_BNN9`` see
    ``oes.dynamics.rigid_body.contact_detection``. Contacts of bodies that are not live are left
    out.
    """
    (inverse_BN33, heavy_BN), (spinning_m, h, rounds) = inertia, numbers
    num = twist_BN6.shape[1]
    rows = no_rows(num)
    inverse_N33, pushed_R4, still_2 = (
        np.empty((num, 3, 3)),
        np.empty((len(rows.body_R2), 4)),
        np.zeros(2),
    )
    for b in range(len(twist_BN6)):
        count = 0
        for n in range(num):
            if not is_live_BN[b, n]:
                continue
            turned_inertia(turn_BN33[b, n], inverse_BN33[b, n], heavy_BN[b, n], inverse_N33[n])
            count = add_own(rows, count, table, b, n, turn_BN33[b, n], grip_BN3[b, n, 0], still_2)
            count = add_own(
                rows, count, rod, b, n, turn_BN33[b, n], grip_BN3[b, n, 1], rod_speed_B2[b]
            )
            count = add_pairs(rows, count, n, pair_BNN9[b, n], grip_BN3[b, n, 2])
        for r in range(count):
            prepare_constraints(rows, r, inverse_N33, heavy_BN[b])
        pushed_R4[:count] = 0
        for _ in range(rounds):
            _round(rows, count, spinning_m, h, pushed_R4, twist_BN6[b])


@jit
def _round(
    rows: ConstraintRows,
    count: int,
    spinning_m: float,
    h: float,
    pushed_R4: Floats,
    twist_N6: Floats,
) -> None:
    """Every contact once."""
    for r in range(count):
        _push(rows, r, h, pushed_R4, twist_N6)
    for r in range(count):
        _rub(rows, r, pushed_R4, twist_N6)
        if rows.body_R2[r, 1] == NONE:
            _twirl(rows, r, spinning_m, pushed_R4, twist_N6)


@jit
def _push(rows: ConstraintRows, r: int, h: float, pushed_R4: Floats, twist_N6: Floats) -> None:
    """Along the normal: never pulling."""
    gap, old = rows.number_R4[r, 0], pushed_R4[r, 0]
    aim = -gap / h if gap > 0 else -PARTED * gap / h
    new = max(old + (aim - _speed(rows, r, 0, twist_N6)) / rows.soft_R3[r, 0], 0.0)
    if new != old:
        _kick(rows, r, 0, new - old, twist_N6)
        pushed_R4[r, 0] = new


@jit
def _rub(rows: ConstraintRows, r: int, pushed_R4: Floats, twist_N6: Floats) -> None:
    """Across the normal: within the cone of friction."""
    first = pushed_R4[r, 1] - _speed(rows, r, 1, twist_N6) / rows.soft_R3[r, 1]
    second = pushed_R4[r, 2] - _speed(rows, r, 2, twist_N6) / rows.soft_R3[r, 2]
    most, length = (
        rows.number_R4[r, 1] * pushed_R4[r, 0],
        math.sqrt(first * first + second * second),
    )
    if length > most:
        first, second = first * most / length, second * most / length
    if first != pushed_R4[r, 1] or second != pushed_R4[r, 2]:
        _kick(rows, r, 1, first - pushed_R4[r, 1], twist_N6)
        _kick(rows, r, 2, second - pushed_R4[r, 2], twist_N6)
        pushed_R4[r, 1], pushed_R4[r, 2] = first, second


@jit
def _twirl(
    rows: ConstraintRows, r: int, spinning_m: float, pushed_R4: Floats, twist_N6: Floats
) -> None:
    """About the normal: a contact is a spot that resists turning, not a point."""
    n, old, most = rows.body_R2[r, 0], pushed_R4[r, 3], spinning_m * pushed_R4[r, 0]
    rate = 0.0
    for i in range(3):
        rate += twist_N6[n, 3 + i] * rows.axis_R33[r, 0, i]
    new = min(max(old - rate / rows.twirl_R4[r, 3], -most), most)
    for i in range(3):
        twist_N6[n, 3 + i] += (new - old) * rows.twirl_R4[r, i]
    pushed_R4[r, 3] = new


@jit
def _speed(rows: ConstraintRows, r: int, k: int, twist_N6: Floats) -> float:
    """How fast the first body's point moves along an axis, as the other sees it."""
    found: float = (
        -rows.drift_R2[r, 0] * rows.axis_R33[r, k, 0] - rows.drift_R2[r, 1] * rows.axis_R33[r, k, 1]
    )
    n, other = rows.body_R2[r, 0], rows.body_R2[r, 1]
    for i in range(3):
        found += (
            twist_N6[n, i] * rows.axis_R33[r, k, i]
            + twist_N6[n, 3 + i] * rows.torque_R233[r, 0, k, i]
        )
    if other != NONE:
        for i in range(3):
            found -= twist_N6[other, i] * rows.axis_R33[r, k, i]
            found -= twist_N6[other, 3 + i] * rows.torque_R233[r, 1, k, i]
    return found


@jit
def _kick(rows: ConstraintRows, r: int, k: int, impulse: float, twist_N6: Floats) -> None:
    """An impulse along an axis on the first body, its opposite on the second."""
    n, other = rows.body_R2[r, 0], rows.body_R2[r, 1]
    for i in range(3):
        twist_N6[n, i] += impulse * rows.number_R4[r, 2] * rows.axis_R33[r, k, i]
        twist_N6[n, 3 + i] += impulse * rows.spin_R233[r, 0, k, i]
    if other != NONE:
        for i in range(3):
            twist_N6[other, i] -= impulse * rows.number_R4[r, 3] * rows.axis_R33[r, k, i]
            twist_N6[other, 3 + i] -= impulse * rows.spin_R233[r, 1, k, i]
