"""Contact detection: the deepest or nearest point between bodies and table, rod, or each other.

A contact with table or rod is seven numbers: the point on the body (3, body axes, from its centre
of mass), the unit normal towards the body (3, world axes) and the gap (metres; negative when
penetrating, infinite when far away). A contact of two bodies is nine numbers in world axes: the
normal towards the first body (x, y), the point from the first body's centre of mass (3) and from
the second's (3), and the gap.
"""

import math

import numpy as np

from oes.dynamics.rigid_body.kernels import Bodies, State, dot
from oes.episode import Bools, Floats
from oes.jit import jit

MAX_APPROACH_M = 0.01  # broad phase: bodies farther apart do not meet within a substep
EPS_M = 1e-6
TIE_SLOPE = 1e-5  # tilt that breaks ties between equally low support points
MIN_COSINE = 0.1  # between a profile's normal and its radius


@jit
def detect_table(bodies: Bodies, state: State, side_B2: Floats, is_active_BN: Bools) -> Floats:
    """Lowest support point of every active body as contacts BN7 with the table.

    Among equally low points the one farthest along ``side_B2`` wins.
    """
    contact_BN7 = np.zeros((*state.com_BN3.shape[:2], 7))
    for b, n in np.ndindex(is_active_BN.shape):
        if not (is_active_BN[b, n] and bodies.is_valid_BN[b, n]):
            contact_BN7[b, n, 6] = np.inf
            continue
        lowest, rotation_33, com_z = np.inf, state.rotation_BN33[b, n], state.com_BN3[b, n, 2]
        # An upright body has all supports at one height: a tiny fictitious tilt makes the choice
        # deterministic instead of one of rounding errors.
        tilt_x, tilt_y = TIE_SLOPE * side_B2[b, 0], TIE_SLOPE * side_B2[b, 1]
        tilt_3 = tilt_x * rotation_33[0] + tilt_y * rotation_33[1]
        for support_3 in bodies.support_BNP3[b, n]:
            z = dot(rotation_33[2], support_3)
            tilted = z - tilt_3[0] * support_3[0] - tilt_3[1] * support_3[1]
            tilted -= tilt_3[2] * support_3[2]
            if tilted < lowest:
                lowest = tilted
                contact_BN7[b, n, :3], contact_BN7[b, n, 6] = support_3, com_z + z
        contact_BN7[b, n, 5] = 1.0
    return contact_BN7


@jit
def detect_rod(
    bodies: Bodies, state: State, rod_B3: Floats, radius_m: float, tip_height_m: float
) -> Floats:
    """Contacts BN7 of every body with a vertical rod whose axis stands at ``rod_B3`` (x, y)."""
    contact_BN7 = np.zeros((*state.com_BN3.shape[:2], 7))
    for b, n in np.ndindex(state.com_BN3.shape[:2]):
        contact_BN7[b, n, 6] = np.inf
        com_3 = state.com_BN3[b, n]
        dx, dy = rod_B3[b, 0] - com_3[0], rod_B3[b, 1] - com_3[1]
        limit = bodies.radius_BN[b, n] + radius_m + MAX_APPROACH_M
        if bodies.has_rod_BN[b, n] and math.hypot(dx, dy) < limit:
            tip, R_33 = (dx, dy, tip_height_m - com_3[2]), state.rotation_BN33[b, n]
            _rod_contact(bodies, b, n, R_33, tip, radius_m, contact_BN7[b, n])
    return contact_BN7


@jit
def detect_pairs(bodies: Bodies, pose_BN3: Floats, margin_m: float, is_awake_BN: Bools) -> Floats:
    """Contacts BNN9 of every body (first) with every other, unless both are asleep.

    ``pose_BN3``: x, y of the centre of mass and yaw; tilt is neglected.
    """
    batch, num = pose_BN3.shape[:2]
    contact_BNN9 = np.empty((batch, num, num, 9))
    for b, i, j in np.ndindex((batch, num, num)):
        contact_9 = contact_BNN9[b, i, j]
        if not (is_awake_BN[b, i] or is_awake_BN[b, j]):
            contact_9[8] = np.inf
            continue
        _pair_contact(bodies, b, i, j, pose_BN3[b], contact_9)
        # The force acts at half the height of the lower body.
        z = min(bodies.height_BN[b, i], bodies.height_BN[b, j]) / 2
        contact_9[4] = z - bodies.com_height_BN[b, i]
        contact_9[7] = z - bodies.com_height_BN[b, j]
        contact_9[8] -= margin_m
    return contact_BNN9


@jit
def _rod_contact(
    bodies: Bodies,
    b: int,
    n: int,
    rotation_33: Floats,
    tip_3: tuple[float, float, float],
    radius_m: float,
    contact_7: Floats,
) -> None:
    """Nearest contact at the lower or the upper end of the overlap of rod and body in height.

    ``tip_3``: the rod's tip from the centre of mass, world axes. Two heights suffice, as both
    surfaces are vertical up to a small tilt.
    """
    dx, dy, tip_z = tip_3
    vertex_D2 = bodies.rod_vertex_BND2[b, n]
    level_x = rotation_33[0, 0] * dx + rotation_33[1, 0] * dy
    level_y = rotation_33[0, 1] * dx + rotation_33[1, 1] * dy
    edge = _nearest_point(vertex_D2, level_x, level_y)[0]
    for is_upper in range(2):
        z = max(bodies.rod_min_z_BND[b, n, edge], tip_z)
        if is_upper:
            z = bodies.rod_max_z_BND[b, n, edge]
        x, y = level_x + rotation_33[2, 0] * z, level_y + rotation_33[2, 1] * z
        _, near_x, near_y, square = _nearest_point(vertex_D2, x, y)
        ref_x, ref_y = x + bodies.com_offset_BN2[b, n, 0], y + bodies.com_offset_BN2[b, n, 1]
        boundary = _radius_at(bodies.rod_profile_BND[b, n], ref_x, ref_y)
        sign = -1.0 if math.hypot(ref_x, ref_y) < boundary else 1.0
        distance = math.sqrt(square)
        gap = sign * distance - radius_m
        if gap < contact_7[6]:
            scale = sign / max(distance, EPS_M)
            normal_x, normal_y = (near_x - x) * scale, (near_y - y) * scale
            contact_7[0], contact_7[1], contact_7[2], contact_7[6] = near_x, near_y, z, gap
            for i in range(3):
                contact_7[3 + i] = rotation_33[i, 0] * normal_x + rotation_33[i, 1] * normal_y


