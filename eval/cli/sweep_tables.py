"""What ``moteslam sweep show`` finds and prints: summaries, and the best configuration within a budget of time."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict
from math import inf, isinf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moteslam.errors import ConfigError, InputError
from moteslam.eval.tables import FORMATS

if TYPE_CHECKING:
    from moteslam.eval.sweep.spec import SweepSpec
    from moteslam.eval.sweep.store import Row, Store

COST = "cpu_per_scan"
BUDGET = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*(us|ms|s)")
MILLISECONDS = {"us": 1e-3, "ms": 1.0, "s": 1e3}
PARTS = ("median", "low", "high", "low_quartile", "high_quartile")
"""Of a summary, in the table for programs."""


def metric_names(given: list[str] | None) -> list[str]:
    """The metrics that are asked for, ``final.ate`` by default; an unknown one is refused."""
    from moteslam.eval.metrics.registry import chosen

    chosen(given or ())
    return given or ["final.ate"]


def summed_up(store: Store, spec: SweepSpec, wanted: list[str] | None) -> dict[str, Any]:
    """A sweep's hash, its numbers of runs by status, and its groups: what they have in common, successes, summaries."""
    from moteslam.eval.sweep.tables import summaries

    runs = list(store.rows())
    groups = [
        {
            "group": group.about,
            "runs": group.runs,
            "success": group.success.as_dict(),
            "metrics": {name: asdict(summary) for name, summary in group.values.items()},
        }
        for group in summaries(runs, _measured(runs, wanted, store.path), dict(spec.success))
    ]
    counts = {name or "pending": count for name, count in store.counts().items()}
    return {"hash": store.digest, "runs": counts, "groups": groups}


def _measured(runs: list[Row], wanted: list[str] | None, file: Path) -> list[str]:
    """The metrics that are wanted; by default ``final.ate``, or the first of those that were measured."""
    there = list(dict.fromkeys(name for row in runs if row.status == "ok" for name in (*row.values, *row.costs)))
    if not there:
        return wanted or ["final.ate"]
    if wanted is None:
        return (
            ["final.ate"] if "final.ate" in there else [name for name in there if name not in ("scans", "distance")][:1]
        )
    for name in wanted:
        if name not in there:
            alike = [one for one in there if one.endswith(f".{name}")] or there
            problem = f"{name!r}, which was not measured, expected one of {', '.join(alike)}"
            raise ConfigError(problem, file=file, field="--metric")
    return wanted


def summary_lines(found: dict[str, Any], form: str) -> Iterator[str]:
    """A row a group: of each metric the median with its intervals; in ``csv`` every number has a column of its own."""
    from moteslam.eval.sweep.tables import varying
    from moteslam.robot.values import interval

    groups = found["groups"]
    if groups:
        about, names = varying([each["group"] for each in groups]), list(groups[0]["metrics"])
        if form == "csv":
            columns = [f"{name}.{part}" for name in names for part in PARTS]
        else:
            columns = [column for name in names for column in (with_unit(name), "95 %", "quartiles")]
        rows = [[*about, "runs", "success", *columns]]
        for each in groups:
            success = each["success"]
            share = f" ({100 * success['low']:.0f} to {100 * success['high']:.0f} %)" * (form != "csv")
            cells = [
                *(str(each["group"].get(key, "")) for key in about),
                str(each["runs"]),
                f"{success['count']}{share}",
            ]
            for one in each["metrics"].values():
                if form == "csv":
                    cells += [digits(one[part]) for part in PARTS]
                else:
                    median, *ends = (_number(one[part]) for part in PARTS)
                    cells += [median, interval(*ends[:2]), interval(*ends[2:])]
            rows.append(cells)
        yield FORMATS[form](rows)
    if form == "text":
        yield total(found)


def total(found: dict[str, Any]) -> str:
    """How many runs there are of each status."""
    names = {"pending": "not made yet"}
    return ", ".join(f"{count} {names.get(name, name)}" for name, count in found["runs"].items())


def affordable(file: Path, budget: str, metrics: list[str]) -> list[dict[str, Any]]:
    """The configurations of a sweep whose median processor time a scan is within a budget, the best first.

    Best is the best median of the metric over all runs, failed ones among them; the others are compared with it in
    pairs, since medians that differ by less than their seeds do say little.
    """
    from moteslam.eval.populations import populations, values_of
    from moteslam.eval.statistics import Summary, compare
    from moteslam.eval.sweep.tables import better

    given = BUDGET.fullmatch(budget.strip())
    if given is None or not float(given[1]) > 0:
        raise ConfigError(f"{budget!r}, expected a time above 0 a scan, such as 10ms", field="--budget")
    if len(metrics) > 1:
        raise ConfigError("more than one with --budget, expected what the best is chosen by", field="--metric")
    (metric,), limit = metrics, float(given[1]) * MILLISECONDS[given[2]]

    def summary(values: dict[Any, float | None], metric: str) -> Summary:
        there = [value for value in values.values() if value is not None]
        return Summary.of(there, len(values) - len(there), better=better(metric))

    found = populations([file])
    costs = {name: [v for v in values_of(runs, COST).values() if v is not None] for name, runs in found.items()}
    known = {name: median for name, cost in costs.items() if (median := Summary.of(cost).median) is not None}
    if not known:
        raise InputError("without times, expected a sweep that was made with --time", file=file, field=COST)
    values = {name: values_of(found[name], metric) for name, cost in known.items() if cost <= limit}
    if not values:
        name = min(known, key=known.__getitem__)
        problem = f"nothing costs {limit:g} ms a scan or less; the cheapest is {name}, {known[name]:.3g} ms"
        raise InputError(problem, file=file, field=COST)
    sign = 1.0 if better(metric) == "lower" else -1.0
    summaries = {name: summary(each, metric) for name, each in values.items()}
    best, *others = sorted(values, key=lambda name: inf if (m := summaries[name].median) is None else sign * m)
    return [
        {
            "configuration": name,
            "cpu_per_scan_ms": known[name],
            metric: asdict(summaries[name]),
            "best_against_it": None
            if name == best
            else asdict(compare(values[name], values[best], better=better(metric))),
        }
        for name in (best, *others)
    ]


def affordable_lines(found: list[dict[str, Any]], metric: str, form: str) -> Iterator[str]:
    """A row a configuration."""
    from moteslam.robot.values import interval

    rows = [("configuration", "ms a scan", metric, "95 %", "the best beats it in")]
    for each in found:
        one, against = each[metric], each["best_against_it"]
        beaten = "" if against is None else f"{against['wins']} of {against['pairs']}, p {against['p']:.2g}"
        within = interval(_number(one["low"]), _number(one["high"]))
        cost = f"{each['cpu_per_scan_ms']:.3g}"
        rows.append((each["configuration"], cost, _number(one["median"]), within, beaten))
    yield FORMATS[form](rows)


def with_unit(name: str) -> str:
    """A metric with its unit, as ``final.ate [m]``; what is no metric as it is."""
    from moteslam.eval.metrics.registry import metric

    try:
        unit = metric(name).unit
    except ConfigError:  # scans, distance, or of a plug-in that is not here
        return name
    return f"{name} [{unit}]" if unit else name


def digits(value: float | None) -> str:
    """For programs: all digits, nothing where there is no number, ``inf`` for failures."""
    return "" if value is None else repr(value)


def _number(value: float | None) -> str:
    return "-" if value is None else "failed" if isinf(value) else f"{value:.4g}"
