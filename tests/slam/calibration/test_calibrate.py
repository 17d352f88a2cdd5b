"""Lidars and odometry that are not as stated: from simulated recordings with a fault, and of motions that are known."""

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moteslam.robot import se2
from moteslam.robot.formats import Cut, cut, open_recording
from moteslam.robot.recording import ChunkedRanges, EncoderStream, LidarStream, OdometryStream, Recording
from moteslam.robot.values import Issue
from moteslam.sim.logged import with_odometry
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate
from moteslam.slam.calibration import calibrate as calibrating
from moteslam.slam.calibration import checked as checking
from moteslam.slam.calibration.calibrate import FEW_PAIRS, PAIRS, Calibration, calibrate
from moteslam.slam.calibration.checked import checked
from moteslam.slam.calibration.findings import Findings, findings, trusting
from moteslam.slam.calibration.hand_eye import Fit, Pairs, Parameter, fit
from moteslam.slam.calibration.mended import calibrated
from moteslam.slam.calibration.readings import with_stamps
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.synchronise import dead_reckon

Fault = Callable[[Recording], Recording]
WORLDS = {"ucsd": "loop", "lms200": "office", "rplidar_a1": "corridor"}
"""The platforms here, and where they drive."""


def slow(*values: Any) -> Any:
    return pytest.param(*values, marks=pytest.mark.slow)


@cache
def driven(platform: str, world: str = "", seed: int = 200, noise: str | None = None) -> Recording:
    return simulate(load_scenario(world or WORLDS[platform], platform=platform, noise=noise), seed).recording


@cache
def poses_of(recording: Recording) -> Recording:
    """The same with odometry poses in place of wheels and gyro."""
    path = dead_reckon(recording)
    return recording.replace(encoders=None, imu=None, odometry=OdometryStream(path.stamps, path.poses))


def lidar(**changes: Any) -> Fault:
    """Of the stream: each change is a function of its lidar."""
    return lambda r: r.replace(lidar=replace(r.lidar, **{name: value(r.lidar) for name, value in changes.items()}))


def within(recording: Recording, begin: float, end: float) -> Recording:
    """Its scans from so long after the first on [s], and the other streams whole."""
    since = recording.lidar.stamps - recording.lidar.stamps[0]
    some = (since >= begin) & (since < end)
    return lidar(stamps=lambda s: s.stamps[some], ranges=lambda s: s.ranges[some])(recording)


def mount(**shifts: float) -> Fault:
    def shifted(r: Recording) -> Recording:
        spec = r.platform.lidar
        spec = spec.model_copy(update={name: getattr(spec, name) + shift for name, shift in shifts.items()})
        return r.replace(platform=r.platform.model_copy(update={"lidar": spec}))

    return shifted


def poses(change: Callable[[np.ndarray], np.ndarray]) -> Fault:
    def changed(r: Recording) -> Recording:
        r = poses_of(r)
        return r.replace(odometry=replace(r.odometry, poses=change(r.odometry.poses)))

    return changed


def late(seconds: float) -> Fault:
    def shifted(r: Recording) -> Recording:
        r = poses_of(r)
        return r.replace(odometry=replace(r.odometry, stamps=r.odometry.stamps + seconds))

    return shifted


def biased_gyro(recording: Recording) -> Recording:
    rates = recording.imu.angular_velocity + np.array((0.0, 0.0, 0.02))
    return recording.replace(imu=replace(recording.imu, angular_velocity=rates))


def found_in(recording: Recording, pairs: int = FEW_PAIRS) -> tuple[Calibration, Findings]:
    found = calibrate(recording, pairs=pairs)
    return found, findings(found, recording)


def codes(issues: Iterable[Issue]) -> list[str]:
    return [issue.code for issue in issues]


NARROW = lidar(angle_increment=lambda s: s.angle_increment * 0.95)
LONG = lidar(ranges=lambda s: s.ranges * np.float32(1.1), range_max=lambda s: s.range_max * 1.1)
REVERSED = lidar(ranges=lambda s: np.ascontiguousarray(s.ranges[:, ::-1]))
DRIFTS = lidar(stamps=lambda s: drifted(s, 1.005))

FAULTS: dict[str, tuple[Fault, str, str, float, float]] = {
    "narrow": (NARROW, "lidar-angles", "angles", 1 / 0.95 - 1, 0.005),
    "long": (LONG, "range-scale", "lengths", 0.1, 0.02),
    "farther": (lidar(ranges=lambda s: s.ranges + np.float32(0.1)), "range-offset", "excess", 0.1, 0.02),
    "ahead": (mount(x=0.2), "lidar-mount", "x", -0.2, 0.04),
    "aside": (mount(y=-0.2), "lidar-mount", "y", 0.2, 0.04),
    "turned": (mount(yaw=np.radians(10)), "lidar-mount", "yaw", -10, 2),
    "drifts": (DRIFTS, "clock-drift", "drift", -0.005, 0.001),
}
"""Faults of a lidar: what is done, the code, the figure that shows it, its true difference, and a fifth of that."""


TOO = ("narrow", "farther", "ahead", "turned", "drifts")
"""These are measured by a lidar that sees all round, too."""
FAST = ("long", "ahead", "drifts", "beams")


@pytest.mark.parametrize(
    ("name", "platform"),
    [
        *((pytest.param if name in FAST else slow)(name, "lms200") for name in FAULTS),
        *(slow(name, "rplidar_a1") for name in TOO),
    ],
)
def test_a_lidar_that_is_not_as_stated_is_measured_to_a_fifth(name: str, platform: str) -> None:
    fault, code, shows, size, within = FAULTS[name]
    _, found = found_in(fault(driven(platform)))
    assert codes(found.issues) == [code]
    figure = next(one for one in found.figures if one.name.startswith(shows))
    assert figure.value - figure.stated == pytest.approx(size, abs=within)


def drifted(stream: LidarStream, by: float = 1.02) -> np.ndarray:
    return stream.stamps[0] + (stream.stamps - stream.stamps[0]) * by


