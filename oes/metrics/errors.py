"""Errors and their statistics: numpy and scipy, no files. Every interval is at 95%."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial import KDTree

from oes.episode import Floats
from oes.geom.boxes import iou

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

LEVEL = 0.95
RESAMPLES = 2000
LEAST_ERROR = 1e-3


def translation_mm(found_m: Floats, true_m: Floats) -> Floats:
    """Euclidean distance of points ...3 given in metres, in millimetres."""
    return np.asarray(np.linalg.norm(found_m - true_m, axis=-1) * 1e3)


def rotation_deg(found_33: Floats, true_33: Floats) -> Floats:
    """Geodesic angle between rotation matrices ...33, degrees in [0, 180]; exact for small angles
    too.
    """
    half_chord = np.linalg.norm(found_33 - true_33, axis=(-2, -1)) / 8**0.5
    return np.asarray(np.degrees(2 * np.arcsin(np.clip(half_chord, 0, 1))))


def surface_mm(found_TQ3: Floats, surface_P3: Floats) -> Floats:
    """Mean distance (mm) of points of a surface, as forecast, to the surface as it is: T of them,
    all in its frame.

    Both in metres; ADD-S of Hinterstoisser et al. 2012. A turn that a symmetric object does not
    show is no error, but for half the spacing of the P samples, about.
    """
    distance_TQ, _ = KDTree(surface_P3).query(found_TQ3)
    return np.asarray(np.mean(distance_TQ, axis=-1) * 1e3)


def chamfer_mm(found_P3: Floats, true_Q3: Floats) -> float:
    """Symmetric Chamfer distance (mm) of two surfaces given as points in metres: the mean of both
    mean distances to the nearest point of the other.
    """
    to_true_P, _ = KDTree(true_Q3).query(found_P3)
    to_found_Q, _ = KDTree(found_P3).query(true_Q3)
    return float((np.mean(to_true_P) + np.mean(to_found_Q)) / 2 * 1e3)


def normal_deg(
    found_P3: Floats, found_normal_P3: Floats, true_Q3: Floats, true_normal_Q3: Floats
) -> float:
    """Mean angle (degrees) between unit normals of a surface and those of the nearest points of the
    true one.
    """
    _, nearest_P = KDTree(true_Q3).query(found_P3)
    cosine_P = (found_normal_P3 * true_normal_Q3[nearest_P]).sum(-1)
    return float(np.degrees(np.arccos(np.clip(cosine_P, -1, 1))).mean())


def error_quantile(level: float, scale: Floats, tail: float) -> Floats:
    """Length below which a share ``level`` of errors lies: the length of a two-dimensional Student
    t of ``scale`` and ``tail`` degrees of freedom, P(|e| < r) = 1 - (1 + r^2 / (tail
    scale^2))^(-tail / 2).
    """
    return np.asarray(scale) * float(np.sqrt(tail * ((1 - level) ** (-2 / tail) - 1)))


def error_nll(error: Floats, scale: Floats, tail: float) -> Floats:
    """Negative log-likelihood of errors' lengths under the law of ``error_quantile``: -log of its
    density (r / s^2) (1 + r^2 / (tail s^2))^(-(tail + 2) / 2). Lengths below ``LEAST_ERROR`` count
    as that, to stay finite.
    """
    r, s = np.maximum(error, LEAST_ERROR), np.asarray(scale)
    return np.asarray(-np.log(r / s**2) + (tail + 2) / 2 * np.log1p((r / s) ** 2 / tail))


def bootstrap_mean(values: Floats, groups: Ints, seed: int) -> tuple[float, float, float]:
    """Mean of ``values`` and its bootstrap 95% interval, as (mean, low, high).

    Groups (episodes) are resampled, not values: objects of one episode are not independent. Raises
    ValueError when there are no values.
    """
    sums_G, counts_G = _by_group(values, groups)
    draws_RG = _draws(len(sums_G), seed)
    return float(np.mean(values)), *_percentiles((draws_RG @ sums_G) / (draws_RG @ counts_G))


def bootstrap_ratio(
    above: Floats, below: Floats, groups: Ints, seed: int
) -> tuple[float, float, float]:
    """mean(above) / mean(below) of paired values and its paired bootstrap 95% interval, as (ratio,
    low, high).

    Groups are resampled, as in ``bootstrap_mean``. Raises ValueError for values that are not
    paired, or none.
    """
    if above.shape != below.shape:
        raise ValueError(
            f"a ratio of paired values needs as many above as below, not {above.shape} and {below.shape}"
        )
    above_G, below_G = (_by_group(values, groups)[0] for values in (above, below))
    draws_RG = _draws(len(above_G), seed)
    return float(above.sum() / below.sum()), *_percentiles(
        (draws_RG @ above_G) / (draws_RG @ below_G)
    )


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's 95% score interval of a share of successes. Raises ValueError when there are no
    trials.
    """
    if not 0 <= successes <= trials or trials == 0:
        raise ValueError(f"{successes} successes of {trials} trials make no share")
    found = stats.binomtest(successes, trials).proportion_ci(
        confidence_level=LEVEL, method="wilson"
    )
    return float(found.low), float(found.high)


