"""What a recording holds, and what is wrong with it: rates, gaps, shares of bad readings, streams that do not meet."""

from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.recording import EncoderStream, Recording
from moteslam.robot.rgbd import FrameCount, camera_frames, has_images
from moteslam.robot.sensor_reports import ClockReport, LidarReport, Spans, clock_reports, lidar_report, odometry_of
from moteslam.robot.values import Issue, counted, expect_type

GAP = 5.0  # median intervals: a longer silence is a gap
REPORTED_GAP = 0.5  # [s]: shorter ones are no problem, sensors that send in bursts have many
LATE = 0.1  # [s]: streams may be early or late by as much; drivers, filters and wheels that slip make up some of it
SAME_MOTION = 0.9  # two yaw rates that correlate less do not show an offset clearly
REST = 1.0  # [s]: wheels that stand still at least so long are at rest

SPEEDS = 0.005, 20.0  # Between these a robot that moves is fast [m/s]: else stamps or lengths are in other units,
MOST_RATE, TURNING = 15.0, 0.05  # and so are headings by which it turns faster [rad/s] in such a share of the seconds,
RANGES = 0.05, 200.0  # and ranges of a planar lidar, half of which are shorter or longer than these [m]
SILENT = 5.0  # A wheel that does not count while others go farther is broken [m]: about one that stands it is a turn
WINDOWS, SAMPLE = 1000, 12  # Speeds are looked at over so many seconds or longer spans, ranges in so many scans


@dataclass(frozen=True)
class StreamReport:
    """The stamps of one stream; figures that take two different stamps are None without them."""

    name: str
    readings: int
    start: float  # first stamp [s]
    end: float  # last stamp [s]
    duration: float  # between them [s]
    mean_rate: float | None  # readings a second over the whole [Hz]
    median_rate: float | None  # by the median of the intervals above 0 [Hz]
    largest_gap: float | None  # longest interval [s]
    largest_gap_at: float | None  # stamp before it [s]
    gaps: int  # intervals longer than 5 times the median
    equal_stamps: int  # readings that share the stamp of the one before


@dataclass(frozen=True)
class WheelReport:
    counts: tuple[int, int, int, int]  # of the FR, FL, RR, RL wheel, whichever way it turned
    distance: float | None  # driven [m]; None without wheels in the platform
    at_rest: float  # that the wheels stood still [s], in rests of at least a second


@dataclass(frozen=True)
class GyroReport:
    """The gyro while the wheels stand still: samples, mean and standard deviation of the yaw rate [rad/s]."""

    samples: int
    mean: float
    deviation: float


@dataclass(frozen=True)
class Inspection:
    """What a recording holds, and what is wrong with it; None for what is not there."""

    name: str
    platform: str
    streams: tuple[StreamReport, ...]  # in the order lidar, encoders, odometry, imu, rgb, disparity
    lidar: LidarReport | None
    wheels: WheelReport | None
    gyro_at_rest: GyroReport | None  # None, too, where the wheels never rest
    odometry_distance: float | None  # length of the odometry's path [m], logged with the scans if it has no stream
    clocks: tuple[ClockReport, ...]  # of wheels, gyro and odometry against each other, by the turns that they measure
    problems: tuple[Issue, ...]  # the warnings of the reader first

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values, fit for JSON."""
        return asdict(self)


def inspect_recording(recording: Recording, *, deep: bool = False) -> Inspection:
    """Summarise a recording's streams and list what is wrong with them.

    Args:
        recording: any.
        deep: read ranges that are still in their file, and every image of a camera; without it such ranges are not
            measured, and images not looked at.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    streams = tuple(_stream(name, stamps) for name, stamps in recording.stamps().items() if len(stamps))
    clocks = clock_reports(recording)
    encoders, found = recording.encoders, odometry_of(recording)
    rests = [] if encoders is None else _rests(encoders)
    lidar = None
    if recording.lidar is not None and recording.lidar.ranges.size:
        lidar = lidar_report(recording.lidar, rests, read_ranges=deep or isinstance(recording.lidar.ranges, np.ndarray))
    none = [Issue("no-lidar", "lidar: none, expected scans to make a map of")] if recording.lidar is None else []
    problems = [*recording.warnings, *none, *_of_stamps(streams, clocks), *other_units(recording)]
    if deep and recording.rgbd is not None and has_images(recording.rgbd):
        count = FrameCount()
        deque(camera_frames(recording.rgbd, count=count), maxlen=0)
        problems += count.issues()
    return Inspection(
        name=recording.name,
        platform=recording.platform.name,
        streams=streams,
        lidar=lidar,
        wheels=None if encoders is None else _wheels(recording, encoders, rests),
        gyro_at_rest=gyro_at_rest(recording),
        odometry_distance=None if found is None else float(np.hypot(*np.diff(found[1][:, :2], axis=0).T).sum()),
        clocks=clocks,
        problems=tuple(problems),
    )


