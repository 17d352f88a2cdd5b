"""What a recording may be read with: odometry poses in other forms, a clock's step undone, other stamps."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.inspection import SPEEDS, speeds
from moteslam.robot.platform import Platform
from moteslam.robot.recording import ChunkedRanges, LidarStream, Recording
from moteslam.robot.se2 import Array
from moteslam.robot.sensor_reports import clock_reports, odometry_of, turns
from moteslam.slam.calibration.hand_eye import SLIP, Fit, Pairs, Parameter, Path, clock, fit
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import OdometryPath, odometry_path
from moteslam.slam.inputs.synchronise import WrongStamps

AGREES, AGREES_LOGGED = 0.6, 0.35
"""Turns of scans and odometry that correlate less are not of the same motion: with clocks to be found, and without."""
FORMS = ("stated", "turns", "y", "path")
"""How odometry poses are read: as stated, with their headings or their y negated, headings along the path."""
MOVES = 0.05
"""The direction of a path is taken over this distance [m]."""
QUARTER, AHEAD = 0.15, 0.8
"""A mount is a quarter turn off within the first [rad], and off by another angle only by more; a path goes one way as
seen by its headings where this share of it does."""
OUT_OF_STEP, SURELY = 0.5, 0.8
"""Scans that turn as odometry does so long before or after them [s], and correlate by more, are of another clock."""
INCREMENTS = (0.2, 0.2, 0.3)
"""Steps of odometry, which comes often, are at most these [m, m, rad]; a path goes farther."""
SPARSE, MANY, ONE_SURFACE = 0.5, 150, 0.15
"""Scans of which a larger share is no reading are evened if they have so many beams at least: 120 lie 3 degrees apart.
Neighbouring ranges that differ by a smaller share than the last are of one surface."""
SLIP_STATED = 0.01
"""A robot slips as its stated body does to within about this [s]: masses and forces often are estimates."""
_WRONG = {
    ("turns", 0): ("odometry-signs", "odometry: its headings turn the wrong way against its own path"),
    ("y", 0): ("odometry-signs", "odometry: its y has the wrong sign against its own headings"),
    ("path", 0): (
        "odometry-headings",
        "odometry: its headings do not follow the way that it drives, and are of no use: late, or no radians?",
    ),
    ("stated", 1): ("odometry-headings", "odometry: its headings are a quarter turn off the way that it drives"),
    ("turns", 1): (
        "odometry-headings",
        "odometry: its headings turn clockwise, and count from another direction than its own path, as a compass's do, "
        "or as if z and w of a quaternion were exchanged",
    ),
    ("y", 1): ("odometry-signs", "odometry: its x and y are swapped against its own headings"),
    ("y", 2): ("odometry-signs", "odometry: its x has the wrong sign against its own headings"),
}
"""The code and the text of the forms of odometry poses that are not as stated, by the quarters of a turn; headings that
turn clockwise may count from anywhere."""


def about_form(form: str, offset: float) -> tuple[str, str] | None:
    """The code and the text of odometry poses in one of the `FORMS`, with an angle [rad] added to its headings."""
    quarters = abs(offset) / (np.pi / 2)
    if quarters % 1:
        text = f"odometry: its headings are {np.degrees(abs(offset)):.0f} degrees off the way that it drives"
        return "odometry-headings", text
    return _WRONG.get((form, round(quarters) if form == "y" else min(round(quarters), 1)))


def in_form(path: OdometryPath, form: str, offset: float = 0.0) -> OdometryPath:
    """A path read in one of the `FORMS`, with an angle [rad] added to its headings."""
    x, y, heading = path.poses.T
    if form == "turns":
        heading = -heading
    elif form == "y":
        y = -y
    elif form == "path":
        heading = _along(path.poses)
    return OdometryPath(path.stamps, np.stack((x, y, heading + offset), axis=1))


def heading_offset(poses: Array, aside: float, form: str) -> float:
    """By how much headings of a path [n, 3] are off [rad], 0 if the lidar may be: it is aside by an angle.

    It is if by its headings the odometry drives aside all the time, by as much. A quarter turn is taken for a whole
    one. Headings that are wrong in their ``form``, too, may be off by a half turn, as of a quaternion's z and w
    exchanged.
    """
    half = form != "stated" and abs(aside) > np.pi * 3 / 4
    quarter = np.pi if half else float(np.copysign(np.pi / 2, aside))
    steps = np.diff(poses[:, 0] + 1j * poses[:, 1]) * np.exp(-1j * poses[:-1, 2])
    way, total = complex(steps.sum()), float(np.abs(steps).sum())
    angle, one_way = float(np.angle(way)), abs(way) > AHEAD * total
    if one_way and abs(se2.wrap(aside - quarter)) < QUARTER and abs(se2.wrap(angle - quarter)) < np.pi / 4:
        return quarter
    alike = form == "stated" and abs(aside) > QUARTER and abs(se2.wrap(aside - angle)) < QUARTER / 2
    return angle if one_way and alike else 0.0


def _along(poses: Array) -> Array:
    """The direction of a path at its poses [n], unwrapped [rad]."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    _, first = np.unique(np.floor(way / MOVES), return_index=True)
    if len(first) < 3:
        return np.zeros(len(poses))
    step = np.diff(poses[first, :2], axis=0)
    middle = (first[1:] + first[:-1]) / 2
    return np.interp(np.arange(len(poses)), middle, np.unwrap(np.arctan2(step[:, 1], step[:, 0])))