def stepped(streams: tuple[str, ...], seconds: float, share: float) -> Fault:
    """The clock of some streams set forward after a share of the recording."""

    def changed(r: Recording) -> Recording:
        r = poses_of(r) if "odometry" in streams else r
        at = r.lidar.stamps[0] + share * np.ptp(r.lidar.stamps)
        return with_stamps(r, streams, lambda stamps: stamps + seconds * (stamps > at))

    return changed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("streams", "seconds", "share", "platform"),
    [(("lidar",), 0.9, 0.5, "lms200"), (("encoders", "imu"), 1.5, 0.6, "ucsd")],
)
def test_a_clock_that_steps_is_told_and_corrected(
    streams: tuple[str, ...], seconds: float, share: float, platform: str
) -> None:
    recording = stepped(streams, seconds, share)(driven(platform))
    calibration, found = found_in(recording)
    assert codes(found.moves) == ["clock-step"]
    assert found.decided == {"clock-step"}
    undone, lidar = calibration.step.undone(recording), recording.lidar.stamps
    both = ("lidar", "encoders")
    back = {name: getattr(recording, name).stamps - getattr(undone, name).stamps for name in both}
    assert [name for name in both if back[name].any()] == [streams[0]]
    late = back[streams[0]] > 0
    assert back[streams[0]][late] == pytest.approx(seconds, abs=0.02)
    assert getattr(recording, streams[0]).stamps[np.argmax(late) - 1] == pytest.approx(
        lidar[0] + share * (np.ptp(lidar) - seconds * (streams[0] == "lidar")), abs=1.0
    )
    assert codes(found_in(calibrated(recording, calibration, None))[1].issues) == []


@pytest.mark.slow
def test_angles_that_are_off_by_a_factor_are_found() -> None:
    calibration, found = found_in(lidar(angle_increment=lambda s: s.angle_increment * 0.75)(driven("rplidar_a1")))
    assert calibration.angle_scale == pytest.approx(1 / 0.75, rel=0.01)
    assert codes(found.moves) == ["lidar-angles"]


@pytest.mark.slow
def test_ranges_that_change_in_mid_drive_are_told() -> None:
    recording = driven("lms200")
    stamps = recording.lidar.stamps
    later = np.where(stamps > stamps.mean(), 0.9, 1.0).astype(np.float32)
    found, about = found_in(lidar(ranges=lambda s: s.ranges * later[:, None])(recording), PAIRS)
    assert codes(about.moves) == ["range-change"]
    assert np.expm1(found.fit.change.amount) == pytest.approx(-0.1, rel=0.25)


@pytest.mark.parametrize(("longer", "share"), [(0.25, 0.5), slow(-0.1, 0.3)])
def test_ranges_that_are_all_longer_from_the_middle_on_are_told(longer: float, share: float) -> None:
    recording = driven("lms200")
    stamps = recording.lidar.stamps
    later = np.where(stamps > stamps[0] + share * np.ptp(stamps), longer, 0.0).astype(np.float32)
    found, about = found_in(lidar(ranges=lambda s: s.ranges + later[:, None])(recording))
    assert codes(about.moves) == ["range-change"]
    assert found.longer.amount == pytest.approx(longer, abs=0.04)
    assert found.longer.time == pytest.approx(stamps[0] + share * np.ptp(stamps), abs=20)


def test_scans_stamped_as_they_arrive_in_bundles_are_told_and_spread() -> None:
    recording = driven("lms200")
    stamps = recording.lidar.stamps
    arrived = stamps[np.minimum(np.arange(len(stamps)) // 8 * 8 + 7, len(stamps) - 1)] + 0.001 * (
        np.arange(len(stamps)) % 8
    )
    wrong = lidar(stamps=lambda s: arrived)(recording)
    calibration, found = found_in(wrong)
    assert codes(found.moves) == ["stamps-jitter"]
    np.testing.assert_allclose(calibrated(wrong, calibration, None).lidar.stamps, stamps, atol=0.03)


def test_odometry_that_comes_as_increments_is_told_and_summed_up() -> None:
    recording = poses_of(driven("lms200"))
    steps = se2.between(recording.odometry.poses[:-1], recording.odometry.poses[1:])
    wrong = recording.with_poses(lambda _, poses: np.vstack((np.zeros(3), steps)))
    calibration, found = found_in(wrong)
    assert codes(found.moves) == ["odometry-increments"]
    summed = calibrated(wrong, calibration, None).odometry.poses
    np.testing.assert_allclose(summed, se2.compose(se2.inverse(recording.odometry.poses[0]), recording.odometry.poses))


def test_odometry_that_stands_still_is_no_increments() -> None:
    recording = poses_of(driven("lms200")).with_poses(lambda _, poses: np.full_like(poses, 0.05))
    calibration, found = found_in(recording)
    assert codes(found.moves) == ["odometry-unfit"]
    assert calibrated(recording, calibration, None).odometry is None


@pytest.mark.parametrize("late", [3.0, 5.0])
def test_scans_stamped_seconds_late_throughout_are_not_told_to_be_so_for_a_time(late: float) -> None:
    calibration, found = checked(lidar(stamps=lambda s: s.stamps + late)(driven("urg04lx", "doors")), 150)
    assert codes(found.moves) == ["clock-offset"]
    assert calibration.fit.values[Parameter.OFFSET] == pytest.approx(-late, abs=0.03)


def varying(recording: Recording) -> Recording:
    """Every scan has other beams, as of cheap lidars, laid on one fan by their angles."""
    ranges, rng = recording.lidar.ranges[:], np.random.default_rng(0)
    laid = np.full_like(ranges, np.nan)
    for row, measured in zip(laid, ranges, strict=True):
        there = np.arange(rng.uniform(0, 2), len(row) - 1, 2.2 * rng.uniform(0.97, 1.03)).astype(int)
        row[there] = measured[there]
    return lidar(ranges=lambda _: laid)(recording)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (lambda r: r, []),
        (NARROW, ["lidar-angles"]),
        (lidar(time_increment=lambda s: -s.time_increment), ["time-increment", "clock-offset"]),
    ],
)
def test_a_lidar_whose_beams_vary_from_scan_to_scan_is_measured(fault, expected: list[str]) -> None:
    calibration, found = checked(fault(varying(driven("rplidar_a1"))), 150)
    assert codes(found.moves) == expected
    np.testing.assert_allclose(calibration.fit.values[:2], 0.0, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.0, 0.5])
