"""``moteslam compare``: configurations on the same runs, in pairs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from math import isinf, isnan
from pathlib import Path
from typing import Annotated, Any

import typer

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli import options
from moteslam.eval.cli.sweep_tables import digits, metric_names, with_unit
from moteslam.eval.cli.text import answer
from moteslam.eval.tables import FORMATS, literal

COUNTS = ("configuration", "pairs", "better", "worse", "equal")
HEAD = (*COUNTS, "median difference", "95 %", "p", "failed", "failed, first")
CSV_HEAD = ("metric", *COUNTS, "median", "low", "high", "p", "failed", "failed_first")


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
    from moteslam.eval.runs import better, by_configuration, read_runs, values_of

    names = metric_names(metrics)
    found = by_configuration(row for row in read_runs(paths) if row.status)
    if len(found) < 2:
        raise InputError(f"{len(found)} configuration, expected two or more to compare", file=paths[0])
    first = next(iter(found)) if baseline is None else baseline
    if first not in found:
        raise ConfigError(f"{first!r}, expected one of {', '.join(map(repr, found))}", field="--baseline")
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