@jit
def _nearest_point(vertex_D2: Floats, x: float, y: float) -> tuple[int, float, float, float]:
    """Nearest point of a closed polygon: index of its edge, x, y and the squared distance."""
    least, edge, near_x, near_y = np.inf, 0, 0.0, 0.0
    for d in range(len(vertex_D2)):
        start_x, start_y = vertex_D2[d, 0], vertex_D2[d, 1]
        end = 0 if d + 1 == len(vertex_D2) else d + 1
        edge_x, edge_y = vertex_D2[end, 0] - start_x, vertex_D2[end, 1] - start_y
        length2 = max(edge_x * edge_x + edge_y * edge_y, EPS_M * EPS_M)
        along = ((x - start_x) * edge_x + (y - start_y) * edge_y) / length2
        along = min(max(along, 0.0), 1.0)
        point_x, point_y = start_x + along * edge_x, start_y + along * edge_y
        square = (x - point_x) ** 2 + (y - point_y) ** 2
        if square < least:
            least, edge, near_x, near_y = square, d, point_x, point_y
    return edge, near_x, near_y, least


@jit
def _pair_contact(
    bodies: Bodies, b: int, i: int, j: int, pose_N3: Floats, contact_9: Floats
) -> None:
    """Contact, but for z, at the vertex of ``i`` that is deepest in ``j``, along j's normal."""
    contact_9[:] = 0.0
    contact_9[0], contact_9[1], contact_9[8] = -1.0, -0.0, np.inf
    dx, dy = pose_N3[i, 0] - pose_N3[j, 0], pose_N3[i, 1] - pose_N3[j, 1]
    limit = bodies.radius_BN[b, i] + bodies.radius_BN[b, j] + MAX_APPROACH_M
    is_pair = i != j and bodies.is_valid_BN[b, i] and bodies.is_valid_BN[b, j]
    if not is_pair or math.hypot(dx, dy) > limit:
        return
    cos_i, sin_i = math.cos(pose_N3[i, 2]), math.sin(pose_N3[i, 2])
    cos_j, sin_j = math.cos(pose_N3[j, 2]), math.sin(pose_N3[j, 2])
    vertex_D2, profile_D = bodies.vertex_BND2[b, i], bodies.profile_BND[b, j]
    deepest, at_x, at_y, arm_x, arm_y = -np.inf, 1.0, 0.0, 0.0, 0.0
    for d in range(len(vertex_D2)):
        x = cos_i * vertex_D2[d, 0] - sin_i * vertex_D2[d, 1]
        y = sin_i * vertex_D2[d, 0] + cos_i * vertex_D2[d, 1]
        from_x, from_y = x + dx, y + dy
        # Cheaper than the exact test below, and rejects most vertices.
        if from_x * from_x + from_y * from_y > (bodies.radius_BN[b, j] + MAX_APPROACH_M) ** 2:
            continue
        ref_x = cos_j * from_x + sin_j * from_y + bodies.com_offset_BN2[b, j, 0]
        ref_y = cos_j * from_y - sin_j * from_x + bodies.com_offset_BN2[b, j, 1]
        depth = _radius_at(profile_D, ref_x, ref_y) - math.hypot(ref_x, ref_y)
        if depth > deepest:
            deepest, at_x, at_y, arm_x, arm_y = depth, ref_x, ref_y, x, y
    if deepest == -np.inf:
        return
    count = len(profile_D)
    direction = int(np.rint(math.atan2(at_y, at_x) * (count / (2 * math.pi)))) % count
    normal_2 = bodies.normal_BND2[b, j, direction]
    # Depth is radial; its component along the normal is the distance to the surface.
    cosine = (normal_2[0] * at_x + normal_2[1] * at_y) / max(math.hypot(at_x, at_y), EPS_M)
    contact_9[0] = cos_j * normal_2[0] - sin_j * normal_2[1]
    contact_9[1] = sin_j * normal_2[0] + cos_j * normal_2[1]
    contact_9[2], contact_9[3], contact_9[5], contact_9[6] = arm_x, arm_y, arm_x + dx, arm_y + dy
    contact_9[8] = -deepest * max(cosine, MIN_COSINE)


@jit
def _radius_at(profile_D: Floats, x: float, y: float) -> float:
    """Radius of a profile towards (x, y); as ``oes.geom.polar.radius_at`` for one point."""
    count = len(profile_D)
    position = math.atan2(y, x) * (count / (2 * math.pi))
    below = math.floor(position)
    first = int(below) % count
    step = profile_D[(first + 1) % count] - profile_D[first]
    radius: float = profile_D[first] + (position - below) * step
    return radius
