"""Integration of one action in substeps: detection, solver, semi-implicit Euler, sleeping."""

import math

import numpy as np

from oes.dynamics.rigid_body.constraints import ContactRows
from oes.dynamics.rigid_body.contact_detection import detect_pairs, detect_rod, detect_table
from oes.dynamics.rigid_body.contact_manifold import Manifold, update_manifold
from oes.dynamics.rigid_body.kernels import Bodies, State, StepSettings, dot
from oes.dynamics.rigid_body.solver import solve_contacts
from oes.episode import Bools, Floats
from oes.jit import jit

GRAVITY = 9.81
WAKE_M = 0.002  # a gap below this wakes a sleeping body


@jit
def advance_substeps(
    bodies: Bodies,
    state: State,
    manifolds: tuple[Manifold, Manifold],
    rows: ContactRows,
    forward_B2: Floats,
    cfg: StepSettings,
) -> Floats:
    """Advance ``state`` and the ``manifolds`` with table and rod; planar poses BN3 (x, y, yaw).

    ``rows``: work space; ``forward_B2``: direction of the rod.
    """
    table, rod = manifolds
    for step in range(cfg.substeps):
        contact_BN7 = detect_rod(bodies, state, rod.origin_B3, cfg.rod_radius_m, cfg.tip_height_m)
        update_manifold(rod, contact_BN7, state)
        # The first substep tests all pairs: bodies may start out in contact.
        is_tested_BN = state.is_awake_BN | (step == 0)
        pair_BNN9 = detect_pairs(bodies, _planar_pose(state), cfg.margin_m, is_tested_BN)
        is_active_BN = _wake(rod, pair_BNN9, state.is_awake_BN)
        contact_BN7 = detect_table(bodies, state, forward_B2, is_active_BN)
        update_manifold(table, contact_BN7, state)
        state.twist_BN6[..., 2] -= GRAVITY * cfg.dt
        solve_contacts(bodies, state, manifolds, pair_BNN9, is_active_BN, rows, cfg)
        _integrate(state, rod, cfg.dt)
    return _planar_pose(state)


@jit
def _planar_pose(state: State) -> Floats:
    """Poses BN3: x, y and the yaw of the rotation about z that is nearest to the body's."""
    planar_BN3 = np.empty_like(state.com_BN3)
    for b, n in np.ndindex(planar_BN3.shape[:2]):
        R_33 = state.rotation_BN33[b, n]
        planar_BN3[b, n, :2] = state.com_BN3[b, n, :2]
        planar_BN3[b, n, 2] = math.atan2(R_33[1, 0] - R_33[0, 1], R_33[0, 0] + R_33[1, 1])
    return planar_BN3


@jit
def _wake(rod: Manifold, pair_BNN9: Floats, is_awake_BN: Bools) -> Bools:
    """Wake bodies that the rod or another body comes close to.

    Returns the active bodies BN: those awake or near an awake one, whose contacts are solved.
    """
    is_near_BN = np.zeros_like(is_awake_BN)
    for b, n, other in np.ndindex(pair_BNN9.shape[:3]):
        if rod.count_BN[b, n] > 0 or pair_BNN9[b, n, other, 8] < WAKE_M:
            is_awake_BN[b, n] = True
        if pair_BNN9[b, n, other, 8] < np.inf:
            is_near_BN[b, n] = is_near_BN[b, other] = True
    return is_awake_BN | is_near_BN


@jit
def _integrate(state: State, rod: Manifold, dt: float) -> None:
    """Semi-implicit Euler; sleeping bodies lose their velocity instead."""
    for b in range(len(state.com_BN3)):
        rod.origin_B3[b, 0] += rod.velocity_B2[b, 0] * dt
        rod.origin_B3[b, 1] += rod.velocity_B2[b, 1] * dt
        for n in range(state.com_BN3.shape[1]):
            if not state.is_awake_BN[b, n]:
                state.twist_BN6[b, n] = 0.0
                continue
            for k in range(3):
                state.com_BN3[b, n, k] += state.twist_BN6[b, n, k] * dt
            _rotate(state.rotation_BN33[b, n], state.twist_BN6[b, n, 3:], dt)


@jit
def _rotate(rotation_33: Floats, angular_3: Floats, dt: float) -> None:
    """Rotate by an angular velocity for ``dt``, by Rodrigues' formula for each body axis."""
    rate = math.sqrt(dot(angular_3, angular_3))
    if rate > 0:
        x, y, z = angular_3[0] / rate, angular_3[1] / rate, angular_3[2] / rate
        sin, cos = math.sin(rate * dt), math.cos(rate * dt)
        for k in range(3):
            u, v, w = rotation_33[0, k], rotation_33[1, k], rotation_33[2, k]
            along = (x * u + y * v + z * w) * (1 - cos)
            rotation_33[0, k] = cos * u + sin * (y * w - z * v) + along * x
            rotation_33[1, k] = cos * v + sin * (z * u - x * w) + along * y
            rotation_33[2, k] = cos * w + sin * (x * v - y * u) + along * z
