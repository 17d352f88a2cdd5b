"""What ``moteslam sweep show`` prints: summaries, and the best configuration within a budget of processor time."""

from __future__ import annotations

import re
from math import inf, isinf
from pathlib import Path
from typing import TYPE_CHECKING

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli.text import note, say, say_json, say_table

if TYPE_CHECKING:
    from moteslam.eval.sweep.spec import SweepSpec
    from moteslam.eval.sweep.store import Row, Store
    from moteslam.eval.sweep.tables import GroupSummary

MOST_SHOWN = 40
"""Differences in the table that is printed."""
COST = "cpu_per_scan"
BUDGET = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*(us|ms|s)")
MILLISECONDS = {"us": 1e-3, "ms": 1.0, "s": 1e3}
PARTS = ("median", "low", "high", "low_quartile", "high_quartile")
"""Of a summary, in the table for programs."""


def metric_names(given: list[str] | None) -> list[str]:
    """The metrics that are asked for, ``final.ate`` by default.

    Raises:
        ConfigError: an unknown metric.
    """
    from moteslam.eval.metrics.registry import chosen

    chosen(given)
    return given or ["final.ate"]


def say_summaries(store: Store, spec: SweepSpec, wanted: list[str] | None, form: str) -> None:
    """A row a configuration and scenario: runs, successes, and of each metric the median with its intervals.

    As ``text``, ``json`` or a format of ``moteslam.eval.tables``; in ``csv`` every number has a column of its own, with
    all of its digits. Runs without a result are counted below the table, or on stderr.

    Raises:
        ConfigError: a metric was not measured; those that were are named.
    """
    from moteslam.eval.sweep.tables import summaries, varying

    counts, runs = store.counts(), list(store.rows())
    names = _measured(runs, wanted, store.path)
    found = summaries(runs, names, dict(spec.success))
    if form == "json":
        groups = [
            {
                "group": group.about,
                "runs": group.runs,
                "success": group.success.as_dict(),
                "metrics": {name: summary.as_dict() for name, summary in group.values.items()},
            }
            for group in found
        ]
        say_json({"hash": store.digest, "runs": {name or "pending": n for name, n in counts.items()}, "groups": groups})
        return
    if found:
        about = varying(found)
        rows = [[*about, *_head(names, form)]]
        rows += [[*(str(group.about.get(key, "")) for key in about), *_cells(group, names, form)] for group in found]
        say_table(rows, form, right=() if form == "text" else range(len(about), len(rows[0])))
    total = ", ".join(f"{count} {name or 'not made yet'}" for name, count in counts.items())
    if form == "text":
        say(total)
    elif set(counts) != {"ok"}:
        note(f"warning: {store.path}: {total}")


def _measured(runs: list[Row], wanted: list[str] | None, file: Path) -> list[str]:
    """The metrics that are wanted; by default ``final.ate``, or the first of those that were measured."""
    there = list(dict.fromkeys(name for row in runs if row.status == "ok" for name in (*row.values, *row.costs)))
    if not there:
        return wanted or ["final.ate"]
    if wanted is None:
        others = [name for name in there if name not in ("scans", "distance")]
        return ["final.ate"] if "final.ate" in there else others[:1]
    for name in wanted:
        if name not in there:
            alike = [one for one in there if one.endswith(f".{name}")] or there
            problem = f"{name!r}, which was not measured, expected one of {', '.join(alike)}"
            raise ConfigError(problem, file=file, field="--metric")
    return wanted


def _head(names: list[str], form: str) -> list[str]:
    if form == "csv":
        return ["runs", "success", *(f"{name}.{part}" for name in names for part in PARTS)]
    return ["runs", "success", *(cell for name in names for cell in (with_unit(name), "95 %", "quartiles"))]


