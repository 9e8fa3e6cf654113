"""What touches do to bodies in the plane: impulses to their velocities, and steps that part what overlaps. Compiled,
over all scenes; a touch is seven numbers (see ``oes.dynamics.touch``), inertia the square of the radius of gyration."""

import numpy as np

from oes.compiled import compiled
from oes.episode import Floats


@compiled
def strike_rod(
    touch_BN7: Floats, inertia_BN: Floats, speed_B2: Floats, h: float, friction: float, twist_BN3: Floats
) -> None:
    """Velocities such that nothing approaches the rod, which moves at ``speed_B2`` whatever it meets, in ``h`` seconds,
    and nothing slips along it as far as friction holds."""
    for b in range(len(twist_BN3)):
        for n in range(twist_BN3.shape[1]):
            touch_7, inertia = touch_BN7[b, n], inertia_BN[b, n]
            own_x, own_y = _speed(twist_BN3[b, n], touch_7[2], touch_7[3])
            x, y = own_x - speed_B2[b, 0], own_y - speed_B2[b, 1]
            closing = x * touch_7[0] + y * touch_7[1] - max(touch_7[6], 0.0) / h
            if closing > 0:
                push = closing / _softness(touch_7[0], touch_7[1], touch_7[2], touch_7[3], inertia)
                slip = (y * touch_7[0] - x * touch_7[1]) / _softness(
                    -touch_7[1], touch_7[0], touch_7[2], touch_7[3], inertia
                )
                rub = -min(max(slip, -friction * push), friction * push)
                kick_x, kick_y = -rub * touch_7[1] - push * touch_7[0], rub * touch_7[0] - push * touch_7[1]
                _kick(twist_BN3[b, n], kick_x, kick_y, touch_7[2], touch_7[3], inertia)


@compiled
def strike_pairs(
    touch_BNN7: Floats, inertia_BN: Floats, heavy_BN: Floats, h: float, friction: float, twist_BN3: Floats
) -> None:
    """Velocities such that no body approaches another, all pairs at once; a pair that touches twice gets half of each.
    ``heavy_BN``: masses, in whatever unit."""
    num = twist_BN3.shape[1]
    for b in range(len(twist_BN3)):
        kick_NN2 = np.zeros((num, num, 2))
        for i in range(num):
            for j in range(num):
                touch_7 = touch_BNN7[b, i, j]
                own_x, own_y = _speed(twist_BN3[b, i], touch_7[2], touch_7[3])
                its_x, its_y = _speed(twist_BN3[b, j], touch_7[4], touch_7[5])
                x, y = own_x - its_x, own_y - its_y
                closing = x * touch_7[0] + y * touch_7[1] - max(touch_7[6], 0.0) / h
                if closing > 0:
                    first, second = 1 / heavy_BN[b, i], 1 / heavy_BN[b, j]
                    soft = _pair_softness(touch_7, first, second, inertia_BN[b, i], inertia_BN[b, j])
                    push, slip = closing / soft, (y * touch_7[0] - x * touch_7[1]) / soft
                    rub = -min(max(slip, -friction * push), friction * push)
                    kick_NN2[i, j, 0] = -rub * touch_7[1] - push * touch_7[0]
                    kick_NN2[i, j, 1] = rub * touch_7[0] - push * touch_7[1]
        _kick_pairs(kick_NN2, touch_BNN7[b], inertia_BN[b], 1 / heavy_BN[b], twist_BN3[b])


@compiled
def part_rod(touch_BN7: Floats, inertia_BN: Floats, pose_BN3: Floats) -> None:
    """Places (x, y, turn) after what overlaps the rod has been moved off it."""
    for b in range(len(pose_BN3)):
        for n in range(pose_BN3.shape[1]):
            touch_7, inertia = touch_BN7[b, n], inertia_BN[b, n]
            if touch_7[6] < 0:
                out = touch_7[6] / _softness(touch_7[0], touch_7[1], touch_7[2], touch_7[3], inertia)
                _kick(pose_BN3[b, n], out * touch_7[0], out * touch_7[1], touch_7[2], touch_7[3], inertia)


@compiled
def part_pairs(touch_BNN7: Floats, inertia_BN: Floats, pose_BN3: Floats) -> None:
    """Places after what overlaps has been moved apart, as if all were as heavy."""
    num = pose_BN3.shape[1]
    for b in range(len(pose_BN3)):
        kick_NN2 = np.zeros((num, num, 2))
        for i in range(num):
            for j in range(num):
                touch_7 = touch_BNN7[b, i, j]
                if touch_7[6] < 0:
                    out = touch_7[6] / _pair_softness(touch_7, 1.0, 1.0, inertia_BN[b, i], inertia_BN[b, j])
                    kick_NN2[i, j, 0], kick_NN2[i, j, 1] = out * touch_7[0], out * touch_7[1]
        _kick_pairs(kick_NN2, touch_BNN7[b], inertia_BN[b], np.ones(num), pose_BN3[b])


@compiled
def _kick_pairs(kick_NN2: Floats, touch_NN7: Floats, inertia_N: Floats, inverse_N: Floats, change_N3: Floats) -> None:
    """What impulses on the first of each pair, and their opposites on the second, change."""
    num = len(change_N3)
    for i in range(num):
        for j in range(num):
            x, y = kick_NN2[i, j, 0], kick_NN2[i, j, 1]
            if x == 0 and y == 0:
                continue
            half = 0.5 if kick_NN2[j, i, 0] != 0 or kick_NN2[j, i, 1] != 0 else 1.0
            first, second, touch_7 = half * inverse_N[i], half * inverse_N[j], touch_NN7[i, j]
            _kick(change_N3[i], first * x, first * y, touch_7[2], touch_7[3], inertia_N[i])
            _kick(change_N3[j], -second * x, -second * y, touch_7[4], touch_7[5], inertia_N[j])


@compiled
def _softness(x: float, y: float, lever_x: float, lever_y: float, inertia: float) -> float:
    """How much a unit impulse over mass along a direction changes the velocity of its point in that direction."""
    return 1 + (lever_x * y - lever_y * x) ** 2 / inertia


@compiled
def _pair_softness(touch_7: Floats, first: float, second: float, inertia: float, other_inertia: float) -> float:
    """The same of both bodies along their normal; ``first`` and ``second``: one over their masses."""
    own = first * _softness(touch_7[0], touch_7[1], touch_7[2], touch_7[3], inertia)
    return own + second * _softness(touch_7[0], touch_7[1], touch_7[4], touch_7[5], other_inertia)


@compiled
def _speed(twist_3: Floats, lever_x: float, lever_y: float) -> tuple[float, float]:
    """Velocity of a body's point."""
    return twist_3[0] - twist_3[2] * lever_y, twist_3[1] + twist_3[2] * lever_x


@compiled
def _kick(change_3: Floats, x: float, y: float, lever_x: float, lever_y: float, inertia: float) -> None:
    """Add to a velocity (or to a place) what an impulse over mass at a point does."""
    change_3[0] += x
    change_3[1] += y
    change_3[2] += (lever_x * y - lever_y * x) / inertia
