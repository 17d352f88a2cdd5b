"""A recording at a glance: what its streams cover, how often they read, how they turn, and what the lidar sees."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.report.style import DEAD_RECKONING, SLAM, saved_figure
from moteslam.robot.inspection import GAP, REPORTED_GAP, Inspection
from moteslam.robot.recording import CHUNK, measured
from moteslam.robot.sensor_reports import SCANS, yaw_rates

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from moteslam.robot.recording import LidarStream, Recording

Array = NDArray[np.float64]

STREAM_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""The palette of Okabe and Ito."""
BINS = 240
"""Across the time of a recording."""
RANGE_BINS = 80


def draw_streams(path: str | PathLike[str], recording: Recording, found: Inspection) -> None:
    """Draw what a recording's streams cover, their rates, the yaw rates they measure, and all its ranges, over time."""
    stamps = {name: some for name, some in recording.stamps().items() if len(some)}
    first = min(float(some[0]) for some in stamps.values())
    last = max(float(some[-1]) for some in stamps.values())
    span = max(last - first, 1e-3)
    colours = dict(zip(stamps, STREAM_COLOURS, strict=False))
    rates = yaw_rates(recording)
    lidar = recording.lidar if recording.lidar is not None and recording.lidar.ranges.size else None
    heights = [0.35 * len(stamps) + 0.3, 1.4, *([1.6] if rates else []), *([2.0, 1.0] if lidar is not None else [])]
    title = f"{recording.name}: {span:.0f} s from {first:.3f} s on"
    since = {name: some - first for name, some in stamps.items()}
    with saved_figure(path, size=(10.0, sum(heights) + 0.5 * len(heights) + 0.6), title=title) as figure:
        panels = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
        panels[0].set_xlim(-0.01 * span, 1.01 * span)
        panels[-1].set_xlabel("time since the first stamp [s]")
        _draw_cover(panels[0], since, colours)
        _draw_rates(panels[1], since, colours, span)
        if rates:
            axes = panels[2]
            late = {clock.name: f"\n{1000 * clock.offset:+.0f} ms to {clock.reference}" for clock in found.clocks}
            times = np.linspace(first, last, 4 * BINS)
            for width, (name, rate) in zip(np.linspace(2.2, 0.8, len(rates)), rates.items(), strict=True):
                part = f"\nfirst {SCANS} scans" if name == "lidar" and lidar is not None and len(lidar) > SCANS else ""
                label = f"{name}{late.get(name, '')}{part}"
                axes.plot(times - first, rate.at(times), color=colours[name], lw=width, label=label)
            axes.set_ylabel("yaw rate [rad/s]")
            _legend(axes)
        if lidar is not None:
            _draw_ranges(panels[-2], panels[-1], lidar, first, span)


def _draw_cover(axes: Axes, stamps: dict[str, Array], colours: dict[str, str]) -> None:
    """A bar for what each stream covers, in black where it has a gap."""
    for row, (name, some) in enumerate(stamps.items()):
        steps = np.diff(some)
        gaps = _gaps(some)
        begins, ends = np.append(some[0], some[gaps + 1]), np.append(some[gaps], some[-1])
        axes.broken_barh(list(zip(begins, ends - begins, strict=True)), (row - 0.3, 0.6), color=colours[name])
        if len(gaps):
            silent = [(float(some[gap]), float(steps[gap])) for gap in gaps]
            axes.broken_barh(silent, (row - 0.3, 0.6), color="black")
    axes.set_yticks(range(len(stamps)), list(stamps))
    axes.invert_yaxis()
    axes.set_title("what the streams cover; gaps in black", loc="left")


def _gaps(stamps: Array) -> NDArray[np.intp]:
    """After which readings there is a gap, as `inspect` reports it."""
    steps = np.diff(stamps)
    above = steps[steps > 0]
    longest = max(GAP * float(np.median(above)), REPORTED_GAP) if len(above) else np.inf
    return np.flatnonzero(steps > longest)


