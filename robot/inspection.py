"""What a recording holds, and what is wrong with it: rates, gaps, shares of bad readings, streams that do not meet."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.recording import EncoderStream, ImuStream, Recording, RgbdStream
from moteslam.robot.rgbd import LARGEST_GAP, FrameCount, has_images, pairs, read_frame
from moteslam.robot.sensor_reports import ClockReport, LidarReport, Spans, clock_reports, lidar_report, yaw_rates
from moteslam.robot.values import Issue, counted, expect_type

GAP = 5.0
"""A silence of more than this many median intervals is a gap."""

REPORTED_GAP = 0.5
"""Shorter gaps are no problem [s]: sensors that send in bursts have many."""

ENDS_EARLY = 0.1
"""Streams may begin later or end earlier than the scans by this much [s]."""

LATE = 0.1
"""Streams may be early or late by this much [s]; drivers, filters and wheels that slip make up some of it."""

SAME_MOTION = 0.9
"""Two yaw rates that correlate less do not show an offset clearly."""

REST = 1.0
"""Wheels that stand still at least this long are at rest [s]."""

SPEEDS = 0.005, 20.0
"""Between these a robot that moves is fast [m/s]: a slower or faster one has stamps or lengths in other units,"""
MOST_RATE = 15.0
"""and so has one that turns faster than this [rad/s],"""
MOST_RANGE = 200.0
"""and a planar lidar, half of whose ranges are longer than this [m]."""
WINDOWS, SAMPLE = 1000, 12
"""Speeds are looked at over this many seconds or longer spans, ranges in this many scans."""


@dataclass(frozen=True)
class StreamReport:
    """The stamps of one stream.

    Attributes:
        name: of the stream.
        readings: how many.
        start, end: first and last stamp [s]; ``duration`` between them.
        mean_rate, median_rate: readings a second over the whole, and by the median of the intervals above 0; None
            where there is no such interval.
        largest_gap: longest interval [s], and ``largest_gap_at`` the stamp before it; None for one reading.
        gaps: intervals longer than 5 times the median.
        equal_stamps: readings that share the stamp of the one before.
    """

    name: str
    readings: int
    start: float
    end: float
    duration: float
    mean_rate: float | None
    median_rate: float | None
    largest_gap: float | None
    largest_gap_at: float | None
    gaps: int
    equal_stamps: int


@dataclass(frozen=True)
class WheelReport:
    """The encoders.

    Attributes:
        counts: of the FR, FL, RR, RL wheel, whichever way it turned.
        distance: driven [m]; None without wheels in the platform.
        at_rest: that the wheels stood still [s], in rests of at least a second.
    """

    counts: tuple[int, int, int, int]
    distance: float | None
    at_rest: float


@dataclass(frozen=True)
class GyroReport:
    """The gyro while the wheels stand still: samples, mean and standard deviation of the yaw rate [rad/s]."""

    samples: int
    mean: float
    deviation: float


@dataclass(frozen=True)
class Inspection:
    """What a recording holds, and what is wrong with it.

    Attributes:
        name, platform: names of the recording and of its robot.
        streams: in the order lidar, encoders, odometry, imu, rgb, disparity; those that are there.
        lidar: None where there is none, or no scan of it.
        wheels: None without encoders.
        gyro_at_rest: None without IMU or encoders, or where the wheels never rest.
        odometry_distance: length of the odometry's path [m], of the poses logged with the scans if it has no stream
            of its own; None without either.
        clocks: how the stamps of the streams lie against each other, by the turns that they measure.
        problems: what is wrong; the warnings of the reader first.
    """

    name: str
    platform: str
    streams: tuple[StreamReport, ...]
    lidar: LidarReport | None
    wheels: WheelReport | None
    gyro_at_rest: GyroReport | None
    odometry_distance: float | None
    clocks: tuple[ClockReport, ...]
    problems: tuple[Issue, ...]

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
    streams = stream_reports(recording)
    rests = [] if recording.encoders is None else _rests(recording.encoders)
    read_ranges = deep or isinstance(getattr(recording.lidar, "ranges", None), np.ndarray)
    lidar = None
    if recording.lidar is not None and recording.lidar.ranges.size:
        lidar = lidar_report(recording.lidar, rests, read_ranges=read_ranges)
    clocks = clock_reports(yaw_rates(recording, scans=read_ranges))
    problems = [*recording.warnings, *_missing(recording), *_gaps(streams), *_meetings(streams)]
    problems += _late(streams, clocks)
    problems += other_units(recording)
    if lidar is not None and lidar.blind_scans:
        text = f"lidar: {counted(lidar.blind_scans, 'scan')} without a single endpoint"
        problems.append(Issue("blind-scans", text, lidar.blind_scans))
    if deep and recording.rgbd is not None and has_images(recording.rgbd):
        problems += _images(recording.rgbd)
    return Inspection(
        name=recording.name,
        platform=recording.platform.name,
        streams=streams,
        lidar=lidar,
        wheels=_wheels(recording, rests),
        gyro_at_rest=None if recording.imu is None else _gyro(recording.imu, rests),
        odometry_distance=_odometry_distance(recording),
        clocks=clocks,
        problems=tuple(problems),
    )


def stream_reports(recording: Recording) -> tuple[StreamReport, ...]:
    """The stamps of each stream that has a reading, in the order of `Inspection.streams`."""
    return tuple(_stream(name, stamps) for name, stamps in recording.stamps().items() if len(stamps))


def _stream(name: str, stamps: NDArray[np.float64]) -> StreamReport:
    start, end = float(stamps[0]), float(stamps[-1])
    steps = np.diff(stamps)
    above = steps[steps > 0]
    median = float(np.median(above)) if len(above) else None
    longest = int(np.argmax(steps)) if len(steps) else None
    return StreamReport(
        name=name,
        readings=len(stamps),
        start=start,
        end=end,
        duration=end - start,
        mean_rate=(len(stamps) - 1) / (end - start) if end > start else None,
        median_rate=None if median is None else 1 / median,
        largest_gap=None if longest is None else float(steps[longest]),
        largest_gap_at=None if longest is None else float(stamps[longest]),
        gaps=0 if median is None else int((steps > GAP * median).sum()),
        equal_stamps=int((steps == 0).sum()),
    )


def _rests(encoders: EncoderStream) -> Spans:
    """From when to when [s] the wheels stood still, each at least a second."""
    still = np.concatenate(([False], (encoders.counts == 0).all(axis=1), [False]))
    edges = np.flatnonzero(np.diff(still))
    spans = ((float(encoders.stamps[a]), float(encoders.stamps[b - 1])) for a, b in edges.reshape(-1, 2))
    return [(start, end) for start, end in spans if end - start >= REST]


def _wheels(recording: Recording, rests: Spans) -> WheelReport | None:
    if recording.encoders is None:
        return None
    wheels = recording.platform.wheels
    travelled = np.abs(recording.encoders.counts.mean(axis=1)).sum()
    front_right, front_left, rear_right, rear_left = np.abs(recording.encoders.counts).sum(axis=0).tolist()
    return WheelReport(
        counts=(front_right, front_left, rear_right, rear_left),
        distance=None if wheels is None else float(travelled * wheels.metres_per_count),
        at_rest=sum(end - start for start, end in rests),
    )


def _gyro(imu: ImuStream, rests: Spans) -> GyroReport | None:
    inside = np.zeros(len(imu), bool)
    for start, end in rests:
        inside |= (imu.stamps >= start) & (imu.stamps <= end)
    rates = imu.angular_velocity[inside, 2]
    if not len(rates):
        return None
    return GyroReport(len(rates), float(rates.mean()), float(rates.std()))


def _odometry(recording: Recording) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """The stamps [n] and poses [n, 3] of the odometry, of those logged with scans where it has no stream."""
    if recording.odometry is not None:
        return recording.odometry.stamps, recording.odometry.poses
    if recording.lidar is not None and recording.lidar.odometry is not None:
        return recording.lidar.stamps, recording.lidar.odometry
    return None


def _odometry_distance(recording: Recording) -> float | None:
    found = _odometry(recording)
    return None if found is None else float(np.hypot(*np.diff(found[1][:, :2], axis=0).T).sum())


def other_units(recording: Recording) -> list[Issue]:
    """Figures that no robot and no planar lidar gives, in the units that they are stated in.

    All but ``implausible-speed`` leave nothing to make a map of.
    """
    issues = []
    if (found := _odometry(recording)) is not None and (speed := _speed(*found)) is not None:
        text = (
            f"odometry: moves at {speed:.3g} m/s, expected a robot's speed: are its stamps in s and its lengths in m?"
        )
        if speed > SPEEDS[1]:
            issues.append(Issue("odometry-units", text))
        elif speed < SPEEDS[0]:
            issues.append(Issue("implausible-speed", text))
    if recording.imu is not None and len(recording.imu):
        rate = float(np.quantile(np.abs(recording.imu.angular_velocity[:, 2]), 0.99))
        if rate > MOST_RATE:
            text = f"imu: turns at {rate:.3g} rad/s, expected at most {MOST_RATE:g}: is its rate in rad/s?"
            issues.append(Issue("gyro-units", text))
    if recording.lidar is not None and len(recording.lidar):
        some = np.linspace(0, len(recording.lidar) - 1, SAMPLE).astype(np.intp)
        ranges = np.concatenate([recording.lidar.ranges[scan : scan + 1] for scan in some.tolist()])
        ranges = ranges[np.isfinite(ranges)]
        if len(ranges) and (middle := float(np.median(ranges))) > MOST_RANGE:
            text = f"lidar: half of its ranges are beyond {middle:.3g} m, expected below {MOST_RANGE:g}: are they in m?"
            issues.append(Issue("range-units", text))
    return issues


def _speed(stamps: NDArray[np.float64], poses: NDArray[np.float64]) -> float | None:
    """The median speed [m/s] over the seconds in which the robot moves; None if it never does."""
    span = float(stamps[-1] - stamps[0])
    if not span > 0:
        return None
    at = np.unique(np.searchsorted(stamps, np.linspace(stamps[0], stamps[-1], 2 + int(min(span, WINDOWS)))))
    elapsed, driven = np.diff(stamps[at]), np.hypot(*np.diff(poses[at, :2], axis=0).T)
    moving = (elapsed > 0) & (driven > 0)
    return float(np.median(driven[moving] / elapsed[moving])) if moving.any() else None


def _images(stream: RgbdStream) -> tuple[Issue, ...]:
    """What is missing or broken among the images; each pair of them is decoded."""
    count = FrameCount()
    disparity, rgb, _ = pairs(stream, largest_gap=LARGEST_GAP)
    for one, other in zip(disparity.tolist(), rgb.tolist(), strict=True):
        count.note(read_frame(stream, one, other))
    return count.issues()


def _late(streams: tuple[StreamReport, ...], clocks: tuple[ClockReport, ...]) -> list[Issue]:
    """Streams whose turns come clearly earlier or later than another's; sparse ones are left out."""
    rates = {stream.name: stream.median_rate or 0.0 for stream in streams}
    problems = []
    for clock in clocks:
        sparse = min(rates[clock.name], rates[clock.reference]) < 1 / LATE
        if abs(clock.offset) > LATE and clock.correlation > SAME_MOTION and not sparse:
            side = "late" if clock.offset > 0 else "early"
            text = f"{clock.name}: turns come {abs(clock.offset):.2f} s {side} by the {clock.reference}'s clock"
            problems.append(Issue("clock-offset", text))
    return problems