def test_odometry_logged_late_with_scans_is_told_and_put_right(late: float) -> None:
    recording = poses_of(driven("lms200"))
    stamps, odometry = recording.lidar.stamps, recording.odometry
    logged = se2.interpolate(odometry.stamps, odometry.poses, stamps - late)
    recording = lidar(odometry=lambda s: logged)(recording.replace(odometry=None))
    calibration, found = found_in(recording)
    assert codes(found.moves) == (["clock-offset"] if late else [])
    assert not late or calibration.fit.values[Parameter.OFFSET] == pytest.approx(late, abs=0.12)  # wheels turn first
    mended = calibrated(recording, calibration, None).lidar.odometry
    true = se2.interpolate(odometry.stamps, odometry.poses, stamps)
    assert np.median(np.hypot(*(mended - true)[:, :2].T)) < (0.15 if late else 1e-9)


def packed(stream: LidarStream, end: int) -> np.ndarray:
    """Its ranges without those beyond 4 m, the gaps closed and the end, or the beginning, filled up."""
    ranges = np.array(stream.ranges)
    order = np.argsort(end * ~(ranges < 4.0), axis=1, kind="stable")
    return np.take_along_axis(np.where(ranges < 4.0, ranges, np.nan).astype(np.float32), order, axis=1)


def turning_unevenly(stream: LidarStream) -> np.ndarray:
    """Of a motor whose speed wobbles by 5 % in 20 s."""
    beams = np.arange(stream.ranges.shape[1])
    shares = 1 + 0.05 * np.sin(2 * np.pi * stream.stamps / 20)
    return np.take_along_axis(stream.ranges, np.rint(shares[:, None] * beams).astype(int) % len(beams), axis=1)


def mean_of_four(stream: LidarStream) -> np.ndarray:
    return np.mean([np.roll(stream.ranges, k, axis=0) for k in range(4)], axis=0, dtype=np.float32)


def half_as_before(stream: LidarStream) -> np.ndarray:
    ranges = np.array(stream.ranges)
    for before, scan in pairwise(ranges):
        both = np.isfinite(before) & np.isfinite(scan)
        scan[both] = (scan[both] + before[both]) / 2
    return ranges


