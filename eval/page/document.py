"""The report as one HTML file: tables, charts and a player of runs, with everything that they need in it."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import distribution
from importlib.resources import files
from math import isfinite
from pathlib import Path
from typing import Any

from jinja2 import BaseLoader, Environment, StrictUndefined
from markupsafe import Markup, escape

from moteslam.errors import ConfigError
from moteslam.eval.metrics.registry import chosen, metric
from moteslam.eval.page import charts
from moteslam.eval.page.material import Key, Material, ReportRun
from moteslam.eval.page.player import Budget, playable
from moteslam.eval.statistics import Proportion, compare
from moteslam.eval.sweep.tables import better
from moteslam.eval.tables import literal
from moteslam.robot.values import interval

USUAL = (
    *("final.ate", "online.ate", "dead_reckoning.ate", "final.rpe_1m", "map_f1", "map_cells_per_metre"),
    *("nees", "lost_recall", "loops_false", "relations", "cpu_per_scan"),
)
"""Metrics of a report whose sweeps name none."""
MOST_METRICS = 8
"""Of a report that was not asked for more."""
STYLE_OF_MAPS = re.compile(r'getElementById\("([0-9a-f]{32,})"\)')
"""plotly.js adds a style of its geographic maps, which the policy forbids, unless an element of this name is there."""


def page(
    material: Material,
    *,
    title: str,
    metrics: Sequence[str] = (),
    baseline: str | None = None,
    progress: Callable[[float], None] = lambda _read: None,
) -> str:
    """The report, as HTML.

    Without metrics it has those that the specifications name, else the usual ones; without a baseline the others are
    compared with the first configuration. ``progress`` is called with how many runs were read. ``ConfigError``: an
    unknown metric or baseline.
    """
    runs, names = material.runs, _metrics(material, metrics)
    by_configuration = charts.grouped(runs, lambda run: run.configuration)
    if baseline is not None and baseline not in by_configuration:
        expected = ", ".join(map(repr, list(by_configuration)[:8]))
        raise ConfigError(f"{baseline!r}, expected one of {expected}", field="--baseline")
    first = baseline or next(iter(by_configuration))
    units, meanings = dict.fromkeys(names, ""), dict.fromkeys(names, "")
    for name in names:
        with suppress(ConfigError):  # of a plug-in that is not here
            units[name], meanings[name] = metric(name).unit, metric(name).meaning
        units[name] = material.units.get(name) or units[name]
    player_of: dict[int, int | None] = {}
    players: list[tuple[str, Markup]] = []
    budget = Budget.of(max(sum(run.folder is not None for run in runs), 1))
    for number, run in enumerate(runs):
        player_of[number] = None if run.folder is None else len(players)
        if run.folder is not None:
            players.append((f"{run.configuration}: {run.name}", data_block(playable(run.folder, budget))))
            progress(len(players))
    keys = list(dict.fromkeys(key for run in runs for key, _ in run.varied))
    drawn = [
        {
            "spread": charts.spread(runs, name, units[name]),
            "pairs": charts.paired(runs, first, name, units[name]),
            "curves": [one for key in keys if (one := charts.curves(runs, key, name, units[name])) is not None],
        }
        for name in names
    ]
    others = [name for name in by_configuration if name != first]
    pairs = {
        name: [
            (other, compare(*(_values(by_configuration[one], name) for one in (first, other)), better=better(name)))
            for other in others
        ]
        for name in names
    }
    return _render(
        {
            "title": title,
            "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            "material": material,
            "names": names,
            "units": units,
            "meanings": meanings,
            "runs": runs,
            "configurations": by_configuration,
            "places": charts.grouped(runs, lambda run: ", ".join(filter(None, (run.place, run.platform, run.noise)))),
            "baseline": first,
            "pairs": pairs if others else {},
            "failures": [run for run in runs if run.status != "ok"],
            "player_of": player_of,
            "players": players,
            "charts": data_block(drawn),
            "has_curves": any(each["curves"] for each in drawn),
        }
    )


def data_block(value: Any) -> Markup:
    """JSON that cannot end the script element that it stands in, nor begin a comment."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _render(context: dict[str, Any]) -> str:
    assets = files("moteslam.eval.page")
    style, *own = (assets.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "player.js", "page.js"))
    plotly = distribution("plotly").locate_file("plotly/package_data/plotly.min.js")  # the package is not imported
    scripts = [Path(str(plotly)).read_text(encoding="utf-8"), *own]
    environment = Environment(
        loader=BaseLoader(),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if isinstance(value, Markup) or not isinstance(value, str) else literal(value),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": _number,
        "interval": lambda low, high: interval(_number(low), _number(high)),
        "share": _share,
        "lines": lambda text: Markup("\n").join(escape(literal(line)) for line in text.splitlines()),
        "key": lambda value: "" if value is None else repr(value),  # by which a cell is sorted
        "success": lambda runs: Proportion(sum(run.succeeded for run in runs), len(runs)),
        "summary": charts.summary_of,
        "by_configuration": lambda runs: charts.grouped(runs, lambda run: run.configuration),
        "s": lambda count: "" if count == 1 else "s",
    }
    policy = (
        f"default-src 'none'; script-src {' '.join(map(_hash, scripts))}; style-src {_hash(style)} {_hash('')}; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    context["no_styles"] = STYLE_OF_MAPS.findall(scripts[0])
    template = environment.from_string(assets.joinpath("page.html").read_text(encoding="utf-8"))
    return template.render(**context, policy=Markup(policy), style=Markup(style), scripts=list(map(Markup, scripts)))


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _metrics(material: Material, wanted: Sequence[str]) -> list[str]:
    """The metrics that are shown."""
    having = list(dict.fromkeys(name for run in material.runs for name in run.values))
    if wanted:
        try:
            chosen(wanted)
        except ConfigError as error:
            raise ConfigError(error.problem, field="--metric") from error
        if missing := [name for name in wanted if name not in having]:
            raise ConfigError(f"{missing[0]!r}, which no run has; expected {', '.join(having[:8])}", field="--metric")
        return list(wanted)
    found = [name for name in (*material.wanted, *USUAL) if name in having]
    return list(dict.fromkeys(found or having or material.wanted or ["final.ate"]))[
        : max(MOST_METRICS, len(set(material.wanted)))
    ]


def _values(runs: Sequence[ReportRun], metric: str) -> dict[Key, float | None]:
    """By case, None of runs that failed; runs of which the metric is absent are left out."""
    having = [run for run in runs if run.status != "ok" or metric in run.values]
    return {run.case: run.values[metric] if run.status == "ok" else None for run in having}


def _number(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isfinite(value) else "failed"


def _share(one: Proportion) -> str:
    low, high = one.interval
    return f"{one.count} of {one.total} ({100 * low:.0f} to {100 * high:.0f} %)"
