"""Curves of a sweep: the median of a metric over what varies, a line for each scenario and configuration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, log10
from os import PathLike
from typing import TYPE_CHECKING, Any

from moteslam.eval.metrics.registry import metric
from moteslam.eval.report import style
from moteslam.eval.report.comparison import COLOURS
from moteslam.eval.sweep.tables import GroupSummary, better, varying

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FAR_APART, FAR_APART_BELOW = 12.0, 5.0
"""Values of which one is this many times another have a logarithmic axis, if all are above 0; so have those below."""
DODGE = 0.012
"""Between the same place on two lines, as a share of the axis: so that intervals lie beside each other."""
PANELS_APART = 0.06
"""As a share of a panel."""
DASHES, MARKERS = ("-", "--", ":", "-."), ("o", "s", "^", "D", "v", "P")
SETTINGS = ("scenario", "platform", "noise")
"""Columns that say where it was run: they choose the colour, all others dashes and marker."""
MARGIN = 0.08
"""Beyond the values, as a share of the axis; medians that are infinite lie there."""


@dataclass(frozen=True)
class Line:
    """The groups of one scenario and configuration, in the order of their places.

    Attributes:
        label: what sets it apart from the other lines; empty of a single one.
        look: colour, dashes and marker.
        places: on the axis.
        groups: at these.
    """

    label: str
    look: dict[str, Any]
    places: list[float]
    groups: list[GroupSummary]


@dataclass(frozen=True)
class Places:
    """Where the values of a column lie on the axis.

    Attributes:
        values: in their order; the places of words are 0, 1, 2, ...
        numeric: whether all are numbers, also where they were written as words.
    """

    values: list[Any]
    numeric: bool

    @classmethod
    def of(cls, values: Sequence[Any]) -> Places:
        """Of the values of a column, in rising order if they are numbers."""
        once = list(dict.fromkeys(values))
        numeric = all(_number(value) is not None for value in once)
        return cls(sorted(once, key=lambda value: _number(value) or 0.0) if numeric else once, numeric)

    def of_value(self, value: Any) -> float:
        """The place of one of the values."""
        number = _number(value) if self.numeric else None
        return float(self.values.index(value)) if number is None else number

    @property
    def logarithmic(self) -> bool:
        """Whether they are numbers far apart."""
        return self.numeric and far_apart([self.of_value(value) for value in self.values], FAR_APART_BELOW)


def draw_sweep(
    path: str | PathLike[str],
    groups: Sequence[GroupSummary],
    metrics: Sequence[str],
    *,
    column: str,
    label: str | None = None,
    title: str = "",
) -> None:
    """Medians over a column with bars for their 95 % bootstrap intervals, a panel a metric.

    A median that is infinite, since half of the runs failed, is an open marker beyond the others. Bars end at the edge
    where they go on to infinity.

    Args:
        path: of the PNG.
        groups: of a sweep, with all of the metrics.
        metrics: names.
        column: of ``GroupSummary.about``, such as a key that varies; groups without it are left out.
        label: of the axis, by default the name of the column.
        title: over the figure.

    Raises:
        OutputError: it cannot be written.
    """
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    shown = [group for group in groups if column in group.about]
    places = Places.of([group.about[column] for group in shown])
    lines = lines_of(shown, column, places)
    with style.saved_figure(path, size=(1.0 + 5.2 * len(metrics), 4.6)) as figure:
        panels = figure.subplots(1, len(metrics), squeeze=False)[0]
        if isinstance(layout := figure.get_layout_engine(), ConstrainedLayoutEngine):
            layout.set(wspace=PANELS_APART)
        for axes, name in zip(panels, metrics, strict=True):
            _draw(axes, lines, name, places)
            axes.set_xlabel(style.printable(column if label is None else label), parse_math=False)
        panels[0].errorbar([], [], yerr=[], color="0.4", ls="", capsize=3.5, label="95 % interval of the median")
        style.legend_below(figure, *panels, columns=2 if len(metrics) == 1 else 5)
        style.heading(figure, title)


def lines_of(groups: Sequence[GroupSummary], column: str, places: Places) -> list[Line]:
    """The lines of groups: a colour for each scenario, robot and noise, dashes for each configuration."""
    others = [key for key in varying(groups) if key != column and len({_text(group, key) for group in groups}) > 1]
    members: dict[tuple[tuple[str, ...], tuple[str, ...]], list[GroupSummary]] = {}
    for group in groups:
        where = tuple(_text(group, key) for key in others if key in SETTINGS)
        how = tuple(_named(group, key) for key in others if key not in SETTINGS)
        members.setdefault((where, how), []).append(group)
    wheres = list(dict.fromkeys(where for where, _ in members))
    hows = list(dict.fromkeys(how for _, how in members))
    lines = []
    for (where, how), each in members.items():
        first, second = wheres.index(where), hows.index(how)
        look = {"color": COLOURS[first % len(COLOURS)], "ls": DASHES[second % len(DASHES)]}
        look["marker"] = MARKERS[(second if len(hows) > 1 else first) % len(MARKERS)]
        ordered = sorted(each, key=lambda group: places.of_value(group.about[column]))
        label = ", ".join(filter(None, (*where, *how)))
        lines.append(Line(label, look, [places.of_value(group.about[column]) for group in ordered], ordered))
    return lines


def far_apart(values: Sequence[float], factor: float = FAR_APART) -> bool:
    """Whether values are all above 0 and one is this many times another."""
    return bool(values) and min(values) > 0 and max(values) >= factor * min(values)


def dodged(places: Sequence[float], shift: float, span: tuple[float, float], *, logarithmic: bool) -> list[float]:
    """Places moved by a share of an axis that goes from the first to the second of ``span``."""
    low, high = span
    if logarithmic:
        return [place * (high / low) ** shift for place in places]
    return [place + shift * (high - low) for place in places]


def _draw(axes: Axes, lines: Sequence[Line], name: str, places: Places) -> None:
    ends = sorted(places.of_value(value) for value in places.values)
    span = (ends[0], ends[-1]) if ends[0] < ends[-1] else (ends[0] - 0.5, ends[0] + 0.5)
    finite = [
        value
        for line in lines
        for group in line.groups
        for value in (group.values[name].median, group.values[name].low, group.values[name].high)
        if value is not None and isfinite(value)
    ]
    unit, factor = _unit(metric(name).unit, finite)
    finite = [factor * value for value in finite]
    logarithmic = far_apart(finite)
    low, high = _limits(finite, logarithmic=logarithmic, least=0.0 if better(name) == "lower" else None)
    if places.logarithmic:
        axes.set_xscale("log")
    if logarithmic:
        axes.set_yscale("log")
    for index, line in enumerate(lines):
        there = [k for k, group in enumerate(line.groups) if group.values[name].median is not None]
        shift = DODGE * (index - (len(lines) - 1) / 2)
        x = dodged([line.places[k] for k in there], shift, span, logarithmic=places.logarithmic)
        found = [line.groups[k].values[name] for k in there]
        y, bottom, top = (
            [_clipped(getattr(one, part), factor, low, high) for one in found] for part in ("median", "low", "high")
        )
        axes.vlines(x, bottom, top, color=line.look["color"], lw=1.4, alpha=0.7)
        for ends_of in (bottom, top):
            axes.plot(x, ends_of, "_", color=line.look["color"], ms=7, mew=1.4, alpha=0.7)
        axes.plot(x, y, lw=1.4, ms=5.5, label=line.label or "median", **line.look)
        failed = [k for k, one in enumerate(found) if not isfinite(one.median or 0.0)]
        axes.plot(
            [x[k] for k in failed], [y[k] for k in failed], "o", mfc="white", mec=line.look["color"], ms=9, zorder=5
        )
    axes.set_ylim(low, high)
    _ticks(axes, places)
    axes.set_ylabel(f"{name}{f' [{unit}]' if unit else ''}")
    axes.grid(axis="y", color="0.9", lw=0.6)


def _limits(values: Sequence[float], *, logarithmic: bool, least: float | None) -> tuple[float, float]:
    """Of the axis: beyond the values by ``MARGIN``; from ``least`` on, if given, where it is linear."""
    if not values:
        return 0.0, 1.0
    low, high = min(values), max(values)
    if logarithmic:
        factor = 10 ** (MARGIN * log10(high / low))
        return low / factor, high * factor
    if least is not None and low >= least:
        return least, high + MARGIN * (high - least or 1.0)
    margin = MARGIN * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def _clipped(value: float | None, factor: float, low: float, high: float) -> float:
    return low if value is None else min(max(factor * value, low), high)


def _unit(unit: str, values: Sequence[float]) -> tuple[str, float]:
    """The unit of an axis and what values are multiplied by: centimetres where all are below a metre."""
    return ("cm", 100.0) if unit == "m" and values and max(values) < 1 else (unit, 1.0)


def _ticks(axes: Axes, places: Places) -> None:
    """A tick at every value."""
    axes.set_xticks([places.of_value(value) for value in places.values], list(map(_shown, places.values)))
    axes.minorticks_off()
    for text in axes.get_xticklabels():
        text.set_parse_math(False)
    if axes.get_yscale() == "log":
        low, high = axes.get_ylim()
        steps = [digit * 10.0**power for power in range(-9, 10) for digit in (1, 2, 5)]
        shown = [step for step in steps if low <= step <= high]
        axes.set_yticks(shown, [f"{step:g}" for step in shown])
        axes.set_ylim(low, high)


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _text(group: GroupSummary, key: str) -> str:
    return str(group.about.get(key, ""))


def _named(group: GroupSummary, key: str) -> str:
    text = _text(group, key)
    return text if key == "configuration" or not text else f"{key}={text}"


def _number(value: Any) -> float | None:
    """A number, also one written as a word; None of anything else."""
    if isinstance(value, bool):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if isfinite(number) else None
