"""Curves: errors and the effective number of particles over time, and medians of a sweep over what varies."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from math import isfinite, log10
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from moteslam.errors import File, unit_of
from moteslam.eval.metrics.ate import AteResult
from moteslam.eval.metrics.relations import RelationResult
from moteslam.eval.report import style
from moteslam.eval.report.style import curve_axes, line_look
from moteslam.eval.runs import CONFIGURATION, SETTINGS, Shown, better, grouped, headings, key_words, summary_of, varying
from moteslam.eval.statistics import FEWEST
from moteslam.eval.sweep.store import Row
from moteslam.eval.tables import fitting, literal, number
from moteslam.robot.se2 import Array
from moteslam.robot.values import expect_type

Errors = AteResult | None
Look = dict[str, Any]
Line = tuple[str, AteResult, Look]  # Label, to which its RMSE is added, errors and look of a curve

RUG = 1.05  # Where the marks of resampling stand, as a share of the particles
FAR_APART, BELOW = 20, 0.05
"""Errors of which one is this many times another are drawn on logarithmic axes, of each all but this lowest share."""


def draw_error(
    path: File, *, slam: AteResult, final: Errors = None, dead_reckoning: Errors = None, title: str = ""
) -> None:
    """Distance and angle between estimate and truth over time, after alignment, of SLAM (online where the final path is
    given, too), of its final path, and of dead reckoning; on logarithmic axes where one is ``FAR_APART`` times as far
    off as another.
    """
    online, colour = ("SLAM", style.SLAM) if final is None else (style.ONLINE, style.ONLINE_COLOUR)
    given = (
        ("dead_reckoning", "dead reckoning", dead_reckoning, style.DEAD_RECKONING),
        ("slam", online, slam, colour),
        ("final", style.FINAL, final, style.SLAM),
    )
    for field, _, errors, _ in given:
        if errors is not None or field == "slam":
            expect_type(errors, AteResult, field, "absolute_trajectory_error(estimate, truth) makes one")
    known = ((name, errors, colour) for _, name, errors, colour in given if errors is not None)
    lines: list[Line] = [(f"{name}, RMSE", errors, {"color": colour}) for name, errors, colour in known]
    rmse = [errors.rmse for _, errors, _ in lines]
    with style.saved_figure(path, size=(8.0, 5.0), title=title, columns=(3, 2)) as figure:
        distance, angle = figure.subplots(2, 1, sharex=True)
        _draw_errors(distance, angle, lines, logarithmic=max(rmse) > FAR_APART * min(rmse))


def _draw_errors(
    distance: style.Axes, angle: style.Axes | None, lines: Sequence[Line], *, logarithmic: bool = False
) -> None:
    start = min(float(errors.stamps[0]) for _, errors, _ in lines)
    unit, factor = fitting("m", [errors.rmse for _, errors, _ in lines])
    far, turned = [factor * errors.errors for _, errors, _ in lines], []
    for label, errors, look in lines:
        time = errors.stamps - start
        label = f"{label} {number(factor * errors.rmse)} {unit}"
        style.draw_curve(distance, time, factor * errors.errors, label=label, **look)
        if angle is not None and errors.rotation_errors is not None:
            turned.append(np.rad2deg(errors.rotation_errors))
            style.draw_curve(angle, time, turned[-1], **look)
    named = (distance, f"position error [{unit}]"), (angle, "heading error [deg]")
    for (axes, label), values in zip(named, (far, turned), strict=True):
        if axes is None:
            continue
        curve_axes(axes, label)
        above = [some[some > 0] for some in values if (some > 0).any()]
        if logarithmic and above:
            low = min(float(np.quantile(some, BELOW)) for some in above)
            style.log_axis(axes, low, 1.2 * max(float(some.max()) for some in above))
        else:
            axes.set_ylim(bottom=0)
    (angle or distance).set_xlabel("time [s]")


def draw_effective_particles(
    path: File, stamps: Array, n_eff: Array, resampled: Array, *, particles: Array, below: float = 0.0, title: str = ""
) -> None:
    """The effective number of particles before resampling at updates [n] of the filter with stamps [s], how many
    particles there are where that changes, where the filter resampled (not 0), and the share of the particles
    ``below`` which it does.
    """
    time, when, most, n = stamps - stamps[0], np.asarray(resampled, bool), int(particles.max()), len(stamps)
    with style.saved_figure(path, size=(10.0, 3.6), title=title, columns=(3, 2)) as figure:
        axes = figure.subplots()
        style.draw_curve(axes, time, n_eff, label="effective particles", color=style.SLAM)
        if particles.min() < most:
            axes.plot(time, particles, color="0.5", lw=0.8, drawstyle="steps-post", label="particles")
        if 0 < below < 1:  # else never, or at every update
            label = f"resampled below {below:g} of the particles"
            axes.plot(time, below * particles, color="0.3", lw=0.8, ls="--", drawstyle="steps-post", label=label)
        above = np.full(when.sum(), most * RUG)  # over the curve, which marks on it would hide
        label = f"resampled ({when.sum()} of {n} updates)"
        axes.plot(time[when], above, "|", color=style.DEAD_RECKONING, ms=7, mew=0.5, label=label)
        axes.set(xlabel="time [s]", ylim=(0, most * (2 * RUG - 1)))
        curve_axes(axes, f"particles (of {most})")


def draw_comparison(path: File, results: Mapping[str, AteResult | RelationResult], *, title: str = "") -> None:
    """Errors over time and paths, after alignment; against relations, the share of them below each error.

    Of trajectories by name, one at least, all of one kind. Against positions alone there are no errors of the heading.
    """
    shown = dict(zip(_short(list(results)), results.values(), strict=True))
    if against := {name: result for name, result in shown.items() if isinstance(result, AteResult)}:
        _draw_errors_and_paths(path, against, title)
    else:
        _draw_shares(path, {name: r for name, r in shown.items() if isinstance(r, RelationResult)}, title)


def _draw_errors_and_paths(path: File, results: Mapping[str, AteResult], title: str) -> None:
    has_heading = any(ate.rotation_errors is not None for ate in results.values())
    first = next(iter(results.values())).reference
    lines: list[Line] = [
        (f"{name}{', scale fitted' if ate.scale != 1 else ''}, ATE RMSE", ate, line_look(i))
        for i, (name, ate) in enumerate(results.items())
    ]
    with style.saved_figure(path, size=(12.0, 5.5), title=title, columns=(2, 1)) as figure:
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
        unit, factor = fitting("m", [result.translation.mean for result in results.values()])
        for i, (name, result) in enumerate(results.items()):
            look = {"lw": 1.2, **line_look(i)}
            label = f"{name}, mean {number(factor * result.translation.mean)} {unit} over {result.pairs} relations"
            distance.ecdf(factor * result.errors, label=label, **look)
            angle.ecdf(np.rad2deg(result.rotation_errors), **look)
        far = factor * np.concatenate([one.errors for one in results.values()])
        turned = np.rad2deg(np.concatenate([one.rotation_errors for one in results.values()]))
        panels = (distance, f"translation error [{unit}]", far), (angle, "rotation error [deg]", turned)
        for axes, label, values in panels:
            axes.set_xlabel(label)
            axes.grid(color="0.9", lw=0.6)
            if len(above := values[values > 0]):
                style.log_axis(axes, float(np.quantile(above, 0.01)), 1.2 * float(above.max()), "x")
        distance.set(ylabel="share of the relations below", ylim=(0, 1))


def _short(names: list[str]) -> list[str]:
    """What sets files apart: names without endings, of those of one name their folders, else paths as they part."""
    files = [Path(name).absolute() for name in names]
    stems, folders = ([each.stem for each in files], [each.parent.name for each in files])
    for some in (stems, folders) if len({each.name for each in files}) == 1 else (stems,):
        if len(set(some)) == len(names):
            return some
    shared = Path(os.path.commonpath([each.parent for each in files]))
    return [str(each.relative_to(shared)) for each in files]


LOG_Y, LOG_X = 12.0, 5.0
"""Values of which one is this many times another have a logarithmic axis, if all are above 0; so have those below."""
DODGE, MARGIN = 0.012, 0.08
"""Between the same place on two lines, whose intervals lie side by side, and beyond the values, where medians that are
infinite lie; as shares of the axis."""
MARKERS = ("o", "s", "^", "D", "v", "P")


class SweptLine(NamedTuple):
    """The runs of one scenario and configuration, by their values of a column.

    ``where`` (scenario, robot, noise) and ``how`` set the line apart from the others.
    """

    where: str
    how: str
    groups: Mapping[Any, Sequence[Row]]

    @property
    def label(self) -> str:
        """What sets it apart, in words; empty of a single line."""
        return ", ".join(filter(None, (self.where, self.how)))


def lines_over(rows: Iterable[Row], column: str) -> list[SweptLine]:
    """The lines of a chart over a column of ``Row.about``; runs without it are left out."""
    having = [row for row in rows if column in row.about]
    # a configuration has one version
    keys = [key for key in varying([row.about for row in having]) if key not in (column, "version")]
    keys = [key for key in keys if len({str(row.about.get(key, "")) for row in having}) > 1]

    def words(row: Row, settings: bool) -> str:
        named = [key for key in keys if (key in SETTINGS) == settings and row.about.get(key, "") != ""]
        plain = (*SETTINGS, CONFIGURATION)
        return ", ".join(f"{'' if key in plain else f'{key_words(key)} '}{row.about[key]}" for key in named)

    members = grouped(having, lambda row: (words(row, True), words(row, False)))
    return [SweptLine(*apart, grouped(some, lambda row: row.about[column])) for apart, some in members.items()]


def axis_title(key: str, rows: Iterable[Row]) -> str:
    """A column in words, with the unit of its key: ``lidar range max [m]``."""
    from moteslam.robot.platform import Platform
    from moteslam.sim.scenario import Scenario
    from moteslam.slam.config import load_preset, preset_names

    of, *place = key.split(".")
    models: list[Any] = [{"scenario": Scenario, "platform": Platform}[of]] if of in ("scenario", "platform") else []
    if of == "slam":
        models = [type(load_preset(name)) for name in {row.run.preset: 0 for row in rows} if name in preset_names()]
    unit = next((found for model in models if (found := unit_of(model, place))), "")
    return key_words(key) + (f" [{unit.strip()}]" if unit else "")


def draw_sweep(
    path: File, rows: Sequence[Row], metrics: Sequence[str], *, column: str, label: str | None = None
) -> None:
    """Medians over a column of ``Row.about`` with bars for their 95 % bootstrap intervals, or of few runs each of them
    as a point; a panel a metric.

    A colour stands for a scenario, robot and noise, or in one alone for a configuration, as dashes do. A median that is
    infinite, since half of the runs failed, is an open marker beyond the others, a dash stands where there is none.
    Bars end at the edge where they go on to infinity.
    """
    lines, titles = lines_over(rows, column), headings(rows, metrics)
    places = places_of([value for line in lines for value in line.groups])
    wheres, hows = list(dict.fromkeys(line.where for line in lines)), list(dict.fromkeys(line.how for line in lines))
    looks = []
    for first, second in ((wheres.index(line.where), hows.index(line.how)) for line in lines):
        marker = MARKERS[(second if len(hows) > 1 else first) % len(MARKERS)]
        colour = first if len(wheres) > 1 else second
        look = {"color": style.COLOURS[colour % len(style.COLOURS)], "marker": marker}
        looks.append(look | {"ls": style.DASHES[second % len(style.DASHES)]})
    once = [{str(row.about[key]) for row in rows} for key in SETTINGS]  # what the lines do not say
    title = ", ".join(filter(None, (value for values in once if len(values) == 1 for value in values)))
    with style.saved_figure(path, size=(1.0 + 5.2 * len(metrics), 4.6), title=title) as figure:
        panels = figure.subplots(1, len(metrics), squeeze=False)[0]
        for axes, name in zip(panels, metrics, strict=True):
            _draw_medians(axes, lines, looks, titles[name], places)
            axes.set_xlabel(literal(axis_title(column, rows) if label is None else label), parse_math=False)
        if max(len(runs) for line in lines for runs in line.groups.values()) >= FEWEST:
            panels[0].errorbar([], [], yerr=[], color="0.4", ls="", capsize=3.5, label="95 % interval of the median")


def places_of(values: Sequence[Any]) -> dict[Any, float]:
    """Where the values of a column lie on the axis, in their order there.

    Numbers, also those that were written as words, lie where they are; words and truth values side by side.
    """
    once = list(dict.fromkeys(values))
    try:
        numbers = {value: float("nan" if isinstance(value, bool) else value) for value in once}
    except (TypeError, ValueError):
        numbers = {}
    if not numbers or not all(map(isfinite, numbers.values())):
        return {value: float(k) for k, value in enumerate(once)}
    return dict(sorted(numbers.items(), key=lambda item: item[1]))


def far_apart(values: Sequence[float], factor: float = LOG_Y) -> bool:
    """Whether values are all above 0 and one is this many times another."""
    return len(values) > 0 and min(values) > 0 and max(values) >= factor * min(values)


def _draw_medians(
    axes: style.Axes, lines: Sequence[SweptLine], looks: Sequence[Look], shown: Shown, places: dict[Any, float]
) -> None:
    name, title, factor = shown
    summed = [{value: summary_of(rows, name) for value, rows in line.groups.items()} for line in lines]
    alone = [row.known[name] for line in lines for rows in line.groups.values() for row in rows if name in row.known]
    ends = [end for line in summed for one in line.values() for end in (one.median, one.low, one.high)]
    few = all(len(rows) < FEWEST for line in lines for rows in line.groups.values())
    finite = [factor * value for value in (*ends, *(alone if few else ())) if value is not None and isfinite(value)]
    low, high = _limits(finite, logarithmic=far_apart(finite), from_zero=better(name) == "lower")
    first, last = min(places.values()), max(places.values())
    if first == last:
        first, last = first - 0.5, last + 0.5
    words = [*places.values()] == [*range(len(places))]  # a line from one to the next would mean nothing
    if not words and far_apart(list(places.values()), LOG_X):
        axes.set_xscale("log")
    aside = 0.2 * words
    axes.plot([first - aside, last + aside], [high, high], ls="")  # every panel has all places
    for place in [x for at, x in places.items() if all(at not in one or one[at].median is None for one in summed)]:
        axes.text(place, 0.02, "none", transform=axes.get_xaxis_transform(), ha="center", size="small")
    for index, (line, groups) in enumerate(zip(lines, summed, strict=True)):
        having = [(value, x, groups[value]) for value, x in places.items() if value in groups]
        having = [(value, x, one) for value, x, one in having if one.median is not None]
        shift = DODGE * (4 if words else 1) * (index - (len(lines) - 1) / 2)
        x = np.array([x for _, x, _ in having])
        x = x * (last / first) ** shift if axes.get_xscale() == "log" else x + shift * (last - first)
        ranges = [(one.median, one.low, one.high) if one.low is not None else (one.median,) * 3 for *_, one in having]
        ranged = factor * np.array(ranges, np.float64).reshape(-1, 3).T
        y, bottom, top = np.clip(ranged, low, high)
        bars = np.array([one.low is not None for _, _, one in having], np.bool_)
        look = {"lw": 1.4, **looks[index], **({"ls": ""} if words else {})}
        axes.plot(x, y, ms=5.5, label=line.label or "median", **look)
        axes.errorbar(x[bars], y[bars], yerr=((y - bottom)[bars], (top - y)[bars]), capsize=3.5, **look)
        for at, (value, _, _) in zip(x, having, strict=True) if few else ():  # no interval: every run
            each = [factor * row.known[name] for row in line.groups[value] if name in row.known]
            axes.plot([at] * len(each), each, ".", color=looks[index]["color"], ms=4, alpha=0.5)
        failed = ~np.isfinite(ranged[0])
        if failed.any():
            axes.plot(x[failed], y[failed], "o", clip_on=False, mec=looks[index]["color"], mfc="white", ms=9, zorder=5)
            axes.plot([], [], "o", mec="0.4", mfc="white", ms=9, label="half of the runs or more failed")
    if few:
        colour = looks[0]["color"] if len({look["color"] for look in looks}) == 1 else "0.4"
        text = f"every run{'; large: their median' * (len(lines) > 1)}"
        axes.plot([], [], ".", color=colour, alpha=0.5, label=text)
    names = [f"{value:g}" if isinstance(value, float) else str(value) for value in places]
    axes.set_xticks(list(places.values()), names, parse_math=False)
    if far_apart(finite):
        style.log_axis(axes, low, high)
    axes.set_ylim(low, high)
    axes.minorticks_off()
    axes.set_ylabel(title if few else f"median {title}")
    axes.grid(axis="y", color="0.9", lw=0.6)


def _limits(values: Sequence[float], *, logarithmic: bool, from_zero: bool) -> tuple[float, float]:
    """Of the axis: beyond the values by ``MARGIN``; a linear one begins at 0 where that is the best value."""
    if not values:
        return 0.0, 1.0
    low, high = min(values), max(values)
    if logarithmic:
        factor = 10 ** (MARGIN * log10(high / low))
        return low / factor, high * factor
    if from_zero and low >= 0:
        return 0.0, high + MARGIN * (high or 1.0)
    margin = MARGIN * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin
