"""Which detection is which object: assignment by distance, and what happens to an object that is
not seen.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from oes.episode import Floats


def assign(expected_N3: Floats, seen_D3: Floats, reach_m: float) -> NDArray[np.int64]:
    """For each expected position the detection that belongs to it, or -1.

    Pairs are chosen by least total distance among those at most ``reach_m`` apart; no detection is
    used twice.
    """
    matched = np.full(len(expected_N3), -1)
    if not len(seen_D3) or not len(expected_N3):
        return matched
    distance_ND = np.linalg.norm(expected_N3[:, None] - seen_D3[None], axis=-1)
    out_of_reach = reach_m * (len(expected_N3) + len(seen_D3) + 1)
    cost_ND = np.where(distance_ND <= reach_m, distance_ND, out_of_reach)
    for object_i, seen_i in zip(*linear_sum_assignment(cost_ND), strict=True):
        if cost_ND[object_i, seen_i] <= reach_m:
            matched[object_i] = seen_i
    return matched


def update_tracks(
    center_N3: Floats, size_N3: Floats, seen_center_D3: Floats, seen_size_D3: Floats, reach_m: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """New centres, sizes and which objects were seen; an object that is not seen keeps the estimate
    passed in.
    """
    matched_N = assign(center_N3, seen_center_D3, reach_m)
    seen_N = matched_N >= 0
    center_N3, size_N3 = center_N3.copy(), size_N3.copy()
    center_N3[seen_N] = seen_center_D3[matched_N[seen_N]]
    size_N3[seen_N] = seen_size_D3[matched_N[seen_N]]
    return center_N3, size_N3, seen_N