def _clock_step(streams: Sequence[str], stamp: float, seconds: float) -> WrongStamps:
    """After a stamp [s] the clock of some streams is ahead of what it was before by so many seconds."""
    text = f"{streams[0]}: its clock steps by {seconds:+.2f} s after {stamp:.3f} s, where nothing "
    told = "clock-step", f"{text}is recorded and the robot does not drive"
    gap = stamp + seconds / 2  # streams of one clock have their last readings at other stamps
    return WrongStamps(told, lambda whole: with_stamps(whole, streams, lambda at: at - seconds * (at > gap)))


def clock_steps(recording: Recording, least: float) -> Iterator[WrongStamps]:
    """What the longest gap of scans, and that of the odometry, would be as a step of more than ``least`` [s]."""
    for streams in (("lidar",), ("odometry", "encoders", "imu")):
        stream = next((one for name in streams if (one := getattr(recording, name)) is not None), None)
        if stream is None or len(stream) < 2:
            continue
        gaps = np.diff(stream.stamps)
        longest, usual = int(np.argmax(gaps)), float(np.median(gaps))
        if gaps[longest] - usual > least:
            yield _clock_step(streams, float(stream.stamps[longest]), float(gaps[longest]) - usual)


def increments(recording: Recording) -> WrongStamps | None:
    """Of odometry whose poses stay at 0, and drive as a robot once each is added to the ones before."""
    stamps, poses = odometry_of(recording) or (np.zeros(0), np.zeros((0, 3)))
    if not len(poses) or (np.abs(poses).max(axis=0) > INCREMENTS).any():
        return None
    if not SPEEDS[0] < (speeds(stamps, se2.accumulate(poses))[0] or 0.0) < SPEEDS[1]:
        return None
    told = "odometry-increments", "odometry: its poses are increments, each from the one before, not from its beginning"
    return WrongStamps(told, lambda whole: whole.with_poses(lambda _, poses: se2.accumulate(poses)))


def evened(lidar: LidarStream, some: NDArray[np.float32]) -> LidarStream:
    """A lidar whose scans each have other beams, laid on a finer fan, on one of as many as a scan has.

    Ranges between two neighbouring beams of a scan are those of the line between their endpoints, if these are of one
    surface; ``some`` ranges show how many each has.
    """
    share = float(np.isnan(some).mean())
    apart = round(1 / max(1 - share, 1e-3))
    if share <= SPARSE or lidar.ranges.shape[1] < MANY * apart:
        return lidar
    slots = np.arange(lidar.ranges.shape[1])
    at = slots[::apart]

    def between(ranges: NDArray[np.float32]) -> NDArray[np.float32]:
        there = ~np.isnan(ranges)
        left = np.maximum.accumulate(np.where(there, slots, -1), axis=1)[:, at]
        right = np.minimum.accumulate(np.where(there, slots, len(slots))[:, ::-1], axis=1)[:, ::-1][:, at]
        known = (left >= 0) & (right < len(slots)) & (right - left <= 2 * apart)
        a, b = (np.take_along_axis(ranges, side.clip(0, len(slots) - 1), axis=1) for side in (left, right))
        turn, back = (steps * lidar.angle_increment for steps in (at - left, right - at))
        with np.errstate(invalid="ignore", divide="ignore"):
            line = a * b * np.sin(turn + back) / (a * np.sin(turn) + b * np.sin(back))
            known &= np.isfinite(a) & np.isfinite(b) & (np.abs(a - b) < ONE_SURFACE * np.minimum(a, b))
        return np.where(left == right, a, np.where(known, line, np.nan)).astype(np.float32)

    ranges = ChunkedRanges(lambda first, last: between(lidar.ranges[first:last]), len(lidar), len(at))
    increments = {key: apart * getattr(lidar, key) for key in ("angle_increment", "time_increment")}
    return replace(lidar, ranges=ranges, **increments)


