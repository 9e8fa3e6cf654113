"""Sequential impulses: projected Gauss-Seidel over the contacts of a scene."""

import math

import numpy as np

from oes.dynamics.rigid_body.constraints import (
    FRICTION,
    GAP,
    INV_MASS,
    KINEMATIC,
    ContactRows,
    add_kinematic_contacts,
    add_pair_contacts,
    prepare_rows,
    world_inverse_inertia,
)
from oes.dynamics.rigid_body.contact_manifold import Manifold
from oes.dynamics.rigid_body.kernels import Bodies, State, StepSettings
from oes.episode import Bools, Floats
from oes.jit import jit

ERP = 0.08  # share of a penetration corrected per substep (Baumgarte), PyBullet's default


@jit
def solve_contacts(
    bodies: Bodies,
    state: State,
    manifolds: tuple[Manifold, Manifold],
    pair_BNN9: Floats,
    is_active_BN: Bools,
    rows: ContactRows,
    cfg: StepSettings,
) -> None:
    """Change the twists of active bodies to satisfy non-penetration and the friction cone.

    ``manifolds``: with table and rod; ``rows``: work space.
    """
    (table, rod), num = manifolds, state.com_BN3.shape[1]
    inverse_N33, impulse_P4 = np.empty((num, 3, 3)), np.empty((len(rows.body_P2), 4))
    for b in range(len(state.com_BN3)):
        count, twist_N6 = 0, state.twist_BN6[b]
        for n in range(num):
            if is_active_BN[b, n]:
                R_33, mass = state.rotation_BN33[b, n], bodies.mass_BN[b, n]
                world_inverse_inertia(R_33, bodies.inverse_inertia_BN33[b, n], mass, inverse_N33[n])
                count = add_kinematic_contacts(rows, count, table, b, n, R_33)
                count = add_kinematic_contacts(rows, count, rod, b, n, R_33)
                friction = bodies.pair_friction_BN[b, n]
                count = add_pair_contacts(rows, count, n, pair_BNN9[b, n], friction)
        for p in range(count):
            prepare_rows(rows, p, inverse_N33, bodies.mass_BN[b])
        # No warm starting: impulses accumulate from zero in every substep.
        impulse_P4[:count] = 0
        for _ in range(cfg.iterations):
            # All normals before all frictions, as friction is bounded by the normal impulses.
            for p in range(count):
                _solve_normal(rows, p, cfg.dt, impulse_P4, twist_N6)
            for p in range(count):
                _solve_friction(rows, p, impulse_P4, twist_N6)
                if rows.body_P2[p, 1] == KINEMATIC:
                    _solve_spinning(rows, p, cfg.spinning_m, impulse_P4, twist_N6)


@jit
def _solve_normal(
    rows: ContactRows, p: int, dt: float, impulse_P4: Floats, twist_N6: Floats
) -> None:
    gap, old = rows.scalar_P4[p, GAP], impulse_P4[p, 0]
    # An open gap may close within the substep; a penetration is corrected by ERP only, as full
    # correction would add energy.
    target = -gap / dt if gap > 0 else -ERP * gap / dt
    change = (target - _velocity(rows, p, 0, twist_N6)) / rows.inv_effective_mass_P3[p, 0]
    new = max(old + change, 0.0)  # contacts push, they never pull
    if new != old:
        _apply(rows, p, 0, new - old, twist_N6)
        impulse_P4[p, 0] = new


@jit
def _solve_friction(rows: ContactRows, p: int, impulse_P4: Floats, twist_N6: Floats) -> None:
    first = impulse_P4[p, 1] - _velocity(rows, p, 1, twist_N6) / rows.inv_effective_mass_P3[p, 1]
    second = impulse_P4[p, 2] - _velocity(rows, p, 2, twist_N6) / rows.inv_effective_mass_P3[p, 2]
    # Both tangents together: the friction cone's section is a disc, not a square.
    limit = rows.scalar_P4[p, FRICTION] * impulse_P4[p, 0]
    length = math.sqrt(first * first + second * second)
    if length > limit:
        first, second = first * limit / length, second * limit / length
    if first != impulse_P4[p, 1] or second != impulse_P4[p, 2]:
        _apply(rows, p, 1, first - impulse_P4[p, 1], twist_N6)
        _apply(rows, p, 2, second - impulse_P4[p, 2], twist_N6)
        impulse_P4[p, 1], impulse_P4[p, 2] = first, second


@jit
def _solve_spinning(
    rows: ContactRows, p: int, spinning_m: float, impulse_P4: Floats, twist_N6: Floats
) -> None:
    """Friction torque about the normal: a contact is a patch, not a point."""
    n, old, limit = rows.body_P2[p, 0], impulse_P4[p, 3], spinning_m * impulse_P4[p, 0]
    rate = 0.0
    for i in range(3):
        rate += twist_N6[n, 3 + i] * rows.axis_P33[p, 0, i]
    new = min(max(old - rate / rows.spin_P4[p, 3], -limit), limit)
    for i in range(3):
        twist_N6[n, 3 + i] += (new - old) * rows.spin_P4[p, i]
    impulse_P4[p, 3] = new


# The two innermost kernels index whole arrays: a view per call would cost a fifth of the solver.


@jit
def _velocity(rows: ContactRows, p: int, k: int, twist_N6: Floats) -> float:
    """Relative velocity of the first body at the contact along row ``k``."""
    axis_P33, angular_P233 = rows.axis_P33, rows.angular_P233
    n, other = rows.body_P2[p, 0], rows.body_P2[p, 1]
    velocity: float = -rows.velocity_P2[p, 0] * axis_P33[p, k, 0]
    velocity -= rows.velocity_P2[p, 1] * axis_P33[p, k, 1]
    for i in range(3):
        linear = twist_N6[n, i] * axis_P33[p, k, i]
        velocity += linear + twist_N6[n, 3 + i] * angular_P233[p, 0, k, i]
    if other != KINEMATIC:
        for i in range(3):
            velocity -= twist_N6[other, i] * axis_P33[p, k, i]
            velocity -= twist_N6[other, 3 + i] * angular_P233[p, 1, k, i]
    return velocity


@jit
def _apply(rows: ContactRows, p: int, k: int, impulse: float, twist_N6: Floats) -> None:
    """Apply an impulse along row ``k`` to the first body and its opposite to the second."""
    n, other = rows.body_P2[p, 0], rows.body_P2[p, 1]
    for i in range(3):
        twist_N6[n, i] += impulse * rows.scalar_P4[p, INV_MASS] * rows.axis_P33[p, k, i]
        twist_N6[n, 3 + i] += impulse * rows.response_P233[p, 0, k, i]
    if other != KINEMATIC:
        for i in range(3):
            twist_N6[other, i] -= impulse * rows.scalar_P4[p, INV_MASS + 1] * rows.axis_P33[p, k, i]
            twist_N6[other, 3 + i] -= impulse * rows.response_P233[p, 1, k, i]