def mcnemar_exact(only_first: int, only_second: int) -> float:
    """Two-sided p of paired successes: how likely so uneven a split of the discordant pairs is
    under a fair coin.

    Also the exact sign test, of how often one of two paired values was the greater. 1 where no pair
    is discordant.
    """
    discordant = only_first + only_second
    return float(stats.binomtest(only_first, discordant).pvalue) if discordant else 1.0


def signed_rank(first_N: Floats, second_N: Floats) -> float:
    """Two-sided p of Wilcoxon's signed-rank test of paired values; 1 where all are equal."""
    difference_N = first_N - second_N
    return float(stats.wilcoxon(difference_N).pvalue) if difference_N.any() else 1.0


@dataclass(frozen=True)
class Boxes:
    """Axis-aligned boxes of many scenes: which scene each is of, centre and size (metres)."""

    scene_P: Ints
    center_P3: Floats
    size_P3: Floats


def average_precision(found: Boxes, score_P: Floats, true: Boxes, min_iou: float) -> float:
    """Area under the all-point interpolated precision-recall curve of 3D boxes.

    Detections of the whole set are ranked together by score; each takes the free true box of its
    scene that it overlaps most, if by at least ``min_iou``. Raises ValueError when there are no
    true boxes.
    """
    if len(true.scene_P) == 0:
        raise ValueError("average precision needs at least one true box")
    order = np.argsort(-score_P, kind="stable")
    is_hit = _hits(found, order, true, min_iou)
    hits = np.cumsum(is_hit)
    precision = hits / np.arange(1, len(order) + 1)
    best = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.sum(best[is_hit]) / len(true.scene_P))


def _hits(found: Boxes, order: Ints, true: Boxes, min_iou: float) -> Bools:
    """For each detection in ``order``: whether it takes a true box."""
    is_taken = np.zeros(len(true.scene_P), dtype=bool)
    is_hit = np.zeros(len(order), dtype=bool)
    for rank, i in enumerate(order):
        free = np.flatnonzero((true.scene_P == found.scene_P[i]) & ~is_taken)
        if len(free) == 0:
            continue
        overlaps = iou(
            found.center_P3[i], found.size_P3[i], true.center_P3[free], true.size_P3[free]
        )
        best = int(np.argmax(overlaps))
        is_hit[rank] = overlaps[best] >= min_iou
        is_taken[free[best]] = is_hit[rank]
    return is_hit


def _by_group(values: Floats, groups: Ints) -> tuple[Floats, Floats]:
    """Sum and number of values of each group."""
    if len(values) == 0:
        raise ValueError("no values to take a mean of")
    if len(values) != len(groups):
        raise ValueError(f"{len(values)} values cannot belong to {len(groups)} groups")
    _, group_i = np.unique(groups, return_inverse=True)
    return np.bincount(group_i, weights=values).astype(np.float64), np.bincount(group_i).astype(
        np.float64
    )


@lru_cache(maxsize=8)
def _draws(num_groups: int, seed: int) -> Floats:
    """How often each group comes up in each resample, R x G."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(num_groups, np.full(num_groups, 1 / num_groups), size=RESAMPLES).astype(
        np.float64
    )


def _percentiles(resampled_R: Floats) -> tuple[float, float]:
    low, high = np.quantile(resampled_R, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)
