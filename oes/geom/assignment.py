"""Gated one-to-one assignment of points."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from oes.episode import Floats, Ints


def assign(points_N3: Floats, candidates_P3: Floats, gate_m: float) -> Ints:
    """Index of the candidate assigned to each point, -1 for none; each is used at most once.

    Minimizes the total distance among pairs at most ``gate_m`` apart (Hungarian algorithm).
    """
    distance_NP = np.linalg.norm(points_N3[:, None] - candidates_P3[None], axis=-1)
    # One pair outside the gate costs more than all pairs inside it, so gated pairs come first.
    penalty_m = gate_m * (sum(distance_NP.shape) + 1)
    cost_NP = np.where(distance_NP <= gate_m, distance_NP, penalty_m)
    row, column = linear_sum_assignment(cost_NP)
    is_close = distance_NP[row, column] <= gate_m
    match_N = np.full(len(points_N3), -1)
    match_N[row[is_close]] = column[is_close]
    return match_N
