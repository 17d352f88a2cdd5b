"""What readings show of their sensors: the lidar's figures, and how clocks lie against each other.

Clocks: the yaw rates of two streams are held against each other at shifted times. The shift at which they correlate
most is the offset between the clocks that stamp them, delays of drivers and filters included. Wheels that slip and
scans that are matched badly lower the correlation and do not move its peak.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.platform import field_of_view
from moteslam.robot.recording import (
    LidarStream,
    Ranges,
    Recording,
    chosen,
    chunks,
    measured,
    phases,
)
from moteslam.robot.values import Summarised
from moteslam.robot.wheel_odometry import wheel_path

Array = NDArray[np.float64]

Spans = list[tuple[float, float]]
"""From when to when [s]."""
_SAMPLE = 1_000_000
"""Ranges that the resolution is measured on, of scans spread over the recording."""
_UNIT = 1e-5
"""To which ranges are rounded before they are compared [m]: float32 at 80 m is good for 4e-6."""
_COMMON = 0.2
"""Share of the steps between distinct ranges that have to be alike for a resolution."""
_REST_SCANS = 1000
"""Of one rest, for the range noise."""
_REST_READINGS = 10
"""Of one beam in one rest, for its range noise."""

LONGEST = 1.0
"""Offsets up to this are looked for [s]."""

STEP = 0.01
"""Between the shifts that are tried, and between the times at which yaw rates are compared [s]."""

WINDOW = 0.1
"""A yaw rate is the mean over this time [s]: single counts of an encoder are far apart."""

LEAST_TURN = 0.05
"""Where neither turns, nothing is compared: the least standard deviation of a yaw rate [rad/s]."""

LEAST_CORRELATION = 0.7
"""Below it two yaw rates are not of the same motion, and no offset is reported."""

_DURATION = 600.0
"""At most this much of a recording is compared, from the first turn on [s]."""
_BEAMS, _FEWEST_BEAMS = 180, 20
SCANS = 3000
"""At most this number of scans are matched, from the first on."""
_SHIFT = 0.35
"""The largest turn between two scans that is looked for [rad]."""


@dataclass(frozen=True)
class RangeNoise:
    """How much ranges scatter while the robot stands still.

    Attributes:
        deviation: median over the beams of the standard deviation of a beam's endpoints [m].
        at_range: median range of those beams [m].
        beams: how many there were, a beam counted once a rest.
    """

    deviation: float
    at_range: float
    beams: int


@dataclass(frozen=True)
class LidarReport:
    """The scans.

    Attributes:
        beams: in a scan; of an interlaced lidar, bearings of its grid.
        interlace: a scan measures every so manieth beam.
        angle_min: of the first beam, in the lidar's frame [rad].
        angle_increment: between beams [rad].
        turns: which way the beams go round.
        field_of_view: from the first beam to the last [degrees].
        range_min, range_max: limits of the recording [m].
        nearest, farthest: shortest and longest range of an endpoint [m]; None without endpoints.
        resolution: the usual step between distinct ranges [m]; None where they have no common one.
        noise_at_rest: None without encoders, or where the wheels never rest.
        no_return, invalid: shares (0 to 1) of the beams without return, and of those without a usable reading.
        blind_scans: scans without a single endpoint.

    What is measured of the ranges, from ``nearest`` on, is None where they were not read.
    """

    beams: int
    interlace: int
    angle_min: float
    angle_increment: float
    turns: Literal["clockwise", "counterclockwise"]
    field_of_view: float
    range_min: float
    range_max: float
    nearest: float | None = None
    farthest: float | None = None
    resolution: float | None = None
    noise_at_rest: RangeNoise | None = None
    no_return: float | None = None
    invalid: float | None = None
    blind_scans: int | None = None


def lidar_report(lidar: LidarStream, rests: Spans, *, read_ranges: bool = True) -> LidarReport:
    """Measure a lidar's figures.

    Args:
        lidar: the scans.
        rests: when the wheels stood still.
        read_ranges: or leave them in their file, and only state what its scans have in common.
    """
    return LidarReport(
        beams=lidar.ranges.shape[1],
        interlace=lidar.interlace,
        angle_min=lidar.angle_min,
        angle_increment=lidar.angle_increment,
        turns="clockwise" if lidar.angle_increment < 0 else "counterclockwise",
        field_of_view=float(np.degrees(field_of_view(lidar.ranges.shape[1], lidar.angle_increment))),
        range_min=lidar.range_min,
        range_max=lidar.range_max,
        **(_of_ranges(lidar, rests) if read_ranges else {}),
    )


def _of_ranges(lidar: LidarStream, rests: Spans) -> dict[str, Any]:
    """The fields of `LidarReport` that all ranges together give."""
    nearest, farthest, no_return, invalid, blind, beams = np.inf, -np.inf, 0, 0, 0, 0
    for scans in chunks(lidar.ranges):
        finite = np.isfinite(scans)
        nearest = min(nearest, float(scans.min(initial=np.inf, where=finite)))
        farthest = max(farthest, float(scans.max(initial=-np.inf, where=finite)))
        no_return += int(np.isinf(scans).sum())
        meant = measured(scans, lidar.interlace)
        beams += int(meant.sum())
        invalid += int((np.isnan(scans) & meant).sum())
        blind += int((~finite.any(axis=1)).sum())
    return {
        "nearest": nearest if nearest < np.inf else None,
        "farthest": farthest if farthest > -np.inf else None,
        "no_return": no_return / beams,
        "invalid": invalid / beams,
        "blind_scans": blind,
        "resolution": _resolution(lidar.ranges),
        "noise_at_rest": _noise_at_rest(lidar, rests),
    }


def _resolution(ranges: Ranges) -> float | None:
    """The most frequent step between distinct ranges [m], the smallest of equally frequent ones.

    A single range off the grid changes two steps and not the most frequent one. Ranges that are not rounded have no
    step that is frequent, or, where they are dense, none that is longer than two units of comparison.
    """
    every = max(1, ranges.size // _SAMPLE)
    sample = ranges[::every]
    units = np.unique(np.rint(sample[np.isfinite(sample)].astype(np.float64) / _UNIT))
    steps, counts = np.unique(np.diff(units), return_counts=True)
    if not len(steps):
        return None
    usual = steps[np.argmax(counts)]
    alike = np.abs(steps - usual) <= 1  # a step of 390.6 units is 390 or 391
    if usual <= 2 or counts[alike].sum() < _COMMON * counts.sum():
        return None
    return float(np.average(steps[alike], weights=counts[alike]) * _UNIT)


def _noise_at_rest(lidar: LidarStream, rests: Spans) -> RangeNoise | None:
    deviations, means = [], []
    for start, end in rests:
        first, last = np.searchsorted(lidar.stamps, (start, end), side="left")
        ranges = lidar.ranges[first : min(last, first + _REST_SCANS)].astype(np.float64)
        finite = np.isfinite(ranges)
        ranges = ranges[:, finite.sum(axis=0) >= _REST_READINGS]
        if ranges.size:
            ranges[np.isinf(ranges)] = np.nan
            deviations.append(np.nanstd(ranges, axis=0, ddof=1))
            means.append(np.nanmean(ranges, axis=0))
    if not deviations:
        return None
    spread = np.concatenate(deviations)
    return RangeNoise(float(np.median(spread)), float(np.median(np.concatenate(means))), len(spread))


@dataclass(frozen=True, eq=False, repr=False)
class YawRate(Summarised):
    """The yaw rate that a stream measures: its mean between stamps.

    Attributes:
        stamps: [n] [s].
        headings: [n] unwrapped [rad].
    """

    stamps: Array
    headings: Array

    def at(self, times: Array) -> Array:
        """The mean over `WINDOW` about times [m] [rad/s]; NaN before the first stamp and after the last."""
        later, earlier = (np.interp(times + side, self.stamps, self.headings) for side in (WINDOW / 2, -WINDOW / 2))
        inside = (times >= self.stamps[0]) & (times <= self.stamps[-1])
        return np.where(inside, (later - earlier) / WINDOW, np.nan)


@dataclass(frozen=True)
class ClockReport:
    """How the stamps of a stream lie against those of another.

    Attributes:
        name, reference: of the two streams.
        offset: that the stream's stamps are late by [s].
        correlation: of the two yaw rates at this offset, -1 to 1.
    """

    name: str
    reference: str
    offset: float
    correlation: float


def clock_reports(rates: dict[str, YawRate]) -> tuple[ClockReport, ...]:
    """The offsets of streams, by their ``yaw_rates``, against the first of them, where they measure the same turns."""
    names = list(rates)
    found = (_compared(name, names[0], rates[name], rates[names[0]]) for name in names[1:])
    return tuple(report for report in found if report is not None)


def yaw_rates(recording: Recording, *, scans: bool = True) -> dict[str, YawRate]:
    """The yaw rates that the streams of a recording measure: of ``imu``, ``encoders``, ``odometry`` and ``lidar``.

    Args:
        recording: any.
        scans: match consecutive scans, too; reads ranges.
    """
    rates = {}
    if recording.imu is not None and len(recording.imu) > 1:
        stamps, rate = recording.imu.stamps, recording.imu.angular_velocity[:, 2]
        mean = (rate[1:] + rate[:-1]) / 2
        rates["imu"] = YawRate(stamps, np.concatenate(([0.0], np.cumsum(mean * np.diff(stamps)))))
    if recording.encoders is not None and len(recording.encoders) > 1 and recording.platform.wheels is not None:
        path = wheel_path(recording, turn_of=None)
        rates["encoders"] = YawRate(recording.encoders.stamps, np.unwrap(path[:, 2]))
    if recording.odometry is not None and len(recording.odometry) > 1:
        rates["odometry"] = YawRate(recording.odometry.stamps, np.unwrap(recording.odometry.poses[:, 2]))
    if scans and (lidar := recording.lidar) is not None and len(lidar) > 2 and lidar.ranges.shape[1] >= _FEWEST_BEAMS:
        rates["lidar"] = scan_turns(lidar)
    return rates


def scan_turns(lidar: LidarStream) -> YawRate:
    """The headings that scans show: the turn at which each looks most like the one before, beam by beam.

    A turn about the lidar shifts a scan along its beams; the shift with the least mean difference of ranges is taken,
    to a fraction of a beam. It is a rough measure, and enough for the time at which the robot turns.

    Args:
        lidar: with scans closer than a third of a radian to each other; of others the turns are not to be used.
    """
    stamps = lidar.stamps[:SCANS]
    ranges, begins = _beams_of_scans(np.asarray(chosen(lidar.ranges, np.arange(len(stamps)))), lidar.interlace)
    every = max(1, ranges.shape[1] // _BEAMS)
    ranges = ranges[:, ::every].astype(np.float64)
    ranges = np.where(np.isfinite(ranges), ranges, lidar.range_max)
    step = lidar.angle_increment * lidar.interlace * every
    widest = max(2, min(ranges.shape[1] // 3, int(_SHIFT / abs(step))))
    shifts = np.arange(-widest, widest + 1)
    inner = slice(widest, ranges.shape[1] - widest)
    before = ranges[:-1, inner]
    cost = np.stack(
        [
            np.abs(ranges[1:, widest + shift : ranges.shape[1] - widest + shift] - before).mean(axis=1)
            for shift in shifts
        ]
    )
    best = np.clip(cost.argmin(axis=0), 1, len(shifts) - 2)
    left, middle, right = (np.take_along_axis(cost, best[None] + side, axis=0)[0] for side in (-1, 0, 1))
    bend = left - 2 * middle + right
    part = np.where(bend > 0, 0.5 * (left - right) / np.where(bend > 0, bend, 1), 0.0)
    turns = -(shifts[best] + np.clip(part, -0.5, 0.5)) * step  # what the robot turns left, the scan turns right
    turns -= np.diff(begins) * lidar.angle_increment
    return YawRate(stamps, np.concatenate(([0.0], np.cumsum(turns))))


def _beams_of_scans(ranges: NDArray[np.float32], interlace: int) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """The ranges [n, k] of the beams that scans of a lidar measured, and at which beam of its grid each begins [n]."""
    begins = phases(ranges, interlace)
    columns = begins[:, None] + np.arange(0, ranges.shape[1] - interlace + 1, interlace)
    return np.take_along_axis(ranges, columns, axis=1), begins


def _compared(name: str, reference: str, rate: YawRate, other: YawRate) -> ClockReport | None:
    begin = max(rate.stamps[0], other.stamps[0]) + LONGEST + WINDOW
    end = min(rate.stamps[-1], other.stamps[-1]) - LONGEST - WINDOW
    if end - begin < 2 * LONGEST:
        return None
    times = np.arange(begin, min(end, begin + _DURATION), STEP)
    fixed = other.at(times)
    if fixed.std() < LEAST_TURN or rate.at(times).std() < LEAST_TURN:
        return None
    lags = np.arange(-LONGEST, LONGEST + STEP / 2, STEP)
    correlations = np.array([_correlation(fixed, rate.at(times + lag)) for lag in lags])
    best = int(np.argmax(correlations))
    if correlations[best] < LEAST_CORRELATION:
        return None
    return ClockReport(name, reference, round(float(lags[best]), 3), float(correlations[best]))


def _correlation(one: Array, other: Array) -> float:
    spread = one.std() * other.std()
    return float(((one - one.mean()) * (other - other.mean())).mean() / spread) if spread > 0 else 0.0
