"""Weights, resampling and the paths that follow from it."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.slam.filter.history import History
from moteslam.slam.filter.resampling import generator_for, systematic
from moteslam.slam.filter.update_policy import Travelled, UpdateConfig, update_due
from moteslam.slam.filter.weights import Weights


def test_uniform_weights():
    weights = Weights.uniform(8)
    assert weights.values == pytest.approx(1 / 8)
    assert weights.effective_number == pytest.approx(8)
    assert weights.best == 0


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


def test_systematic_resampling_draws_each_floor_or_ceil_times():
    generator = generator_for(1, 2)
    for _ in range(50):
        weights = generator.dirichlet(np.full(40, 0.3))
        parents = systematic(weights, generator)
        counts = np.bincount(parents, minlength=40)
        assert (np.diff(parents) >= 0).all()
        assert (counts >= np.floor(40 * weights - 1e-9)).all()
        assert (counts <= np.ceil(40 * weights + 1e-9)).all()


def test_systematic_resampling_is_unbiased():
    weights = np.array([0.05, 0.15, 0.8])
    counts = np.zeros(3)
    for step in range(4000):
        counts += np.bincount(systematic(weights, generator_for(7, step)), minlength=3)
    assert counts / counts.sum() == pytest.approx(weights, abs=0.01)


def test_random_numbers_depend_on_seed_and_step_alone():
    assert generator_for(0, 5).random() == generator_for(0, 5).random()
    assert generator_for(0, 5).random() != generator_for(0, 6).random()
    assert generator_for(0, 5).random() != generator_for(1, 5).random()


def test_paths_follow_the_parents():
    history = History()
    history.append(np.array([[0, 0, 0], [1, 0, 0]], float), np.array([1, 1]))
    history.append(np.array([[2, 0, 0], [3, 0, 0]], float), None)
    history.append(np.array([[4, 0, 0], [5, 0, 0]], float), np.array([0, 0]))
    np.testing.assert_array_equal(history.paths(np.array([0, 1]))[..., 0], [[1, 2, 4], [1, 3, 5]])
    for first in range(4):
        np.testing.assert_array_equal(history.path(1, first), history.path(1)[first:])
        np.testing.assert_array_equal(
            history.ancestors(np.array([0, 1]), first), history.ancestors(np.array([0, 1]))[:, first:]
        )


def test_parents_may_be_recorded_after_an_update():
    poses = np.array([[0, 0, 0], [1, 0, 0]], float)
    at_once, later = History(), History()
    at_once.append(poses, np.array([1, 1]))
    later.append(poses, None)
    later.resampled(np.array([1, 1]))
    for history in (at_once, later):
        history.append(poses + 2, None)
    np.testing.assert_array_equal(later.paths(np.array([0, 1]))[..., 0], [[1, 2], [1, 3]])
    np.testing.assert_array_equal(later.paths(np.array([0, 1])), at_once.paths(np.array([0, 1])))


def test_the_last_step_is_from_the_parent():
    history = History()
    history.append(np.array([[0.0, 0, 0], [5.0, 0, np.pi / 2]]))
    np.testing.assert_array_equal(history.step(1), np.zeros(3))
    history.resampled(np.array([1, 1]))
    history.append(np.array([[5.0, 1.0, np.pi / 2], [5.0, 2.0, np.pi / 2]]))
    np.testing.assert_allclose(history.step(0), [1.0, 0.0, 0.0], atol=1e-12)


def test_the_last_updates_own_parents_do_not_change_its_paths():
    history = History()
    history.append(np.array([[0, 0, 0], [1, 0, 0]], float), None)
    history.resampled(np.array([1, 1]))
    np.testing.assert_array_equal(history.paths(np.array([0]))[0, :, 0], [0])


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


def test_what_was_travelled_adds_up() -> None:
    travelled = Travelled(0.0, 0.0, 0.0).plus(0.5, 0.1, 0.5).plus(0.0, 0.1, 0.5)
    assert travelled == pytest.approx((0.5, 0.2, 1.0))
