"""Figures of errors, and of the effective number of particles, over time."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.metrics.ate import AteResult
from moteslam.eval.metrics.relations import RelationResult
from moteslam.eval.metrics.residuals import ResidualResult
from moteslam.eval.report import style
from moteslam.eval.report.style import File, curve_axes, line_look
from moteslam.eval.tables import fitting, number

Array = NDArray[np.float64]
Errors = AteResult | None
Line = tuple[str, AteResult, dict[str, Any]]
"""Label, errors and look of a curve."""

RUG = 1.05
"""Where the marks of resampling stand, as a share of the particles."""
FAR_APART, LEAST_SHOWN = 20, 0.01
"""Errors of which one is this many times another are drawn on logarithmic axes, from there on, whatever the unit."""


def draw_error(
    path: File, *, slam: AteResult, final: Errors = None, dead_reckoning: Errors = None, title: str = ""
) -> None:
    """Distance and angle between estimate and truth over time, after alignment, of SLAM (online), of its final path,
    and of dead reckoning; on logarithmic axes where one is ``FAR_APART`` times as far off as another.
    """
    given = (
        ("dead reckoning", dead_reckoning, {"color": style.DEAD_RECKONING}),
        (style.ONLINE, slam, {"color": style.SLAM if final is None else style.ONLINE_COLOUR}),
        (style.FINAL, final, {"color": style.SLAM}),
    )
    lines: list[Line] = [
        (f"{name}, RMSE {_length(errors.rmse)}", errors, look) for name, errors, look in given if errors is not None
    ]
    rmse = [errors.rmse for _, errors, _ in lines]
    with style.saved_figure(path, size=(8.0, 5.0), title=title, columns=(3, 2)) as figure:
        distance, angle = figure.subplots(2, 1, sharex=True)
        _draw_errors(distance, angle, lines, logarithmic=max(rmse) > FAR_APART * min(rmse))


def _length(value: float) -> str:
    unit, factor = fitting("m", [value])
    return f"{number(factor * value)} {unit}"


def _draw_errors(
    distance: style.Axes, angle: style.Axes | None, lines: Sequence[Line], *, logarithmic: bool = False
) -> None:
    start = min(float(errors.stamps[0]) for _, errors, _ in lines)
    unit, factor = fitting("m", [float(errors.errors.max()) for _, errors, _ in lines])
    largest = [factor * max(float(errors.errors.max()) for _, errors, _ in lines), 0.0]
    for label, errors, look in lines:
        time = errors.stamps - start
        style.draw_curve(distance, time, factor * errors.errors, label=label, **look)
        if angle is not None and errors.rotation_errors is not None:
            turns = np.rad2deg(errors.rotation_errors)
            largest[1] = max(largest[1], float(turns.max()))
            style.draw_curve(angle, time, turns, **look)
    named = (distance, f"position error [{unit}]"), (angle, "heading error [deg]")
    for (axes, label), most in zip(named, largest, strict=True):
        if axes is None:
            continue
        curve_axes(axes, label)
        if logarithmic and most > LEAST_SHOWN:
            style.log_axis(axes, LEAST_SHOWN, 1.2 * most)
        else:
            axes.set_ylim(bottom=0)
    (angle or distance).set_xlabel("time [s]")


def draw_effective_particles(
    path: File, stamps: Array, n_eff: Array, resampled: Array, *, particles: Array, title: str = ""
) -> None:
    """The effective number of particles before resampling at updates [n] of the filter with stamps [s], how many
    particles there are where that changes, and where the filter resampled (not 0).
    """
    time, when, most, n = stamps - stamps[0], np.asarray(resampled, bool), int(particles.max()), len(stamps)
    with style.saved_figure(path, size=(10.0, 3.6), title=title) as figure:
        axes = figure.subplots()
        style.draw_curve(axes, time, n_eff, label="effective particles", color=style.SLAM)
        if particles.min() < most:
            axes.plot(time, particles, color="0.5", lw=0.8, drawstyle="steps-post", label="particles")
        above = np.full(when.sum(), most * RUG)  # over the curve, which marks on it would hide
        label = f"resampled ({when.sum()} of {n} updates)"
        axes.plot(time[when], above, "|", color=style.DEAD_RECKONING, ms=7, mew=0.5, label=label)
        axes.set_xlabel("time [s]")
        axes.set_ylim(0, most * (2 * RUG - 1))
        curve_axes(axes, f"particles (of {most})")


def draw_comparison(
    path: File, results: Mapping[str, AteResult | RelationResult | ResidualResult], *, title: str = ""
) -> None:
    """Errors over time and paths, after alignment; against relations, the share of them below each error.

    Of trajectories by name, one at least, all of one kind. Against positions alone there are no errors of the heading.
    """
    shown = dict(zip(_short(list(results)), results.values(), strict=True))
    against = {name: result for name, result in shown.items() if isinstance(result, AteResult)}
    if against:
        _draw_errors_and_paths(path, against, title)
    else:
        _draw_shares(path, {name: r for name, r in shown.items() if isinstance(r, RelationResult)}, title)


def _draw_errors_and_paths(path: File, results: Mapping[str, AteResult], title: str) -> None:
    has_heading = any(ate.rotation_errors is not None for ate in results.values())
    first = next(iter(results.values())).reference
    lines: list[Line] = [
        (f"{name}, ATE RMSE {_length(ate.rmse)}{', scale fitted' if ate.scale != 1 else ''}", ate, line_look(i))
        for i, (name, ate) in enumerate(results.items())
    ]
    with style.saved_figure(path, size=(12.0, 5.5), title=title, columns=(1, 1)) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.2, 1.0))
        distance = figure.add_subplot(grid[0, 0] if has_heading else grid[:, 0])
        plan = figure.add_subplot(grid[:, 1])
        angle = figure.add_subplot(grid[1, 0], sharex=distance) if has_heading else None
        _draw_errors(distance, angle, lines)
        paths = [(ate.aligned, {"lw": 1.1, **look}) for _, ate, look in lines]
        style.draw_paths(plan, (first, {**style.TRUTH_BAND, "label": "reference"}), *paths, start=first)
        style.plan(plan)


def _draw_shares(path: File, results: Mapping[str, RelationResult], title: str) -> None:
    with style.saved_figure(path, size=(10.0, 4.2), title=title, columns=(1, 1)) as figure:
        distance, angle = figure.subplots(1, 2, sharey=True)
        for i, (name, result) in enumerate(results.items()):
            look = {"lw": 1.2, **line_look(i)}
            label = f"{name}, mean {_length(result.translation.mean)} over {result.pairs} relations"
            distance.ecdf(result.errors, label=label, **look)
            angle.ecdf(np.rad2deg(result.rotation_errors), **look)
        far = np.concatenate([one.errors for one in results.values()])
        turned = np.rad2deg(np.concatenate([one.rotation_errors for one in results.values()]))
        for axes, label, values in ((distance, "translation error [m]", far), (angle, "rotation error [deg]", turned)):
            axes.set_xlabel(label)
            axes.grid(color="0.9", lw=0.6)
            if len(above := values[values > 0]):
                style.log_axis(axes, float(np.quantile(above, 0.01)), 1.2 * float(above.max()), "x")
        distance.set_ylabel("share of the relations below")
        distance.set_ylim(0, 1)


def _short(names: list[str]) -> list[str]:
    """File names without the folders that they share."""
    if len(names) == 1:
        return [Path(names[0]).name]
    shared = Path(os.path.commonpath([Path(name).absolute().parent for name in names]))
    return [str(Path(name).absolute().relative_to(shared)) for name in names]
