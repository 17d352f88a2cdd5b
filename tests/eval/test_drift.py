"""Drift per metre, and what is left where the robot comes back."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.metrics.rpe import LENGTHS, drift, loop_closing_error
from moteslam.robot import se2
from moteslam.robot.trajectory import Trajectory


def straight(length: float, scale: float = 1.0) -> Trajectory:
    x = np.arange(0.0, length, 0.1)
    return Trajectory(0.2 * np.arange(len(x)), np.column_stack((scale * x, 0 * x, 0 * x)))


def circle(turns: float, turned: float = 2 * np.pi) -> Trajectory:
    """A circle of 8 m radius, a step of 0.1 m each; ``turned`` is how far the estimate turns each time around."""
    n = round(turns * 2 * np.pi * 8 / 0.1)
    step = np.array([0.1, 0.0, turned / (2 * np.pi * 8 / 0.1)])
    return Trajectory(0.2 * np.arange(n + 1), np.vstack((np.zeros(3), se2.accumulate(np.tile(step, (n, 1))))))


def test_a_scale_that_is_off_is_the_drift() -> None:
    result = drift(straight(60.0, 1.02), straight(60.0))
    assert set(result.lengths) == set(LENGTHS[:4])
    for length in LENGTHS[:4]:
        assert result.translation[result.lengths == length].mean() == pytest.approx(0.02, rel=0.03), length
    assert result.rotation.max() == 0


def test_a_yaw_rate_that_is_off_is_the_drift_of_the_heading() -> None:
    result = drift(circle(1.0, 2 * np.pi + 0.1), circle(1.0))
    assert result.rotation.mean() == pytest.approx(0.1 / (2 * np.pi * 8), rel=0.01)


def test_the_loop_that_does_not_close() -> None:
    """Twice around a circle: everything from the second time on is seen again, 0.1 rad and a bit farther turned."""
    result = loop_closing_error(circle(1.98, 2 * np.pi + 0.1), circle(1.98))
    np.testing.assert_allclose(result.rotation_errors, 0.1, rtol=0.05)
    assert result.translation.median == pytest.approx(8 * 0.1, rel=0.1)
    gaps = np.diff(result.stamps, axis=1)[:, 0] / 0.2 * 0.1
    assert (gaps > 15).all()
    assert loop_closing_error(circle(2.0), circle(2.0)).translation.max < 1e-9


def test_what_cannot_be_had_says_why() -> None:
    with pytest.raises(InputError, match=r"3.90 m driven, expected at least 5 m"):
        drift(straight(4.0), straight(4.0))
    with pytest.raises(InputError, match="no place visited twice"):
        loop_closing_error(straight(60.0), straight(60.0))


def test_laid_on_the_start_the_error_grows_from_there() -> None:
    estimate, reference = circle(1.0, 2 * np.pi + 0.1), circle(1.0)
    moved = Trajectory(estimate.stamps, se2.compose((3.0, -2.0, 1.0), estimate.poses))
    result = absolute_trajectory_error(moved, reference, from_start=True)
    assert result.errors[0] < 1e-9
    assert result.errors[-1] == pytest.approx(0.1 * 8, rel=0.2)
    assert result.rmse > absolute_trajectory_error(moved, reference).rmse
    with pytest.raises(InputError, match="scale: given with from_start"):
        absolute_trajectory_error(moved, reference, from_start=True, scale=True)
