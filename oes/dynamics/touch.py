"""Where bodies in the plane touch a rod and each other: compiled, over all bodies of all scenes.

A touch is six numbers and a gap, in the world's axes: the body's outward normal (x, y), the contact from its centre of
mass (x, y), from the other's (x, y), and how far apart they are (metres; negative where they overlap; infinite for
what is not near).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oes.compiled import compiled
from oes.episode import Floats

NEAR_M = 0.03  # what is farther apart meets in no short time
TINY_M = 1e-6
LEAST_SLANT = 0.1

Touch = tuple[float, float, float, float, float, float, float]


class Outlines(NamedTuple):
    """N bodies of B scenes in their own axes, for the rod and for others: radii BNK from the reference point, corners
    BNK2 from the centre of mass; normals BNK2 of the latter; the reference point's place BN2 in the outlines' axes, how
    far corners reach BN, and which there are BN (of which the rod may touch)."""

    rod_BNK: Floats
    rod_corner_BNK2: Floats
    whole_BNK: Floats
    corner_BNK2: Floats
    normal_BNK2: Floats
    mass_BN2: Floats
    reach_BN: Floats
    is_there_BN: NDArray[np.bool_]
    has_rod_BN: NDArray[np.bool_]


@compiled
def rod_touches(bodies: Outlines, pose_BN3: Floats, rod_B2: Floats, radius_m: float) -> Floats:
    """Touches BN7 of every body (its pose: x and y of the centre of mass, turn) with a round rod at ``rod_B2``."""
    touch_BN7 = np.empty((*pose_BN3.shape[:2], 7))
    for b in range(len(pose_BN3)):
        for n in range(pose_BN3.shape[1]):
            touch_BN7[b, n] = _rod_touch(bodies, b, n, pose_BN3[b], rod_B2[b, 0], rod_B2[b, 1], radius_m)
    return touch_BN7


@compiled
def pair_touches(bodies: Outlines, pose_BN3: Floats) -> Floats:
    """Touches BNN7 of every body (first) with every other."""
    num = pose_BN3.shape[1]
    touch_BNN7 = np.empty((len(pose_BN3), num, num, 7))
    for b in range(len(pose_BN3)):
        for i in range(num):
            for j in range(num):
                touch_BNN7[b, i, j] = _pair_touch(bodies, b, i, j, pose_BN3[b])
    return touch_BNN7


@compiled
def _rod_touch(bodies: Outlines, b: int, n: int, pose_N3: Floats, rod_x: float, rod_y: float, radius_m: float) -> Touch:
    """Body ``n`` (its pose: x and y of the centre of mass, turn) and a round rod."""
    cos, sin = math.cos(pose_N3[n, 2]), math.sin(pose_N3[n, 2])
    dx, dy = rod_x - pose_N3[n, 0], rod_y - pose_N3[n, 1]
    if not bodies.has_rod_BN[b, n] or math.hypot(dx, dy) > bodies.reach_BN[b, n] + radius_m + NEAR_M:
        return 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf
    x, y = cos * dx + sin * dy, cos * dy - sin * dx
    corner_K2 = bodies.rod_corner_BNK2[b, n]
    least, near_x, near_y = np.inf, 0.0, 0.0
    for k in range(len(corner_K2)):
        at_x, at_y = corner_K2[k, 0], corner_K2[k, 1]
        after = 0 if k + 1 == len(corner_K2) else k + 1
        side_x, side_y = corner_K2[after, 0] - at_x, corner_K2[after, 1] - at_y
        along = ((x - at_x) * side_x + (y - at_y) * side_y) / max(side_x * side_x + side_y * side_y, TINY_M * TINY_M)
        along = min(max(along, 0.0), 1.0)
        spot_x, spot_y = at_x + along * side_x, at_y + along * side_y
        square = (x - spot_x) ** 2 + (y - spot_y) ** 2
        if square < least:
            least, near_x, near_y = square, spot_x, spot_y
    from_x, from_y = x + bodies.mass_BN2[b, n, 0], y + bodies.mass_BN2[b, n, 1]
    sign = -1.0 if math.hypot(from_x, from_y) < _radius_at(bodies.rod_BNK[b, n], from_x, from_y) else 1.0
    distance = math.sqrt(least)
    scale = sign / max(distance, TINY_M)
    out_x, out_y = (x - near_x) * scale, (y - near_y) * scale
    lever_x, lever_y = cos * near_x - sin * near_y, sin * near_x + cos * near_y
    return cos * out_x - sin * out_y, sin * out_x + cos * out_y, lever_x, lever_y, 0.0, 0.0, sign * distance - radius_m


@compiled
def _pair_touch(bodies: Outlines, b: int, i: int, j: int, pose_N3: Floats) -> Touch:
    """Body ``i`` at that corner of it which is deepest in (or nearest to) body ``j``, with j's normal there, turned to
    point out of i."""
    apart_x, apart_y = pose_N3[i, 0] - pose_N3[j, 0], pose_N3[i, 1] - pose_N3[j, 1]
    is_pair = i != j and bodies.is_there_BN[b, i] and bodies.is_there_BN[b, j]
    if not is_pair or math.hypot(apart_x, apart_y) > bodies.reach_BN[b, i] + bodies.reach_BN[b, j] + NEAR_M:
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
    normal_2 = bodies.normal_BNK2[b, j, int(np.rint(math.atan2(at_y, at_x) * (count / (2 * math.pi)))) % count]
    slant = (normal_2[0] * at_x + normal_2[1] * at_y) / max(math.hypot(at_x, at_y), TINY_M)
    out_x, out_y = -(cos_j * normal_2[0] - sin_j * normal_2[1]), -(sin_j * normal_2[0] + cos_j * normal_2[1])
    gap = -deepest * max(slant, LEAST_SLANT)
    return out_x, out_y, lever_x, lever_y, lever_x + apart_x, lever_y + apart_y, gap


@compiled
def _radius_at(radius_K: Floats, x: float, y: float) -> float:
    """As ``oes.geom.polar.radius_at``, of one outline towards one point."""
    count = len(radius_K)
    place = math.atan2(y, x) * (count / (2 * math.pi))
    below = math.floor(place)
    first = int(below) % count
    found: float = radius_K[first] + (place - below) * (radius_K[(first + 1) % count] - radius_K[first])
    return found
