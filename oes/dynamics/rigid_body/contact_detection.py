"""Where bodies touch the table, a rod and each other: compiled, over all bodies of all scenes.

A touch of table or rod is seven numbers: where on the body, in its own axes from its centre of mass
(3), the normal towards the body (3, the world's axes), and how far apart they are (metres; negative
where they overlap; infinite for what is not near). One of two bodies, in the world's axes, is nine:
the normal towards the first (x, y), the place from the first's centre of mass (3) and from the
second's (3), and how far apart they are.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oes.episode import Floats
from oes.jit import jit

NEAR_M = 0.01  # what is farther apart meets in no short time
TINY_M = 1e-6
LEAN = 1e-5  # a slope that decides between feet that are equally low
LEAST_SLANT = 0.1

Touch = tuple[float, float, float, float, float, float, float]


class Outlines(NamedTuple):
    """N bodies of B scenes in their own axes, for the rod and for others: radii BNK from the
    reference point, corners BNK2 from the centre of mass; normals BNK2 of the latter; the centre of
    mass BN2 from the reference point, how far corners reach BN; feet BNM3 and the heights between
    which the rod's outline is reached BNK, from the centre of mass; how tall they are BN; and which
    there are BN (of which the rod may touch).
    """

    rod_BNK: Floats
    rod_corner_BNK2: Floats
    whole_BNK: Floats
    corner_BNK2: Floats
    normal_BNK2: Floats
    mass_BN2: Floats
    reach_BN: Floats
    foot_BNM3: Floats
    rod_low_BNK: Floats
    rod_high_BNK: Floats
    tall_BN: Floats
    is_there_BN: NDArray[np.bool_]
    has_rod_BN: NDArray[np.bool_]


@jit
def foot_touches(
    bodies: Outlines,
    place_BN3: Floats,
    turn_BN33: Floats,
    side_B2: Floats,
    is_live_BN: NDArray[np.bool_],
) -> Floats:
    """Touches BN7 of live bodies with the table: the lowest foot; of equally low ones that farthest
    to a side. Those of others are infinitely far.
    """
    touch_BN7 = np.zeros((*place_BN3.shape[:2], 7))
    for b in range(len(place_BN3)):
        lean_x, lean_y = LEAN * side_B2[b, 0], LEAN * side_B2[b, 1]
        for n in range(place_BN3.shape[1]):
            if not (is_live_BN[b, n] and bodies.is_there_BN[b, n]):
                touch_BN7[b, n, 6] = np.inf
                continue
            lowest, turn_33 = np.inf, turn_BN33[b, n]
            lean_3 = lean_x * turn_33[0] + lean_y * turn_33[1]
            for foot_3 in bodies.foot_BNM3[b, n]:
                height = (
                    turn_33[2, 0] * foot_3[0]
                    + turn_33[2, 1] * foot_3[1]
                    + turn_33[2, 2] * foot_3[2]
                )
                leant = (
                    height - lean_3[0] * foot_3[0] - lean_3[1] * foot_3[1] - lean_3[2] * foot_3[2]
                )
                if leant < lowest:
                    lowest = leant
                    touch_BN7[b, n, :3], touch_BN7[b, n, 6] = foot_3, place_BN3[b, n, 2] + height
            touch_BN7[b, n, 5] = 1.0
    return touch_BN7


@jit
def rod_touches(
    bodies: Outlines,
    place_BN3: Floats,
    turn_BN33: Floats,
    rod_B3: Floats,
    radius_m: float,
    tip_m: float,
) -> Floats:
    """Touches BN7 of every body with a round rod at ``rod_B3`` (x, y) whose tip is ``tip_m`` above
    the table.
    """
    touch_BN7 = np.zeros((*place_BN3.shape[:2], 7))
    for b in range(len(place_BN3)):
        for n in range(place_BN3.shape[1]):
            touch_BN7[b, n, 6] = np.inf
            dx, dy = rod_B3[b, 0] - place_BN3[b, n, 0], rod_B3[b, 1] - place_BN3[b, n, 1]
            if (
                bodies.has_rod_BN[b, n]
                and math.hypot(dx, dy) < bodies.reach_BN[b, n] + radius_m + NEAR_M
            ):
                low = tip_m - place_BN3[b, n, 2]
                _rod_touch(bodies, b, n, turn_BN33[b, n], dx, dy, low, radius_m, touch_BN7[b, n])
    return touch_BN7


@jit
def pair_touches(
    bodies: Outlines,
    pose_BN3: Floats,
    height_BN: Floats,
    margin_m: float,
    is_awake_BN: NDArray[np.bool_],
) -> Floats:
    """Touches BNN9 of every body (first) with every other, where at least one of them is awake."""
    num = pose_BN3.shape[1]
    touch_BNN9 = np.empty((len(pose_BN3), num, num, 9))
    for b in range(len(pose_BN3)):
        for i in range(num):
            for j in range(num):
                if not (is_awake_BN[b, i] or is_awake_BN[b, j]):
                    touch_BNN9[b, i, j, 8] = np.inf
                    continue
                x, y, own_x, own_y, its_x, its_y, gap = _pair_touch(bodies, b, i, j, pose_BN3[b])
                z = min(bodies.tall_BN[b, i], bodies.tall_BN[b, j]) / 2
                touch_BNN9[b, i, j, :5] = -x, -y, own_x, own_y, z - height_BN[b, i]
                touch_BNN9[b, i, j, 5:] = its_x, its_y, z - height_BN[b, j], gap - margin_m
    return touch_BNN9


@jit
def _rod_touch(
    bodies: Outlines,
    b: int,
    n: int,
    turn_33: Floats,
    dx: float,
    dy: float,
    low: float,
    radius_m: float,
    touch_7: Floats,
) -> None:
    """Of two places, at the lower and the upper end of where body and rod are side by side, the
    nearer one.

    The rod's axis is at (``dx``, ``dy``) from the centre of mass and begins ``low`` above it
    (metres, world axes).
    """
    corner_K2 = bodies.rod_corner_BNK2[b, n]
    k = _nearest(
        corner_K2, turn_33[0, 0] * dx + turn_33[1, 0] * dy, turn_33[0, 1] * dx + turn_33[1, 1] * dy
    )[0]
    for is_high in range(2):
        z = bodies.rod_high_BNK[b, n, k] if is_high else max(bodies.rod_low_BNK[b, n, k], low)
        x = turn_33[0, 0] * dx + turn_33[1, 0] * dy + turn_33[2, 0] * z
        y = turn_33[0, 1] * dx + turn_33[1, 1] * dy + turn_33[2, 1] * z
        _, near_x, near_y, square = _nearest(corner_K2, x, y)
        from_x, from_y = x + bodies.mass_BN2[b, n, 0], y + bodies.mass_BN2[b, n, 1]
        sign = (
            -1.0
            if math.hypot(from_x, from_y) < _radius_at(bodies.rod_BNK[b, n], from_x, from_y)
            else 1.0
        )
        distance = math.sqrt(square)
        gap = sign * distance - radius_m
        if gap < touch_7[6]:
            scale = sign / max(distance, TINY_M)
            in_x, in_y = (near_x - x) * scale, (near_y - y) * scale
            touch_7[0], touch_7[1], touch_7[2], touch_7[6] = near_x, near_y, z, gap
            for i in range(3):
                touch_7[3 + i] = turn_33[i, 0] * in_x + turn_33[i, 1] * in_y


@jit
def _nearest(corner_K2: Floats, x: float, y: float) -> tuple[int, float, float, float]:
    """Of an outline: which side is nearest to a point, where on it (x, y), and the square of how
    far.
    """
    least, side, near_x, near_y = np.inf, 0, 0.0, 0.0
    for k in range(len(corner_K2)):
        at_x, at_y = corner_K2[k, 0], corner_K2[k, 1]
        after = 0 if k + 1 == len(corner_K2) else k + 1
        side_x, side_y = corner_K2[after, 0] - at_x, corner_K2[after, 1] - at_y
        along = ((x - at_x) * side_x + (y - at_y) * side_y) / max(
            side_x * side_x + side_y * side_y, TINY_M * TINY_M
        )
        along = min(max(along, 0.0), 1.0)
        spot_x, spot_y = at_x + along * side_x, at_y + along * side_y
        square = (x - spot_x) ** 2 + (y - spot_y) ** 2
        if square < least:
            least, side, near_x, near_y = square, k, spot_x, spot_y
    return side, near_x, near_y, least


@jit
def _pair_touch(bodies: Outlines, b: int, i: int, j: int, pose_N3: Floats) -> Touch:
    """Body ``i`` at that corner of it which is deepest in (or nearest to) body ``j``, with j's
    normal there, turned to point out of i.
    """
    apart_x, apart_y = pose_N3[i, 0] - pose_N3[j, 0], pose_N3[i, 1] - pose_N3[j, 1]
    is_pair = i != j and bodies.is_there_BN[b, i] and bodies.is_there_BN[b, j]
    if (
        not is_pair
        or math.hypot(apart_x, apart_y) > bodies.reach_BN[b, i] + bodies.reach_BN[b, j] + NEAR_M
    ):
        return 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf
    cos_i, sin_i = math.cos(pose_N3[i, 2]), math.sin(pose_N3[i, 2])
    cos_j, sin_j = math.cos(pose_N3[j, 2]), math.sin(pose_N3[j, 2])
    corner_K2, radius_K = bodies.corner_BNK2[b, i], bodies.whole_BNK[b, j]
    deepest, at_x, at_y, lever_x, lever_y = -np.inf, 1.0, 0.0, 0.0, 0.0
    for k in range(len(corner_K2)):
        x = cos_i * corner_K2[k, 0] - sin_i * corner_K2[k, 1]
        y = sin_i * corner_K2[k, 0] + cos_i * corner_K2[k, 1]
        on_x, on_y = x + apart_x, y + apart_y
        if on_x * on_x + on_y * on_y > (bodies.reach_BN[b, j] + NEAR_M) ** 2:
            continue
        own_x = cos_j * on_x + sin_j * on_y + bodies.mass_BN2[b, j, 0]
        own_y = cos_j * on_y - sin_j * on_x + bodies.mass_BN2[b, j, 1]
        depth = _radius_at(radius_K, own_x, own_y) - math.hypot(own_x, own_y)
        if depth > deepest:
            deepest, at_x, at_y, lever_x, lever_y = depth, own_x, own_y, x, y
    if deepest == -np.inf:
        return 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf
    count = len(radius_K)
    normal_2 = bodies.normal_BNK2[
        b, j, int(np.rint(math.atan2(at_y, at_x) * (count / (2 * math.pi)))) % count
    ]
    slant = (normal_2[0] * at_x + normal_2[1] * at_y) / max(math.hypot(at_x, at_y), TINY_M)
    out_x, out_y = (
        -(cos_j * normal_2[0] - sin_j * normal_2[1]),
        -(sin_j * normal_2[0] + cos_j * normal_2[1]),
    )
    gap = -deepest * max(slant, LEAST_SLANT)
    return out_x, out_y, lever_x, lever_y, lever_x + apart_x, lever_y + apart_y, gap


@jit
def _radius_at(radius_K: Floats, x: float, y: float) -> float:
    """As ``oes.geom.polar.radius_at``, of one outline towards one point."""
    count = len(radius_K)
    place = math.atan2(y, x) * (count / (2 * math.pi))
    below = math.floor(place)
    first = int(below) % count
    found: float = radius_K[first] + (place - below) * (
        radius_K[(first + 1) % count] - radius_K[first]
    )
    return found
