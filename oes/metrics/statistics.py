"""Confidence intervals (95%) and paired significance tests."""

from functools import lru_cache

import numpy as np
from scipy import stats

from oes.episode import Floats, Ints

LEVEL = 0.95
RESAMPLES = 2000


def bootstrap_mean(values: Floats, groups: Ints, seed: int) -> tuple[float, float, float]:
    """Mean and its bootstrap interval, as (mean, low, high). Raises ValueError without values.

    Groups (episodes) are resampled, not values: objects of one episode are not independent.
    """
    sum_G, count_G = _group_sums(values, groups)
    weight_RG = _resamples(len(sum_G), seed)
    means_R = (weight_RG @ sum_G) / (weight_RG @ count_G)
    return float(np.mean(values)), *_interval(means_R)


def bootstrap_ratio(
    numerator: Floats, denominator: Floats, groups: Ints, seed: int
) -> tuple[float, float, float]:
    """Ratio of the means of paired values and its bootstrap interval, as (ratio, low, high).

    Groups are resampled as in ``bootstrap_mean``. Raises ValueError for unpaired or no values.
    """
    if numerator.shape != denominator.shape:
        shapes = f"{numerator.shape} and {denominator.shape}"
        raise ValueError(f"a ratio of paired values needs equal shapes, not {shapes}")
    above_G, below_G = (_group_sums(values, groups)[0] for values in (numerator, denominator))
    weight_RG = _resamples(len(above_G), seed)
    ratios_R = (weight_RG @ above_G) / (weight_RG @ below_G)
    return float(numerator.sum() / denominator.sum()), *_interval(ratios_R)


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson score interval of a success rate. Raises ValueError without trials."""
    if not 0 <= successes <= trials or trials == 0:
        raise ValueError(f"{successes} successes of {trials} trials make no rate")
    test = stats.binomtest(successes, trials)
    interval = test.proportion_ci(confidence_level=LEVEL, method="wilson")
    return float(interval.low), float(interval.high)


def mcnemar_exact(only_first: int, only_second: int) -> float:
    """Two-sided p of McNemar's exact test from the discordant pairs; 1 without any.

    With counts of "first is greater" and "second is greater" it is the exact sign test.
    """
    discordant = only_first + only_second
    return float(stats.binomtest(only_first, discordant).pvalue) if discordant else 1.0


def signed_rank(first_N: Floats, second_N: Floats) -> float:
    """Two-sided p of Wilcoxon's signed-rank test of paired values; 1 where all are equal."""
    difference_N = first_N - second_N
    return float(stats.wilcoxon(difference_N).pvalue) if difference_N.any() else 1.0


def _group_sums(values: Floats, groups: Ints) -> tuple[Floats, Floats]:
    """Sum and number of values of each group."""
    if len(values) == 0:
        raise ValueError("no values to take a mean of")
    if len(values) != len(groups):
        raise ValueError(f"{len(values)} values cannot belong to {len(groups)} groups")
    _, group_i = np.unique(groups, return_inverse=True)
    count_G = np.bincount(group_i).astype(np.float64)
    return np.bincount(group_i, weights=values).astype(np.float64), count_G


@lru_cache(maxsize=8)
def _resamples(num_groups: int, seed: int) -> Floats:
    """Multiplicity of each group in each resample, ``RESAMPLES`` x ``num_groups``."""
    rng, share = np.random.default_rng(seed), np.full(num_groups, 1 / num_groups)
    return rng.multinomial(num_groups, share, size=RESAMPLES).astype(np.float64)


def _interval(resampled: Floats) -> tuple[float, float]:
    low, high = np.quantile(resampled, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)