def _missing(recording: Recording) -> list[Issue]:
    problems = []
    if recording.lidar is None:
        problems.append(Issue("no-lidar", "lidar: none, expected scans to make a map of"))
    logged = recording.lidar is not None and recording.lidar.odometry is not None
    if recording.encoders is None and recording.odometry is None and not logged:
        problems.append(Issue("no-odometry", "odometry: none, expected wheel encoders or odometry poses"))
    if recording.encoders is not None and recording.imu is None:
        problems.append(Issue("no-imu", "imu: none; turns come from the wheels alone"))
    return problems


def _gaps(streams: tuple[StreamReport, ...]) -> list[Issue]:
    problems = []
    for stream in streams:
        if stream.gaps and stream.largest_gap is not None and stream.largest_gap > REPORTED_GAP:
            text = (
                f"{stream.name}: {counted(stream.gaps, 'gap')} of more than 5 median intervals, "
                f"the longest {stream.largest_gap:.2f} s after {stream.largest_gap_at:.6f}"
            )
            problems.append(Issue("gaps", text, stream.gaps))
        if stream.equal_stamps:
            text = f"{stream.name}: {stream.equal_stamps} readings share the stamp of the one before"
            problems.append(Issue("equal-stamps", text, stream.equal_stamps))
    return problems


def _meetings(streams: tuple[StreamReport, ...]) -> list[Issue]:
    """Streams of motion that do not cover the scans."""
    by_name = {stream.name: stream for stream in streams}
    scans = by_name.get("lidar")
    if scans is None:
        return []
    problems = []
    for stream in (by_name[name] for name in ("encoders", "odometry", "imu") if name in by_name):
        if stream.start > scans.end or stream.end < scans.start:
            text = f"{stream.name}: no stamp within the time of the lidar, expected one clock"
            problems.append(Issue("other-clock", text, stream.readings))
            continue
        if scans.end - stream.end > ENDS_EARLY:
            text = f"{stream.name}: last reading {scans.end - stream.end:.2f} s before the last scan"
            problems.append(Issue("ends-early", text))
        if stream.start - scans.start > ENDS_EARLY:
            text = f"{stream.name}: first reading {stream.start - scans.start:.2f} s after the first scan"
            problems.append(Issue("begins-late", text))
    return problems
