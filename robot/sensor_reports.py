"""What readings show of their sensors: the lidar's figures, and how the clocks of motion lie against each other.

Clocks: the yaw rates of two streams are held against each other at shifted times. The shift at which they correlate
most is the offset between the clocks that stamp them, delays of drivers and filters included; wheels that slip lower
the correlation and do not move its peak. Scans are held against odometry by the calibration.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.recording import LidarStream, Ranges, Recording, chunks, measured
from moteslam.robot.wheel_odometry import gyro_turn, wheel_path

Array = NDArray[np.float64]
Spans = list[tuple[float, float]]  # From when to when [s]

_SAMPLE = 1_000_000  # Ranges that the resolution is measured on, of scans spread over the recording
_UNIT = 1e-5  # To which ranges are rounded before they are compared [m]: float32 at 80 m is good for 4e-6
_COMMON = 0.2  # Share of the steps between distinct ranges that have to be alike for a resolution
_REST_SCANS, _REST_READINGS = 1000, 10  # For the range noise: most scans of a rest, least readings of a beam in it

LEAST_CORRELATION = 0.7  # Below it two yaw rates are not of the same motion, and no offset is reported
LONGEST, STEP = 1.0, 0.01  # Offsets up to the first are looked for, in steps [s]
WINDOW = 0.1  # A yaw rate is the mean over this time [s]: single counts of an encoder are far apart
LEAST_TURN = 0.05  # Where neither turns, nothing is compared: the least standard deviation of a yaw rate [rad/s]
_DURATION = 600.0  # At most this much of a recording is compared [s]
_EVERY = 0.03  # Yaw rates are compared at times this far apart [s]: in no step with the readings
_NO_DRIFT = np.zeros(1)


@dataclass(frozen=True)
class RangeNoise:
    """How much ranges scatter while the robot stands still."""

    deviation: float  # median over the beams of the standard deviation of a beam's endpoints [m]
    at_range: float  # median range of those beams [m]
    beams: int  # how many there were, a beam counted once a rest


@dataclass(frozen=True)
class LidarReport:
    """The scans. What is measured of the ranges, from ``nearest`` on, is None if they were not read."""

    beams: int  # in a scan; of an interlaced lidar, bearings of its grid
    interlace: int  # k if a scan measures every k-th beam
    angle_min: float  # of the first beam, in the lidar's frame [rad]
    angle_increment: float  # between beams [rad]
    turns: Literal["clockwise", "counterclockwise"]
    field_of_view: float  # from the first beam to the last [degrees]
    range_min: float  # limits of the recording [m]
    range_max: float
    nearest: float | None = None  # shortest and longest range of an endpoint [m]
    farthest: float | None = None
    resolution: float | None = None  # usual step between distinct ranges [m]; None without a common one
    noise_at_rest: RangeNoise | None = None  # None without encoders, or where the wheels never rest
    no_return: float | None = None  # share (0 to 1) of the beams without return
    invalid: float | None = None  # share of the beams without a usable reading
    blind_scans: int | None = None  # without a single endpoint


@dataclass(frozen=True)
class ClockReport:
    """By how much the stamps of a stream are late against those of another, and the standard deviation of that [s]."""

    name: str
    reference: str
    offset: float
    correlation: float  # of their yaw rates
    deviation: float  # wheels slip for about a second at a time


def lidar_report(lidar: LidarStream, rests: Spans, *, read_ranges: bool = True) -> LidarReport:
    """A lidar's figures: what its scans have in common, and, unless ranges are left in their file, what these show.

    ``rests`` is when the wheels stood still.
    """
    report = LidarReport(
        beams=lidar.ranges.shape[1],
        interlace=lidar.interlace,
        angle_min=lidar.angle_min,
        angle_increment=lidar.angle_increment,
        turns="clockwise" if lidar.angle_increment < 0 else "counterclockwise",
        field_of_view=float(np.degrees((lidar.ranges.shape[1] - 1) * abs(lidar.angle_increment))),
        range_min=lidar.range_min,
        range_max=lidar.range_max,
    )
    if not read_ranges:
        return report
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
    return replace(
        report,
        nearest=nearest if nearest < np.inf else None,
        farthest=farthest if farthest > -np.inf else None,
        no_return=no_return / beams,
        invalid=invalid / beams,
        blind_scans=blind,
        resolution=_resolution(lidar.ranges),
        noise_at_rest=_noise_at_rest(lidar, rests),
    )


def _resolution(ranges: Ranges) -> float | None:
    """The most frequent step between distinct ranges [m], the smallest of equally frequent ones.

    A single range off the grid changes two steps and not the most frequent one. Ranges that are not rounded have no
    step that is frequent, or, where they are dense, none that is longer than two units of comparison.
    """
    sample = ranges[:: max(1, ranges.size // _SAMPLE)]
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


def odometry_of(recording: Recording) -> tuple[Array, Array] | None:
    """The stamps [n] and poses [n, 3] of the odometry, of those logged with scans where it has none."""
    if recording.odometry is not None and len(recording.odometry):
        return recording.odometry.stamps, recording.odometry.poses
    if recording.lidar is not None and recording.lidar.odometry is not None:
        return recording.lidar.stamps, recording.lidar.odometry
    return None


def turns(recording: Recording) -> dict[str, tuple[Array, Array]]:
    """The stamps [n] [s] and unwrapped headings [n] [rad] that ``imu``, ``encoders`` and ``odometry`` measure."""
    imu, encoders, odometry = recording.imu, recording.encoders, odometry_of(recording)
    found = {}
    if imu is not None and len(imu) > 1:
        found["imu"] = imu.stamps, np.cumsum(gyro_turn(imu.stamps, imu))
    if encoders is not None and len(encoders) > 1 and recording.platform.wheels is not None:
        found["encoders"] = encoders.stamps, np.unwrap(wheel_path(recording, gyro=False)[:, 2])
    if odometry is not None and len(odometry[0]) > 1:
        found["odometry"] = odometry[0], np.unwrap(odometry[1][:, 2])
    return found


def yaw_rate(stamps: Array, headings: Array, times: Array) -> Array:
    """The mean over `WINDOW` about times [m] [rad/s], by ``turns``; NaN before the first stamp and after the last."""
    later, earlier = (np.interp(times + side, stamps, headings) for side in (WINDOW / 2, -WINDOW / 2))
    inside = (times >= stamps[0]) & (times <= stamps[-1])
    return np.where(inside, (later - earlier) / WINDOW, np.nan)


def clock_reports(recording: Recording) -> tuple[ClockReport, ...]:
    """The offsets of the streams that turn against the first of them, where they measure the same turns."""
    found = turns(recording)
    return tuple(filter(None, (_compared(name, next(iter(found)), found) for name in list(found)[1:])))


def _compared(name: str, reference: str, found: dict[str, tuple[Array, Array]]) -> ClockReport | None:
    rates = found[name], found[reference]
    begin = max(stamps[0] for stamps, _ in rates) + LONGEST + WINDOW
    end = min(stamps[-1] for stamps, _ in rates) - LONGEST - WINDOW
    if end - begin < 2 * LONGEST:
        return None
    times = np.arange(begin, min(end, begin + _DURATION), _EVERY)
    turned, expected = (WINDOW * yaw_rate(*rate, times) for rate in rates)
    if min(turned.std(), expected.std()) < WINDOW * LEAST_TURN:
        return None
    lags = np.arange(-LONGEST, LONGEST + STEP / 2, STEP)
    lag, _, correlation = agreement(times - WINDOW / 2, times + WINDOW / 2, expected, *found[name], lags)
    about = np.sqrt((1 - correlation**2) / (end - begin)) * expected.std() / np.gradient(expected, _EVERY).std()
    report = ClockReport(name, reference, round(lag, 3), correlation, float(about))
    return report if correlation >= LEAST_CORRELATION else None


def agreement(
    first: Array,
    last: Array,
    turns: Array,
    stamps: Array,
    headings: Array,
    lags: Array,
    drifts: Array = _NO_DRIFT,
    *,
    lag_costs: float = 0.0,
) -> tuple[float, float, float]:
    """Lag [s] and drift [s/s] of a clock at which its turns agree best with those of another, and their correlation.

    Args:
        first, last, turns: [k] when each turn of the other began and ended [s], and how large it was [rad].
        stamps, headings: [n] of the clock [s], and what turns there, unwrapped [rad].
        lags, drifts: to be tried; a drift counts from the middle of the turns.
        lag_costs: the correlation that a lag of a second has to gain, so that of equals the smaller counts.
    """
    limit = 3 * np.median(np.abs(turns)) + 0.05
    expected = np.clip(turns, -limit, limit)
    expected = expected - expected.mean()
    middle = float(first.min() + np.ptp(first) / 2)
    best, found = -np.inf, (0.0, 0.0, 0.0)
    for drift in drifts.tolist():
        shift = drift * (first - middle) + lags[:, None]
        began, ended = (np.interp(times + shift, stamps, headings) for times in (first, last))
        turned = np.clip(ended - began, -limit, limit)
        turned = turned - turned.mean(axis=1, keepdims=True)
        scale = np.sqrt((expected**2).sum() * (turned**2).sum(axis=1))
        correlation = (expected * turned).sum(axis=1) / np.maximum(scale, 1e-9)
        score = np.abs(correlation) - lag_costs * np.abs(lags) - abs(drift)
        k = int(score.argmax())
        if score[k] > best:
            best, found = float(score[k]), (float(lags[k]), drift, float(correlation[k]))
    return found
