"""What the scans of a recording show of their lidar, to be held beside its data sheet."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from moteslam.robot.fan import field_of_view
from moteslam.robot.interlace import measured
from moteslam.robot.ranges import Ranges, chunks
from moteslam.robot.recording import LidarStream

_SAMPLE = 1_000_000
"""Ranges that the resolution is measured on, of scans spread over the recording."""
_MEDIAN_SAMPLE = 20_000_000
"""Ranges that the median is taken of, likewise: 80 MB."""
_UNIT = 1e-5
"""To which ranges are rounded before they are compared [m]: float32 at 80 m is good for 4e-6."""
_COMMON = 0.2
"""Share of the steps between distinct ranges that have to be alike for a resolution."""
_REST_SCANS = 1000
"""Of one rest, for the range noise."""
_REST_READINGS = 10
"""Of one beam in one rest, for its range noise."""

Spans = list[tuple[float, float]]
"""From when to when [s]."""


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
        median_range: of the endpoints [m]; None without.

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
    nearest: float | None
    farthest: float | None
    resolution: float | None
    noise_at_rest: RangeNoise | None
    no_return: float | None
    invalid: float | None
    blind_scans: int | None
    median_range: float | None


def lidar_report(lidar: LidarStream, rests: Spans, *, read_ranges: bool = True) -> LidarReport:
    """Measure a lidar's figures.

    Args:
        lidar: the scans.
        rests: when the wheels stood still.
        read_ranges: or leave them in their file, and only state what its scans have in common.
    """
    beams = lidar.ranges.shape[1]
    ranges = _ranges(lidar.ranges, lidar.interlace) if read_ranges else _Ranges()
    return LidarReport(
        beams=beams,
        interlace=lidar.interlace,
        angle_min=lidar.angle_min,
        angle_increment=lidar.angle_increment,
        turns="clockwise" if lidar.angle_increment < 0 else "counterclockwise",
        field_of_view=float(np.degrees(field_of_view(beams, lidar.angle_increment))),
        range_min=lidar.range_min,
        range_max=lidar.range_max,
        **asdict(ranges),
        resolution=_resolution(lidar.ranges) if read_ranges else None,
        noise_at_rest=_noise_at_rest(lidar, rests) if read_ranges else None,
        median_range=_median(lidar.ranges) if read_ranges else None,
    )


@dataclass(frozen=True)
class _Ranges:
    """What all ranges together are: fields of `LidarReport`."""

    nearest: float | None = None
    farthest: float | None = None
    no_return: float | None = None
    invalid: float | None = None
    blind_scans: int | None = None


def _ranges(ranges: Ranges, interlace: int) -> _Ranges:
    nearest, farthest, no_return, invalid, blind, beams = np.inf, -np.inf, 0, 0, 0, 0
    for scans in chunks(ranges):
        finite = np.isfinite(scans)
        nearest = min(nearest, float(scans.min(initial=np.inf, where=finite)))
        farthest = max(farthest, float(scans.max(initial=-np.inf, where=finite)))
        no_return += int(np.isinf(scans).sum())
        meant = measured(scans, interlace)
        beams += int(meant.sum())
        invalid += int((np.isnan(scans) & meant).sum())
        blind += int((~finite.any(axis=1)).sum())
    return _Ranges(
        nearest=nearest if nearest < np.inf else None,
        farthest=farthest if farthest > -np.inf else None,
        no_return=no_return / beams,
        invalid=invalid / beams,
        blind_scans=blind,
    )


def _median(ranges: Ranges) -> float | None:
    """Of the endpoints [m], of scans spread over the recording where there are many; None without."""
    sample = ranges[:: max(1, ranges.size // _MEDIAN_SAMPLE)]
    endpoints = sample[np.isfinite(sample)]
    return float(np.median(endpoints)) if len(endpoints) else None


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
