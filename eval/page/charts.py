"""Charts of a report as plain values that plotly.js draws: lines and points of SVG alone.

Names go through ``label``: plotly.js takes some HTML in its texts, and its entities.
"""

import html
from collections.abc import Mapping, Sequence
from math import ceil, floor, isfinite, log10
from typing import Any

from moteslam.eval.report.curves import axis_title, lines_over
from moteslam.eval.runs import Shown, key_words, summary_of
from moteslam.eval.statistics import Summary
from moteslam.eval.sweep.store import Row
from moteslam.eval.tables import literal

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#B8A700")
"""Of lines: the palette of Okabe and Ito, made for colour-blind readers, its black and yellow fit for both schemes."""
SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "star", "hexagon")
DASHES = ("solid", "dash", "dot", "dashdot")
MOST_LINES = 16  # Of a chart; the others are left out, and counted in its note
WIDE = 20.0
"""Values whose largest is at least this multiple of the smallest are drawn on a logarithmic axis."""
DECADES = 1e3  # Values over more have a tick a decade
LABEL = 28
"""Characters of a line of a label; of a longer one the end is shown, where such names differ."""

Figure = dict[str, Any]


def label(text: object) -> str:
    """Text as a chart shows it literally."""
    return html.escape(literal(text), quote=False)


def _lines(name: str) -> str:
    """A name under its column, a line a part."""
    parts = map(literal, name.split(", "))
    return "<br>".join(label(part if len(part) <= LABEL else f"…{part[1 - LABEL :]}") for part in parts)


def curves(runs: Sequence[Row], key: str, metric: Shown) -> Figure | None:
    """The median of a metric over the values of one key that varies, with its 95 % interval; None of fewer than two
    values.
    """
    lines = lines_over(runs, key)
    values = list(dict.fromkeys(value for line in lines for value in line.groups))
    numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    if numeric:
        values.sort()
    traces: list[Figure] = []
    for index, line in enumerate(lines[:MOST_LINES]):
        title = line.label or metric.title
        points = [
            (value if numeric else label(value), f"{title}; {key_words(key)} {value}", summary_of(some, metric.name))
            for value in values
            if (some := line.groups.get(value))
        ]
        dash = DASHES[(index // len(COLOURS)) % len(DASHES)]
        colour, symbol = {"color": COLOURS[index % len(COLOURS)]}, SYMBOLS[index % len(SYMBOLS)]
        look = {"line": {**colour, "width": 2, "dash": dash}, "marker": {**colour, "size": 8, "symbol": symbol}}
        traces.append({**_medians(points, metric, mode="lines+markers", thickness=1.5), "name": label(title), **look})
    if len(values) < 2 or not any(trace["y"] for trace in traces):
        return None
    x_axis = {"title": {"text": label(axis_title(key, runs))}, "type": "category", **(_axis(values) if numeric else {})}
    return _figure(traces, x_axis, _y(metric, traces), len(lines), "lines")


def spread(columns: Mapping[str, Sequence[Row]], metric: Shown) -> Figure | None:
    """Every run as a point, a column a group, a colour a scenario, and beside them the median with its 95 % interval;
    None of fewer than two runs.
    """
    names = list(columns)[:MOST_LINES]
    places = list(dict.fromkeys(run.about["scenario"] for name in names for run in columns[name]))
    several, wide = len(places) > 1, 0.8 / max(len(places), 1)
    traces: list[Figure] = []
    for k, place in enumerate(places):
        x, y, texts, medians = [], [], [], []
        for index, name in enumerate(names):
            some = [run for run in columns[name] if run.about["scenario"] == place]
            having = [run for run in some if run.status == "ok" and metric.name in run.known]
            middle = index + wide * (k - (len(places) - 1) / 2)
            x += [middle + 0.4 * wide * (((7 * n) % 23) / 23 - 0.5) for n in range(len(having))]  # the same each time
            y += [metric.factor * run.known[metric.name] for run in having]
            texts += [f"{name}; {run.name}: {metric.text(run.known[metric.name])}" for run in having]
            if having:
                medians.append((middle + 0.35 * wide, name, summary_of(some, metric.name)))
        colour = {"color": COLOURS[k % len(COLOURS)]}
        legend = {"name": label(place), "legendgroup": label(place)}
        traces.append({**_points("markers", x, y, texts), **legend, "marker": {**colour, "size": 6, "opacity": 0.5}})
        look = {"marker": {**colour, "size": 9, "symbol": "diamond"}, "showlegend": False}
        traces.append({**_medians(medians, metric, mode="markers", thickness=2.0), **legend, **look})
    if sum(len(trace["y"]) for trace in traces[::2]) < 2:
        return None
    x_axis = {"tickvals": list(range(len(names))), "ticktext": list(map(_lines, names)), "automargin": True}
    x_axis |= {"ticklabeloverflow": "allow", "range": [-0.6, len(names) - 0.4]}
    traces = [{**trace, "showlegend": several and trace.get("showlegend", True)} for trace in traces]
    return _figure(traces, x_axis, _y(metric, traces), len(columns), "configurations")


def _figure(traces: list[Figure], x_axis: Figure, y_axis: Figure, count: int, what: str) -> Figure:
    note = f"{count - MOST_LINES} more {what} are left out" if count > MOST_LINES else ""
    return {"data": traces, "layout": {"xaxis": x_axis, "yaxis": y_axis}, "note": note}


def _points(mode: str, x: Sequence[Any], y: Sequence[float], texts: Sequence[str]) -> Figure:
    hover = {"text": list(map(label, texts)), "hovertemplate": "%{text}<extra></extra>"}
    return {"type": "scatter", "mode": mode, "x": list(x), "y": list(y), **hover}


def _medians(points: Sequence[tuple[Any, str, Summary]], metric: Shown, *, mode: str, thickness: float) -> Figure:
    """Medians with their 95 % intervals, if there are any, at places of x, each with its name; to a side where an
    interval goes on to infinity it has no bar, and a median that is infinite is left out.
    """
    x, y, texts, above, below = [], [], [], [], []
    for place, name, one in points:
        if (middle := one.median) is None or not isfinite(middle):
            continue
        low, high = (middle if end is None or not isfinite(end) else end for end in (one.low, one.high))
        within = "" if one.low is None else f"95 % {metric.text(one.low)} to {metric.text(one.high)}, "
        x.append(place)
        y.append(metric.factor * middle)
        texts.append(f"{name}: median {metric.text(middle)}, {within}{one.runs} runs, {one.failed} failed")
        above.append(metric.factor * max(high - middle, 0.0))
        below.append(metric.factor * max(middle - low, 0.0))
    error = {"type": "data", "symmetric": False, "thickness": thickness, "array": above, "arrayminus": below}
    return {**_points(mode, x, y, texts), "error_y": error}


def _y(metric: Shown, traces: Sequence[Figure]) -> Figure:
    look = _axis([value for trace in traces for value in trace["y"]])
    return {"title": {"text": label(metric.title)}, **look} | ({} if look["type"] == "log" else {"rangemode": "tozero"})


def _axis(values: Sequence[float]) -> Figure:
    """Linear, or logarithmic with ticks at 1, 2 and 5 times a power of ten; over more than three decades at these."""
    if not (min(values) > 0 and max(values) >= WIDE * min(values)):
        return {"type": "linear"}
    steps = (1, 2, 5) if max(values) < DECADES * min(values) else (1,)
    powers = range(floor(log10(min(values))) - 1, ceil(log10(max(values))) + 1)
    ticks = [step * 10.0**power for power in powers for step in steps]
    return {"type": "log", "tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}
