"""Trajectories scored against one reference, side by side: their errors, and their paths on the reference's."""

from __future__ import annotations

import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from moteslam.eval.metrics.ate import AteResult
from moteslam.eval.metrics.relations import RelationResult
from moteslam.eval.metrics.residuals import ResidualResult
from moteslam.eval.report import style
from moteslam.eval.report.curves import broken

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#0072B2", "#D55E00", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""From the palette of Okabe and Ito, whose green is the truth's; of more trajectories they are used again, dashed."""


def draw_comparison(
    path: str | PathLike[str],
    results: Mapping[str, AteResult | RelationResult | ResidualResult],
    *,
    title: str = "",
) -> None:
    """Errors over time and paths, after alignment; against relations, the share of them below each error.

    Against positions there are no errors of the heading.

    Args:
        path: of the PNG.
        results: by the name of the trajectory, at least one, all of one kind.
        title: over the figure.

    Raises:
        OutputError: it cannot be written.
    """
    shown = dict(zip(_short(list(results)), results.values(), strict=True))
    against = {name: r for name, r in shown.items() if isinstance(r, AteResult)}
    if against:
        _draw_errors_and_paths(path, against, title)
    else:
        _draw_shares(path, {name: r for name, r in shown.items() if isinstance(r, RelationResult)}, title)


def _draw_errors_and_paths(path: str | PathLike[str], results: Mapping[str, AteResult], title: str) -> None:
    start = min(float(result.stamps[0]) for result in results.values())
    with style.saved_figure(path, size=(12.0, 5.5)) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.2, 1.0))
        has_heading = any(result.rotation_errors is not None for result in results.values())
        plan = figure.add_subplot(grid[:, 1])
        distance = figure.add_subplot(grid[0, 0] if has_heading else grid[:, 0])
        angle = figure.add_subplot(grid[1, 0], sharex=distance) if has_heading else None
        for i, (name, ate) in enumerate(results.items()):
            look = _look(i)
            if i == 0:
                plan.plot(*ate.reference[:, :2].T, color=style.TRUTH, lw=4.0, alpha=0.55, label="reference")
            time = ate.stamps - start
            plan.plot(*ate.aligned[:, :2].T, lw=1.1, **look)
            label = f"{name}, ATE RMSE {100 * ate.rmse:.1f} cm" + (", scale fitted" if ate.scale != 1 else "")
            distance.plot(*broken(time, 100 * ate.errors), lw=1.0, label=label, **look)
            if angle is not None and ate.rotation_errors is not None:
                angle.plot(*broken(time, np.rad2deg(ate.rotation_errors)), lw=1.0, **look)
        _curves(distance, "position error [cm]")
        if angle is not None:
            _curves(angle, "heading error [deg]")
        first = next(iter(results.values()))
        style.mark_start(plan, first.reference)
        ends = [(first.reference, style.TRUTH)]
        ends += [(result.aligned, _look(i)["color"]) for i, result in enumerate(results.values())]
        style.mark_ends(plan, *ends)
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
            distance.plot(np.sort(result.errors), share, lw=1.2, label=label, **_look(i))
            angle.plot(np.rad2deg(np.sort(result.rotation_errors)), share, lw=1.2, **_look(i))
        for axes, unit in ((distance, "translation error [m]"), (angle, "rotation error [deg]")):
            axes.set_xlabel(unit)
            axes.set_xscale("log")
            axes.grid(color="0.9", lw=0.6)
        distance.set_ylabel("share of the relations below")
        distance.set_ylim(0, 1)
        style.legend_below(figure, distance, columns=1)
        style.heading(figure, title)


def _curves(axes: Axes, unit: str) -> None:
    axes.set_ylabel(unit)
    axes.set_ylim(bottom=0)
    axes.margins(x=0.01)
    axes.grid(axis="y", color="0.9", lw=0.6)


def _short(names: list[str]) -> list[str]:
    """File names without the folders that they share."""
    if len(names) == 1:
        return [Path(names[0]).name]
    shared = Path(os.path.commonpath([Path(name).absolute().parent for name in names]))
    return [str(Path(name).absolute().relative_to(shared)) for name in names]


def _look(index: int) -> dict[str, Any]:
    """Colour and dashes of the trajectory of this index."""
    return {"color": COLOURS[index % len(COLOURS)], "ls": ("-", "--", ":", "-.")[index // len(COLOURS) % 4]}
