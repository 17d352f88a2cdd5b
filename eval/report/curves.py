"""Figures of errors, and of the effective number of particles, over time."""

from __future__ import annotations

import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.metrics.ate import AteResult
from moteslam.eval.metrics.relations import RelationResult
from moteslam.eval.metrics.residuals import ResidualResult
from moteslam.eval.report import style
from moteslam.eval.report.style import broken, curve_axes, line_look

RUG = 1.05
"""Where the marks of resampling stand, as a share of the particles."""
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
    """
    dashed = {"color": style.SLAM, "ls": (0, (3, 1.5))}
    given: tuple[tuple[dict[str, Any], str, AteResult | None], ...] = (
        ({"color": style.DEAD_RECKONING}, "dead reckoning", dead_reckoning),
        ({"color": style.SLAM}, style.ONLINE, slam),
        (dashed, style.FINAL, final),
    )
    results = [(look, name, result) for look, name, result in given if result is not None]
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
        for axes, label in ((distance, "position error [cm]"), (angle, "heading error [deg]")):
            axes.set_yscale("log" if logarithmic else "linear")
            axes.set_ylim(bottom=LEAST_SHOWN if logarithmic else 0)
            curve_axes(axes, label)
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
            label = f"effective particles: range in {_seconds(time[-1] / WINDOWS)}"
            axes.fill_between(middle, low, high, color=style.PARTICLE, alpha=0.5, lw=0, label=label)
            width = time[-1] / MEDIANS
            trend = running_median(time, n_eff, middle, width)
            axes.plot(middle, trend, color=style.SLAM, lw=1.4, label=f"running median over {_seconds(width)}")
        if particles.min() < most:
            axes.plot(time, particles, color="0.5", lw=0.8, drawstyle="steps-post", label="particles")
        above = np.full(when.sum(), most * RUG)  # over the curve, which marks on it would hide
        label = f"resampled ({when.sum()} of {len(time)} updates)"
        axes.plot(time[when], above, "|", color=style.DEAD_RECKONING, ms=7, mew=0.5, label=label)
        axes.set_xlabel("time [s]")
        axes.set_ylim(0, most * (2 * RUG - 1))
        curve_axes(axes, f"particles (of {most})")
        style.legend_below(figure, axes)
        style.heading(figure, title)


def ranges(
    time: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The middles [w] of equal windows of time, and the least and largest of the values [n] in each; NaN in empty ones.

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
    """The median of the values [n] within half a width [s] of each of the times ``at`` [w]; NaN in an empty window.

    Args:
        time: [n] rising [s].
        values: [n].
        at: [w] the middles of the windows [s].
        width: of a window [s].
    """
    first, last = np.searchsorted(time, at - width / 2), np.searchsorted(time, at + width / 2, side="right")
    return np.array([np.median(values[i:k]) if k > i else np.nan for i, k in zip(first, last, strict=True)])


def draw_comparison(
    path: str | PathLike[str], results: Mapping[str, AteResult | RelationResult | ResidualResult], *, title: str = ""
) -> None:
    """Errors over time and paths, after alignment; against relations, the share of them below each error.

    Against positions alone there are no errors of the heading.

    Args:
        path: of the PNG.
        results: by the name of the trajectory, at least one, all of one kind.
        title: over the figure.
    """
    shown = dict(zip(_short(list(results)), results.values(), strict=True))
    against = {name: result for name, result in shown.items() if isinstance(result, AteResult)}
    if against:
        _draw_errors_and_paths(path, against, title)
    else:
        _draw_shares(path, {name: r for name, r in shown.items() if isinstance(r, RelationResult)}, title)


def _draw_errors_and_paths(path: str | PathLike[str], results: Mapping[str, AteResult], title: str) -> None:
    start = min(float(ate.stamps[0]) for ate in results.values())
    has_heading = any(ate.rotation_errors is not None for ate in results.values())
    first = next(iter(results.values())).reference
    with style.saved_figure(path, size=(12.0, 5.5)) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.2, 1.0))
        plan = figure.add_subplot(grid[:, 1])
        distance = figure.add_subplot(grid[0, 0] if has_heading else grid[:, 0])
        angle = figure.add_subplot(grid[1, 0], sharex=distance) if has_heading else None
        plan.plot(*first[:, :2].T, color=style.TRUTH, lw=4.0, alpha=0.55, label="reference")
        for i, (name, ate) in enumerate(results.items()):
            time, look = ate.stamps - start, line_look(i)
            plan.plot(*ate.aligned[:, :2].T, lw=1.1, **look)
            label = f"{name}, ATE RMSE {100 * ate.rmse:.1f} cm" + (", scale fitted" if ate.scale != 1 else "")
            distance.plot(*broken(time, 100 * ate.errors), lw=1.0, label=label, **look)
            if angle is not None and ate.rotation_errors is not None:
                angle.plot(*broken(time, np.rad2deg(ate.rotation_errors)), lw=1.0, **look)
        for axes, label in ((distance, "position error [cm]"), (angle, "heading error [deg]")):
            if axes is not None:
                axes.set_ylim(bottom=0)
                curve_axes(axes, label)
        style.mark_start(plan, first)
        ends = [(ate.aligned, line_look(i)["color"]) for i, ate in enumerate(results.values())]
        style.mark_ends(plan, (first, style.TRUTH), *ends)
        (angle or distance).set_xlabel("time [s]")
        style.plan(plan)
        style.legend_below(figure, distance, plan, columns=1)
        style.heading(figure, title)


def _draw_shares(path: str | PathLike[str], results: Mapping[str, RelationResult], title: str) -> None:
    with style.saved_figure(path, size=(10.0, 4.2)) as figure:
        distance, angle = figure.subplots(1, 2, sharey=True)
        for i, (name, result) in enumerate(results.items()):
            share = np.arange(1, result.used + 1) / result.used
            label = f"{name}, mean {result.all.translation.mean:.3f} m over {result.used} relations"
            distance.plot(np.sort(result.errors), share, lw=1.2, label=label, **line_look(i))
            angle.plot(np.rad2deg(np.sort(result.rotation_errors)), share, lw=1.2, **line_look(i))
        for axes, unit in ((distance, "translation error [m]"), (angle, "rotation error [deg]")):
            axes.set_xlabel(unit)
            axes.set_xscale("log")
            axes.grid(color="0.9", lw=0.6)
        distance.set_ylabel("share of the relations below")
        distance.set_ylim(0, 1)
        style.legend_below(figure, distance, columns=1)
        style.heading(figure, title)


def _short(names: list[str]) -> list[str]:
    """File names without the folders that they share."""
    if len(names) == 1:
        return [Path(names[0]).name]
    shared = Path(os.path.commonpath([Path(name).absolute().parent for name in names]))
    return [str(Path(name).absolute().relative_to(shared)) for name in names]


def _seconds(time: float) -> str:
    return f"{time:.1f} s" if time < 10 else f"{time:.0f} s"
