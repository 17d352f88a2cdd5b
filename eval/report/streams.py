"""A recording at a glance: what its streams cover, how often they read, how they turn, and what the lidar sees."""

from __future__ import annotations

import numpy as np

from moteslam.errors import File
from moteslam.eval.metrics.association import evenly
from moteslam.eval.report import style
from moteslam.eval.report.style import DEAD_RECKONING, SLAM
from moteslam.robot.inspection import GAP, REPORTED_GAP, Inspection
from moteslam.robot.recording import CHUNK, LidarStream, Recording, measured
from moteslam.robot.se2 import Array
from moteslam.robot.sensor_reports import turns, yaw_rate

BINS = 240  # Across the time of a recording
RANGES = 180  # At most this many beams of a scan are drawn


def draw_streams(path: File, recording: Recording, found: Inspection) -> None:
    """Draw what a recording's streams cover, their rates, the yaw rates they measure, and all its ranges, over time."""
    stamps = {name: some for name, some in recording.stamps().items() if len(some)}
    first = min(float(some[0]) for some in stamps.values())
    last = max(float(some[-1]) for some in stamps.values())
    span = max(last - first, 1e-3)
    colours = dict(zip(stamps, style.COLOURS, strict=False))
    rates = turns(recording)
    lidar = recording.lidar if recording.lidar is not None and recording.lidar.ranges.size else None
    heights = [0.35 * len(stamps) + 0.3, 1.4, *([1.6] if rates else []), *([2.0, 1.0] if lidar is not None else [])]
    title = f"{recording.name}: {span:.0f} s from {first:.3f} s on"
    since = {name: some - first for name, some in stamps.items()}
    with style.saved_figure(path, size=(10.0, sum(heights) + 0.5 * len(heights) + 0.6), title=title) as figure:
        panels = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
        panels[0].set_xlim(-0.01 * span, 1.01 * span)
        panels[-1].set_xlabel("time since the first stamp [s]")
        for row, (name, some) in enumerate(since.items()):
            steps = np.diff(some)
            above = steps[steps > 0]
            longest = max(GAP * float(np.median(above)), REPORTED_GAP) if len(above) else np.inf
            gaps = np.flatnonzero(steps > longest)
            begins, ends = np.append(some[0], some[gaps + 1]), np.append(some[gaps], some[-1])
            panels[0].broken_barh(list(zip(begins, ends - begins, strict=True)), (row - 0.3, 0.6), color=colours[name])
            if len(gaps):
                silent = [(float(some[gap]), float(steps[gap])) for gap in gaps]
                panels[0].broken_barh(silent, (row - 0.3, 0.6), color="black")
        panels[0].set_yticks(range(len(since)), list(since))
        panels[0].invert_yaxis()
        panels[0].set_title("what the streams cover; gaps in black", loc="left")
        _draw_rates(panels[1], since, colours, span)
        if rates:
            axes = panels[2]
            late = {clock.name: f"\n{1000 * clock.offset:+.0f} ms to {clock.reference}" for clock in found.clocks}
            times = np.linspace(first, last, 4 * BINS)
            for width, (name, rate) in zip(np.linspace(2.2, 0.8, len(rates)), rates.items(), strict=True):
                label, colour = f"{name}{late.get(name, '')}", colours.get(name, style.COLOURS[-1])
                axes.plot(times - first, yaw_rate(*rate, times), color=colour, lw=width, label=label)
            axes.set_ylabel("yaw rate [rad/s]")
            _legend(axes)
        if lidar is not None:
            _draw_ranges(panels[-2], panels[-1], lidar, first)


def _draw_rates(axes: style.Axes, stamps: dict[str, Array], colours: dict[str, str], span: float) -> None:
    means = [len(some) / span for some in stamps.values()]
    for width, (name, some) in zip(np.linspace(3.0, 1.0, len(stamps)), stamps.items(), strict=True):
        # from its first to its last reading: a bin that is half empty is no change of the rate
        covered = max(float(some[-1] - some[0]), 1e-3)
        bins = int(np.clip(len(some) // 10, 1, BINS))
        counts, edges = np.histogram(some, bins=bins, range=(some[0], some[0] + covered))
        axes.stairs(counts / (covered / bins), edges, baseline=None, color=colours[name], label=name, lw=width)
    if max(means) > 8 * min(means):
        axes.set_yscale("log")
        style.log_axis(axes, *axes.get_ylim())
    else:
        axes.set_ylim(bottom=0)
    axes.set_ylabel("rate [Hz]")
    _legend(axes)


def _draw_ranges(above: style.Axes, below: style.Axes, lidar: LidarStream, first: float) -> None:
    """The ranges of an even choice of scans and beams over time, and the shares of all beams that are no endpoints."""
    times, count = lidar.stamps - first, len(lidar)
    some = evenly(np.arange(count), 2 * BINS)
    sample = np.asarray(lidar.ranges[some])[:, :: max(1, lidar.ranges.shape[1] // RANGES)]
    endpoints = np.isfinite(sample)
    above.plot(np.repeat(times[some, None], sample.shape[1], axis=1)[endpoints], sample[endpoints], ",", color="0.2")
    farthest = 1.05 * float(np.quantile(sample[endpoints], 0.995)) if endpoints.any() else lidar.range_max
    above.set(ylim=(0, farthest), ylabel="range [m]")
    groups = np.arange(count) * min(BINS, count) // count
    beams, without, invalid = (np.zeros(groups[-1] + 1) for _ in range(3))
    for start in range(0, count, CHUNK):
        ranges = lidar.ranges[start : start + CHUNK]
        meant, group = measured(ranges, lidar.interlace), groups[start : start + CHUNK]
        for total, chosen in ((beams, meant), (without, np.isinf(ranges)), (invalid, np.isnan(ranges) & meant)):
            np.add.at(total, group, chosen.sum(axis=1))
    middle = np.bincount(groups, times) / np.bincount(groups)
    for total, colour, name in ((without, SLAM, "no return"), (invalid, DEAD_RECKONING, "invalid")):
        label = f"{name}, {100 * total.sum() / max(beams.sum(), 1):.2g} %"
        below.plot(*style.broken(middle, 100 * total / np.maximum(beams, 1)), color=colour, label=label, lw=1.2)
    below.set(ylabel="beams [%]", ylim=(0, None))
    _legend(below)


def _legend(axes: style.Axes) -> None:
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
