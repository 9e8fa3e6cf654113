"""Metrics and statistics against hand-computed values."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oes.metrics.errors import Boxes, average_precision, rotation_deg, translation_mm
from oes.metrics.statistics import (
    bootstrap_mean,
    bootstrap_ratio,
    mcnemar_exact,
    signed_rank,
    wilson,
)


def test_translation_is_the_distance_in_mm() -> None:
    np.testing.assert_allclose(
        translation_mm(np.array([[0.003, 0.004, 0.0]]), np.zeros((1, 3))), [5.0]
    )


@pytest.mark.parametrize("angle_deg", [0.0, 1e-4, 30.0, 179.0])
def test_rotation_is_the_geodesic_angle(angle_deg: float) -> None:
    start = Rotation.from_rotvec([0.3, -0.8, 0.2])
    axis = np.array([0.6, 0.0, 0.8])
    turned = Rotation.from_rotvec(np.radians(angle_deg) * axis) * start
    assert rotation_deg(turned.as_matrix(), start.as_matrix()) == pytest.approx(angle_deg, abs=1e-6)


def test_rotation_of_noise_beyond_half_a_turn_is_finite() -> None:
    assert rotation_deg(np.diag([-1.0, -1.0, 1.0000001]), np.eye(3)) == pytest.approx(180)


def test_bootstrap_mean_of_constant_values_has_no_width() -> None:
    assert bootstrap_mean(np.full(6, 2.0), np.array([0, 0, 1, 1, 2, 2]), seed=0) == (2.0, 2.0, 2.0)


def test_bootstrap_resamples_episodes_not_objects() -> None:
    """Ten copies of each of 20 episodes' values carry no more information than one."""
    values = np.random.default_rng(0).normal(size=20)
    mean, low, high = bootstrap_mean(values, np.arange(20), seed=1)
    assert bootstrap_mean(
        np.repeat(values, 10), np.repeat(np.arange(20), 10), seed=1
    ) == pytest.approx((mean, low, high))
    assert high - low == pytest.approx(2 * 1.96 * values.std() / 20**0.5, rel=0.1)


def test_bootstrap_ratio_is_paired() -> None:
    """Values in a fixed proportion leave nothing uncertain, however widely they scatter."""
    below = np.array([1.0, 10.0, 100.0, 3.0])
    assert bootstrap_ratio(0.7 * below, below, np.array([0, 1, 2, 3]), seed=0) == pytest.approx(
        (0.7, 0.7, 0.7)
    )


def test_bootstrap_refuses_nothing_and_the_unpaired() -> None:
    with pytest.raises(ValueError, match="no values"):
        bootstrap_mean(np.zeros(0), np.zeros(0, dtype=np.int64), seed=0)
    with pytest.raises(ValueError, match="paired"):
        bootstrap_ratio(np.ones(3), np.ones(2), np.arange(3), seed=0)


def test_wilson_agrees_with_the_textbook() -> None:
    """43 of 50: (p + z2/2n -+ z sqrt(p(1-p)/n + z2/4n2)) / (1 + z2/n) with z = 1.96."""
    assert wilson(43, 50) == pytest.approx((0.738, 0.930), abs=1e-3)
    assert wilson(0, 10)[0] == 0
    with pytest.raises(ValueError, match="trials"):
        wilson(0, 0)


def test_signed_ranks_count_how_often_and_how_far_one_is_the_greater() -> None:
    first = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    assert signed_rank(first, first) == 1
    assert (
        signed_rank(np.zeros(5), first)
        == signed_rank(first, np.zeros(5))
        == pytest.approx(2 / 2**5)
    )
    assert signed_rank(first, np.array([3.0, 3.0, 3.0, 3.0, 3.5])) == 1


def test_mcnemar_counts_discordant_pairs() -> None:
    assert mcnemar_exact(0, 0) == 1
    assert mcnemar_exact(5, 0) == pytest.approx(2 / 2**5)
    assert mcnemar_exact(1, 7) == mcnemar_exact(7, 1) == pytest.approx(2 * (1 + 8) / 2**8)


def boxes(scenes: list[int], xs: list[float]) -> Boxes:
    centers = np.array([[x, 0.0, 0.0] for x in xs]).reshape(-1, 3)
    return Boxes(np.array(scenes, dtype=np.int64), centers, np.full((len(xs), 3), 0.1))


def test_average_precision_by_hand() -> None:
    """Ranked hit, miss, hit, duplicate over three truths: recall 1/3 at precision 1, 2/3 at 2/3,
    and no more.
    """
    true = boxes([0, 0, 1], [0.0, 0.5, 0.0])
    found = boxes([0, 1, 0, 0], [0.0, 0.9, 0.51, 0.0])
    assert average_precision(found, np.array([0.9, 0.8, 0.7, 0.6]), true, 0.25) == pytest.approx(
        1 / 3 + 2 / 3 / 3
    )


def test_average_precision_ranks_the_whole_set_together() -> None:
    """The miss of scene 1 outranks the hit of scene 0, so precision at the hit is a half."""
    true = boxes([0], [0.0])
    found = boxes([0, 1], [0.0, 0.0])
    assert average_precision(found, np.array([0.2, 0.9]), true, 0.5) == pytest.approx(0.5)
    assert average_precision(found, np.array([0.9, 0.2]), true, 0.5) == pytest.approx(1.0)


def test_average_precision_needs_overlap_and_truth() -> None:
    true = boxes([0], [0.0])
    assert average_precision(boxes([0], [0.05]), np.ones(1), true, 0.5) == 0  # IoU 1/3
    assert average_precision(boxes([0], [0.05]), np.ones(1), true, 0.3) == 1
    assert average_precision(boxes([], []), np.zeros(0), true, 0.5) == 0
    with pytest.raises(ValueError, match="true box"):
        average_precision(true, np.ones(1), boxes([], []), 0.5)
