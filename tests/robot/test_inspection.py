"""What an inspection reports, and by how much clocks are apart."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.robot.formats import open_recording
from moteslam.robot.inspection import inspect_recording
from moteslam.robot.platforms import CARMEN, UCSD
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording
from moteslam.robot.sensor_reports import ClockReport, LidarReport, clock_reports
from moteslam.slam.online import OnlineSlam


def scans(stamps: np.ndarray, **changes: object) -> LidarStream:
    ranges = np.ones((len(stamps), 4), np.float32)
    return LidarStream(stamps, ranges, -1.5, 1.0, 0.1, 30.0, **changes)


def wheels(stamps: np.ndarray, count: int = 1) -> EncoderStream:
    return EncoderStream(stamps, np.full((len(stamps), 4), count))


def test_rates_gaps_and_equal_stamps() -> None:
    stamps = np.array([0.0, 0.1, 0.2, 0.2, 0.3, 2.3, 2.4, 2.45])
    report = inspect_recording(Recording("x", UCSD, lidar=scans(stamps), encoders=wheels(stamps)))
    lidar = report.streams[0]
    assert (lidar.name, lidar.readings, lidar.start, lidar.end) == ("lidar", 8, 0.0, 2.45)
    assert lidar.mean_rate == pytest.approx(7 / 2.45)
    assert lidar.median_rate == pytest.approx(10)
    assert (lidar.gaps, lidar.equal_stamps) == (1, 1)
    assert lidar.largest_gap == pytest.approx(2.0)
    assert lidar.largest_gap_at == 0.3
    assert [(one.code, one.count) for one in report.problems] == [("gaps", 1)] * 2


def test_shares_of_the_beams() -> None:
    ranges = np.ones((5, 4), np.float32)
    ranges[0], ranges[1, 0], ranges[1, 1:3] = np.inf, np.inf, np.nan
    lidar = LidarStream(np.arange(5.0), ranges, -1.5, 1.0, 0.1, 30.0, odometry=np.zeros((5, 3)))
    report = inspect_recording(Recording("x", CARMEN, lidar=lidar))
    assert (report.lidar.no_return, report.lidar.invalid, report.lidar.blind_scans) == (0.25, 0.1, 1)
    assert report.lidar.field_of_view == pytest.approx(np.degrees(3.0))
    assert report.odometry_distance == 0.0


@pytest.mark.parametrize("motion", ["encoders", "odometry", "imu"])
def test_motion_of_another_time_than_the_scans_is_told(motion: str) -> None:
    for stamps, apart in ((np.arange(0.0, 8.525, 0.025), False), (np.arange(100.0, 108.525, 0.025), True)):
        n = len(stamps)
        stream = {
            "encoders": wheels(stamps),
            "odometry": OdometryStream(stamps, np.zeros((n, 3))),
            "imu": ImuStream(stamps, np.zeros((n, 3)), np.zeros((n, 3))),
        }[motion]
        recording = Recording("x", UCSD, lidar=scans(np.arange(0.0, 10.01, 0.025))).replace(**{motion: stream})
        told = [(one.code, one.message.split(":")[0]) for one in inspect_recording(recording).problems]
        assert told == [("other-clock", motion)] * apart


def test_a_recording_without_a_lidar_is_told() -> None:
    report = inspect_recording(Recording("x", UCSD, encoders=wheels(np.arange(3.0))))
    assert [problem.code for problem in report.problems] == ["no-lidar"]


def test_the_gyro_is_judged_where_the_wheels_rest() -> None:
    stamps = np.arange(0, 10, 0.025)
    counts = np.where((stamps > 2) & (stamps < 4), 10, 0)
    encoders = EncoderStream(stamps, np.repeat(counts[:, None], 4, axis=1))
    rates = np.zeros((1000, 3))
    times = np.arange(1000) * 0.01
    rates[:, 2] = np.where((times > 2) & (times < 4), 1.0, 0.02)
    imu = ImuStream(times, rates, np.zeros((1000, 3)))
    report = inspect_recording(Recording("x", UCSD, encoders=encoders, imu=imu))
    assert report.gyro_at_rest.mean == pytest.approx(0.02)
    assert report.gyro_at_rest.deviation == pytest.approx(0.0, abs=1e-12)
    assert report.wheels.at_rest == pytest.approx(7.95, abs=0.06)
    assert report.wheels.distance == pytest.approx(counts.sum() * 0.0022)


def test_the_real_ucsd_recordings(data_folder: Path) -> None:
    """The figures measured on them: rates, gyro at rest, stamps in bursts."""
    report = inspect_recording(open_recording(data_folder / "ucsd", sequence=20))
    streams = {stream.name: stream for stream in report.streams}
    assert streams["encoders"].median_rate == pytest.approx(40, abs=0.1)
    assert streams["imu"].mean_rate == pytest.approx(100, abs=0.1)
    assert 0.0038 < report.gyro_at_rest.deviation < 0.0045
    assert 1.0 < np.degrees(report.gyro_at_rest.mean) * 60 < 1.4
    assert report.wheels.distance == pytest.approx(95.9, abs=0.05)


@pytest.mark.parametrize(
    ("seconds", "metres", "headings", "rates", "ranges", "code"),
    [
        (1, 1, 1, 1, 1, None),
        (1000, 1, 1, 1, 1, "implausible-speed"),
        (1, 1000, 1, 1, 1, "odometry-units"),
        (1, 1, 57.3, 1, 1, "odometry-units"),
        (1, 1, 1, 57.3, 1, "gyro-units"),
        (1, 1, 1, 1, 1000, "range-units"),
        (1, 1, 1, 1, 0.001, "range-units"),
    ],
)
def test_figures_in_other_units_are_told_and_give_no_map(
    seconds: float, metres: float, headings: float, rates: float, ranges: float, code: str | None
) -> None:
    stamps = seconds * np.arange(50) / 10
    lidar = scans(stamps)
    recording = Recording(
        "x",
        CARMEN,
        lidar=replace(lidar, ranges=ranges * lidar.ranges[:], range_max=100.0 * ranges),
        odometry=OdometryStream(stamps, np.arange(50)[:, None] * (0.05 * metres, 0.0, 0.05 * headings)),
        imu=ImuStream(stamps, np.full((50, 3), 0.5 * rates), np.zeros((50, 3))),
    )
    codes = {"implausible-speed", "odometry-units", "gyro-units", "range-units"}
    found = [problem.code for problem in inspect_recording(recording).problems if problem.code in codes]
    assert found == ([code] if code else [])
    if code is None or code == "implausible-speed":
        OnlineSlam.over(recording)
    else:
        with pytest.raises(InputError):
            OnlineSlam.over(recording)


def test_running_totals_in_place_of_counts_are_no_speed_of_a_robot() -> None:
    counts = np.repeat(np.arange(0, 20_000, 20)[:, None], 4, axis=1)
    lidar = scans(np.arange(50) / 10)
    recording = Recording("x", UCSD, lidar=lidar, encoders=EncoderStream(np.arange(1000) / 40, counts))
    assert "odometry-units" in [problem.code for problem in inspect_recording(recording).problems]
    with pytest.raises(InputError, match="encoders: move at"):
        OnlineSlam.over(recording)


@pytest.mark.parametrize(("counts", "dead"), [((20, 0, 20, 0), ["front left, rear left"]), ((20, 20, 20, 20), [])])
@pytest.mark.parametrize(("begin", "when"), [(0, "at all"), (400, "from 10.00 to 24.98 s"), (900, "")])
def test_wheels_that_do_not_count_are_told(begin: int, when: str, counts: tuple[int, ...], dead: list[str]) -> None:
    rows = np.tile(20, (1000, 4))
    rows[begin:] = counts
    encoders = EncoderStream(np.arange(1000) / 40, rows)
    recording = Recording("x", UCSD, lidar=scans(np.arange(50) / 2), encoders=encoders)
    problems = [problem.message for problem in inspect_recording(recording).problems]
    assert [text.split(": ")[1] for text in problems if f"no count {when}," in text] == (dead if when else [])


RNG = np.random.default_rng(1)


def measured(ranges: np.ndarray, *, increment: float = 0.01, counts: np.ndarray | None = None) -> LidarReport:
    """The report on scans ten times a second, of a robot whose wheels count this at each of them."""
    stamps = np.arange(len(ranges)) / 10
    counts = np.zeros(len(ranges), np.int64) if counts is None else counts
    recording = Recording(
        "x",
        UCSD,
        lidar=LidarStream(stamps, ranges.astype(np.float32), 0.5, increment, 0.1, 30.0),
        encoders=EncoderStream(stamps, np.repeat(counts[:, None], 4, axis=1)),
    )
    return inspect_recording(recording).lidar


@pytest.mark.parametrize("step", [0.00025, 1 / 256, 0.05])
def test_the_resolution_is_the_step_that_ranges_were_rounded_to(step: float) -> None:
    rounded = np.round(RNG.uniform(1, 6, (200, 100)) / step) * step
    assert measured(rounded).resolution == pytest.approx(step, rel=0.0005)


@pytest.mark.parametrize("count", [1, 100_000])
def test_ranges_that_were_not_rounded_have_no_resolution(count: int) -> None:
    assert measured(RNG.uniform(1, 6, (1, count)), increment=1e-5).resolution is None


def test_noise_is_measured_within_each_rest_and_not_on_the_way() -> None:
    places = np.array((2.0, 3.0, 4.0, 4.0))
    ranges = np.repeat(places, 50)[:, None] + RNG.normal(0, 0.012, (200, 300))
    ranges[50:100] += np.linspace(0, 3, 50)[:, None]  # on the way
    ranges[::7, 3], ranges[::9, 4] = np.nan, np.inf
    ranges[:, 0] += RNG.uniform(0, 3, 200)  # somebody walks through one beam
    ranges[:50, 200:] = np.inf  # in the first rest these meet nothing
    counts = np.repeat((0, 10, 0, 0), 50)
    noise = measured(ranges, counts=counts).noise_at_rest
    assert noise.deviation == pytest.approx(0.012, rel=0.05)
    assert noise.at_range == pytest.approx(4.0, abs=0.01)
    assert noise.beams == 500


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