def off_its_axis(ranges: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """What a disc of marks that is 2 degrees off its axis makes of beams at even angles."""
    true = angles + np.deg2rad(2) * np.sin(angles + 0.7)
    return ranges[:, np.abs(se2.wrap(true[:, None] - angles)).argmin(axis=1)]


def in_turn(stream: LidarStream) -> np.ndarray:
    """Of two lidars in one stream: one looks ahead and one back."""
    ahead, back = stream.ranges[:, 180:], stream.ranges[:, :180]
    return np.where(np.arange(len(stream))[:, None] % 2, ahead, back)


def turned_round(some: slice) -> Fault:
    def turned(stream: LidarStream) -> np.ndarray:
        ranges = np.array(stream.ranges)
        ranges[some] = ranges[some, ::-1]
        return ranges

    return lidar(ranges=turned)


def half_of_the_turn_before(stream: LidarStream) -> np.ndarray:
    ranges = np.array(stream.ranges)
    ranges[1:, 180:] = stream.ranges[:-1, 180:]
    return ranges


def given_twice(recording: Recording) -> Recording:
    wheels = recording.encoders
    return recording.replace(encoders=EncoderStream(np.repeat(wheels.stamps, 2), np.repeat(wheels.counts, 2, axis=0)))


def exchanged(recording: Recording) -> Recording:
    """The mount is known from the poses of robot and lidar, as of a log, and these are exchanged."""
    spec, path = recording.platform.lidar, dead_reckon(recording)
    laser = se2.interpolate(path.stamps, se2.compose(path.poses, spec.pose), recording.lidar.stamps)
    back = dict(zip(("x", "y", "yaw"), se2.inverse(spec.pose).tolist(), strict=True))
    robot = recording.platform.model_copy(update={"lidar": spec.model_copy(update=back)})
    return lidar(odometry=lambda _: laser)(recording.replace(encoders=None, platform=robot))


BACKWARDS = lidar(
    ranges=lambda s: np.ascontiguousarray(s.ranges[:, ::-1]),
    angle_min=lambda s: s.angles[-1],
    angle_increment=lambda s: -s.angle_increment,
)
NO_ORDER = "not measured in their order"
TOLD = {
    "unfit": (lidar(ranges=lambda s: s.ranges * np.float32(100)), ("lms200",), "scans-unfit", "fit each other"),
    "packed": (lidar(ranges=lambda s: packed(s, 1)), ("lms200",), "scans-unfit", "at one end"),
    "packed at the end": (lidar(ranges=lambda s: packed(s, -1)), ("rplidar_a1",), "scans-unfit", "at one end"),
    "means": (lidar(ranges=mean_of_four), ("rplidar_a1",), "scans-unfit", "means of several scans"),
    "half as before": (lidar(ranges=half_as_before), ("lms200",), "scans-unfit", "means of several scans"),
    "turned round": (turned_round(slice(1, None, 2)), ("lms200",), "scans-unfit", "in the other order"),
    "a fifth turned round": (turned_round(slice(2, None, 5)), ("rplidar_a1",), "scans-unfit", "in the other order"),
    "two lidars": (lidar(ranges=in_turn), ("rplidar_a1",), "scans-unfit", "two lidars"),
    "few bits": (
        lidar(ranges=lambda s: s.ranges % np.float32(8.192)),
        ("lms200", "loop"),
        "scans-unfit",
        "too few bits",
    ),
    "backwards": (BACKWARDS, ("rplidar_a1",), "scans-unfit", NO_ORDER),
    "the turn before": (lidar(ranges=half_of_the_turn_before), ("rplidar_a1",), "scans-unfit", NO_ORDER),
    "uneven angles": (
        lidar(ranges=lambda s: off_its_axis(s.ranges[:], s.angles)),
        ("rplidar_a1", "office"),
        "lidar-angles",
        "",
    ),
    "uneven turns": (lidar(ranges=turning_unevenly), ("rplidar_a1", "loop", 12), "odometry-unfit", "speed of a motor"),
    "wheels twice": (given_twice, ("ucsd",), "range-scale", "given twice"),
    "exchanged": (exchanged, ("lms200",), "lidar-mount", "exchanged"),
    "off by less than 0.15 m": (mount(y=-0.13, yaw=np.radians(-6)), ("lms200",), "lidar-mount", ""),
    "gyro with a bias": (biased_gyro, ("ucsd",), "gyro-bias", "rad/s while the wheels stand"),
    "drifts as none does": (lidar(stamps=drifted), ("lms200",), "other-clock", "as no clock does"),
}
"""What is done, in which drive, the code, and what its message says."""


@pytest.mark.parametrize(
    "name",
    [name if name in ("backwards", "off by less than 0.15 m") else slow(name) for name in TOLD],
)
def test_what_is_wrong_is_said(name: str) -> None:
    fault, drive, code, words = TOLD[name]
    calibration, found = checked(fault(driven(*drive)), 150)
    (issue,) = found.moves
    assert issue.code == code
    assert words in issue.message
    assert ("exchanged" in issue.message) == (name == "exchanged")
    unmeasured = name == "uneven angles" or (code == "scans-unfit" and words != NO_ORDER)
    assert (calibration is None) == unmeasured  # nothing is made of it
    assert not found.decided
    assert trusting(SyncConfig(), [issue]).travelling == (code not in ("lidar-angles", "odometry-unfit", "other-clock"))


@pytest.mark.slow
def test_a_lidar_that_is_turned_in_mid_drive_is_said_to_be() -> None:
    def turned(s: LidarStream) -> np.ndarray:
        late = s.stamps > s.stamps[0] + 0.4 * np.ptp(s.stamps)
        by = round(np.radians(-8) / s.angle_increment)
        return np.where(late[:, None], np.roll(s.ranges, -by, axis=1), s.ranges)

    recording = driven("rplidar_a1", "loop", 12)
    found, about = checked(lidar(ranges=turned)(recording), 300)
    assert codes(about.moves) == ["mount-moves"]
    assert np.degrees(found.fit.turned.amount) == pytest.approx(-8, abs=1.0)
    stamps = recording.lidar.stamps
    assert found.fit.turned.time == pytest.approx(stamps[0] + 0.4 * np.ptp(stamps), abs=0.1 * np.ptp(stamps))


@pytest.mark.slow
@pytest.mark.parametrize(("curl", "told"), [(-0.2, True), (0.04, False)])
def test_odometry_that_curls_is_said_to(curl: float, told: bool) -> None:
    def curled(poses: np.ndarray) -> np.ndarray:
        steps = se2.between(poses[:-1], poses[1:])
        steps[:, 2] += curl * steps[:, 0]
        return np.asarray(se2.accumulate(np.vstack((poses[:1], steps))))

    calibration, found = found_in(poses(curled)(driven("rplidar_a1")))
    assert codes(found.issues) == ["odometry-turn-scale"] * told
    assert found.moves == ()
    assert calibration.fit.curl[0] == pytest.approx(curl, abs=0.05)


@pytest.mark.slow
def test_a_lidar_that_sees_the_floor_has_no_scale() -> None:
    def tilted(s: LidarStream) -> np.ndarray:
        down = 0.07 * np.cos(s.angles)
        return np.where(down > 1e-3, np.minimum(s.ranges, 0.2 / np.maximum(down, 1e-3)), s.ranges).astype(np.float32)

    recording = cut(driven("rplidar_a1", "loop", 12), Cut(0.0, 75.0))
    calibration, found = checked(lidar(ranges=tilted)(recording), 300)
    assert calibration.fit.values[Parameter.LENGTHS] < 0.1
    assert codes(found.issues) == ["lidar-tilted"]


@pytest.mark.slow
def test_floor_before_a_tilted_lidar_is_no_limit_of_its_ranges() -> None:
    def tilted(s: LidarStream) -> np.ndarray:
        floor = 0.2 / np.maximum(0.0523 * np.cos(s.angles), 1e-3)
        floor = floor * np.random.default_rng(0).normal(1, 0.003, s.ranges.shape)
        return np.where(floor < s.range_max, np.minimum(s.ranges, floor), s.ranges).astype(np.float32)

    found, about = found_in(lidar(ranges=tilted)(driven("rplidar_a1", "loop", 12)), FEW_PAIRS)
    assert codes(about.moves) == ["lidar-tilted"]
    assert found.no_surfaces == pytest.approx(-3.8, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("world", "platform", "sensors"),
    [("office", "lms200", ("lidar", "encoders")), ("loop", "ucsd", ("lidar", "encoders", "imu"))],
)
def test_a_clock_that_drifts_is_known_to_some_milliseconds_over_the_drive(
    world: str, platform: str, sensors: tuple[str, ...]
) -> None:
    settings = [f"platform.noise.{name}.clock.rate_error=0" for name in sensors]
    true = simulate(load_scenario(world, platform=platform, settings=settings), 100).recording
    recording = DRIFTS(true)
    found = calibrate(recording)
    stamps = calibrated(recording, found, "lidar").lidar.stamps
    # of one speed in all turns, slip would pass for a lidar farther ahead
    assert found.fit.values[Parameter.X] == pytest.approx(true.platform.lidar.x, abs=0.01)
    assert np.ptp(stamps - true.lidar.stamps) < 0.007
    assert stamps[0] == pytest.approx(true.lidar.stamps[0], abs=0.02)  # where both clocks are one


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["lms200", "rplidar_a1"])
def test_stamps_that_were_counted_over_lost_scans_are_told(platform: str) -> None:
    first, second = within(driven(platform), 0.0, 30.0), within(driven(platform), 33.0, np.inf)
    ranges = np.concatenate((first.lidar.ranges, second.lidar.ranges))
    stamps = np.linspace(first.lidar.stamps[0], second.lidar.stamps[-1], len(ranges))
    _, found = found_in(lidar(stamps=lambda s: stamps, ranges=lambda s: ranges)(first))
    assert "other-clock" in codes(found.moves)


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["lms200", "rplidar_a1"])
def test_stamps_that_fall_behind_by_seconds_are_no_turns_the_other_way(platform: str) -> None:
    kept = np.flatnonzero(np.random.default_rng(0).random(len(driven(platform, "office").lidar)) > 0.05)
    counted = lidar(stamps=lambda s: s.stamps[: len(kept)], ranges=lambda s: s.ranges[kept])
    _, found = checked(counted(poses_of(driven(platform, "office"))))
    assert codes(found.moves) == ["other-clock"]


