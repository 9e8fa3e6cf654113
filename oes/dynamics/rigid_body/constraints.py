"""Contact constraints of one scene: Jacobian rows and inverse effective masses."""

import math
from typing import NamedTuple

import numpy as np

from oes.dynamics.rigid_body.contact_manifold import MAX_POINTS, Manifold
from oes.dynamics.rigid_body.kernels import cross, dot
from oes.episode import Floats, Ints
from oes.jit import jit

STEEP = 0.7  # a normal with a larger |z| takes its first tangent from the x axis, not the z axis
KINEMATIC = -1  # index of table and rod: impulses do not move them
GAP, FRICTION, INV_MASS = 0, 1, 2  # columns of ContactRows.scalar_P4


class ContactRows(NamedTuple):
    """P contacts of one scene, each with three rows: the normal and two tangents (world axes).

    body_P2         indices of the two bodies; the second may be ``KINEMATIC``
    scalar_P4       gap, friction coefficient, inverse masses of both bodies (0 for ``KINEMATIC``)
    axis_P33        normal towards the first body, tangents
    arm_P23         contact point from the centre of mass of either body
    angular_P233    angular Jacobian: torque on either body by a unit impulse along each row
    response_P233   angular velocity that this torque causes
    inv_effective_mass_P3   velocity along each row caused by a unit impulse along it
    velocity_P2     velocity of a ``KINEMATIC`` second body (x, y)
    spin_P4         angular velocity (3) and its normal component by a unit torque about the normal
    """

    body_P2: Ints
    scalar_P4: Floats
    axis_P33: Floats
    arm_P23: Floats
    angular_P233: Floats
    response_P233: Floats
    inv_effective_mass_P3: Floats
    velocity_P2: Floats
    spin_P4: Floats


def empty_rows(num: int) -> ContactRows:
    """Rows for the largest number of contacts that ``num`` bodies can have, uninitialized."""
    rows = num * (2 * MAX_POINTS + num)
    shapes = (4,), (3, 3), (2, 3), (2, 3, 3), (2, 3, 3), (3,), (2,), (4,)
    return ContactRows(np.empty((rows, 2), np.int64), *(np.empty((rows, *x)) for x in shapes))


@jit
def world_inverse_inertia(
    rotation_33: Floats, inverse_33: Floats, mass: float, out_33: Floats
) -> None:
    """R I^-1 R^T / mass into ``out_33``."""
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += rotation_33[i, k] * inverse_33[k, m] * rotation_33[j, m]
            out_33[i, j] = total / mass


@jit
def add_kinematic_contacts(
    rows: ContactRows, count: int, manifold: Manifold, b: int, n: int, rotation_33: Floats
) -> int:
    """Append a body's contacts with table or rod; the new number of contacts."""
    for c in range(manifold.count_BN[b, n]):
        point_3 = manifold.point_BN43[b, n, c]
        for k in range(3):
            rows.axis_P33[count, 0, k] = manifold.normal_BN43[b, n, c, k]
            rows.arm_P23[count, 0, k] = dot(rotation_33[k], point_3)
        rows.scalar_P4[count, GAP] = manifold.gap_BN4[b, n, c]
        rows.scalar_P4[count, FRICTION] = manifold.friction_BN[b, n]
        rows.velocity_P2[count] = manifold.velocity_B2[b]
        rows.body_P2[count, 0], rows.body_P2[count, 1] = n, KINEMATIC
        count += 1
    return count


@jit
def add_pair_contacts(
    rows: ContactRows, count: int, n: int, contact_N9: Floats, friction: float
) -> int:
    """Append a body's contacts with other bodies; the new number of contacts."""
    for other in range(len(contact_N9)):
        contact_9 = contact_N9[other]
        if contact_9[8] < np.inf:
            axis_3 = rows.axis_P33[count, 0]
            axis_3[0], axis_3[1], axis_3[2] = contact_9[0], contact_9[1], 0
            rows.arm_P23[count, 0], rows.arm_P23[count, 1] = contact_9[2:5], contact_9[5:8]
            rows.scalar_P4[count, GAP], rows.scalar_P4[count, FRICTION] = contact_9[8], friction
            rows.velocity_P2[count] = 0.0
            rows.body_P2[count, 0], rows.body_P2[count, 1] = n, other
            count += 1
    return count


@jit
def prepare_rows(rows: ContactRows, p: int, inverse_N33: Floats, mass_N: Floats) -> None:
    """Complete contact ``p`` from its normal, arms, bodies and world inverse inertias."""
    axis_33 = rows.axis_P33[p]
    # First tangent: the coordinate axis that is far from the normal, orthogonalized.
    k = 0 if abs(axis_33[0, 2]) > STEEP else 2
    along = axis_33[0, k]
    across = math.sqrt(1 - along * along)
    for i in range(3):
        axis_33[1, i] = ((1.0 if i == k else 0.0) - along * axis_33[0, i]) / across
        rows.inv_effective_mass_P3[p, i] = 0.0
    axis_33[2, 0], axis_33[2, 1], axis_33[2, 2] = cross(axis_33[0], axis_33[1])
    for side in range(2):
        n = rows.body_P2[p, side]
        rows.scalar_P4[p, INV_MASS + side] = 0.0 if n == KINEMATIC else 1 / mass_N[n]
        if n != KINEMATIC:
            _prepare_side(rows, p, side, inverse_N33[n])
    # Only table and rod resist spinning: bodies touch each other along a line, not on a patch.
    if rows.body_P2[p, 1] == KINEMATIC:
        n, total = rows.body_P2[p, 0], 0.0
        for i in range(3):
            rate = 0.0
            for k in range(3):
                rate += inverse_N33[n, i, k] * axis_33[0, k]
            rows.spin_P4[p, i] = rate
            total += rate * axis_33[0, i]
        rows.spin_P4[p, 3] = total


@jit
def _prepare_side(rows: ContactRows, p: int, side: int, inverse_33: Floats) -> None:
    """Angular Jacobian and response of one body, and its share of the effective masses."""
    angular_33, response_33 = rows.angular_P233[p, side], rows.response_P233[p, side]
    arm_3, axis_33 = rows.arm_P23[p, side], rows.axis_P33[p]
    for k in range(3):
        x, y, z = cross(arm_3, axis_33[k])
        angular_33[k, 0], angular_33[k, 1], angular_33[k, 2] = x, y, z
        inv_mass = rows.scalar_P4[p, INV_MASS + side]
        for i in range(3):
            response_33[k, i] = inverse_33[i, 0] * x + inverse_33[i, 1] * y + inverse_33[i, 2] * z
            inv_mass += angular_33[k, i] * response_33[k, i]
        rows.inv_effective_mass_P3[p, k] += inv_mass
