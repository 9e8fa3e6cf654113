"""The table's friction on bodies that slide and turn on it: compiled, over all bodies of all scenes."""

import math

import numpy as np

from oes.compiled import compiled
from oes.episode import Floats

SLOW_M_S = 1e-3
LEAST_SPREAD_M2 = 1e-5
ROUNDS = 2


@compiled
def brake(
    support_BNM2: Floats,
    share_BNM: Floats,
    inertia_BN: Floats,
    strength_BN: Floats,
    lean_m: float,
    turn_BN: Floats,
    twist_BN3: Floats,
) -> None:
    """Change velocities ``twist_BN3`` (m/s, m/s, rad/s) as some time of friction does.

    Points of support are in bodies' own axes, from the centre of mass, and bear shares of the weight. Inertia: the
    square of the radius of gyration; strength: the speed that friction takes in that time from what slides without
    turning; ``lean_m``: how far ahead of the centre of mass the load's centre is.
    """
    for b in range(len(twist_BN3)):
        for n in range(twist_BN3.shape[1]):
            _brake(
                support_BNM2[b, n],
                share_BNM[b, n],
                inertia_BN[b, n],
                strength_BN[b, n],
                lean_m,
                turn_BN[b, n],
                twist_BN3[b, n],
            )


@compiled
def _brake(
    support_M2: Floats, share_M: Floats, inertia: float, strength: float, lean_m: float, turn: float, twist_3: Floats
) -> None:
    """One body: rounds of reweighted least squares towards the minimiser of kinetic energy
    lost plus dissipation; each is a 3 x 3 system, solved by eliminating translation."""
    vx, vy, omega = twist_3[0], twist_3[1], twist_3[2]
    if vx == 0 and vy == 0 and omega == 0:
        return
    arm_M2 = np.empty_like(support_M2)
    cos, sin = math.cos(turn), math.sin(turn)
    for m in range(len(arm_M2)):
        x, y = support_M2[m, 0], support_M2[m, 1]
        arm_M2[m, 0], arm_M2[m, 1] = cos * x - sin * y, sin * x + cos * y
    ahead = lean_m / max(math.hypot(vx, vy), SLOW_M_S)
    load_M = _loads(arm_M2, share_M, vx * ahead, vy * ahead)
    new_x, new_y, new_omega = vx, vy, omega
    for _ in range(ROUNDS):
        total, side_x, side_y, spin = 1.0, 0.0, 0.0, inertia
        for m in range(len(arm_M2)):
            x, y = arm_M2[m, 0], arm_M2[m, 1]
            drag = strength * load_M[m] / max(math.hypot(new_x - new_omega * y, new_y + new_omega * x), SLOW_M_S)
            total += drag
            side_x += drag * x
            side_y += drag * y
            spin += drag * (x * x + y * y)
        rest = spin - (side_x * side_x + side_y * side_y) / total
        new_omega = (inertia * omega + (side_y * vx - side_x * vy) / total) / rest
        new_x, new_y = (vx + side_y * new_omega) / total, (vy - side_x * new_omega) / total
    twist_3[0], twist_3[1], twist_3[2] = new_x, new_y, new_omega


@compiled
def _loads(arm_M2: Floats, share_M: Floats, ahead_x: float, ahead_y: float) -> Floats:
    """Shares M of the weight on points of support: as ``share_M`` but for a slope over them that brings their centre
    to the given place from the centre of mass, as balance demands (as far as none is pulled down)."""
    middle_x, middle_y = (share_M * arm_M2[:, 0]).sum(), (share_M * arm_M2[:, 1]).sum()
    x_M, y_M = arm_M2[:, 0] - middle_x, arm_M2[:, 1] - middle_y
    xx, yy = (share_M * x_M * x_M).sum() + LEAST_SPREAD_M2, (share_M * y_M * y_M).sum() + LEAST_SPREAD_M2
    xy = (share_M * x_M * y_M).sum()
    to_x, to_y = ahead_x - middle_x, ahead_y - middle_y
    slope_x, slope_y = (yy * to_x - xy * to_y) / (xx * yy - xy * xy), (xx * to_y - xy * to_x) / (xx * yy - xy * xy)
    load_M = share_M * np.maximum(1 + x_M * slope_x + y_M * slope_y, 0)
    found_M: Floats = load_M / max(load_M.sum(), 1e-6)
    return found_M
