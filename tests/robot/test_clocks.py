import numpy as np
import pytest

from moteslam.robot.inspection import inspect_recording
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, ImuStream, OdometryStream, Recording
from moteslam.robot.sensor_reports import ClockReport, clock_reports

STAMPS = np.arange(2000) / 20
HEADINGS = 0.8 * np.sin(STAMPS / 3) + 0.5 * np.sin(1.3 * STAMPS)
RATES = 0.8 / 3 * np.cos(STAMPS / 3) + 0.65 * np.cos(1.3 * STAMPS)


def turning(late: float = 0.0) -> Recording:
    """A robot that turns to and fro on the spot; its odometry's stamps are late by this many seconds."""
    poses = np.column_stack((np.zeros((2000, 2)), HEADINGS))
    rates = np.column_stack((np.zeros((2000, 2)), RATES))
    return Recording(
        "turning",
        UCSD,
        odometry=OdometryStream(STAMPS + late, poses),
        imu=ImuStream(STAMPS, rates, np.zeros((2000, 3))),
    )


def offset(recording: Recording, name: str) -> ClockReport:
    return next(clock for clock in clock_reports(recording) if clock.name == name)


@pytest.mark.parametrize("late", [0.0, 0.3, -0.25, 0.8])
def test_the_shift_at_which_two_yaw_rates_agree(late: float) -> None:
    clock = offset(turning(late), "odometry")
    assert clock.reference == "imu"
    assert clock.offset == pytest.approx(late, abs=0.011)
    assert clock.correlation > 0.99


def test_late_stamps_are_a_problem_and_small_delays_are_none() -> None:
    assert "clock-offset" in {problem.code for problem in inspect_recording(turning(0.3)).problems}
    assert "clock-offset" not in {problem.code for problem in inspect_recording(turning(0.05)).problems}


def test_an_offset_that_slip_may_explain_is_no_problem() -> None:
    """Slip of half a second at a time, in 15 s; the scatter of the offset over 30 such drives is as stated."""
    short, reports, told = slice(0, 300), [], 0
    for seed in range(30):
        slip = np.random.default_rng(seed).normal(0, 0.3, 300).reshape(-1, 10).mean(axis=1).repeat(10)
        poses = np.column_stack((np.zeros((300, 2)), HEADINGS[short] + np.cumsum(slip / 20)))
        late = turning().replace(odometry=OdometryStream(STAMPS[short] + 0.06, poses))
        reports.append(offset(late, "odometry"))
        told += any(problem.code == "clock-offset" for problem in inspect_recording(late).problems)
    scatter, stated = np.std([report.offset for report in reports]), np.mean([report.deviation for report in reports])
    assert scatter / 2 < stated < 2 * scatter
    assert told == 0 < sum(abs(report.offset) > 0.1 for report in reports)


def test_wheels_against_the_gyro() -> None:
    side = np.diff(HEADINGS, prepend=HEADINGS[0]) * UCSD.wheels.effective_track / 2 / UCSD.wheels.metres_per_count
    counter = np.rint(np.cumsum(side)).astype(np.int64)
    right = np.diff(counter, prepend=counter[0])
    counts = np.column_stack((right, -right, right, -right))
    recording = turning().replace(encoders=EncoderStream(STAMPS - 0.15, counts), odometry=None)
    assert offset(recording, "encoders").offset == pytest.approx(-0.15, abs=0.011)


def test_nothing_is_told_of_a_robot_that_does_not_turn_or_of_other_motions() -> None:
    still = turning().replace(odometry=OdometryStream(STAMPS, np.zeros((2000, 3))))
    other = turning().replace(
        odometry=OdometryStream(STAMPS, np.column_stack((np.zeros((2000, 2)), np.sin(STAMPS * 0.9))))
    )
    assert clock_reports(still) == ()
    assert clock_reports(other) == ()