def with_stamps(recording: Recording, names: Sequence[str], change: Callable[[Array], Array]) -> Recording:
    """The same with the stamps [n] [s] of some streams changed."""
    streams = {name: getattr(recording, name) for name in names}
    changed = {
        name: replace(stream, stamps=change(stream.stamps)) for name, stream in streams.items() if stream is not None
    }
    return recording.replace(**changed)


def at_times(path: OdometryPath) -> Path:
    """The poses at times, as ``path.at`` gives them, made for many calls."""
    columns = path.poses[:, 0], path.poses[:, 1], np.unwrap(path.poses[:, 2])
    return lambda times: np.stack([np.interp(times, path.stamps, column) for column in columns], axis=-1)


def wrong_way(recording: Recording, pairs: Pairs) -> Literal["", "lidar", "odometry", "gyro"]:
    """Which of scans and odometry turns the wrong way, by a third that turns: the gyro, or wheels beside a gyro."""
    found = turns(recording)
    if len(found) < 2 or "imu" not in found:
        return ""
    other: Literal["odometry", "gyro"] = "gyro" if "encoders" in found else "odometry"
    *_, correlation = clock(pairs, *found["encoders" if other == "gyro" else "imu"], shared=False)
    if abs(correlation) < AGREES:
        return ""
    return "lidar" if correlation < 0 else other


def in_step(path: OdometryPath, pairs: Pairs) -> OdometryPath:
    """The path on the clock of the scans, where these turn as it does throughout, at another time."""
    offset, _, correlation = clock(pairs, path.stamps, np.unwrap(path.poses[:, 2]), shared=False)
    return OdometryPath(path.stamps - offset, path.poses) if correlation > SURELY else path


def out_of_step(recording: Recording, pairs: Pairs) -> bool:
    """Whether pairs of scans turn as the odometry does some time before or after them."""
    found = (clock(pairs, *each, shared=False) for each in turns(recording).values())
    return any(correlation > SURELY and abs(offset) > OUT_OF_STEP for offset, _, correlation in found)


def falls_behind(recording: Recording, pairs: Pairs) -> bool:
    """Whether scans turn as the odometry does ever longer before or after them, in each quarter of the pairs."""
    quarters = np.array_split(np.argsort(pairs.first), 4)
    for each in turns(recording).values():
        found = [clock(Pairs(*(of[some] for of in pairs)), *each, shared=False) for some in quarters]
        more = np.diff([offset for offset, *_ in found])
        alike = all(correlation > AGREES for *_, correlation in found)
        if alike and (np.sign(more) == np.sign(more[0])).all() and abs(more.sum()) > 2 * OUT_OF_STEP:
            return True
    return False


def expected_slip(platform: Platform) -> tuple[float, float]:
    """How far its wheels slip outwards in a turn, over speed and turn, and the deviation of that [s].

    The force that turns the robot is that of the floor against the slip; a stated body says how large it is.
    """
    wheels, body = platform.wheels, platform.body
    if wheels is None or body is None or wheels.sideways_ratio <= 0:
        return SLIP
    contacts = 4 if wheels.wheel_base else 2
    return body.mass / (contacts * body.stiffness * wheels.sideways_ratio), SLIP_STATED


def lag_of_wheels(recording: Recording, pairs: Pairs) -> float:
    """By how much the wheels' stamps are late against those of the gyro [s]: coarsely by the scans of pairs, which are
    compared over more time, then by the gyro's turns. 0 where these are not the same.
    """
    if "encoders" not in (found := turns(recording)):  # a single reading
        return 0.0
    lag, *_ = clock(pairs, *found["encoders"], shared=False)
    near = with_stamps(recording, ("encoders",), lambda stamps: stamps - lag)
    return next((lag + report.offset for report in clock_reports(near) if report.name == "encoders"), 0.0)


def without_lag(recording: Recording, pairs: Pairs, stream: str, lag: float) -> Fit:
    """A fit on one clock once the stamps of a stream, ``imu`` or ``encoders``, are earlier by a lag [s]."""
    path = odometry_path(with_stamps(recording, (stream,), lambda stamps: stamps - lag), SyncConfig())
    assert path is not None
    found = fit(pairs, at_times(path), (0.0, 0.0), shared=True, slip=expected_slip(recording.platform))
    found.values[Parameter.OFFSET] = lag
    return found
