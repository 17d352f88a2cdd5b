"""Covariances that are right have a NEES in its interval, and those that are not have not."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.metrics.localisation import nees_from_start, nees_interval, share_within_spread
from moteslam.robot import se2
from moteslam.robot.trajectory import Trajectory

STEP, NOISE = np.array([0.2, 0.0, 0.02]), np.diag((1e-4, 1e-4, 1e-6))
RUNS, STEPS = 100, 300


def dead_reckoned(seed: int) -> tuple[Trajectory, np.ndarray, Trajectory]:
    """An odometry with noise, the covariances that follow from it, and the truth, which starts elsewhere."""
    rng = np.random.default_rng(seed)
    steps = np.tile(STEP, (STEPS, 1))
    noisy = steps + rng.multivariate_normal(np.zeros(3), NOISE, STEPS)
    true = np.vstack((np.zeros(3), se2.accumulate(steps)))
    estimated = np.vstack((np.zeros(3), se2.accumulate(noisy)))
    c, s = np.cos(STEP[2]), np.sin(STEP[2])
    back = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])  # from the frame before the step to that after it
    moved = back @ np.array([[1, 0, -STEP[1]], [0, 1, STEP[0]], [0, 0, 1]])
    covariances = np.zeros((STEPS + 1, 3, 3))
    for k in range(STEPS):
        covariances[k + 1] = moved @ covariances[k] @ moved.T + back @ NOISE @ back.T
    stamps = 0.1 * np.arange(STEPS + 1)
    elsewhere = se2.compose((4.0, -7.0, 2.0), true)
    return Trajectory(stamps, estimated), covariances, Trajectory(stamps, elsewhere)


def test_of_100_runs_of_a_consistent_filter_95_lie_in_the_interval() -> None:
    results = [nees_from_start(*dead_reckoned(seed)) for seed in range(RUNS)]
    low, high = nees_interval(1)
    assert (low, high) == pytest.approx((0.2158, 9.3484), abs=1e-4)
    ends = np.array([result.end for result in results])
    assert 90 <= ((low < ends) & (ends < high)).sum() <= 99
    assert 90 <= sum(result.interval[0] < result.mean < result.interval[1] for result in results) <= 99
    # the ends of the runs are independent of each other
    low, high = nees_interval(RUNS)
    assert low < ends.mean() < high


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_covariances_that_are_wrong_are_noticed(factor: float) -> None:
    ends = []
    for seed in range(RUNS):
        estimate, covariances, truth = dead_reckoned(seed)
        ends.append(nees_from_start(estimate, factor * covariances, truth).end)
    low, high = nees_interval(RUNS)
    assert not low < np.mean(ends) < high


def test_the_error_is_seen_from_the_start() -> None:
    """Half a metre at the first pose is no error: estimate and truth are laid on each other there."""
    estimate, covariances, truth = dead_reckoned(0)
    moved = Trajectory(estimate.stamps, se2.compose((0.5, 0.3, -1.0), estimate.poses))
    kept = nees_from_start(estimate, covariances, truth)
    np.testing.assert_allclose(nees_from_start(moved, covariances, truth).nees, kept.nees)


def test_what_cannot_be_had_says_why() -> None:
    estimate, covariances, truth = dead_reckoned(0)
    with pytest.raises(InputError, match=r"^covariances: \[3, 3, 3\], expected one of each of 301"):
        nees_from_start(estimate, covariances[:3], truth)
    with pytest.raises(InputError, match=r"^covariances: one that is not positive"):
        nees_from_start(estimate, -covariances, truth)
    with pytest.raises(InputError, match=r"^covariances: no covariance of rank three"):
        nees_from_start(estimate, 0 * covariances, truth)
    with pytest.raises(InputError, match=r"^truth: it covers 0 poses"):
        nees_from_start(estimate, covariances, Trajectory(truth.stamps + 1e6, truth.poses))


def test_the_share_within_the_spread() -> None:
    rng = np.random.default_rng(0)
    deviations = np.tile((0.02, 0.01, 0.005), (4000, 1))
    errors = rng.normal(size=(4000, 3)) * deviations
    assert share_within_spread(errors, deviations) == pytest.approx(0.95, abs=0.015)
    assert share_within_spread(3 * errors, deviations) < 0.6
    assert share_within_spread(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), np.zeros((2, 3))) == 0.5
    with pytest.raises(InputError, match="deviations"):
        share_within_spread(errors, deviations[:3])
