"""Curves of a sweep: the median of a metric over what varies, a line for each scenario and configuration."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, log10
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from moteslam.eval.metrics.registry import metric
from moteslam.eval.report import style
from moteslam.eval.sweep.tables import GroupSummary, better, varying
from moteslam.eval.tables import literal

FAR_APART, FAR_APART_BELOW = 12.0, 5.0
"""Values of which one is this many times another have a logarithmic axis, if all are above 0; so have those below."""
DODGE = 0.012
"""Between the same place on two lines, as a share of the axis: so that intervals lie beside each other."""
MARKERS = ("o", "s", "^", "D", "v", "P")
SETTINGS = ("scenario", "platform", "noise")
"""Columns that say where it was run: they choose the colour, all others dashes and marker."""
MARGIN = 0.08
"""Beyond the values, as a share of the axis; medians that are infinite lie there."""


class Line(NamedTuple):
    """The groups of one scenario and configuration at their places on the axis; its label sets it apart from others."""

    label: str
    look: dict[str, Any]
    places: list[float]
    groups: list[GroupSummary]


def draw_sweep(
    path: str | PathLike[str],
    groups: Sequence[GroupSummary],
    metrics: Sequence[str],
    *,
    column: str,
    label: str | None = None,
) -> None:
    """Medians over a column of ``GroupSummary.about`` with bars for their 95 % bootstrap intervals, a panel a metric.

    A median that is infinite, since half of the runs failed, is an open marker beyond the others. Bars end at the edge
    where they go on to infinity. Groups without the column are left out.
    """
    shown = [group for group in groups if column in group.about]
    places = places_of([group.about[column] for group in shown])
    lines = lines_of(shown, column, places)
    with style.saved_figure(path, size=(1.0 + 5.2 * len(metrics), 4.6)) as figure:
        panels = figure.subplots(1, len(metrics), squeeze=False)[0]
        for axes, name in zip(panels, metrics, strict=True):
            _draw(axes, lines, name, places)
            axes.set_xlabel(literal(column if label is None else label), parse_math=False)
        panels[0].errorbar([], [], yerr=[], color="0.4", ls="", capsize=3.5, label="95 % interval of the median")


def places_of(values: Sequence[Any]) -> dict[Any, float]:
    """Where the values of a column lie on the axis, in their order there.

    Numbers, also those that were written as words, lie where they are; words and truth values side by side.
    """
    once = list(dict.fromkeys(values))
    try:
        numbers = {value: float(value) for value in once}
    except (TypeError, ValueError):
        numbers = {}
    if not numbers or any(isinstance(value, bool) or not isfinite(numbers[value]) for value in once):
        return {value: float(k) for k, value in enumerate(once)}
    return dict(sorted(numbers.items(), key=lambda item: item[1]))


def lines_of(groups: Sequence[GroupSummary], column: str, places: dict[Any, float]) -> list[Line]:
    """The lines of groups: a colour for each scenario, robot and noise, dashes for each configuration."""

    def text(group: GroupSummary, key: str) -> str:
        return str(group.about.get(key, ""))

    keys = varying([group.about for group in groups])
    others = [key for key in keys if key != column and len({text(group, key) for group in groups}) > 1]
    members: dict[tuple[tuple[str, ...], tuple[str, ...]], list[GroupSummary]] = {}
    for group in groups:
        where = tuple(text(group, key) for key in others if key in SETTINGS)
        words = {key: text(group, key) for key in others if key not in SETTINGS}
        how = tuple(word if key == "configuration" or not word else f"{key}={word}" for key, word in words.items())
        members.setdefault((where, how), []).append(group)
    wheres = list(dict.fromkeys(where for where, _ in members))
    hows = list(dict.fromkeys(how for _, how in members))
    lines = []
    for (where, how), each in members.items():
        first, second = wheres.index(where), hows.index(how)
        look = {
            "color": style.COLOURS[first % len(style.COLOURS)],
            "ls": style.DASHES[second % len(style.DASHES)],
            "marker": MARKERS[(second if len(hows) > 1 else first) % len(MARKERS)],
        }
        ordered = sorted(each, key=lambda group: places[group.about[column]])
        label = ", ".join(filter(None, (*where, *how)))
        lines.append(Line(label, look, [places[group.about[column]] for group in ordered], ordered))
    return lines


def far_apart(values: Sequence[float], factor: float = FAR_APART) -> bool:
    """Whether values are all above 0 and one is this many times another."""
    return len(values) > 0 and min(values) > 0 and max(values) >= factor * min(values)


def _draw(axes: style.Axes, lines: Sequence[Line], name: str, places: dict[Any, float]) -> None:
    summaries = [group.values[name] for line in lines for group in line.groups]
    ends = [value for one in summaries for value in (one.median, one.low, one.high)]
    finite = [value for value in ends if value is not None and isfinite(value)]
    unit, factor = axis_unit(metric(name).unit, finite)
    finite = [factor * value for value in finite]
    low, high = _limits(finite, logarithmic=far_apart(finite), from_zero=better(name) == "lower")
    first, last = min(places.values()), max(places.values())
    if first == last:
        first, last = first - 0.5, last + 0.5
    if far_apart(list(places.values()), FAR_APART_BELOW):
        axes.set_xscale("log")
    for index, line in enumerate(lines):
        having = [(x, group.values[name]) for x, group in zip(line.places, line.groups, strict=True)]
        having = [(x, one) for x, one in having if one.median is not None]
        shift = DODGE * (index - (len(lines) - 1) / 2)
        x = np.array([x for x, _ in having])
        x = x * (last / first) ** shift if axes.get_xscale() == "log" else x + shift * (last - first)
        shown = [[factor * float(getattr(one, part)) for _, one in having] for part in ("median", "low", "high")]
        y, bottom, top = np.clip(shown, low, high)
        look = {"lw": 1.4, "ms": 5.5, "capsize": 3.5, "label": line.label or "median", **line.look}
        axes.errorbar(x, y, yerr=(y - bottom, top - y), **look)
        failed = ~np.isfinite(shown[0])
        axes.plot(x[failed], y[failed], "o", mfc="white", mec=line.look["color"], ms=9, zorder=5)
    names = [f"{value:g}" if isinstance(value, float) else str(value) for value in places]
    axes.set_xticks(list(places.values()), names, parse_math=False)
    if far_apart(finite):
        style.log_axis(axes, low, high)
    axes.set_ylim(low, high)
    axes.minorticks_off()
    axes.set_ylabel(f"{name}{f' [{unit}]' if unit else ''}")
    axes.grid(axis="y", color="0.9", lw=0.6)


def axis_unit(unit: str, values: Sequence[float]) -> tuple[str, float]:
    """The unit of an axis and what values are multiplied by: centimetres where all are below a metre."""
    return ("cm", 100.0) if unit == "m" and values and max(values) < 1 else (unit, 1.0)


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
