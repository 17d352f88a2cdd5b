"""Figures over time: the error of SLAM and of dead reckoning, and the effective number of particles."""

from __future__ import annotations

from os import PathLike

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.metrics.ate import AteResult
from moteslam.eval.report import style

RUG = 1.05
"""Where the marks of resampling stand, as a share of the particles."""
GAP = 10
"""Median intervals, and at least a second: a curve does not go on across a longer one; nothing was measured there."""


def draw_error(
    path: str | PathLike[str], *, slam: AteResult, dead_reckoning: AteResult | None = None, title: str = ""
) -> None:
    """Distance and angle between estimate (of SLAM, online) and truth over time, after alignment.

    Raises:
        OutputError: it cannot be written.
    """
    results = [(style.SLAM, style.ONLINE, slam)]
    if dead_reckoning is not None:
        results.insert(0, (style.DEAD_RECKONING, "dead reckoning", dead_reckoning))
    start = min(float(result.stamps[0]) for _, _, result in results)
    with style.saved_figure(path, size=(8.0, 5.0)) as figure:
        distance, angle = figure.subplots(2, 1, sharex=True)
        for colour, name, result in results:
            label = f"{name}, RMSE {100 * result.rmse:.1f} cm"
            time = result.stamps - start
            distance.plot(*broken(time, 100 * result.errors), color=colour, lw=1.0, label=label)
            angle.plot(*broken(time, np.rad2deg(result.rotation_errors)), color=colour, lw=1.0)
        for axes, unit in ((distance, "position error [cm]"), (angle, "heading error [deg]")):
            axes.set_ylabel(unit)
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
    """The effective number of particles at every scan, how many there are where that changes, and the resamplings.

    Args:
        path: of the PNG.
        stamps: [n] of the scans [s].
        n_eff: [n], from 1.
        resampled: [n], not 0 where it did.
        particles: [n] how many there are.
        title: over the figure.

    Raises:
        OutputError: it cannot be written.
    """
    time = stamps - stamps[0]
    when = np.asarray(resampled, bool)
    most = int(particles.max())
    with style.saved_figure(path, size=(8.0, 3.2)) as figure:
        axes = figure.subplots()
        axes.plot(*broken(time, n_eff), color=style.SLAM, lw=0.8, label="effective particles")
        if particles.min() < most:
            axes.plot(time, particles, color="0.5", lw=0.8, drawstyle="steps-post", label="particles")
        above = np.full(when.sum(), most * RUG)  # over the curve, which marks on it would hide
        axes.plot(time[when], above, "|", color=style.DEAD_RECKONING, ms=7, mew=0.7, label=f"resampled ({when.sum()})")
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"particles (of {most})")
        axes.set_ylim(0, most * (2 * RUG - 1))
        axes.margins(x=0.01)
        axes.grid(axis="y", color="0.9", lw=0.6)
        style.legend_below(figure, axes)
        style.heading(figure, title)


def broken(time: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A curve [n] over time [n] [s] with a NaN in each of its gaps, where it is not to be drawn."""
    steps = np.diff(time)
    if not len(steps):
        return time, values
    gaps = np.flatnonzero(steps > max(1.0, GAP * float(np.median(steps)))) + 1
    return np.insert(time, gaps, time[gaps]), np.insert(values, gaps, np.nan)