def _cells(group: GroupSummary, names: list[str], form: str) -> list[str]:
    """For people; for programs (``csv``) all digits, nothing where there is no number, ``inf`` for failures."""
    from moteslam.robot.values import interval

    summaries = [group.values[name] for name in names]
    if form == "csv":
        numbers = [getattr(summary, part) for summary in summaries for part in PARTS]
        cells = ["" if number is None else repr(number) for number in numbers]
        return [str(group.runs), str(group.success.count), *cells]
    low, high = (100 * share for share in group.success.interval)
    cells = [str(group.runs), f"{group.success.count} ({low:.0f} to {high:.0f} %)"]
    for summary in summaries:
        cells += [
            _number(summary.median),
            interval(_number(summary.low), _number(summary.high)),
            interval(_number(summary.low_quartile), _number(summary.high_quartile)),
        ]
    return cells


def say_affordable(file: Path, budget: str, metrics: list[str], form: str) -> None:
    """The configurations of a sweep whose median processor time a scan is within a budget, the best first.

    Best is the best median of the metric over all runs, failed ones among them; the others are compared with it in
    pairs, since medians that differ by less than their seeds do say little.

    Raises:
        ConfigError: the budget is no time, or there are several metrics.
        InputError: times were not measured, or no configuration is within the budget; the cheapest is named.
    """
    from moteslam.eval.populations import populations
    from moteslam.eval.statistics import Summary, compare
    from moteslam.eval.sweep.tables import better
    from moteslam.robot.values import interval

    given = BUDGET.fullmatch(budget.strip())
    if given is None or not float(given[1]) > 0:
        raise ConfigError(f"{budget!r}, expected a time above 0 a scan, such as 10ms", field="--budget")
    if len(metrics) > 1:
        raise ConfigError("more than one with --budget, expected what the best is chosen by", field="--metric")
    (metric,), limit = metrics, float(given[1]) * MILLISECONDS[given[2]]
    found = {each.name: each for each in populations([file])}
    costs = {name: Summary.of([v for v in each.values(COST).values() if v is not None]) for name, each in found.items()}
    known = {name: cost.median for name, cost in costs.items() if cost.median is not None}
    if not known:
        raise InputError("without times, expected a sweep that was made with --time", file=file, field=COST)
    values = {name: found[name].values(metric) for name, cost in known.items() if cost <= limit}
    if not values:
        name = min(known, key=known.__getitem__)
        problem = f"nothing costs {limit:g} ms a scan or less; the cheapest is {name}, {known[name]:.3g} ms"
        raise InputError(problem, file=file, field=COST)
    sign = 1.0 if better(metric) == "lower" else -1.0
    summaries = {}
    for name, of_runs in values.items():
        there = [value for value in of_runs.values() if value is not None]
        summaries[name] = Summary.of(there, len(of_runs) - len(there), better=better(metric))
    medians = {name: one.median for name, one in summaries.items()}
    ordered = sorted(values, key=lambda name: inf if (median := medians[name]) is None else sign * median)
    best = ordered[0]
    against = {name: compare(values[name], values[best], better=better(metric)) for name in ordered[1:]}
    if form == "json":
        say_json(
            [
                {
                    "configuration": name,
                    "cpu_per_scan_ms": known[name],
                    metric: summaries[name].as_dict(),
                    "best_against_it": None if name == best else against[name].as_dict(),
                }
                for name in ordered
            ]
        )
        return
    rows = [("configuration", "ms a scan", metric, "95 %", "the best beats it in")]
    for name in ordered:
        one = summaries[name]
        beaten = "" if name == best else f"{(a := against[name]).wins} of {a.pairs}, p {a.p:.2g}"
        within = interval(_number(one.low), _number(one.high))
        rows.append((name, f"{known[name]:.3g}", _number(one.median), within, beaten))
    say_table(rows, form, right=(1,))


def with_unit(name: str) -> str:
    """A metric with its unit, as ``final.ate [m]``; what is no metric as it is."""
    from moteslam.eval.metrics.registry import metric

    try:
        unit = metric(name).unit
    except ConfigError:  # scans, distance, or of a plug-in that is not here
        return name
    return f"{name} [{unit}]" if unit else name


def _number(value: float | None) -> str:
    return "-" if value is None else "failed" if isinf(value) else f"{value:.4g}"
