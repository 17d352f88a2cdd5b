"""``moteslam compare``: configurations on the same runs, in pairs; and what ``sweep show`` finds of a sweep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from math import isinf, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli import options
from moteslam.eval.cli.text import answer, note
from moteslam.eval.tables import FORMATS, literal

if TYPE_CHECKING:
    from moteslam.eval.sweep.store import Row, Store

COUNTS = ("configuration", "pairs", "better", "worse", "equal")
HEAD = (*COUNTS, "median difference", "95 %", "p", "failed", "failed, first")
CSV_HEAD = ("metric", *COUNTS, "median", "low", "high", "p", "failed", "failed_first")


def compare(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="PATH...", help="Files of sweeps, or result folders; the first is compared with."),
    ],
    metrics: options.Metrics = None,
    baseline: options.Baseline = None,
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
    from moteslam.eval.runs import better, by_configuration, read_runs, values_of

    names = metric_names(metrics)
    found = by_configuration(row for row in read_runs(paths) if row.status)
    if len(found) < 2:
        raise InputError(f"{len(found)} configuration, expected two or more to compare", file=paths[0])
    first = next(iter(found)) if baseline is None else baseline
    if first not in found:
        raise ConfigError(f"{first!r}, expected one of {', '.join(map(repr, found))}", field="--baseline")
    for other, rows in found.items():
        of, counts = values_of(found[first], "scans"), values_of(rows, "scans")
        if unlike := [case for case in of if of[case] and (counts.get(case) or of[case]) != of[case]]:
            text = f"warning: {other}: other numbers of scans in {len(unlike)} of its runs"
            note(f"{text}: another recording of that name, whose errors cannot be compared?")
    compared = {
        name: {
            other: asdict(statistics.compare(values_of(found[first], name), values_of(rows, name), better=better(name)))
            for other, rows in found.items()
            if other != first
        }
        for name in names
    }
    if not any(one["pairs"] for each in compared.values() for one in each.values()):
        raise InputError(f"no run in common with {first} that has {', '.join(names)}", file=paths[-1])
    answer({"baseline": first, "metrics": compared}, _lines(first, compared, form), as_json=as_json)


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
    return "failed" if isinf(value) else f"{value:+.3g}"


PARTS = ("median", "low", "high", "low_quartile", "high_quartile")
"""Of a summary, in the table for programs."""


def metric_names(given: list[str] | None) -> list[str]:
    """The metrics that are asked for, ``final.ate`` by default; an unknown one is refused."""
    from moteslam.eval.metrics.registry import chosen

    chosen(given or ())
    return given or ["final.ate"]


def summed_up(store: Store, wanted: list[str] | None) -> dict[str, Any]:
    """A sweep's hash, its numbers of runs by status, and its groups: what they have in common, successes, summaries."""
    from moteslam.eval.runs import grouped, summary_of
    from moteslam.eval.statistics import Proportion

    rows = [row for row in store.rows() if row.status]
    names = _measured(rows, wanted, store)
    groups = [
        {
            "group": dict(about),
            "runs": len(members),
            "success": Proportion(sum(row.succeeded for row in members), len(members)).as_dict(),
            "metrics": {name: asdict(summary_of(members, name)) for name in names},
        }
        for about, members in grouped(rows, lambda row: tuple(row.about.items())).items()
    ]
    counts = {name or "pending": count for name, count in store.counts().items()}
    return {"hash": store.digest, "runs": counts, "groups": groups}


def _measured(rows: list[Row], wanted: list[str] | None, store: Store) -> list[str]:
    """The metrics that are wanted; by default ``final.ate``, or the first of those that were measured."""
    there = list(dict.fromkeys(name for row in rows if row.status == "ok" for name in (*row.values, *row.costs)))
    if not there:
        return wanted or ["final.ate"]
    if wanted is None:
        others = [name for name in there if name not in ("scans", "distance")]
        return ["final.ate"] if "final.ate" in there else others[:1]
    for name in wanted:
        if name not in there:
            alike = [one for one in there if one.endswith(f".{name}")] or there
            problem = f"{name!r}, which was not measured, expected one of {', '.join(alike)}"
            raise ConfigError(problem, file=store.path, field="--metric")
    return wanted


def summary_lines(found: dict[str, Any], form: str) -> Iterator[str]:
    """A row a group: of each metric the median with its intervals; in ``csv`` every number has a column of its own."""
    from moteslam.eval.runs import varying
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
            cells = [*(str(each["group"].get(key, "")) for key in about), str(each["runs"])]
            cells.append(f"{success['count']}{share}")
            for one in each["metrics"].values():
                if form == "csv":
                    cells += [digits(one[part]) for part in PARTS]
                else:
                    median, *ends = (shown(one[part]) for part in PARTS)
                    cells += [median, interval(*ends[:2]), interval(*ends[2:])]
            rows.append(cells)
        yield FORMATS[form](rows)
    if form == "text":
        yield total(found)


def total(found: dict[str, Any]) -> str:
    """How many runs there are of each status."""
    names = {"pending": "not made yet"}
    return ", ".join(f"{count} {names.get(name, name)}" for name, count in found["runs"].items())


def with_unit(name: str) -> str:
    """A metric with its unit, as ``final.ate [m]``; what is no metric as it is."""
    from moteslam.eval.runs import unit_of

    return f"{name} [{unit}]" if (unit := unit_of(name)) else name


def digits(value: float | None) -> str:
    """For programs: all digits, nothing where there is no number, ``inf`` for failures."""
    return "" if value is None else repr(value)


def shown(value: float | None) -> str:
    """For people."""
    return "-" if value is None else "failed" if isinf(value) else f"{value:.4g}"