def _draw_rates(axes: Axes, stamps: dict[str, Array], colours: dict[str, str], span: float) -> None:
    means = [len(some) / span for some in stamps.values()]
    for width, (name, some) in zip(np.linspace(3.0, 1.0, len(stamps)), stamps.items(), strict=True):
        # from its first to its last reading: a bin that is half empty is no change of the rate
        covered = max(float(some[-1] - some[0]), 1e-3)
        bins = int(np.clip(len(some) // 10, 1, BINS))
        counts, edges = np.histogram(some, bins=bins, range=(some[0], some[0] + covered))
        axes.stairs(counts / (covered / bins), edges, baseline=None, color=colours[name], label=name, lw=width)
    if max(means) > 8 * min(means):
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0)
    axes.set_ylabel("readings a second [Hz]")
    _legend(axes)


def _draw_ranges(above: Axes, below: Axes, lidar: LidarStream, first: float, span: float) -> None:
    """How many ranges of each length there are over time, and the shares of those that are no endpoints."""
    bins = min(BINS, len(lidar))
    edges = np.linspace(0.0, span, bins + 1)
    limit = _longest(lidar)
    counts, beams = np.zeros((RANGE_BINS, bins)), np.zeros(bins)
    without, invalid = np.zeros(bins), np.zeros(bins)
    for start in range(0, len(lidar), CHUNK):
        ranges = lidar.ranges[start : start + CHUNK]
        times = np.repeat(lidar.stamps[start : start + CHUNK, None] - first, ranges.shape[1], axis=1)
        meant, good = measured(ranges, lidar.interlace), np.isfinite(ranges)
        counts += np.histogram2d(ranges[good], times[good], (RANGE_BINS, bins), ((0, limit), (0, span)))[0]
        for total, chosen in ((beams, meant), (without, np.isinf(ranges)), (invalid, np.isnan(ranges) & meant)):
            total += np.histogram(times[chosen], edges)[0]
    share = np.divide(counts, beams, out=np.zeros_like(counts), where=beams > 0)
    shown = _shown_in(edges, lidar.stamps - first, beams > 0)
    share = np.where(shown >= 0, share[:, shown], 0.0)
    above.pcolormesh(edges, np.linspace(0, limit, RANGE_BINS + 1), np.sqrt(share), cmap="Greys", rasterized=True)
    above.set_ylabel("range [m]")
    above.set_title("ranges; dark: many beams of that range", loc="left")
    for total, colour, label in ((without, SLAM, "no return"), (invalid, DEAD_RECKONING, "invalid")):
        percent = np.divide(100 * total, beams, out=np.full(bins, np.nan), where=beams > 0)
        percent = np.where(shown >= 0, percent[shown], np.nan)
        label = f"{label}, {100 * total.sum() / beams.sum():.2g} %"
        below.plot((edges[1:] + edges[:-1]) / 2, percent, color=colour, label=label, lw=1.2)
    below.set_ylabel("beams [%]")
    below.set_ylim(bottom=0)
    _legend(below)


def _shown_in(edges: Array, stamps: Array, has_scans: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Of which column each column of a picture shows the scans: its own, else the last one's before it; -1 in a gap.

    Args:
        edges: [n + 1] of the columns [s].
        stamps: [k] of the scans [s].
        has_scans: [n] whether a scan falls into a column.
    """
    columns = np.arange(len(has_scans))
    shown = np.maximum.accumulate(np.where(has_scans, columns, -1))
    before = np.searchsorted(stamps, edges[:-1], side="right") - 1  # the last scan before a column without one
    in_gap = np.isin(before, _gaps(stamps)) | (before < 0) | (before >= len(stamps) - 1)
    return np.where(has_scans | ~in_gap, shown, -1)


def _longest(lidar: LidarStream) -> float:
    """Up to which range to draw [m]: nearly all endpoints of scans spread over the recording."""
    sample = lidar.ranges[:: max(1, len(lidar) // 500)]
    endpoints = sample[np.isfinite(sample)]
    return float(np.quantile(endpoints, 0.995)) * 1.05 if len(endpoints) else lidar.range_max


def _legend(axes: Axes) -> None:
    """Beside the panel, over no data."""
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
