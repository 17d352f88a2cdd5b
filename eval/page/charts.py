"""Charts of a report as plain values that plotly.js draws: lines and points of SVG alone.

Names go through ``label``: plotly.js takes some HTML in its texts, and its entities.
"""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

from moteslam.eval.runs import lines_over, summary_of, values_of
from moteslam.eval.statistics import Summary
from moteslam.eval.sweep.store import Row
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


def curves(runs: Sequence[Row], key: str, metric: str, unit: str) -> Figure | None:
    """The median of a metric over the values of one key that varies, with its 95 % interval; None of fewer than two
    values.
    """
    lines = lines_over(runs, key)
    values = list(dict.fromkeys(value for line in lines for value in line.groups))
    numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    if numeric:
        values.sort()
    traces: list[Figure] = []
    for number, line in enumerate(lines[:MOST_LINES]):
        title = line.label or line.name
        points = [
            (value if numeric else label(value), f"{title}; {key}={value}", summary_of(line.groups[value], metric))
            for value in values
            if value in line.groups
        ]
        dash = DASHES[(number // len(COLOURS)) % len(DASHES)]
        look = {"line": {"color": COLOURS[number % len(COLOURS)], "width": 2, "dash": dash}, "marker": _marker(number)}
        traces.append({**_medians(points, mode="lines+markers", thickness=1.5), "name": label(title), **look})
    if len(values) < 2 or not any(trace["y"] for trace in traces):
        return None
    x_axis = {"title": {"text": label(key)}, "type": "category", **(_axis(values) if numeric else {})}
    return _figure(traces, x_axis, _y(metric, unit, traces), len(lines), "lines")


def spread(columns: Mapping[str, Sequence[Row]], metric: str, unit: str) -> Figure | None:
    """Every run as a point, a column a configuration; its median and 95 % interval beside them; None of fewer than two
    runs.
    """
    traces: list[Figure] = []
    names = list(columns)[:MOST_LINES]
    for number, name in enumerate(names):
        having = [run for run in columns[name] if run.status == "ok" and metric in run.known]
        if not having:
            continue
        values = [run.known[metric] for run in having]
        places = [number + 0.5 * (((7 * k) % 23) / 23 - 0.5) for k in range(len(values))]  # apart, the same each time
        texts = [f"{name}; {run.name}: {run.known[metric]:.4g}" for run in having]
        look = {"color": COLOURS[number % len(COLOURS)], "size": 5, "opacity": 0.5}
        traces.append({**_points("markers", places, values, texts), "name": label(name), "marker": look})
        median = _medians([(number + 0.36, name, summary_of(columns[name], metric))], mode="markers", thickness=2.0)
        traces.append({**median, "marker": {**look, "size": 9, "opacity": 1.0, "symbol": "diamond"}})
    if sum(len(trace["y"]) for trace in traces[::2]) < 2:
        return None
    x_axis = {
        "tickvals": list(range(len(names))),
        "ticktext": [label(name if len(name) <= 40 else f"{name[:39]}…") for name in names],
        "automargin": True,
        "ticklabeloverflow": "allow",
        "range": [-0.6, len(names) - 0.4],
    }
    traces = [{**trace, "showlegend": False} for trace in traces]
    return _figure(traces, x_axis, _y(metric, unit, traces), len(columns), "configurations")


def paired(columns: Mapping[str, Sequence[Row]], baseline: str, metric: str, unit: str) -> Figure | None:
    """A point for each pair of runs of a configuration and the baseline on the same case. None without any."""
    first = values_of(columns[baseline], metric)
    traces: list[Figure] = []
    others = [name for name in columns if name != baseline]
    for number, name in enumerate(others[:MOST_LINES]):
        names = {run.case: run.name for run in columns[name]}
        pairs = [
            (case, one, value)
            for case, value in values_of(columns[name], metric).items()
            if (one := first.get(case)) is not None and value is not None
        ]
        if not pairs:
            continue
        _, x, y = zip(*pairs, strict=True)
        texts = [f"{name}; {names[case]}: {b:.4g}, {baseline}: {a:.4g}" for case, a, b in pairs]
        marker = {**_marker(number + 1), "opacity": 0.7}
        traces.append({**_points("markers", x, y, texts), "name": label(name), "marker": marker})
    if not traces:
        return None
    everything = [value for trace in traces for value in (*trace["x"], *trace["y"])]
    ends = [min(everything), max(everything)]
    look = {"hoverinfo": "skip", "line": {"color": "#7F7F7F", "width": 1, "dash": "dot"}}
    line = {"type": "scatter", "mode": "lines", "name": "equal", "x": ends, "y": ends, **look}
    x_axis, y_axis = ({**_axis(everything), **_title(f"{metric} of the {of}", unit)} for of in ("baseline", "others"))
    return _figure([line, *traces], x_axis, y_axis, len(others), "configurations")


def _figure(traces: list[Figure], x_axis: Figure, y_axis: Figure, count: int, what: str) -> Figure:
    note = f"{count - MOST_LINES} more {what} are left out" if count > MOST_LINES else ""
    return {"data": traces, "layout": {"xaxis": x_axis, "yaxis": y_axis}, "note": note}


def _points(mode: str, x: Sequence[Any], y: Sequence[float], texts: Sequence[str]) -> Figure:
    hover = {"text": list(map(label, texts)), "hovertemplate": "%{text}<extra></extra>"}
    return {"type": "scatter", "mode": mode, "x": list(x), "y": list(y), **hover}


def _medians(points: Sequence[tuple[Any, str, Summary]], *, mode: str, thickness: float) -> Figure:
    """Medians with their 95 % intervals at places of x, each with its name; to a side where an interval goes on to
    infinity it has no bar, and a median that is infinite is left out.
    """
    shown = [(x, name, one) for x, name, one in points if one.median is not None and isfinite(one.median)]
    medians = [one.median or 0.0 for _, _, one in shown]
    ends = [(_finite(one.low, y), _finite(one.high, y)) for (_, _, one), y in zip(shown, medians, strict=True)]
    texts = [
        f"{name}: median {one.median:.4g}, 95 % {one.low:.4g} to {one.high:.4g}, {one.runs} runs, {one.failed} failed"
        for _, name, one in shown
    ]
    bars = {
        "array": [max(high - y, 0.0) for (_, high), y in zip(ends, medians, strict=True)],
        "arrayminus": [max(y - low, 0.0) for (low, _), y in zip(ends, medians, strict=True)],
    }
    error = {"type": "data", "symmetric": False, "thickness": thickness, **bars}
    return {**_points(mode, [x for x, _, _ in shown], medians, texts), "error_y": error}


def _marker(number: int) -> Figure:
    return {"color": COLOURS[number % len(COLOURS)], "size": 8, "symbol": SYMBOLS[number % len(SYMBOLS)]}


def _title(name: str, unit: str) -> Figure:
    return {"title": {"text": label(f"{name} [{unit}]" if unit else name)}}


def _y(metric: str, unit: str, traces: Sequence[Figure]) -> Figure:
    look = _axis([value for trace in traces for value in trace["y"]])
    return {**_title(metric, unit), **look} | ({} if look["type"] == "log" else {"rangemode": "tozero"})


def _axis(values: Sequence[float]) -> Figure:
    """Linear, or logarithmic with ticks at 1, 2 and 5; of more than three decades at 1."""
    if not (min(values) > 0 and max(values) >= WIDE * min(values)):
        return {"type": "linear"}
    return {"type": "log", "dtick": "D2" if max(values) < DECADES * min(values) else 1}


def _finite(value: float | None, other: float) -> float:
    return value if value is not None and isfinite(value) else other
