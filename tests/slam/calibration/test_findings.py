"""What a calibration says, to which side and by how much, and what is mended by it: of figures that are made up."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sim_logs import winding

from moteslam.robot.platforms import UCSD
from moteslam.slam.calibration.calibrate import Calibration
from moteslam.slam.calibration.findings import findings, stamped_at_end
from moteslam.slam.calibration.hand_eye import Fit, Parameter
from moteslam.slam.calibration.mended import calibrated
from moteslam.slam.calibration.parts import Change

RECORDING = winding(seconds=10.0)
MIDDLE = float(RECORDING.lidar.stamps.mean())
VALUES = np.array((*UCSD.lidar.pose, 1.0, 1.0, 0.0, 0.0, 0.0))
"""By `Parameter`, as stated."""
ABOUT = np.array((0.01, 0.01, 0.01, 0.01, 0.01, 0.01, 0.01, 0.0005))


def fit_with(**changes: Any) -> Fit:
    """As stated, but for parameters, by their names in small letters, and other fields."""
    values = VALUES.copy()
    for name in [name for name in changes if name.upper() in Parameter.__members__]:
        values[Parameter[name.upper()]] = changes.pop(name)
    return Fit(values, ABOUT, 3.0, MIDDLE, Change(), Change(), (0.0, 0.01), 0.0)._replace(**changes)


def calibration(of_fit: dict[str, Any] | None = None, **changes: Any) -> Calibration:
    """One of which nothing is wrong, but for changes."""
    fit = fit_with(**(of_fit or {}))
    sound = Calibration(
        1.0, 0.001, (0.0, 0.01), Change(), False, "", "stated", 0.0, fit, 0.99, fit, True, "", True, False, None, None
    )
    return replace(sound, **changes)


@pytest.mark.parametrize(
    ("of_fit", "changes", "code", "words"),
    [
        ({}, {"excess": (0.2, 0.01)}, "range-offset", ("0.20 m (95 %: 0.18 to 0.22) too long", "subtract 0.200 m")),
        ({}, {"excess": (-0.2, 0.01)}, "range-offset", ("0.20 m", "too short", "subtract -0.200 m")),
        ({}, {"longer": Change(50.0, 0.3, 0.01)}, "range-change", ("50 s on all ranges are 0.30 m longer",)),
        ({}, {"longer": Change(50.0, -0.3, 0.01)}, "range-change", ("0.30 m shorter",)),
        ({}, {"angle_scale": 0.95}, "lidar-angles", ("5.0 % (95 %: 4.8 to 5.2 %) less than", "= 0.0165806")),
        ({}, {"no_surfaces": 3.419}, "range-max", ("from 3.41 m on", "range_max = 3.41")),
        ({}, {"no_surfaces": -3.82}, "lidar-tilted", ("a line 3.8 m before it",)),
        ({}, {"sweep": 0.018}, "time-increment", ("takes 0.018 s", "time_increment = 0.0001")),
        ({"change": Change(40.0, np.log(1.1), 0.005)}, {}, "range-change", ("40 s on", "10.0 % more")),
        ({"turned": Change(30.0, 0.1745, 0.005)}, {}, "mount-moves", ("30 s on", "10.0 degrees to the left")),
        ({"curl": (0.2, 0.01)}, {}, "odometry-turn-scale", ("0.20 rad to the left",)),
        ({"lengths": 1.1}, {}, "range-scale", ("10.0 % (95 %: 8.0 to 12.0 %) more", f"= {1.1 * 0.0022:.6g}")),
        ({"turns": 0.8}, {}, "odometry-turn-scale", ("25.0 % (95 %: 21.9 to 28.1 %) more",)),
        (
            {"x": 0.5, "y": -0.3},
            {},
            "lidar-mount",
            ("x [m] 0.5 (95 %: 0.48 to 0.52)", "y [m] -0.3", "x = 0.500, y = -0.300"),
        ),
        ({"offset": -0.5}, {"shared_clock": False}, "clock-offset", ("0.50 s (95 %: 0.48 to 0.52) later",)),
        ({"offset": 0.5}, {"shared_clock": False}, "clock-offset", ("earlier than the odometry",)),
        ({"offset": 0.5}, {"shared_clock": False, "late": "gyro"}, "clock-offset", ("imu: stamped 0.50 s", "later")),
        ({"drift": 0.005}, {"shared_clock": False}, "clock-drift", ("-5.00 ms a second", "-5.98 to -4.02")),
        ({}, {"uneven": 0.02}, "other-clock", ("-20 ms a second", "were they counted")),
    ],
)
def test_what_is_certain_is_said_by_how_much_and_to_which_side(
    of_fit: dict[str, Any], changes: dict[str, Any], code: str, words: tuple[str, ...]
) -> None:
    (issue,) = findings(calibration(of_fit, **changes), RECORDING).issues
    assert issue.code == code
    assert [word for word in words if word not in issue.message] == []


def test_a_gyro_that_saturates_is_not_said_to_be_in_other_units() -> None:
    rates = RECORDING.imu.angular_velocity
    rates = rates * np.linspace(1.0, 1.1, len(rates))[:, None]
    most = float(np.abs(rates[:, 2]).max())
    for limit, words in ((most, "no rad/s"), (most / 2, f"measures {most / 2:.3g} rad/s and no more")):
        imu = replace(RECORDING.imu, angular_velocity=rates.clip(-limit, limit))
        (issue,) = findings(calibration({"turns": 0.8}), RECORDING.replace(imu=imu)).issues
        assert words in issue.message


def test_a_clock_that_drifts_is_not_stamped_at_the_end_of_a_sweep() -> None:
    lidar = replace(RECORDING.lidar, time_increment=0.3 / (RECORDING.lidar.ranges.shape[1] - 1))
    for drift, at_end in ((0.0, True), (0.005, False)):
        found = calibration({"offset": -0.3, "drift": drift}, shared_clock=False)
        assert stamped_at_end(found, RECORDING.replace(lidar=lidar)) == at_end


def test_clocks_and_lengths_are_mended_on_the_side_that_is_asked_for() -> None:
    found = calibration({"offset": 0.5, "drift": 0.005, "lengths": 1.1}, shared_clock=False)
    lidar, encoders = RECORDING.lidar, RECORDING.encoders
    mended = calibrated(RECORDING, found, "lidar")
    expected = lidar.stamps + 0.5 + 0.005 * (lidar.stamps - MIDDLE)
    np.testing.assert_allclose(mended.lidar.stamps - MIDDLE, expected - MIDDLE, atol=1e-6)
    np.testing.assert_allclose(mended.lidar.ranges, lidar.ranges / 1.1, rtol=1e-6)
    assert mended.lidar.range_max == pytest.approx(lidar.range_max / 1.1)
    assert mended.encoders.stamps.tobytes() == encoders.stamps.tobytes()
    mended = calibrated(RECORDING, found, "odometry")
    for stream, other in ((mended.encoders, encoders), (mended.imu, RECORDING.imu)):
        np.testing.assert_allclose(stream.stamps - MIDDLE, (other.stamps - MIDDLE - 0.5) / 1.005, atol=1e-6)
    assert mended.lidar.ranges is lidar.ranges
    wheels, stated = mended.platform.wheels, UCSD.wheels
    assert wheels.metres_per_count == pytest.approx(1.1 * stated.metres_per_count)


@pytest.mark.parametrize(
    ("gyro", "turns", "wider"),
    [
        (True, 1.0, 1.0),  # those of the gyro
        (False, 1.0, 1.2),  # turns are right, and must remain so
        (False, 1 / 1.25, 1.0),  # turns are short, too: the wheels are larger, nothing else is wrong
        (False, 1 / 1.6, 1.2 / 1.6),
    ],
)
def test_the_track_of_wheels_that_are_larger_than_stated_is_what_their_turns_say(
    gyro: bool, turns: float, wider: float
) -> None:
    """Turns by the odometry over those by the scans."""
    recording = RECORDING if gyro else RECORDING.replace(imu=None)
    found = calibration({"lengths": 1.2, "turns": turns})
    wheels, stated = calibrated(recording, found, "odometry").platform.wheels, UCSD.wheels
    assert wheels.metres_per_count == pytest.approx(1.2 * stated.metres_per_count)
    assert wheels.effective_track == pytest.approx(wider * stated.effective_track)
    (said,) = [one.message for one in findings(found, recording).issues if one.code == "range-scale"]
    assert ("effective_track" in said) == (wider != 1)


@pytest.mark.parametrize(
    ("wrong", "side"),
    [("lidar", None), ("odometry", None), ("gyro", None), ("", "lidar"), ("", "odometry"), ("", None)],
)
def test_what_turns_the_wrong_way_is_mended_alone(wrong: Any, side: Any) -> None:
    """Where no third witness says what it is, that of the side that is asked for; of the odometry with its gyro."""
    mended = calibrated(RECORDING, calibration(mirrored=True, wrong=wrong), side)
    counts, rates, what = RECORDING.encoders.counts, RECORDING.imu.angular_velocity, wrong or side
    assert mended.lidar.angle_increment == RECORDING.lidar.angle_increment * (-1 if what == "lidar" else 1)
    np.testing.assert_array_equal(mended.encoders.counts, counts[:, [1, 0, 3, 2]] if what == "odometry" else counts)
    turned = wrong == "gyro" or (side == "odometry" and not wrong)
    np.testing.assert_array_equal(mended.imu.angular_velocity, rates * (1, 1, -1) if turned else rates)


def test_a_gyro_that_is_late_is_put_back_alone() -> None:
    mended = calibrated(RECORDING, calibration({"offset": 0.5}, shared_clock=False, late="gyro"), None)
    np.testing.assert_allclose(mended.imu.stamps - RECORDING.imu.stamps, -0.5, atol=1e-6)
    assert mended.encoders.stamps.tobytes() == RECORDING.encoders.stamps.tobytes()
    assert mended.lidar.stamps.tobytes() == RECORDING.lidar.stamps.tobytes()
