from dataclasses import replace

import numpy as np
import pytest
from slam_rooms import recorded, seen_from

from moteslam.robot.inspection import inspect_recording
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording
from moteslam.robot.sensor_reports import ClockReport, clock_reports, scan_turns, yaw_rates

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


def scans() -> LidarStream:
    """What a lidar in a room of five by three metres sees of the turns."""
    walls = [((-2, -1), (3, -1)), ((3, -1), (3, 2)), ((3, 2), (-2, 2)), ((-2, 2), (-2, -1))]
    ranges = seen_from(np.column_stack((np.zeros((400, 2)), HEADINGS[:400])), walls)
    lidar = recorded(ranges, np.zeros((400, 3))).lidar
    return replace(lidar, stamps=STAMPS[:400])


def offset(recording: Recording, name: str) -> ClockReport:
    return next(clock for clock in clock_reports(yaw_rates(recording)) if clock.name == name)


@pytest.mark.parametrize("late", [0.0, 0.3, -0.25, 0.8])
def test_the_shift_at_which_two_yaw_rates_agree(late: float) -> None:
    clock = offset(turning(late), "odometry")
    assert clock.reference == "imu"
    assert clock.offset == pytest.approx(late, abs=0.011)
    assert clock.correlation > 0.99


def test_late_stamps_are_a_problem_and_small_delays_are_none() -> None:
    assert "clock-offset" in {problem.code for problem in inspect_recording(turning(0.3)).problems}
    assert "clock-offset" not in {problem.code for problem in inspect_recording(turning(0.05)).problems}


def interlaced(lidar: LidarStream) -> LidarStream:
    """The same, but every other beam of a scan is not measured, and of the next scan those between."""
    scan, beam = np.indices(lidar.ranges.shape)
    return replace(lidar, ranges=np.where((scan + beam) % 2, np.float32(np.nan), lidar.ranges), interlace=2)


def test_the_turns_that_scans_show() -> None:
    found = scan_turns(scans())
    errors = found.headings - HEADINGS[:400] + HEADINGS[0]
    assert np.abs(errors).max() < 0.1  # of turns of a radian and more


def test_the_turns_that_interlaced_scans_show() -> None:
    errors = scan_turns(interlaced(scans())).headings - HEADINGS[:400] + HEADINGS[0]
    assert np.abs(errors).max() < 0.2  # a scan has half as many beams
    assert np.abs(np.diff(errors)).max() < 0.01  # it begins 0.026 rad beside the one before


def test_scans_against_odometry() -> None:
    lidar = scans()
    clock = offset(turning().replace(imu=None, lidar=replace(lidar, stamps=lidar.stamps + 0.2)), "lidar")
    assert clock.reference == "odometry"
    assert clock.offset == pytest.approx(0.2, abs=0.03)


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
    assert clock_reports(yaw_rates(still)) == ()
    assert clock_reports(yaw_rates(other)) == ()
