"""Persistent contact manifolds between each body and a kinematic one (the table or the rod).

As in Bullet, every substep adds only the deepest point, a manifold holds at most four points, and a
point is dropped once its two sides separate, or slide apart, by more than the breaking distance. A
fast-sliding body therefore stands on one to three support points at a time and chatters, which is
how pushed objects slip off the rod in Bullet.
"""

from typing import NamedTuple

import numpy as np

from oes.dynamics.rigid_body.kernels import State, cross, dot
from oes.episode import Floats, Ints
from oes.jit import jit

MAX_POINTS = 4


class Manifold(NamedTuple):
    """Contact points of N bodies of B scenes with one kinematic body (metres).

    point_BN43   on the body, body axes, from its centre of mass
    anchor_BN43  on the kinematic body, world axes, from its origin
    normal_BN43  unit normal towards the body, world axes
    gap_BN4      signed distance along the normal
    count_BN     number of points in use
    origin_B3, velocity_B2   position and velocity of the kinematic body
    friction_BN, breaking_BN   friction coefficient and breaking distance
    """

    point_BN43: Floats
    anchor_BN43: Floats
    normal_BN43: Floats
    gap_BN4: Floats
    count_BN: Ints
    origin_B3: Floats
    velocity_B2: Floats
    friction_BN: Floats
    breaking_BN: Floats


def empty_manifold(
    origin_B3: Floats, velocity_B2: Floats, friction_BN: Floats, breaking_BN: Floats
) -> Manifold:
    """Manifolds without points."""
    shape = (*friction_BN.shape, MAX_POINTS)
    point, anchor, normal = (np.zeros((*shape, 3)) for _ in range(3))
    points = point, anchor, normal, np.zeros(shape), np.zeros(friction_BN.shape, np.int64)
    return Manifold(*points, origin_B3, velocity_B2, friction_BN, breaking_BN)


@jit
def update_manifold(manifold: Manifold, contact_BN7: Floats, state: State) -> None:
    """Add the detected contacts (see ``contact_detection``), then drop broken points."""
    for b, n in np.ndindex(contact_BN7.shape[:2]):
        com_3, rotation_33 = state.com_BN3[b, n], state.rotation_BN33[b, n]
        if contact_BN7[b, n, 6] < manifold.breaking_BN[b, n]:
            contact_7 = contact_BN7[b, n]
            slot = _slot(manifold, b, n, contact_7[:3])
            manifold.gap_BN4[b, n, slot] = contact_7[6]
            for k in range(3):
                point = com_3[k] + dot(rotation_33[k], contact_7[:3])
                anchor = point - contact_7[6] * contact_7[3 + k] - manifold.origin_B3[b, k]
                manifold.point_BN43[b, n, slot, k] = contact_7[k]
                manifold.normal_BN43[b, n, slot, k] = contact_7[3 + k]
                manifold.anchor_BN43[b, n, slot, k] = anchor
        _refresh(manifold, b, n, com_3, rotation_33)


@jit
def _slot(manifold: Manifold, b: int, n: int, point_3: Floats) -> int:
    """Slot of a new point.

    It replaces the nearest point within the breaking distance, else takes a free slot, else
    replaces the point that leaves the largest contact area.
    """
    point_43, count = manifold.point_BN43[b, n], manifold.count_BN[b, n]
    slot, least = -1, manifold.breaking_BN[b, n] * manifold.breaking_BN[b, n]
    for c in range(count):
        x, y = point_43[c, 0] - point_3[0], point_43[c, 1] - point_3[1]
        z = point_43[c, 2] - point_3[2]
        square = x * x + y * y + z * z
        if square < least:
            slot, least = c, square
    if slot >= 0:
        return slot
    if count < MAX_POINTS:
        manifold.count_BN[b, n] = count + 1
        return int(count)
    # The deepest point is never replaced: it carries the penetration to be resolved.
    gap_4 = manifold.gap_BN4[b, n]
    deepest, largest, slot = 0, -1.0, 0
    for c in range(1, MAX_POINTS):
        deepest = c if gap_4[c] < gap_4[deepest] else deepest
    for c in range(MAX_POINTS):
        if c != deepest:
            area = _area(point_43, c, point_3)
            if area > largest:
                largest, slot = area, c
    return slot


@jit
def _area(point_43: Floats, replaced: int, point_3: Floats) -> float:
    """Largest |diagonal x diagonal|^2 of four points, of which ``replaced`` is exchanged."""
    largest = 0.0
    # The order of the points around the quadrilateral is unknown, so try all three pairings.
    for i in range(1, MAX_POINTS):
        j, k = (2, 3) if i == 1 else ((1, 3) if i == 2 else (1, 2))
        a_3 = point_3 if replaced == 0 else point_43[0]
        b_3 = point_3 if replaced == i else point_43[i]
        c_3 = point_3 if replaced == j else point_43[j]
        d_3 = point_3 if replaced == k else point_43[k]
        first_3 = (a_3[0] - b_3[0], a_3[1] - b_3[1], a_3[2] - b_3[2])
        p, q, r = cross(first_3, (c_3[0] - d_3[0], c_3[1] - d_3[1], c_3[2] - d_3[2]))
        largest = max(largest, p * p + q * q + r * r)
    return largest


@jit
def _refresh(manifold: Manifold, b: int, n: int, com_3: Floats, rotation_33: Floats) -> None:
    """Recompute gaps from the current poses and drop points beyond the breaking distance."""
    point_43, anchor_43 = manifold.point_BN43[b, n], manifold.anchor_BN43[b, n]
    normal_43, gap_4 = manifold.normal_BN43[b, n], manifold.gap_BN4[b, n]
    count, breaking = manifold.count_BN[b, n], manifold.breaking_BN[b, n]
    # Backwards, as a dropped point is overwritten by the last one.
    for c in range(count - 1, -1, -1):
        gap, square = 0.0, 0.0
        for k in range(3):
            x = com_3[k] - manifold.origin_B3[b, k] - anchor_43[c, k]
            x += dot(rotation_33[k], point_43[c])
            gap += x * normal_43[c, k]
            square += x * x
        gap_4[c] = gap
        if gap > breaking or square - gap * gap > breaking * breaking:
            count -= 1
            point_43[c], anchor_43[c] = point_43[count], anchor_43[count]
            normal_43[c], gap_4[c] = normal_43[count], gap_4[count]
    manifold.count_BN[b, n] = count
