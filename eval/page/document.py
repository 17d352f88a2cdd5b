"""The report as one HTML file: tables, charts and a player of runs, with everything that they need in it."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.resources import files
from math import inf, isfinite
from typing import Any

from jinja2 import BaseLoader, Environment, StrictUndefined
from markupsafe import Markup, escape

from moteslam.errors import ConfigError
from moteslam.eval.literal import literal
from moteslam.eval.metrics.registry import chosen, metric
from moteslam.eval.page import charts
from moteslam.eval.page.material import Material, ReportRun
from moteslam.eval.page.player import Budget, playable
from moteslam.eval.statistics.pairs import Comparison, compare
from moteslam.eval.statistics.proportion import Proportion
from moteslam.eval.sweep.tables import better
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


@dataclass(frozen=True)
class Wishes:
    """What a report is asked for.

    Attributes:
        title: of the page.
        metrics: names; empty for those that the specifications name, else the usual ones.
        baseline: name of the configuration that the others are compared with; None for the first.
        players: whether runs can be played.
    """

    title: str
    metrics: tuple[str, ...] = ()
    baseline: str | None = None
    players: bool = True


def page(material: Material, wishes: Wishes, *, progress: Callable[[float], None] | None = None) -> str:
    """The report.

    Args:
        material: what was run.
        wishes: what is shown of it.
        progress: called with how many runs were read.

    Raises:
        ConfigError: an unknown metric or baseline.
        InputError: a result folder that is damaged.
    """
    names = _metrics(material, wishes.metrics)
    configurations = material.configurations
    if wishes.baseline not in (None, *configurations):
        expected = ", ".join(map(repr, configurations[:8]))
        raise ConfigError(f"{wishes.baseline!r}, expected one of {expected}", field="--baseline")
    baseline = wishes.baseline or configurations[0]
    units = {name: _unit(name, material) for name in names}
    folders = [run for run in material.runs if run.folder is not None] if wishes.players else []
    budget = Budget.of(max(len(folders), 1))
    players: list[tuple[str, dict[str, Any]]] = []
    for number, run in enumerate(folders):
        assert run.folder is not None  # or it is none of these
        players.append((f"{run.configuration}: {run.name}", playable(run.folder, budget)))
        if progress is not None:
            progress(number + 1)
    by_metric = {name: _charts(material, name, units[name], baseline) for name in names}
    numbers = {id(run): number for number, run in enumerate(folders)}
    context = {
        "title": wishes.title,
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "material": material,
        "names": names,
        "units": units,
        "meanings": {name: _meaning(name) for name in names},
        "counts": _counts(material.runs),
        "configurations": _configurations(material.runs, names),
        "places": _places(material.runs, names),
        "baseline": baseline,
        "pairs": {name: _pairs(material.runs, baseline, name) for name in names} if len(configurations) > 1 else {},
        "failures": [run for run in material.runs if run.status != "ok"],
        "varied": list(dict.fromkeys(key for run in material.runs for key, _ in run.varied)),
        "player_of": {number: numbers.get(id(run)) for number, run in enumerate(material.runs)},
        "players": [(title, data_block(data)) for title, data in players],
        "charts": data_block([by_metric[name] for name in names]),
        "has_curves": any(each["curves"] for each in by_metric.values()),
    }
    return _render(context)


def data_block(value: Any) -> Markup:
    """JSON that cannot end the script element that it stands in, nor begin a comment."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _render(context: dict[str, Any]) -> str:
    assets = files("moteslam.eval.page")
    style, *own = (assets.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "player.js", "page.js"))
    scripts = [_plotly(), *own]
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
        "lines": _lines,
        "key": _sort_key,
    }
    policy = "; ".join(
        (
            "default-src 'none'",
            f"script-src {' '.join(map(_hash, scripts))}",
            f"style-src {_hash(style)} {_hash('')}",
            "img-src data: blob:",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )
    context["no_styles"] = STYLE_OF_MAPS.findall(scripts[0])
    template = environment.from_string(assets.joinpath("page.html").read_text(encoding="utf-8"))
    return template.render(**context, policy=Markup(policy), style=Markup(style), scripts=list(map(Markup, scripts)))


def _plotly() -> str:
    """plotly.js of the package plotly, which is not imported for it."""
    from importlib.util import find_spec
    from pathlib import Path

    found = find_spec("plotly")
    assert found is not None  # a dependency
    assert found.origin is not None
    return (Path(found.origin).parent / "package_data" / "plotly.min.js").read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _metrics(material: Material, wanted: Sequence[str]) -> list[str]:
    having = material.metrics
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


def _unit(name: str, material: Material) -> str:
    try:
        return material.units.get(name) or metric(name).unit
    except ConfigError:  # a plug-in that is not here
        return ""


def _meaning(name: str) -> str:
    try:
        return metric(name).meaning
    except ConfigError:
        return ""


def _charts(material: Material, name: str, unit: str, baseline: str) -> dict[str, Any]:
    runs = material.runs
    keys = dict.fromkeys(key for run in runs for key, _ in run.varied)
    return {
        "spread": charts.spread(runs, name, unit),
        "pairs": charts.paired(runs, baseline, name, unit),
        "curves": [figure for key in keys if (figure := charts.curves(runs, key, name, unit)) is not None],
    }


def _counts(runs: Sequence[ReportRun]) -> dict[str, Any]:
    return {
        "runs": len(runs),
        "configurations": len({run.configuration for run in runs}),
        "places": len({run.place for run in runs}),
        "seeds": len({run.seed for run in runs}),
        "failed": sum(run.status != "ok" for run in runs),
        "success": Proportion(sum(run.succeeded for run in runs), len(runs)),
    }


def _row(runs: Sequence[ReportRun], names: Sequence[str]) -> dict[str, Any]:
    return {
        "runs": len(runs),
        "success": Proportion(sum(run.succeeded for run in runs), len(runs)),
        "values": [charts.summary_of(runs, name) for name in names],
    }


def _configurations(runs: Sequence[ReportRun], names: Sequence[str]) -> list[dict[str, Any]]:
    """A row a configuration, over all that it was run on."""
    groups = charts.grouped(runs, lambda run: run.configuration)
    return [{"name": name, **_row(members, names)} for name, members in groups.items()]


def _places(runs: Sequence[ReportRun], names: Sequence[str]) -> list[tuple[str, list[dict[str, Any]]]]:
    """For each scenario with robot and noise a row a configuration; none where there is but one of them."""
    groups = charts.grouped(runs, lambda run: ", ".join(filter(None, (run.place, run.platform, run.noise))))
    if len(groups) < 2:
        return []
    return [(place, _configurations(members, names)) for place, members in groups.items()]


def _pairs(runs: Sequence[ReportRun], baseline: str, name: str) -> list[tuple[str, Comparison]]:
    def values(members: Sequence[ReportRun]) -> dict[Any, float | None]:
        return {
            run.case: run.values.get(name) if run.status == "ok" else None
            for run in members
            if run.status != "ok" or name in run.values
        }

    groups = charts.grouped(runs, lambda run: run.configuration)
    first = values(groups[baseline])
    return [
        (other, compare(first, values(members), better=better(name)))
        for other, members in groups.items()
        if other != baseline
    ]


def _number(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isfinite(value) else "failed"


def _share(one: Proportion) -> str:
    low, high = one.interval
    return f"{one.count} of {one.total} ({100 * low:.0f} to {100 * high:.0f} %)"


def _lines(text: str) -> Markup:
    """Text of several lines, each as it is."""
    return Markup("\n").join(escape(literal(line)) for line in text.splitlines())


def _sort_key(value: float | None) -> str:
    """By which a cell is sorted: numbers, failures after them, what is absent last."""
    return "" if value is None else repr(value) if isfinite(value) else repr(inf if value > 0 else -inf)