@pytest.mark.parametrize("form", [lambda r: r, poses_of], ids=["sensors", "poses"])
@pytest.mark.parametrize("platform", ["lms200", slow("rplidar_a1"), slow("ucsd")])
def test_nothing_is_found_where_nothing_is_wrong(platform: str, form: Fault) -> None:
    calibration, found = found_in(form(driven(platform)))
    assert found.issues == found.moves == ()
    assert not found.decided
    assert calibration.longer.amount == pytest.approx(0, abs=0.04)


CLOCKWISE = lidar(angle_min=lambda s: -s.angle_min, angle_increment=lambda s: -s.angle_increment)


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "platform"), [(REVERSED, "lms200"), (REVERSED, "rplidar_a1"), (CLOCKWISE, "lms200")])
def test_beams_the_other_way_round_are_a_mirror_image_and_a_sweep_shows_whether_order_or_angles_are_wrong(
    fault: Fault, platform: str
) -> None:
    """Of 7 ms as of 180 ms."""
    true, recording = driven(platform), fault(driven(platform))
    calibration, found = found_in(recording)
    assert calibration.mirrored
    assert calibration.reversed == (fault is REVERSED)
    assert codes(found.moves) == ["mirrored"]
    mended = calibrated(recording, calibration, "lidar")
    assert found_in(mended)[1].issues == ()
    assert mended.lidar.angle_increment == true.lidar.angle_increment
    assert (mended.lidar.ranges == true.lidar.ranges)[np.isfinite(true.lidar.ranges)].all()


def gyro(by: float | tuple[float, ...]) -> Fault:
    return lambda r: r.replace(imu=replace(r.imu, angular_velocity=r.imu.angular_velocity * by))


def wheels(by: float) -> Fault:
    return lambda r: r.replace(encoders=replace(r.encoders, stamps=r.encoders.stamps + by))


MIRRORED, SCALED = poses(lambda p: p * (1, -1, -1)), poses(lambda p: p * (1.1, 1.1, 1))
SIDES: dict[str, tuple[Fault, str, str, str]] = {
    "turns": (poses(lambda p: p * (1, 1, -1)), "turns", "odometry-signs", "odometry"),
    "x and y": (poses(lambda p: p[:, [1, 0, 2]]), "y", "odometry-signs", "odometry"),
    "x": (poses(lambda p: p * (-1, 1, 1)), "y", "odometry-signs", "odometry"),
    "none": (poses(lambda p: p * (1, 1, 0)), "path", "odometry-headings", "odometry"),
    "quarter": (poses(lambda p: p + np.array((0, 0, np.pi / 2))), "stated", "odometry-headings", "odometry"),
    "aside": (poses(lambda p: p + np.array((0, 0, np.radians(35)))), "stated", "odometry-headings", "odometry"),
    "z and w": (poses(lambda p: (0, 0, np.pi) + p * (1, 1, -1)), "turns", "odometry-headings", "odometry"),
    "mirrored, gyro": (lambda r: MIRRORED(r).replace(imu=r.imu), "stated", "mirrored", "odometry"),
    "beams": (REVERSED, "stated", "mirrored", "lidar"),
    "gyro": (gyro((1, 1, -1)), "stated", "mirrored", "imu"),
    "axes": (
        lambda r: r.replace(imu=replace(r.imu, angular_velocity=r.imu.angular_velocity[:, [2, 1, 0]])),
        "stated",
        "no-gyro",
        "imu",
    ),
    "late gyro": (lambda r: r.replace(imu=replace(r.imu, stamps=r.imu.stamps + 0.3)), "stated", "clock-offset", "imu"),
    "late wheels": (wheels(1.3), "stated", "clock-offset", "encoders"),
    "early wheels": (wheels(-0.4), "stated", "clock-offset", "encoders"),
    "late": (late(0.3), "stated", "clock-offset", "lidar"),
    "mirrored": (MIRRORED, "stated", "mirrored", ""),
    "scaled": (SCALED, "stated", "range-scale", ""),
    "degrees": (gyro(1 / 57.3), "stated", "odometry-turn-scale", ""),
    "backwards": (mount(yaw=np.pi), "stated", "lidar-mount", ""),
}
"""What is done, the form that the odometry then fits in, the code, and which side is wrong where that is known."""
ALONE = ("mirrored", "scaled", "turns", "late", "backwards")
"""Mended by one side, the other is as it was."""


@pytest.mark.slow
@pytest.mark.parametrize("name", list(SIDES))
def test_which_side_is_wrong_is_known_or_else_nothing_is_corrected(name: str) -> None:
    fault, form, code, side = SIDES[name]
    recording = fault(driven("ucsd"))
    calibration, found = found_in(recording)
    assert calibration.form == form
    assert codes(found.issues) == codes(found.moves) == [code]
    assert found.decided == ({code} if side else set())
    assert ("backwards" in found.issues[0].message) == (name == "backwards")
    assert ("its x has the wrong sign" in found.issues[0].message) == (name == "x")
    assert "may drift" not in found.issues[0].message
    as_known = calibrated(recording, calibration, None)
    if side:
        assert found.issues[0].message.startswith(f"{side}: ")
        assert found_in(as_known)[1].issues == ()
    else:
        assert as_known.lidar.ranges is recording.lidar.ranges
    if name in ALONE:
        mended = calibrated(recording, calibration, "lidar" if name == "backwards" else "odometry")
        assert found_in(mended)[1].issues == ()
        assert mended.lidar.angle_increment == recording.lidar.angle_increment
        assert mended.lidar.ranges is recording.lidar.ranges
        assert mended.platform.lidar.yaw == pytest.approx(0, abs=0.02)


def turned_round(begin: float, end: float, what: str) -> Fault:
    """Beams, odometry or gyro go the other way in a part of the time."""

    def made(true: Recording) -> Recording:
        first, lasts = true.lidar.stamps[0], np.ptp(true.lidar.stamps)

        def there(stamps: np.ndarray) -> np.ndarray:
            return (stamps >= first + begin * lasts) & (stamps < first + end * lasts)

        if what == "lidar":
            return lidar(ranges=lambda s: np.where(there(s.stamps)[:, None], s.ranges[:, ::-1], s.ranges))(true)
        rates = np.where(there(true.imu.stamps)[:, None], -true.imu.angular_velocity, true.imu.angular_velocity)
        return true.replace(imu=replace(true.imu, angular_velocity=rates))

    return made


