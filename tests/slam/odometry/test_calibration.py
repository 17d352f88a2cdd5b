"""Systematic errors of odometry: estimated from registered scans, and removed."""

import numpy as np
import pytest
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.odometry.calibration import CalibrationConfig, OdometryCalibration

Array = NDArray[np.float64]
SURE = np.diag([1e6, 1e6, 1e6])
OFFSET = np.array([0.09, 0.0, 0.0])


def motions(count: int, seed: int = 0) -> Array:
    """Of the axle: arcs of up to half a metre and half a radian, and turns on the spot."""
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-0.5, 0.5, count)
    distances = np.where(np.arange(count) % 3 == 0, 0.0, rng.uniform(0.1, 0.5, count))
    return np.stack((distances * np.cos(turns / 2), distances * np.sin(turns / 2), turns), axis=1)


def of_lidar(motion: Array) -> Array:
    return se2.compose(se2.compose(se2.inverse(OFFSET), motion), OFFSET)


def measured(motion: Array, *, scale: float, turn: float, curvature: float) -> Array:
    """What odometry with these errors measures of a motion of the axle."""
    x, y, theta = motion
    distance = np.hypot(x, y) / scale
    rotation = (theta - curvature * distance) / turn
    return np.array((distance * np.cos(rotation / 2), distance * np.sin(rotation / 2), rotation))


def calibrated(
    count: int, *, information: Array = SURE, noise: float = 0.0
) -> tuple[OdometryCalibration, dict[str, float]]:
    calibration = OdometryCalibration(CalibrationConfig())
    errors = {"scale": 0.96, "turn": 1.04, "curvature": 0.03}
    rng = np.random.default_rng(7)
    for motion in motions(count):
        found = of_lidar(motion) + noise * rng.standard_normal(3)
        calibration.update(measured(motion, **errors), found, information)
    return calibration, errors


def test_the_errors_are_estimated_in_a_hundred_metres() -> None:
    calibration, errors = calibrated(400, noise=0.005)
    assert calibration.distance.values[0] == pytest.approx(errors["scale"], abs=0.005)
    assert calibration.turn.values[0] == pytest.approx(errors["turn"], abs=0.01)
    assert calibration.turn.values[1] == pytest.approx(errors["curvature"], abs=0.01)
    assert calibration.offset.values[0] == pytest.approx(OFFSET[0], abs=0.01)


def test_corrected_motions_are_the_true_ones() -> None:
    calibration, errors = calibrated(400)
    true = np.array([of_lidar(motion) for motion in motions(50, seed=1)])
    wheels = np.array([measured(motion, **errors) for motion in motions(50, seed=1)])
    corrected = np.array([calibration.corrected(motion) for motion in wheels])
    assert np.abs(corrected - true).max() < 0.005
    assert np.abs(wheels - true).max() > 0.03


@pytest.mark.parametrize("enabled", [True, False])
def test_before_any_update_and_when_it_is_off_motions_are_not_corrected(enabled: bool) -> None:
    calibration = OdometryCalibration(CalibrationConfig(enabled=enabled))
    if not enabled:
        calibration.update(np.array([0.5, 0.0, 0.1]), np.array([0.48, 0.0, 0.1]), SURE)
    for motion in motions(5):
        np.testing.assert_allclose(calibration.corrected(motion), motion, rtol=0, atol=1e-15)


def test_scans_without_information_change_nothing() -> None:
    """In an endless corridor the scans carry no information of the distance."""
    calibration, _ = calibrated(200, information=np.diag([0.0, 1e6, 1e6]))
    assert calibration.distance.values[0] == pytest.approx(1.0, abs=1e-3)
    assert calibration.offset.values[0] == pytest.approx(OFFSET[0], abs=0.01)


def test_slips_are_gated_out() -> None:
    calibration, _ = calibrated(200)
    before = calibration.distance.values[0]
    for _ in range(20):
        calibration.update(np.array([0.5, 0.0, 0.0]), np.array([0.1, 0.0, 0.0]), SURE)
    assert calibration.distance.values[0] == before


def test_headings_that_are_noise_alone_leave_the_scale_of_turns() -> None:
    """In a straight corridor: a regression on them would end at 0."""
    calibration, rng = OdometryCalibration(CalibrationConfig()), np.random.default_rng(3)
    for _ in range(2000):
        calibration.update(np.array([0.8, 0.0, 0.03 * rng.standard_normal()]), np.array([0.8, 0.0, 0.0]), SURE)
    assert calibration.turn.values[0] == pytest.approx(1.0, abs=0.05)
