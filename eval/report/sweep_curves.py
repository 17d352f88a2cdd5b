"""Curves of a sweep: the median of a metric over what varies, a line for each scenario and configuration."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, log10
from typing import Any

import numpy as np

from moteslam.eval.report import style
from moteslam.eval.report.style import File
from moteslam.eval.runs import Line, better, headings, key_words, lines_over, summary_of
from moteslam.eval.statistics import FEWEST
from moteslam.eval.sweep.store import Row
from moteslam.eval.tables import literal

FAR_APART, FAR_APART_BELOW = 12.0, 5.0
"""Values of which one is this many times another have a logarithmic axis, if all are above 0; so have those below."""
DODGE, MARGIN = 0.012, 0.08
"""Between the same place on two lines, whose intervals lie side by side, and beyond the values, where medians that are
infinite lie; as shares of the axis."""
MARKERS = ("o", "s", "^", "D", "v", "P")


def draw_sweep(
    path: File, rows: Sequence[Row], metrics: Sequence[str], *, column: str, label: str | None = None
) -> None:
    """Medians over a column of ``Row.about`` with bars for their 95 % bootstrap intervals, or of few runs each of them
    as a point; a panel a metric.

    A colour stands for a scenario, robot and noise, dashes for a configuration. A median that is infinite, since half
    of the runs failed, is an open marker beyond the others. Bars end at the edge where they go on to infinity.
    """
    lines = lines_over(rows, column)
    places = places_of([value for line in lines for value in line.groups])
    looks = _looks(lines)
    with style.saved_figure(path, size=(1.0 + 5.2 * len(metrics), 4.6)) as figure:
        panels = figure.subplots(1, len(metrics), squeeze=False)[0]
        for axes, name in zip(panels, metrics, strict=True):
            _draw(axes, lines, looks, name, places)
            axes.set_xlabel(literal(key_words(column) if label is None else label), parse_math=False)
        if max(len(runs) for line in lines for runs in line.groups.values()) >= FEWEST:
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


def _looks(lines: Sequence[Line]) -> list[dict[str, Any]]:
    wheres, hows = list(dict.fromkeys(line.where for line in lines)), list(dict.fromkeys(line.how for line in lines))
    looks = []
    for line in lines:
        first, second = wheres.index(line.where), hows.index(line.how)
        marker = MARKERS[(second if len(hows) > 1 else first) % len(MARKERS)]
        dashes = style.DASHES[second % len(style.DASHES)]
        looks.append({"color": style.COLOURS[first % len(style.COLOURS)], "ls": dashes, "marker": marker})
    return looks


def far_apart(values: Sequence[float], factor: float = FAR_APART) -> bool:
    """Whether values are all above 0 and one is this many times another."""
    return len(values) > 0 and min(values) > 0 and max(values) >= factor * min(values)


def _draw(
    axes: style.Axes, lines: Sequence[Line], looks: Sequence[dict[str, Any]], name: str, places: dict[Any, float]
) -> None:
    summed = [{value: summary_of(rows, name) for value, rows in line.groups.items()} for line in lines]
    alone = [row.known[name] for line in lines for rows in line.groups.values() for row in rows if name in row.known]
    ends = [end for line in summed for one in line.values() for end in (one.median, one.low, one.high)]
    few = all(len(rows) < FEWEST for line in lines for rows in line.groups.values())
    finite = [value for value in (*ends, *(alone if few else ())) if value is not None and isfinite(value)]
    title, factor = headings({name: finite})[name]
    finite = [factor * value for value in finite]
    low, high = _limits(finite, logarithmic=far_apart(finite), from_zero=better(name) == "lower")
    first, last = min(places.values()), max(places.values())
    if first == last:
        first, last = first - 0.5, last + 0.5
    words = [*places.values()] == [*range(len(places))]  # a line from one to the next would mean nothing
    if not words and far_apart(list(places.values()), FAR_APART_BELOW):
        axes.set_xscale("log")
    for index, (line, groups) in enumerate(zip(lines, summed, strict=True)):
        having = [(value, x, groups[value]) for value, x in places.items() if value in groups]
        having = [(value, x, one) for value, x, one in having if one.median is not None]
        shift = DODGE * (4 if words else 1) * (index - (len(lines) - 1) / 2)
        x = np.array([x for _, x, _ in having])
        x = x * (last / first) ** shift if axes.get_xscale() == "log" else x + shift * (last - first)
        ends = [(one.median, one.low, one.high) if one.low is not None else [one.median] * 3 for _, _, one in having]
        shown = factor * np.array(ends, np.float64).reshape(-1, 3).T
        y, bottom, top = np.clip(shown, low, high)
        bars = np.array([one.low is not None for _, _, one in having], np.bool_)
        look = {"lw": 1.4, **looks[index], **({"ls": ""} if words else {})}
        axes.plot(x, y, ms=5.5, label=line.label or "median", **look)
        axes.errorbar(x[bars], y[bars], yerr=((y - bottom)[bars], (top - y)[bars]), capsize=3.5, **look)
        for at, (value, _, _) in zip(x, having, strict=True) if few else ():  # no interval: every run
            each = [factor * row.known[name] for row in line.groups[value] if name in row.known]
            axes.plot([at] * len(each), each, ".", color=looks[index]["color"], ms=4, alpha=0.5)
        failed = ~np.isfinite(shown[0])
        axes.plot(x[failed], y[failed], "o", mfc="white", mec=looks[index]["color"], ms=9, zorder=5)
    if few:
        axes.plot([], [], ".", color="0.4", label="every run")
    names = [f"{value:g}" if isinstance(value, float) else str(value) for value in places]
    axes.set_xticks(list(places.values()), names, parse_math=False)
    if far_apart(finite):
        style.log_axis(axes, low, high)
    axes.set_ylim(low, high)
    axes.minorticks_off()
    axes.set_ylabel(f"median {title}")
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
