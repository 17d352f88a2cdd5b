"""Weights, the paths that follow from resampling, and when an update is due."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.slam.filter.history import History
from moteslam.slam.filter.update_policy import Travelled, UpdateConfig, update_due
from moteslam.slam.filter.weights import Weights


def test_times_is_bayes_and_stays_normalised():
    weights = Weights.uniform(3).times([1, 2, 1]).times([0, 2, 4])
    assert weights.values == pytest.approx([0, 0.5, 0.5])
    assert weights.effective_number == pytest.approx(2)
    assert weights.best == 1


def test_scores_that_are_all_zero_leave_the_weights_as_they_are():
    weights = Weights.uniform(3).times([1, 0, 0])
    assert weights.times([0, 0, 0]) is weights
    assert weights.times([0, 5, 5]) is weights


def test_many_small_likelihoods_do_not_underflow():
    weights = Weights.uniform(2)
    for _ in range(10_000):
        weights = weights.times([1e-3, 2e-3])
    assert weights.best == 1
    assert weights.values.sum() == pytest.approx(1)


def test_paths_follow_the_parents_through_a_changing_number():
    history = History()
    history.append(np.arange(12.0).reshape(4, 3), np.array([1, 3]))
    history.append(np.arange(6.0).reshape(2, 3) + 20)
    np.testing.assert_array_equal(history.paths(np.arange(2))[..., 0], [[3, 20], [9, 23]])
    history.resampled(np.array([0, 1, 1]))  # as well after an update as with it, and without effect on its own paths
    np.testing.assert_array_equal(history.paths(np.arange(2))[..., 0], [[3, 20], [9, 23]])
    history.append(np.arange(9.0).reshape(3, 3) + 40, np.array([2, 2, 2]))
    assert history.particles == 3
    all_, paths = np.arange(3), [[3, 20, 40], [9, 23, 43], [9, 23, 46]]
    np.testing.assert_array_equal(history.paths(all_)[..., 0], paths)
    np.testing.assert_array_equal(history.ancestors(all_), [[1, 0, 0], [3, 1, 1], [3, 1, 2]])
    for first in range(4):
        np.testing.assert_array_equal(history.path(1, first)[:, 0], paths[1][first:])
        np.testing.assert_array_equal(history.ancestors(all_, first), history.ancestors(all_)[:, first:])


def test_the_last_step_is_from_the_parent():
    history = History()
    history.append(np.array([[0.0, 0, 0], [5.0, 0, np.pi / 2]]))
    np.testing.assert_array_equal(history.step(1), np.zeros(3))
    history.resampled(np.array([1, 1]))
    history.append(np.array([[5.0, 1.0, np.pi / 2], [5.0, 2.0, np.pi / 2]]))
    np.testing.assert_allclose(history.step(0), [1.0, 0.0, 0.0], atol=1e-12)


def test_log_likelihoods_multiply_as_likelihoods_do():
    weights = Weights.uniform(4).times([1, 2, 3, 4])
    likelihood = np.array([0.3, 0.1, 0.9, 0.5])
    np.testing.assert_allclose(
        weights.times_log(np.log(likelihood)).values, weights.times(likelihood).values, rtol=1e-12
    )


def test_log_likelihoods_far_from_zero_neither_overflow_nor_vanish():
    weights = Weights.uniform(3).times_log(np.array([-1e6, -1e6 + np.log(3), -1e9]))
    assert weights.values == pytest.approx([0.25, 0.75, 0])
    assert weights.times_log(np.full(3, 1e6)).values == pytest.approx(weights.values)


POLICY = UpdateConfig(distance=0.1, rotation=0.2, interval=5.0)


@pytest.mark.parametrize(
    ("travelled", "due"),
    [
        (Travelled(0.09, 0.19, 4.9), False),
        (Travelled(0.1, 0.0, 0.0), True),
        (Travelled(0.0, 0.2, 0.0), True),
        (Travelled(0.0, 0.0, 5.0), True),
    ],
)
def test_each_of_distance_rotation_and_time_is_enough(travelled: Travelled, due: bool) -> None:
    assert update_due(POLICY, travelled) is due


def test_the_larger_of_odometry_and_tracked_motion_counts() -> None:
    assert update_due(POLICY, Travelled(0.0, 0.0, 0.0), (0.08, 0.08, 0.0))
    assert update_due(POLICY, Travelled(0.0, 0.0, 0.0), (0.0, 0.0, -0.2))
    assert update_due(POLICY, Travelled(0.1, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert not update_due(POLICY, Travelled(0.09, 0.19, 0.0), (0.05, 0.0, 0.19))
