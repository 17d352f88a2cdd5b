"""Charts of a report as plain values that plotly.js draws: lines and points of SVG alone.

Names go through ``label``: plotly.js takes some HTML in its texts, and its entities.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any

from moteslam.eval.page.material import ReportRun
from moteslam.eval.statistics import Summary
from moteslam.eval.sweep.tables import better
from moteslam.eval.tables import literal

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#B8A700")
"""Of lines: the palette of Okabe and Ito, made for colour-blind readers, its black and yellow fit for both schemes."""
SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "star", "hexagon")
DASHES = ("solid", "dash", "dot", "dashdot")
MOST_LINES = 16
"""Of a chart; the others are left out, and counted in its note."""
WIDE = 20.0
"""Values whose largest is at least this multiple of the smallest are drawn on a logarithmic axis."""
DECADES = 1e3
"""Values over more have a tick a decade."""

Figure = dict[str, Any]


def label(text: object) -> str:
    """Text as a chart shows it literally."""
    return html.escape(literal(text), quote=False)


def axis(name: str, unit: str) -> str:
    """A metric with its unit."""
    return label(f"{name} [{unit}]" if unit else name)


def summary_of(runs: Sequence[ReportRun], metric: str) -> Summary:
    """The values of a metric over runs; those that failed count as the worst."""
    good = [run for run in runs if run.status == "ok"]
    return Summary.of([run.values.get(metric) for run in good], len(runs) - len(good), better=better(metric))


def grouped(runs: Sequence[ReportRun], by: Callable[[ReportRun], Any]) -> dict[Any, list[ReportRun]]:
    """Runs by what they have in common, in the order of the first ones."""
    groups: dict[Any, list[ReportRun]] = {}
    for run in runs:
        groups.setdefault(by(run), []).append(run)
    return groups


def curves(runs: Sequence[ReportRun], key: str, metric: str, unit: str) -> Figure | None:
    """The median of a metric over the values of one key that varies, with its 95 % interval, a line a rest.

    None if fewer than two values have one.
    """
    having = [run for run in runs if key in dict(run.varied)]
    values = list(dict.fromkeys(dict(run.varied)[key] for run in having))
    numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    if numeric:
        values.sort()

    def rest(run: ReportRun) -> tuple[str, ...]:
        others = [f"{other}={value}" for other, value in run.varied if other != key]
        return tuple(filter(None, (run.place, run.platform, run.noise, run.base, *others)))

    lines = grouped(having, rest)
    common = set.intersection(*(set(name) for name in lines)) if len(lines) > 1 else set()
    traces, everything = [], []
    for number, (name, members) in enumerate(list(lines.items())[:MOST_LINES]):
        at = grouped(members, lambda run: dict(run.varied)[key])
        summaries = {value: summary_of(at[value], metric) for value in values if value in at}
        shown = {value: one for value, one in summaries.items() if one.median is not None and isfinite(one.median)}
        title = ", ".join(part for part in name if part not in common) or ", ".join(name)
        texts = [
            f"{title}; {key}={value}: median {one.median:.4g}, 95 % {one.low:.4g} to {one.high:.4g}, "
            f"{one.runs} runs, {one.failed} failed"
            for value, one in shown.items()
        ]
        medians = [one.median or 0.0 for one in shown.values()]
        everything += medians
        traces.append(
            {
                **_points("lines+markers", list(shown) if numeric else list(map(label, shown)), medians, texts),
                "name": label(title),
                "error_y": _bars(list(shown.values()), 1.5),
                "line": {
                    "color": COLOURS[number % len(COLOURS)],
                    "width": 2,
                    "dash": DASHES[(number // len(COLOURS)) % len(DASHES)],
                },
                "marker": _marker(number),
            }
        )
    if len(values) < 2 or not everything:
        return None
    x_axis = {"title": {"text": label(key)}, "type": "category", **(_axis(values) if numeric else {})}
    return _figure(traces, x_axis, _y(metric, unit, everything), len(lines), "lines")


def spread(runs: Sequence[ReportRun], metric: str, unit: str) -> Figure | None:
    """Every run as a point, a column a configuration; its median and 95 % interval beside them.

    None of fewer than two runs with a value.
    """
    traces: list[dict[str, Any]] = []
    everything: list[float] = []
    columns = grouped(runs, lambda run: run.configuration)
    for number, (name, members) in enumerate(list(columns.items())[:MOST_LINES]):
        having = [run for run in members if run.status == "ok" and metric in run.values]
        if not having:
            continue
        values = [run.values[metric] for run in having]
        everything += values
        places = [number + 0.5 * (((7 * k) % 23) / 23 - 0.5) for k in range(len(values))]  # apart, the same each time
        texts = [f"{run.configuration}; {run.name}: {run.values[metric]:.4g}" for run in having]
        colour = COLOURS[number % len(COLOURS)]
        marker = {"color": colour, "size": 5, "opacity": 0.5}
        points = _points("markers", places, values, texts)
        traces.append({**points, "name": label(name), "showlegend": False, "marker": marker})
        one = summary_of(members, metric)
        if one.median is not None and isfinite(one.median):
            low, high = _finite(one.low, one.median), _finite(one.high, one.median)
            text = f"{name}: median {one.median:.4g}, 95 % {low:.4g} to {high:.4g}"
            marker = {"color": colour, "size": 9, "symbol": "diamond"}
            points = _points("markers", [number + 0.36], [one.median], [text])
            traces.append({**points, "error_y": _bars([one], 2), "showlegend": False, "marker": marker})
    if len(everything) < 2:
        return None
    names = list(columns)[:MOST_LINES]
    x_axis = {
        "tickvals": list(range(len(names))),
        "ticktext": [label(name if len(name) <= 40 else f"{name[:39]}…") for name in names],
        "automargin": True,
        "ticklabeloverflow": "allow",
        "range": [-0.6, len(names) - 0.4],
    }
    return _figure(traces, x_axis, _y(metric, unit, everything), len(columns), "configurations")


def paired(runs: Sequence[ReportRun], baseline: str, metric: str, unit: str) -> Figure | None:
    """A point for each pair of runs of a configuration and the baseline on the same case. None without any."""
    by_name = grouped([run for run in runs if run.status == "ok" and metric in run.values], lambda r: r.configuration)
    first = {run.case: run for run in by_name.get(baseline, ())}
    traces: list[dict[str, Any]] = []
    everything: list[float] = []
    others = [name for name in grouped(runs, lambda run: run.configuration) if name != baseline]
    for number, name in enumerate(others[:MOST_LINES]):
        pairs = [(first[run.case], run) for run in by_name.get(name, ()) if run.case in first]
        if not pairs:
            continue
        x, y = ([run.values[metric] for run in side] for side in zip(*pairs, strict=True))
        everything += [*x, *y]
        texts = [f"{name}; {b.name}: {b.values[metric]:.4g}, {baseline}: {a.values[metric]:.4g}" for a, b in pairs]
        marker = {**_marker(number + 1), "opacity": 0.7}
        traces.append({**_points("markers", x, y, texts), "name": label(name), "marker": marker})
    if not traces:
        return None
    ends = [min(everything), max(everything)]
    look = {"hoverinfo": "skip", "line": {"color": "#7F7F7F", "width": 1, "dash": "dot"}}
    line = {"type": "scatter", "mode": "lines", "name": "equal", "x": ends, "y": ends, **look}
    x_axis = {"title": {"text": axis(f"{metric} of the baseline", unit)}, **_axis(everything)}
    y_axis = {"title": {"text": axis(f"{metric} of the others", unit)}, **_axis(everything)}
    return _figure([line, *traces], x_axis, y_axis, len(others), "configurations")


def _figure(traces: list[dict[str, Any]], x_axis: Figure, y_axis: Figure, count: int, what: str) -> Figure:
    note = f"{count - MOST_LINES} more {what} are left out" if count > MOST_LINES else ""
    return {"data": traces, "layout": {"xaxis": x_axis, "yaxis": y_axis}, "note": note}


def _points(mode: str, x: Sequence[Any], y: Sequence[float], texts: Sequence[str]) -> dict[str, Any]:
    hover = {"text": list(map(label, texts)), "hovertemplate": "%{text}<extra></extra>"}
    return {"type": "scatter", "mode": mode, "x": list(x), "y": list(y), **hover}


def _bars(summaries: Sequence[Summary], thickness: float) -> dict[str, Any]:
    """The 95 % intervals of medians; none to a side where it goes on to infinity."""
    medians = [one.median or 0.0 for one in summaries]
    highs = [max(_finite(one.high, middle) - middle, 0.0) for one, middle in zip(summaries, medians, strict=True)]
    lows = [max(middle - _finite(one.low, middle), 0.0) for one, middle in zip(summaries, medians, strict=True)]
    return {"type": "data", "symmetric": False, "array": highs, "arrayminus": lows, "thickness": thickness}


def _marker(number: int) -> dict[str, Any]:
    return {"color": COLOURS[number % len(COLOURS)], "size": 8, "symbol": SYMBOLS[number % len(SYMBOLS)]}


def _y(metric: str, unit: str, values: Sequence[float]) -> Figure:
    look = _axis(values)
    return {"title": {"text": axis(metric, unit)}, **look} | ({} if look["type"] == "log" else {"rangemode": "tozero"})


def _axis(values: Sequence[float]) -> Figure:
    """Linear, or logarithmic with ticks at 1, 2 and 5; of more than three decades at 1."""
    if not (min(values) > 0 and max(values) >= WIDE * min(values)):
        return {"type": "linear"}
    return {"type": "log", "dtick": "D2" if max(values) < DECADES * min(values) else 1}


def _finite(value: float | None, other: float) -> float:
    return value if value is not None and isfinite(value) else other