@pytest.mark.slow
@pytest.mark.parametrize("what", ["lidar", "imu"])
@pytest.mark.parametrize(("begin", "end"), [(0.6, 1.1), (0.3, 0.8)])
def test_what_turns_the_other_way_for_a_time_is_told(begin: float, end: float, what: str) -> None:
    true = driven("ucsd")
    found, about = checked(turned_round(begin, end, what)(true), FEW_PAIRS)
    assert found is None
    (said,) = (issue for issue in about.moves if issue.code == "scans-unfit")
    for word, share in ("from", begin), ("until", end):  # one is not told, if there are no turns beyond
        for time in re.findall(rf"^{what}: .*{word} about (\d+) s", said.message):
            assert float(time) == pytest.approx(true.lidar.stamps[0] + share * np.ptp(true.lidar.stamps), abs=6)
    assert re.search(rf"^{what}: (from|until) about \d+", said.message)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "begins", "words"),
    [
        ("lidar", False, r"until about (\d+) s after .*--end \1.* mounted backwards"),
        ("encoders", True, r"from about (\d+) s on lengths by ranges are \d+\.\d % more"),
        ("encoders", False, r"from about (\d+) s on lengths by ranges are \d+\.\d % less"),
    ],
)
def test_what_changes_in_mid_drive_is_said_of_that_part(what: str, begins: bool, words: str) -> None:
    """The lidar is set back by half a turn, or the counts are halved, from a time on or until then."""
    true = driven("rplidar_a1", "office")
    first, duration = true.lidar.stamps[0], np.ptp(true.lidar.stamps)
    wrong = [(each.stamps > first + 0.6 * duration) == begins for each in (true.lidar, true.encoders)]
    counts, ranges = true.encoders.counts.copy(), true.lidar.ranges.copy()
    if what == "encoders":
        counts[wrong[1]] = np.diff(counts[wrong[1]].cumsum(axis=0) // 2, axis=0, prepend=0)
    else:
        ranges[wrong[0]] = np.roll(ranges[wrong[0]], 180, axis=1)
    changed = lidar(ranges=lambda _: ranges)(true.replace(encoders=replace(true.encoders, counts=counts)))
    _, about = checked(changed, FEW_PAIRS)
    assert not about.decided
    (time,) = (found[1] for issue in about.moves if (found := re.search(words, issue.message)))
    assert float(time) % 1_300_000_000 == pytest.approx(0.6 * duration, abs=duration / 5)
    assert "range-scale" not in codes(about.moves)  # it is of neither part


@pytest.mark.slow
def test_odometry_of_another_drive_fits_in_no_way() -> None:
    recording = poses_of(driven("ucsd"))
    other = poses_of(driven("ucsd", "office", 201)).odometry
    shifted = replace(other, stamps=other.stamps + (recording.odometry.stamps[0] - other.stamps[0]))
    recording = recording.replace(odometry=shifted)
    calibration, found = found_in(recording)
    assert codes(found.issues) == ["odometry-unfit"]
    assert calibrated(recording, calibration, None).odometry is None


def test_odometry_that_stands_until_it_jumps_says_nothing_of_the_lidar() -> None:
    recording = poses_of(driven("ucsd"))
    stamps, poses = recording.odometry.stamps, recording.odometry.poses
    seconds = np.floor(stamps - stamps[0])
    for until, told in ((np.inf, ["not-calibrated"]), (seconds[-1] / 2, [])):
        latest = np.searchsorted(seconds, np.minimum(seconds, until))
        held = np.where((seconds < until)[:, None], poses[latest], poses)
        _, found = checked(recording.replace(odometry=replace(recording.odometry, poses=held)), FEW_PAIRS)
        assert codes(found.issues) == told


def test_stamps_of_whole_seconds_and_clocks_far_apart_are_not_calibrated() -> None:
    recording = poses_of(driven("ucsd"))
    odometry = recording.odometry
    whole = recording.replace(odometry=replace(odometry, stamps=np.floor(odometry.stamps)))
    assert calibrate(lidar(stamps=lambda s: np.floor(s.stamps))(whole)) is None
    assert checked(late(3600)(recording)) == (None, None)  # and SLAM refuses it


@pytest.mark.slow
@pytest.mark.parametrize(("seconds", "at_end"), [(0.18, True), (0.4, False)])
def test_scans_stamped_at_the_end_of_their_sweep_are_put_back(seconds: float, at_end: bool) -> None:
    true = poses_of(driven("rplidar_a1"))
    recording = lidar(stamps=lambda s: s.stamps + seconds)(true)
    found, about = found_in(recording)
    (issue,) = (one for one in about.issues if one.code == "clock-offset")
    assert ("as if stamped at its end" in issue.message) == at_end
    value, low, high = map(float, re.findall(r"stamped (\S+) s \(95 %: (\S+) to (\S+)\) later", issue.message)[0])
    assert 0 < low - 0.005 < value < high + 0.005  # rounded
    mended = calibrated(recording, found, None)
    moved, other = (mended.lidar, mended.odometry) if at_end else (mended.odometry, mended.lidar)
    was, same = (true.lidar, true.odometry) if at_end else (true.odometry, recording.lidar)
    np.testing.assert_allclose(moved.stamps, was.stamps + (0 if at_end else seconds), atol=0.04)
    np.testing.assert_array_equal(other.stamps, same.stamps)


@pytest.mark.slow
@pytest.mark.parametrize(("platform", "times", "noise"), [("lms200", 15, 0.0), ("rplidar_a1", 2, 0.05)])
def test_a_sweep_that_is_stated_too_long_or_short_is_told_and_mended_be_turns_of_odometry_ever_so_poor(
    platform: str, times: float, noise: float
) -> None:
    true = with_odometry(driven(platform)).replace(encoders=None, imu=None)
    increment, wrong = true.platform.lidar.time_increment, np.random.default_rng(0).normal(0, noise, len(true.lidar))
    true = lidar(odometry=lambda s: s.odometry + np.outer(wrong, (0, 0, 1)))(true)
    assert found_in(true)[1].issues == ()
    recording = lidar(time_increment=lambda _: times * increment)(true)
    found, about = found_in(recording)
    assert codes(about.moves) == ["time-increment"]
    beams = recording.lidar.ranges.shape[1]
    mended = calibrated(recording, found, "lidar").lidar.time_increment
    assert mended * beams == pytest.approx(increment * beams, abs=0.03)


@pytest.mark.slow
def test_no_return_that_is_written_as_a_range_is_told() -> None:
    """As any below the limit."""

    def written(stream: LidarStream) -> np.ndarray:
        ranges = np.array(stream.ranges)
        none = np.isposinf(ranges)
        ranges[none] = np.random.default_rng(0).uniform(0.85, 0.999, none.sum()) * stream.range_max
        ranges[ranges >= stream.range_max] = np.inf
        return ranges

    true = driven("turtlebot3", "office")
    found, about = found_in(lidar(ranges=written)(true), FEW_PAIRS)
    assert codes(about.moves) == ["range-max"]
    assert found.no_surfaces == pytest.approx(3.5 * 0.85, abs=0.05)
    assert found_in(true, FEW_PAIRS)[1].issues == ()


@pytest.mark.slow
@pytest.mark.parametrize("increment", [0.0005, 0.0])
def test_a_sweep_that_is_not_stated_is_told_where_there_is_one(increment: float) -> None:
    settings = [f"platform.lidar.time_increment={increment}"]
    true = simulate(load_scenario("office", platform="rplidar_a1", settings=settings), 5).recording
    stated = true.platform.with_(lidar={"time_increment": 0.0})
    found, about = found_in(lidar(time_increment=lambda _: 0.0)(true).replace(platform=stated))
    assert codes(about.moves) == ["time-increment"] * bool(increment)
    assert (found.sweep or 0.0) == pytest.approx(359 * increment, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("fault", [NARROW, mount(x=0.2, y=0.2, yaw=0.2)])
def test_a_recording_that_is_mended_is_right(fault: Fault) -> None:
    true = driven("ucsd")
    recording = fault(true)
    mended = calibrated(recording, calibrate(recording, pairs=FEW_PAIRS), "lidar")
    assert found_in(mended)[1].issues == ()
    assert mended.lidar.angle_increment == pytest.approx(true.lidar.angle_increment, rel=0.005)
    assert mended.platform.lidar.pose == pytest.approx(true.platform.lidar.pose, abs=0.04)


def test_ranges_in_their_file_are_never_held_at_once_and_scaled_when_they_are_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = LONG(driven("lms200"))
    ranges = recording.lidar.ranges
    lazy = ChunkedRanges(lambda first, last: ranges[first:last].copy(), *ranges.shape)
    monkeypatch.setattr(ChunkedRanges, "__array__", None)
    recording = lidar(ranges=lambda _: lazy)(recording)
    mended = calibrated(recording, calibrate(recording, pairs=FEW_PAIRS), "lidar")
    assert isinstance(mended.lidar.ranges, ChunkedRanges)
    shown = np.isfinite(ranges[5])
    assert mended.lidar.ranges[5][shown] == pytest.approx(ranges[5][shown] / 1.1, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("platform", "scale", "told"),
    [("rplidar_a1", 1.0, []), ("rplidar_a1", 0.95, ["lidar-angles"])],
)
def test_half_of_a_fan_along_a_wall(platform: str, scale: float, told: list[str]) -> None:
    """By its scans alone one would be 7 % wider than it is; the odometry must fit far better with it."""
    recording = driven(platform, "loop", 101)
    half = {"ranges": lambda s: np.ascontiguousarray(s.ranges[:, 180:]), "angle_min": lambda s: s.angles[180]}
    scaled = lidar(**half, angle_increment=lambda s: scale * s.angle_increment)(recording)
    assert codes(checked(scaled, FEW_PAIRS)[1].issues) == told


@pytest.mark.slow
def test_angles_that_are_not_certain_do_not_turn_the_mount() -> None:
    """Where a lidar of a short range hardly sees anything, its angles would be 3 % off, and its mount 7 degrees."""
    recording = driven("turtlebot3", "lab", 204)
    calibration, found = checked(within(recording, 20, 52), FEW_PAIRS)
    assert abs(calibration.angle_scale - 1) > 0.012
    assert codes(found.issues) == []


@pytest.mark.slow
def test_an_offset_that_may_be_a_drift_is_said_to_be() -> None:
    """In the first half minute of the loop the robot turns once."""
    recording = driven("ucsd")
    late = lidar(stamps=lambda s: s.stamps + 0.3)(within(recording, 0, 32))
    (issue,) = checked(late, FEW_PAIRS)[1].issues
    assert issue.code == "clock-offset"
    assert "may drift" in issue.message


@pytest.mark.slow
def test_while_a_robot_stands_its_ranges_say_nothing_of_a_change_and_milliseconds_are_no_slow_sweep() -> None:
    short = simulate(load_scenario("office", platform="rplidar_a1").with_(duration=25.0), 3).recording
    assert found_in(short, FEW_PAIRS)[1].issues == ()
    streams = {name: getattr(short, name) for name in ("lidar", "encoders", "imu")}
    slower = {name: replace(each, stamps=1000 * each.stamps) for name, each in streams.items()}
    assert "time-increment" not in codes(checked(short.replace(**slower), FEW_PAIRS)[1].issues)


@pytest.mark.slow
def test_what_is_seen_through_at_one_place_alone_is_no_limit_of_the_lidar(data_folder: Path) -> None:
    log = cut(open_recording(data_folder / "intel" / "intel_raw_part.log.gz"), Cut(end=60.0))
    assert "range-max" not in codes(checked(log, FEW_PAIRS)[1].issues)


def test_a_drive_without_turns_is_said_to_show_nothing() -> None:
    scenario = load_scenario("corridor", platform="lms200", settings=["route.waypoints=[[3.5, 0.0], [16.0, 0.0]]"])
    recording = simulate(scenario, 200).recording
    calibration, found = checked(recording)
    assert calibration is calibrate(recording) is None
    assert codes(found.issues) == codes(found.moves) == ["not-calibrated"]
    keep = slice(0, 60)  # of hardly any drive nothing is said
    assert checked(lidar(stamps=lambda s: s.stamps[keep], ranges=lambda s: s.ranges[keep])(recording)) == (None, None)


@pytest.mark.slow
def test_too_little_is_not_calibrated() -> None:
    recording = driven("ucsd")
    few = lidar(ranges=lambda s: s.ranges[:20], stamps=lambda s: s.stamps[:20])(recording)
    blind = lidar(ranges=lambda s: np.full_like(s.ranges, np.inf))(recording)
    for lacking in (few, blind, recording.replace(encoders=None, imu=None), recording.replace(lidar=None)):
        assert calibrate(lacking) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("platform", "world", "seconds", "factor"),
    [("lms200", "office", 32.0, 0.97), ("urg04lx", "lab", 200.0, 1.03)],
)  # legs of tables fit at a few percent more nearly as well, but the odometry does not
def test_angles_are_found_whatever_the_odometry_says(platform: str, world: str, seconds: float, factor: float) -> None:
    recording = poses_of(driven(platform, world, 201, "as_recorded" if world == "lab" else None))
    angles = {"angle_min": lambda s: s.angle_min * factor, "angle_increment": lambda s: s.angle_increment * factor}
    wrong = lidar(**angles)(within(recording, 0, seconds))
    calibration, found = checked(wrong, 150)
    assert calibration.angle_scale * factor == pytest.approx(1.0, abs=0.006)
    assert "lidar-angles" in {issue.code for issue in found.issues}


MOUNT = np.array((0.15, -0.05, 0.3))


def fitted(*, turns: float = 1.0, noise: float = 0.0, slip: float = 0.0, spin: float = 0.0) -> Fit:
    """Of 1000 steps of a second: the odometry's turns scaled and noisy [rad], wheels that slip aside [s] and spin.

    Args:
        spin: by how much more wheels measure in turns of 0.3 rad and more, less in others; of the length.
    """
    rng = np.random.default_rng(0)
    turn = rng.normal(0, 0.2, 1000)
    length = rng.uniform(0.2, 1.0, 1000)

    def arcs(turn: np.ndarray, aside: float = 0.0) -> np.ndarray:
        left = -aside * length * turn
        cos, sin = np.cos(turn / 2), np.sin(turn / 2)
        return np.stack((cos * length - sin * left, sin * length + cos * left, turn), axis=1)

    lidar = se2.compose(se2.compose(se2.inverse(MOUNT), arcs(turn, slip)), MOUNT)
    measured = arcs(turns * turn + rng.normal(0, noise, 1000))
    measured[:, :2] *= 1 + spin * np.minimum((turn[:, None] / 0.3) ** 2, 1)
    poses = se2.accumulate(measured, np.zeros(3))
    poses = np.vstack((np.zeros(3), poses))
    poses[:, 2] = np.unwrap(poses[:, 2])
    first = np.arange(1000.0)
    pairs = Pairs(first, first + 1, lidar, np.tile(1e-6 * np.eye(3), (1000, 1, 1)))
    return fit(pairs, lambda times: poses[np.rint(times).astype(int)], (0.0, 0.0), shared=True)


@pytest.mark.parametrize("noise", [0.0, 0.15])
@pytest.mark.parametrize("turns", [1.0, 1.1, 0.9])
def test_noise_of_the_odometry_is_no_scale_of_its_turns(turns: float, noise: float) -> None:
    found = fitted(turns=turns, noise=noise)
    assert found.values[Parameter.TURNS] == pytest.approx(turns, abs=1e-4 + 3 * noise / 0.2 / 1000**0.5)
    assert found.values[: Parameter.TURNS] == pytest.approx((*MOUNT, 1), abs=0.002)


def test_wheels_that_spin_in_turns_do_not_shorten_the_ranges() -> None:
    assert fitted(spin=0.04).values[Parameter.LENGTHS] == pytest.approx(1, abs=0.004)


def test_wheels_that_slip_aside_in_turns_do_not_move_the_mount() -> None:
    found = fitted(slip=0.1)
    assert found.values[Parameter.SLIP] == pytest.approx(0.1, rel=0.05)
    assert found.values[: Parameter.LENGTHS] == pytest.approx(MOUNT, abs=0.002)


@pytest.mark.slow
def test_where_turns_do_not_agree_pairs_of_scans_nearer_to_each_other_are_tried(monkeypatch: pytest.MonkeyPatch):
    """In a square room a long turn passes for one that is shorter by a quarter."""
    tried: list[Calibration] = []
    calibrate = calibrating._calibrate

    def watched(*arguments: Any) -> Calibration | None:
        found = calibrate(*arguments)
        assert found is not None
        tried.append(found)
        return found if len(tried) > 1 else replace(found, correlation=0.0)

    monkeypatch.setattr(calibrating, "_calibrate", watched)
    found = calibrating.calibrate(driven("rplidar_a1"), pairs=FEW_PAIRS)
    assert found is tried[1]


@pytest.mark.parametrize("early", [True, False])
def test_the_part_that_is_as_stated_is_found_and_the_rest_is_told(monkeypatch: pytest.MonkeyPatch, early: bool) -> None:
    """Of a drive that changes after 0.6 of its time, or is wrong until then."""
    recording = driven("ucsd")
    first, duration = min(stamps[0] for stamps in recording.stamps().values()), 0.0
    duration = max(stamps[-1] for stamps in recording.stamps().values()) - first
    wrong = Issue("lidar-mount", "lidar: mounted elsewhere")

    def of(part: Recording, _: int) -> tuple[None, Findings]:
        begin, end = ((part.lidar.stamps[k] - first) / duration for k in (0, -1))
        told = (wrong,) if (end > 0.61 if early else begin < 0.59) else ()
        return None, Findings((), told, told, frozenset())

    monkeypatch.setattr(checking, "_checked", of)
    (issue,) = checking._changes(recording, {"odometry-unfit"})
    (time,) = re.findall(r"--start (\d+)" if early else r"--end (\d+)", issue.message)
    assert float(time) == pytest.approx(0.6 * duration, abs=duration / 16 + 1)
    assert issue.message.endswith(": lidar: mounted elsewhere")
    assert checking._changes(recording, {"lidar-mount"}) == ()  # which the whole said