def _stream(name: str, stamps: NDArray[np.float64]) -> StreamReport:
    start, end, steps = float(stamps[0]), float(stamps[-1]), np.diff(stamps)
    above = steps[steps > 0]
    median = float(np.median(above)) if len(above) else None
    longest = int(np.argmax(steps)) if len(steps) else None
    mean_rate = (len(stamps) - 1) / (end - start) if end > start else None
    gap, at = (None, None) if longest is None else (float(steps[longest]), float(stamps[longest]))
    usual, gaps = (None, 0) if median is None else (1 / median, int((steps > GAP * median).sum()))
    equal = int((steps == 0).sum())
    return StreamReport(name, len(stamps), start, end, end - start, mean_rate, usual, gap, at, gaps, equal)


def _rests(encoders: EncoderStream) -> Spans:
    """From when to when [s] the wheels stood still, each at least a second."""
    edges = np.flatnonzero(np.diff((encoders.counts == 0).all(axis=1), prepend=False, append=False))
    spans = ((float(encoders.stamps[a]), float(encoders.stamps[b - 1])) for a, b in edges.reshape(-1, 2))
    return [(start, end) for start, end in spans if end - start >= REST]


def _wheels(recording: Recording, encoders: EncoderStream, rests: Spans) -> WheelReport:
    wheels = recording.platform.wheels
    travelled = np.abs(encoders.counts.mean(axis=1)).sum()
    front_right, front_left, rear_right, rear_left = np.abs(encoders.counts).sum(axis=0).tolist()
    distance = None if wheels is None else float(travelled * wheels.metres_per_count)
    at_rest = sum(end - start for start, end in rests)
    return WheelReport((front_right, front_left, rear_right, rear_left), distance, at_rest)


def gyro_at_rest(recording: Recording) -> GyroReport | None:
    """None where no wheels say when the robot rests, or none measured it."""
    imu, rests = recording.imu, [] if recording.encoders is None else _rests(recording.encoders)
    if imu is None or not rests:
        return None
    inside = np.any([(imu.stamps >= start) & (imu.stamps <= end) for start, end in rests], axis=0)
    rates = imu.angular_velocity[inside, 2]
    return GyroReport(len(rates), float(np.mean(rates)), float(np.std(rates))) if len(rates) else None


def _of_stamps(streams: tuple[StreamReport, ...], clocks: tuple[ClockReport, ...]) -> Iterator[Issue]:
    """Gaps; motion of another time than the scans; turns that come clearly late, of dense streams."""
    for stream in streams:
        if stream.gaps and stream.largest_gap is not None and stream.largest_gap > REPORTED_GAP:
            many, longest = counted(stream.gaps, "gap"), f"{stream.largest_gap:.2f} s after {stream.largest_gap_at:.6f}"
            text = f"{stream.name}: {many} of more than 5 median intervals, the longest {longest}"
            yield Issue("gaps", text, stream.gaps)
    by_name = {stream.name: stream for stream in streams}
    moving = [by_name[name] for name in ("encoders", "odometry", "imu") if name in by_name]
    for scans, one in product([by_name[name] for name in by_name if name == "lidar"], moving):
        if one.start > scans.end or one.end < scans.start:
            late, side = abs(one.start - scans.start), "after" if one.start > scans.end else "before"
            text = f"{one.name}: no stamp within the lidar's time, begins {late:.0f} s {side} it, expected one clock"
            yield Issue("other-clock", text, one.readings)
    for clock in clocks:
        sparse = any((by_name[name].median_rate or 0.0) < 1 / LATE for name in (clock.name, clock.reference))
        if abs(clock.offset) > LATE + 2 * clock.deviation and clock.correlation > SAME_MOTION and not sparse:
            side = "late" if clock.offset > 0 else "early"
            text = f"{clock.name}: turns come {abs(clock.offset):.2f} s {side} by the {clock.reference}'s clock"
            yield Issue("clock-offset", text)


