"""Errors of trajectories by hand, what evo has no word on; drift, returns, and what cannot be measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.metrics.ate import absolute_trajectory_error as ate
from moteslam.eval.metrics.rpe import LENGTHS, drift, loop_closing_error, relative_pose_error
from moteslam.robot import se2
from moteslam.robot.se2 import umeyama
from moteslam.robot.trajectory import Trajectory


def line(n: int, *, speed: float = 1.0, rate: float = 10.0, start: float = 0.0) -> Trajectory:
    stamps = start + np.arange(n) / rate
    return Trajectory(stamps, np.stack((speed * np.arange(n) / rate, np.zeros(n), np.zeros(n)), axis=-1))


def circle(turns: float, turned: float = 2 * np.pi) -> Trajectory:
    """A circle of 8 m radius, a step of 0.1 m each; ``turned`` is how far the estimate turns each time around."""
    n = round(turns * 2 * np.pi * 8 / 0.1)
    step = np.array([0.1, 0.0, turned / (2 * np.pi * 8 / 0.1)])
    return Trajectory(0.2 * np.arange(n + 1), np.vstack((np.zeros(3), se2.accumulate(np.tile(step, (n, 1))))))


@pytest.mark.parametrize("count", [1, 2, 30])
def test_alignment_of_points_in_one_place_is_a_shift(count: int) -> None:
    source, target = np.full((count, 2), 0.1) + 1e6, np.full((count, 2), -7.3)
    np.testing.assert_allclose(umeyama(source, target), [-7.4 - 1e6, -7.4 - 1e6, 0], atol=1e-9)


def test_where_the_reference_stands_still_the_headings_are_laid_on_each_other() -> None:
    """Jitter of a millimetre about one place would turn the estimate by any angle."""
    rng, stamps = np.random.default_rng(0), np.arange(0, 10, 0.1)
    still = np.tile((3.0, -2.0, 3.0), (len(stamps), 1)) + rng.normal(0, (1e-5, 1e-5, 0), (len(stamps), 3))
    off = se2.compose((1.0, 5.0, 2.0), still) + rng.normal(0, (1e-3, 1e-3, 1e-3), still.shape)
    result = ate(Trajectory(stamps, off), Trajectory(stamps, still))
    assert max(result.rmse, result.rotation.rmse) < 2e-3
    assert se2.wrap(result.transform[2] + 2.0) == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(result.aligned[:, :2].mean(axis=0), still[:, :2].mean(axis=0), atol=1e-9)


def test_a_dense_reference_is_interpolated_but_not_over_a_hole() -> None:
    reference, stamps = line(1000, rate=100, speed=2), np.arange(1, 9) + 0.003
    estimate = Trajectory(stamps, np.stack((2 * stamps, 0 * stamps, 0 * stamps), axis=-1))
    assert ate(estimate, reference, align=False).translation.max < 1e-12
    assert ate(estimate, reference, align=False, interpolate=False).translation.max > 0.005
    reference = line(1000, rate=100)
    kept = (reference.stamps < 3) | (reference.stamps > 6)
    assert ate(line(90), Trajectory(reference.stamps[kept], reference.poses[kept])).pairs == 61  # to 3.0, from 6.0 on
    assert ate(line(90), reference).pairs == 90


def test_equal_stamps_are_distinct_poses() -> None:
    poses = np.stack((np.array([0.0, 1.0, 1.1, 2.0]), np.zeros(4), np.zeros(4)), axis=-1)
    assert ate(Trajectory(np.array([0.0, 1.0, 1.0, 2.0]), poses), line(30)).pairs == 4


def test_rpe_by_time_of_a_known_drift() -> None:
    for all_pairs in (True, False):
        error = relative_pose_error(line(101, speed=1.02), line(101), delta=2.0, unit="s", all_pairs=all_pairs)
        # with all pairs the last two pairs are 1.9 and 1.8 s long
        np.testing.assert_allclose(error.errors, 0.04, atol=0.0041 if all_pairs else 1e-9)
    assert error.pairs == 5


def test_a_scale_and_a_yaw_rate_that_are_off_are_the_drift() -> None:
    result = drift(line(600, speed=1.02), line(600))
    assert set(result.lengths) == set(LENGTHS[:4])
    for length in LENGTHS[:4]:
        assert result.translation[result.lengths == length].mean() == pytest.approx(0.02, rel=0.03), length
    assert result.rotation.max() == 0
    result = drift(circle(1.0, 2 * np.pi + 0.1), circle(1.0))
    assert result.rotation.mean() == pytest.approx(0.1 / (2 * np.pi * 8), rel=0.01)


def test_the_loop_that_does_not_close() -> None:
    """Twice around a circle: everything from the second time on is seen again, 0.1 rad and a bit farther turned."""
    result = loop_closing_error(circle(1.98, 2 * np.pi + 0.1), circle(1.98))
    np.testing.assert_allclose(result.rotation_errors, 0.1, rtol=0.05)
    assert result.translation.median == pytest.approx(8 * 0.1, rel=0.1)
    assert (np.diff(result.stamps, axis=1)[:, 0] / 0.2 * 0.1 > 15).all()
    assert loop_closing_error(circle(2.0), circle(2.0)).translation.max < 1e-9


@pytest.mark.parametrize(
    ("measure", "problem"),
    [
        (lambda: ate(line(10), line(10, start=100)), r"0\.000 to 0\.900 s.*100\.000 to 100\.900 s"),
        (lambda: ate(line(10), line(10), from_start=True, scale=True), "^scale: "),
        (lambda: relative_pose_error(line(10), line(10), delta=100), "^pairs: .*shorter delta"),
        *((lambda d=d: relative_pose_error(line(10), line(10), delta=d), "^delta: ") for d in (0, -1, np.nan)),
        (lambda: relative_pose_error(line(10), line(10), delta=1.5, unit="frames"), "^delta: "),
        (lambda: relative_pose_error(line(10), line(10), unit="feet"), "^unit: "),  # type: ignore[arg-type]
        (lambda: drift(line(40), line(40)), "^path: 3.90 m driven"),
        (lambda: loop_closing_error(line(600), line(600)), "^path: no place visited twice"),
    ],
)
def test_what_cannot_be_measured_says_why(measure: Callable[[], Any], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        measure()
