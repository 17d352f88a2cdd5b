"""Metrics by hand: what evo has no word on."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.metrics.rpe import relative_pose_error
from moteslam.robot import se2
from moteslam.robot.se2 import umeyama
from moteslam.robot.trajectory import Trajectory


def line(n: int, *, speed: float = 1.0, rate: float = 10.0, start: float = 0.0) -> Trajectory:
    stamps = start + np.arange(n) / rate
    return Trajectory(stamps, np.stack((speed * np.arange(n) / rate, np.zeros(n), np.zeros(n)), axis=-1))


def test_alignment_undoes_a_rigid_motion() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(0, 10, (50, 2))
    pose = np.array([3.0, -200.0, 2.5])
    np.testing.assert_allclose(umeyama(points, se2.transform_points(pose, points)), pose, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 30])
def test_alignment_of_points_in_one_place_is_a_shift(count: int) -> None:
    source, target = np.full((count, 2), 0.1) + 1e6, np.full((count, 2), -7.3)
    np.testing.assert_allclose(umeyama(source, target), [-7.4 - 1e6, -7.4 - 1e6, 0], atol=1e-9)


def test_where_the_reference_stands_still_the_headings_are_laid_on_each_other() -> None:
    """Jitter of a millimetre about one place would turn the estimate by any angle."""
    rng, stamps = np.random.default_rng(0), np.arange(0, 10, 0.1)
    still = np.tile((3.0, -2.0, 3.0), (len(stamps), 1)) + rng.normal(0, (1e-5, 1e-5, 0), (len(stamps), 3))
    off = se2.compose((1.0, 5.0, 2.0), still) + rng.normal(0, (1e-3, 1e-3, 1e-3), still.shape)
    result = absolute_trajectory_error(Trajectory(stamps, off), Trajectory(stamps, still))
    assert result.rotation.rmse < 2e-3
    assert result.rmse < 2e-3
    assert se2.wrap(result.transform[2] + 2.0) == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(result.aligned[:, :2].mean(axis=0), still[:, :2].mean(axis=0), atol=1e-9)


def test_alignment_never_scales_or_mirrors() -> None:
    square = np.array([[0, 0], [1, 0], [1, 2], [0, 1.0]])
    error = absolute_trajectory_error(
        Trajectory(np.arange(4.0), np.c_[square * (1, -1), np.zeros(4)]),
        Trajectory(np.arange(4.0), np.c_[square, np.zeros(4)]),
    )
    assert error.rmse > 0.1


def test_a_dense_reference_is_interpolated() -> None:
    reference = line(1000, rate=100, speed=2)
    stamps = np.arange(1, 9) + 0.003
    estimate = Trajectory(stamps, np.stack((2 * stamps, 0 * stamps, 0 * stamps), axis=-1))
    exact = absolute_trajectory_error(estimate, reference, align=False)
    assert exact.translation.max < 1e-12
    assert absolute_trajectory_error(estimate, reference, align=False, interpolate=False).translation.max > 0.005


def test_a_hole_in_the_reference_is_not_bridged() -> None:
    reference = line(1000, rate=100)
    kept = (reference.stamps < 3) | (reference.stamps > 6)
    holed = Trajectory(reference.stamps[kept], reference.poses[kept])
    assert absolute_trajectory_error(line(90), holed).pairs == 61  # 0 to 3.0 and 6.0 to 8.9
    assert absolute_trajectory_error(line(90), reference).pairs == 90


def test_equal_stamps_are_distinct_poses() -> None:
    stamps = np.array([0.0, 1.0, 1.0, 2.0])
    poses = np.stack((np.array([0.0, 1.0, 1.1, 2.0]), np.zeros(4), np.zeros(4)), axis=-1)
    assert absolute_trajectory_error(Trajectory(stamps, poses), line(30)).pairs == 4


def test_no_overlap_names_both_spans() -> None:
    with pytest.raises(InputError, match=r"0\.000 to 0\.900 s.*100\.000 to 100\.900 s"):
        absolute_trajectory_error(line(10), line(10, start=100))


def test_rpe_by_time_of_a_known_drift() -> None:
    estimate = line(101, speed=1.02)
    for all_pairs in (True, False):
        error = relative_pose_error(estimate, line(101), delta=2.0, unit="s", all_pairs=all_pairs)
        # with all pairs the last two pairs are 1.9 and 1.8 s long
        np.testing.assert_allclose(error.errors, 0.04, atol=0.0041 if all_pairs else 1e-9)
    assert error.pairs == 5


def test_rpe_refuses_what_it_cannot_measure() -> None:
    with pytest.raises(InputError, match="shorter delta"):
        relative_pose_error(line(10), line(10), delta=100)
    for delta, unit in ((0, "m"), (-1, "s"), (np.nan, "m"), (1.5, "frames")):
        with pytest.raises(InputError, match="delta"):
            relative_pose_error(line(10), line(10), delta=delta, unit=unit)
    with pytest.raises(InputError, match="unit"):
        relative_pose_error(line(10), line(10), unit="feet")
