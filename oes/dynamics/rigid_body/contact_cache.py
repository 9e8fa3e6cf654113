"""Contacts as a physics engine keeps them from one short time to the next: compiled, over all
bodies of all scenes.

Like Bullet, whose world is forecast: every time adds the one place where two things are nearest, at
most four are kept, and one is forgotten once its two sides have parted, or slid past each other, by
more than a little. What slides fast is therefore held by one to three of its feet, never by all,
and rattles; that is why a pushed object slips off the rod.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oes.episode import Floats
from oes.jit import jit

MOST = 4

Counts = NDArray[np.int64]


class Kept(NamedTuple):
    """Contacts BN4 of bodies with one other thing: the place on the body in its own axes, from its
    centre of mass; the place on the other from its origin; the normal towards the body (world
    axes); the gap (metres); how many there are BN.
    """

    point_BN43: Floats
    anchor_BN43: Floats
    normal_BN43: Floats
    gap_BN4: Floats
    count_BN: Counts


def none_kept(batch: int, num: int) -> Kept:
    """No contacts, of N bodies in B scenes."""
    point, anchor, normal = (np.zeros((batch, num, MOST, 3)) for _ in range(3))
    return Kept(
        point, anchor, normal, np.zeros((batch, num, MOST)), np.zeros((batch, num), np.int64)
    )


@jit
def keep(
    kept: Kept,
    touch_BN7: Floats,
    place_BN3: Floats,
    turn_BN33: Floats,
    origin_B3: Floats,
    far_BN: Floats,
) -> None:
    """Add the nearest places (see ``oes.dynamics.rigid_body.contact_detection``) and forget what is
    farther off than ``far_BN``.
    """
    for b in range(len(place_BN3)):
        for n in range(place_BN3.shape[1]):
            one = (
                kept.point_BN43[b, n],
                kept.anchor_BN43[b, n],
                kept.normal_BN43[b, n],
                kept.gap_BN4[b, n],
            )
            count, far = kept.count_BN[b, n], far_BN[b, n]
            if touch_BN7[b, n, 6] < far:
                count = _added(
                    one, count, touch_BN7[b, n], place_BN3[b, n], turn_BN33[b, n], origin_B3[b], far
                )
            kept.count_BN[b, n] = _refreshed(
                one, count, place_BN3[b, n], turn_BN33[b, n], origin_B3[b], far
            )


@jit
def _added(
    one: tuple[Floats, Floats, Floats, Floats],
    count: int,
    touch_7: Floats,
    place_3: Floats,
    turn_33: Floats,
    origin_3: Floats,
    far: float,
) -> int:
    """The number of contacts after a place was added, in place of one near it or, of four, of that
    without which they span most.
    """
    point_43, anchor_43, normal_43, gap_4 = one
    slot, least = -1, far * far
    for c in range(count):
        x, y, z = (
            point_43[c, 0] - touch_7[0],
            point_43[c, 1] - touch_7[1],
            point_43[c, 2] - touch_7[2],
        )
        square = x * x + y * y + z * z
        if square < least:
            slot, least = c, square
    if slot < 0 and count < MOST:
        slot, count = count, count + 1
    elif slot < 0:
        slot = _spared(point_43, gap_4, touch_7[:3])
    for k in range(3):
        along = turn_33[k, 0] * touch_7[0] + turn_33[k, 1] * touch_7[1] + turn_33[k, 2] * touch_7[2]
        point_43[slot, k], normal_43[slot, k] = touch_7[k], touch_7[3 + k]
        anchor_43[slot, k] = place_3[k] + along - touch_7[6] * touch_7[3 + k] - origin_3[k]
    gap_4[slot] = touch_7[6]
    return count


@jit
def _spared(point_43: Floats, gap_4: Floats, fresh_3: Floats) -> int:
    """Which of four contacts to give up for a fifth: never the deepest."""
    deepest, most, slot = 0, -1.0, 0
    for c in range(1, MOST):
        deepest = c if gap_4[c] < gap_4[deepest] else deepest
    for c in range(MOST):
        if c != deepest:
            area = _span(point_43, c, fresh_3)
            if area > most:
                most, slot = area, c
    return slot


@jit
def _span(point_43: Floats, spared: int, fresh_3: Floats) -> float:
    """How far apart four places are, one of them replaced: the greatest square of twice the area
    between diagonals.
    """
    most = 0.0
    for i in range(1, MOST):
        j, k = (2, 3) if i == 1 else ((1, 3) if i == 2 else (1, 2))
        a_3, b_3 = fresh_3 if spared == 0 else point_43[0], fresh_3 if spared == i else point_43[i]
        c_3, d_3 = fresh_3 if spared == j else point_43[j], fresh_3 if spared == k else point_43[k]
        x, y, z = a_3[0] - b_3[0], a_3[1] - b_3[1], a_3[2] - b_3[2]
        u, v, w = c_3[0] - d_3[0], c_3[1] - d_3[1], c_3[2] - d_3[2]
        p, q, r = y * w - z * v, z * u - x * w, x * v - y * u
        most = max(most, p * p + q * q + r * r)
    return most


@jit
def _refreshed(
    one: tuple[Floats, Floats, Floats, Floats],
    count: int,
    place_3: Floats,
    turn_33: Floats,
    origin_3: Floats,
    far: float,
) -> int:
    """The number of contacts after gaps were measured anew and those too far off forgotten."""
    point_43, anchor_43, normal_43, gap_4 = one
    for c in range(count - 1, -1, -1):
        gap, square = 0.0, 0.0
        for k in range(3):
            x = place_3[k] - origin_3[k] - anchor_43[c, k]
            x += (
                turn_33[k, 0] * point_43[c, 0]
                + turn_33[k, 1] * point_43[c, 1]
                + turn_33[k, 2] * point_43[c, 2]
            )
            gap += x * normal_43[c, k]
            square += x * x
        gap_4[c] = gap
        if gap > far or square - gap * gap > far * far:
            count -= 1
            point_43[c], anchor_43[c], normal_43[c] = (
                point_43[count],
                anchor_43[count],
                normal_43[count],
            )
            gap_4[c] = gap_4[count]
    return count
