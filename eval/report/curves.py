"""Figures over time: the error of SLAM and of dead reckoning, and the effective number of particles."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.metrics.ate import AteResult
from moteslam.eval.report import style

RUG = 1.05
"""Where the marks of resampling stand, as a share of the particles."""
GAP = 10
"""Median intervals, and at least a second: a curve is broken at a longer gap, in which nothing was measured."""
SINGLE_VALUES = 300
"""A curve of more values is unreadable: their range in windows of time and their running median are drawn instead."""
FAR_APART = 20
"""Errors of which one is this many times another are drawn on logarithmic axes ..."""
LEAST_SHOWN = 0.01
"""... from there on [cm], [deg]."""
WINDOWS, MEDIANS = 240, 25
"""How many of the windows of the range, and of the running median, make a run."""


def draw_error(
    path: str | PathLike[str],
    *,
    slam: AteResult,
    final: AteResult | None = None,
    dead_reckoning: AteResult | None = None,
    title: str = "",
) -> None:
    """Distance and angle between estimate and truth over time, after alignment.

    Of SLAM (online), of its final path, and of dead reckoning; on logarithmic axes where one is ``FAR_APART`` times as
    far off as another.

    Raises:
        OutputError: it cannot be written.
    """
    results: list[tuple[dict[str, Any], str, AteResult]] = [({"color": style.SLAM}, style.ONLINE, slam)]
    if dead_reckoning is not None:
        results.insert(0, ({"color": style.DEAD_RECKONING}, "dead reckoning", dead_reckoning))
    if final is not None:
        results.append(({"color": style.SLAM, "ls": (0, (3, 1.5))}, style.FINAL, final))
    rmse = [result.rmse for _, _, result in results]
    logarithmic = max(rmse) > FAR_APART * min(rmse)
    start = min(float(result.stamps[0]) for _, _, result in results)
    with style.saved_figure(path, size=(8.0, 5.0)) as figure:
        distance, angle = figure.subplots(2, 1, sharex=True)
        for look, name, result in results:
            label = f"{name}, RMSE {100 * result.rmse:.1f} cm"
            time = result.stamps - start
            distance.plot(*broken(time, 100 * result.errors), lw=1.0, label=label, **look)
            if result.rotation_errors is not None:
                angle.plot(*broken(time, np.rad2deg(result.rotation_errors)), lw=1.0, **look)
        for axes, unit in ((distance, "position error [cm]"), (angle, "heading error [deg]")):
            axes.set_ylabel(unit)
            if logarithmic:
                axes.set_yscale("log")
                axes.set_ylim(bottom=LEAST_SHOWN)
            else:
                axes.set_ylim(bottom=0)
            axes.margins(x=0.01)
            axes.grid(axis="y", color="0.9", lw=0.6)
        angle.set_xlabel("time [s]")
        style.legend_below(figure, distance)
        style.heading(figure, title)


def draw_effective_particles(
    path: str | PathLike[str],
    stamps: NDArray[np.float64],
    n_eff: NDArray[np.float64],
    resampled: NDArray[np.float64],
    *,
    particles: NDArray[np.float64],
    title: str = "",
) -> None:
    """The effective number of particles over time, how many there are where that changes, and the resamplings.

    Of more than ``SINGLE_VALUES`` updates, the range in windows of time and a running median are drawn.

    Args:
        path: of the PNG.
        stamps: [n] of the updates of the filter [s].
        n_eff: [n] before resampling, from 1.
        resampled: [n], not 0 where the filter resampled.
        particles: [n] how many there are.
        title: over the figure.

    Raises:
        OutputError: it cannot be written.
    """
    time = stamps - stamps[0]
    when = np.asarray(resampled, bool)
    most = int(particles.max())
    with style.saved_figure(path, size=(10.0, 3.6)) as figure:
        axes = figure.subplots()
        if len(time) <= SINGLE_VALUES:
            axes.plot(*broken(time, n_eff), color=style.SLAM, lw=0.8, label="effective particles")
        else:
            middle, low, high = ranges(time, n_eff)
            label = f"effective particles: range in {style.seconds((time[-1] - time[0]) / WINDOWS)}"
            axes.fill_between(middle, low, high, color=style.PARTICLE, alpha=0.5, lw=0, label=label)
            width = (time[-1] - time[0]) / MEDIANS
            trend = running_median(time, n_eff, middle, width)
            axes.plot(middle, trend, color=style.SLAM, lw=1.4, label=f"running median over {style.seconds(width)}")
        if particles.min() < most:
            axes.plot(time, particles, color="0.5", lw=0.8, drawstyle="steps-post", label="particles")
        above = np.full(when.sum(), most * RUG)  # over the curve, which marks on it would hide
        label = f"resampled ({when.sum()} of {len(time)} updates)"
        axes.plot(time[when], above, "|", color=style.DEAD_RECKONING, ms=7, mew=0.5, label=label)
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"particles (of {most})")
        axes.set_ylim(0, most * (2 * RUG - 1))
        axes.margins(x=0.01)
        axes.grid(axis="y", color="0.9", lw=0.6)
        style.legend_below(figure, axes)
        style.heading(figure, title)


def ranges(
    time: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The middles [w] of equal windows of time, and the least and largest value in each; NaN in empty ones.

    Args:
        time: [n] rising [s].
        values: [n].
    """
    edges = np.linspace(time[0], time[-1], WINDOWS + 1)
    parts = np.split(values, np.searchsorted(time, edges[1:-1]))
    low, high = np.array([(part.min(), part.max()) if len(part) else (np.nan, np.nan) for part in parts]).T
    return (edges[1:] + edges[:-1]) / 2, low, high


def running_median(
    time: NDArray[np.float64], values: NDArray[np.float64], at: NDArray[np.float64], width: float
) -> NDArray[np.float64]:
    """The median of the values [n] within half a width [s] of each of the times ``at`` [w]; NaN where there is none.

    Args:
        time: [n] rising [s].
        values: [n].
        at: [w] the middles of the windows [s].
        width: of a window [s].
    """
    first, last = np.searchsorted(time, at - width / 2), np.searchsorted(time, at + width / 2, side="right")
    return np.array([np.median(values[i:k]) if k > i else np.nan for i, k in zip(first, last, strict=True)])


def broken(time: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A curve [n] over time [n] [s] with a NaN in each of its gaps, where it is not to be drawn."""
    steps = np.diff(time)
    if not len(steps):
        return time, values
    gaps = np.flatnonzero(steps > max(1.0, GAP * float(np.median(steps)))) + 1
    return np.insert(time, gaps, time[gaps]), np.insert(values, gaps, np.nan)