def silent_wheels(recording: Recording) -> str:
    """What is said of wheels that do not count while others go ``SILENT``, as of a cable that is off; else nothing."""
    encoders, wheels = recording.encoders, recording.platform.wheels
    if encoders is None or not len(encoders) or wheels is None:
        return ""
    names, stamps = ("front right", "front left", "rear right", "rear left"), encoders.stamps
    way = np.append(0.0, np.cumsum(np.abs(encoders.counts).max(axis=1) * wheels.metres_per_count))
    dead: dict[tuple[int, int], list[str]] = {}
    for name, counts in zip(names, encoders.counts.T, strict=True):
        at = np.concatenate(([-1], np.flatnonzero(counts), [len(counts)]))
        longest = int((way[at[1:]] - way[at[:-1] + 1]).argmax())
        begin, end = int(at[longest]) + 1, int(at[longest + 1])
        if way[end] - way[begin] > SILENT:
            dead.setdefault((begin, end), []).append(name)
    if not dead:
        return ""
    (begin, end), some = max(dead.items(), key=lambda one: way[one[0][1]] - way[one[0][0]])
    time = "at all" if end - begin == len(stamps) else f"from {stamps[begin]:.2f} to {stamps[end - 1]:.2f} s"
    return f"encoders: {', '.join(some)}: no count {time}, while others count: lengths and turns are wrong"


def other_units(recording: Recording) -> list[Issue]:
    """Figures that no robot and no planar lidar gives, in the units that they are stated in.

    All but ``implausible-speed`` leave nothing to make a map of.
    """
    issues = []
    imu, lidar, encoders = recording.imu, recording.lidar, recording.encoders
    if (found := odometry_of(recording)) is not None:
        speed, rate = speeds(*found)
        code = "odometry-units" if speed is not None and speed > SPEEDS[1] else "implausible-speed"
        if speed is not None and not SPEEDS[0] <= speed <= SPEEDS[1]:
            text = f"moves at {speed:.3g} m/s, expected a robot's speed: are its stamps in s and its lengths in m"
            text += "?" if speed > SPEEDS[1] else ", or its poses increments?"
            issues.append(Issue(code, f"odometry: {text}"))
        elif rate > MOST_RATE:
            text = f"odometry: turns at {rate:.3g} rad/s, expected at most {MOST_RATE:g}: in degrees, or of two robots?"
            issues.append(Issue("odometry-units", text))
    if encoders is not None and len(encoders) and (wheels := recording.platform.wheels) is not None:
        way = np.cumsum(encoders.counts.mean(axis=1) * wheels.metres_per_count)
        if (speed := speeds(encoders.stamps, way[:, None] * (1.0, 0.0, 0.0))[0] or 0.0) > SPEEDS[1]:
            text = f"encoders: move at {speed:.3g} m/s, expected a robot's speed: are counts since the reading before?"
            issues.append(Issue("odometry-units", text))
    if text := silent_wheels(recording):
        issues.append(Issue("implausible-speed", text))
    if imu is not None and len(imu):
        rate = float(np.quantile(np.abs(imu.angular_velocity[:, 2]), 0.99))
        text = f"imu: turns at {rate:.3g} rad/s, expected at most {MOST_RATE:g}: is its rate in rad/s?"
        if rate > MOST_RATE:
            issues.append(Issue("gyro-units", text))
    if lidar is not None and len(lidar):
        some = np.linspace(0, len(lidar) - 1, SAMPLE).astype(np.intp)
        ranges = np.concatenate([lidar.ranges[scan : scan + 1] for scan in some.tolist()])
        ranges = ranges[np.isfinite(ranges)]
        if len(ranges) and not RANGES[0] < (middle := float(np.median(ranges))) < RANGES[1]:
            expected = " to ".join(f"{limit:g}" for limit in RANGES)
            text = f"lidar: the median of its ranges is {middle:.3g} m, expected {expected}: are they in m?"
            issues.append(Issue("range-units", text))
    return issues


def speeds(stamps: NDArray[np.float64], poses: NDArray[np.float64]) -> tuple[float | None, float]:
    """The median speed [m/s] over the seconds in which the robot moves, None if these are fewer than 3: it jumps; the
    yaw rate [rad/s] that it exceeds in ``TURNING`` of all.
    """
    span = float(stamps[-1] - stamps[0])
    if not span > 0:
        return None, 0.0
    steps = np.diff(poses[:, 2], prepend=poses[:1, 2])
    turned = np.cumsum(np.abs(np.arctan2(np.sin(steps), np.cos(steps))))
    at = np.unique(np.searchsorted(stamps, np.linspace(stamps[0], stamps[-1], 2 + int(min(span, WINDOWS)))))
    elapsed, driven = np.diff(stamps[at]), np.hypot(*np.diff(poses[at, :2], axis=0).T)
    moving = (elapsed > 0) & (driven > 0)
    rate = float(np.quantile(np.diff(turned[at])[elapsed > 0] / elapsed[elapsed > 0], 1 - TURNING))
    return float(np.median(driven[moving] / elapsed[moving])) if moving.sum() > 2 else None, rate
