"""``moteslam compare``: configurations on the same runs, in pairs; and the best one within a budget of time."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from math import inf, isnan
from pathlib import Path
from typing import Annotated, Any

import typer

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli import options
from moteslam.eval.cli.sweep_tables import digits, metric_names, shown, with_unit
from moteslam.eval.cli.text import answer
from moteslam.eval.tables import FORMATS, literal

COUNTS = ("configuration", "pairs", "better", "worse", "equal")
HEAD = (*COUNTS, "median difference", "95 %", "p", "failed", "failed, first")
CSV_HEAD = ("metric", *COUNTS, "median", "low", "high", "p", "failed", "failed_first")

COST = "cpu_per_scan"
BUDGET = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*(us|ms|s)")
MILLISECONDS = {"us": 1e-3, "ms": 1.0, "s": 1e3}

Runs = dict[tuple[Any, ...], dict[str, float] | None]
"""Values by metric of each run of a configuration, None of one that failed; runs of two configurations with the same
key (scenario or recording, platform, noise, duration, seed) are a pair."""


def compare(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="PATH...", help="Files of sweeps, or result folders; the first is compared with."),
    ],
    metrics: options.Metrics = None,
    baseline: Annotated[
        str | None, typer.Option(metavar="NAME", help="Compare with this configuration [the first].")
    ] = None,
    form: options.Format = "text",
    as_json: options.Json = False,
) -> None:
    """Compare configurations on the same scenarios, platforms and seeds, in pairs.

    Of each against the first: how often it is better, the median difference with its 95 % interval, and how probable
    so uneven wins are between equals (sign test). A run that failed loses against one that did not.

    \b
    Examples:
      moteslam compare particles.sweep
      moteslam compare before.sweep after.sweep --metric final.ate --metric cpu_per_scan
      moteslam compare result_a result_b --metric map_f1
      moteslam compare particles.sweep --format markdown
    """  # noqa: D301
    from moteslam.eval import statistics
    from moteslam.eval.sweep.tables import better

    names = metric_names(metrics)
    found = populations(paths)
    if len(found) < 2:
        raise InputError(f"{len(found)} configuration, expected two or more to compare", file=paths[0])
    first = next(iter(found)) if baseline is None else baseline
    if first not in found:
        raise ConfigError(f"{first!r}, expected one of {', '.join(map(repr, found))}", field="--baseline")
    compared: dict[str, dict[str, Any]] = {}
    for name in names:
        ours = values_of(found[first], name)
        others = {other: values_of(runs, name) for other, runs in found.items() if other != first}
        compared[name] = {
            other: asdict(statistics.compare(ours, each, better=better(name))) for other, each in others.items()
        }
    if not any(one["pairs"] for each in compared.values() for one in each.values()):
        raise InputError(f"no run in common with {first} that has {', '.join(names)}", file=paths[-1])
    answer({"baseline": first, "metrics": compared}, _lines(first, compared, form), as_json=as_json)


def populations(paths: Sequence[Path]) -> dict[str, Runs]:
    """The configurations of sweeps, and of result folders, by name in their order.

    A file of a sweep has one for each of its configurations, with each combination of what varies; of several files the
    name of each stands before them, its path where two are named alike. A result folder has one, named by the folder.
    """
    from moteslam.eval.results import read_result_folder
    from moteslam.eval.sweep.store import opened
    from moteslam.eval.sweep.tables import group_of

    found: dict[str, Runs] = {}
    alike = len({path.stem for path in paths}) < len(paths)
    for path in paths:
        if path.is_dir():
            result = read_result_folder(path)
            found[str(path)] = {(result.run.get("recording"), result.run.get("seed")): result.values}
            continue
        prefix = f"{path if alike else path.stem}: " if len(paths) > 1 else ""
        with opened(path) as store:
            for row in store.rows():
                if row.status:
                    run = row.run
                    key = (group_of(row)["scenario"], run.platform, run.noise, run.duration, run.seed)
                    found.setdefault(prefix + run.configured, {})[key] = row.known if row.status == "ok" else None
    return found


def values_of(runs: Runs, metric: str) -> dict[tuple[Any, ...], float | None]:
    """One metric's, None of runs that failed; runs of which it is absent are left out."""
    return {
        key: None if values is None else values[metric]
        for key, values in runs.items()
        if values is None or metric in values
    }


def _lines(first: str, compared: dict[str, dict[str, Any]], form: str) -> Iterator[str]:
    if form == "text":
        for name, each in compared.items():
            yield f"{with_unit(name)}, against {literal(first)}"
            yield FORMATS[form]([HEAD, *(_shown(other, one) for other, one in each.items())])
        return
    row = _numbers if form == "csv" else _shown
    rows = [(name, *row(other, one)) for name, each in compared.items() for other, one in each.items()]
    yield FORMATS[form]([CSV_HEAD if form == "csv" else ("metric", *HEAD), *rows])


def _shown(name: str, one: dict[str, Any]) -> tuple[str, ...]:
    interval = "-" if one["low"] is None else f"{_signed(one['low'])} to {_signed(one['high'])}"
    counts = (str(one[count]) for count in ("pairs", "wins", "losses", "ties"))
    failed, failed_first = one["failed"][::-1]
    return (name, *counts, _signed(one["median"]), interval, f"{one['p']:.2g}", str(failed), str(failed_first))


def _numbers(name: str, one: dict[str, Any]) -> tuple[str, ...]:
    columns = ("pairs", "wins", "losses", "ties", "median", "low", "high", "p")
    return (name, *(digits(one[column]) for column in columns), *map(str, one["failed"][::-1]))


def _signed(value: float | None) -> str:
    if value is None or isnan(value):
        return "-"
    return "failed" if abs(value) == float("inf") else f"{value:+.3g}"


def affordable(file: Path, budget: str, metrics: list[str]) -> list[dict[str, Any]]:
    """The configurations of a sweep whose median processor time a scan is within a budget, the best first.

    Best is the best median of the metric over all runs, failed ones among them; the others are compared with it in
    pairs, since medians that differ by less than their seeds do say little.
    """
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
        within = interval(shown(one["low"]), shown(one["high"]))
        cost = f"{each['cpu_per_scan_ms']:.3g}"
        rows.append((each["configuration"], cost, shown(one["median"]), within, beaten))
    yield FORMATS[form](rows)
