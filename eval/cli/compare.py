"""``moteslam compare``: configurations on the same runs, in pairs."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli import options
from moteslam.eval.cli.sweep_tables import with_unit
from moteslam.eval.cli.text import say, say_json, say_table
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.eval.statistics.pairs import Comparison

HEAD = (
    "configuration",
    "pairs",
    "better",
    "worse",
    "equal",
    "median difference",
    "95 %",
    "p",
    "failed",
    "failed, first",
)


def compare(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="PATH...", help="Files of sweeps, or result folders; the first is compared with."),
    ],
    metrics: Annotated[
        list[str] | None, typer.Option("--metric", metavar="NAME", help="Which metrics [final.ate]; repeatable.")
    ] = None,
    baseline: Annotated[
        str | None, typer.Option(metavar="NAME", help="Compare with this configuration [the first].")
    ] = None,
    form: options.Format = None,
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
    from moteslam.eval.metrics.registry import chosen
    from moteslam.eval.populations import populations
    from moteslam.eval.statistics import pairs
    from moteslam.eval.sweep.tables import better

    names = metrics or ["final.ate"]
    chosen(names)
    form = options.chosen_format(form, as_json=as_json)
    found = populations(paths)
    if len(found) < 2:
        raise InputError(f"{len(found)} configuration, expected two or more to compare", file=paths[0])
    first = next((each for each in found if baseline in (None, each.name)), None)
    if first is None:
        expected = ", ".join(repr(each.name) for each in found)
        raise ConfigError(f"{baseline!r}, expected one of {expected}", field="--baseline")
    compared: dict[str, dict[str, Comparison]] = {
        name: {
            each.name: pairs.compare(first.values(name), each.values(name), better=better(name))
            for each in found
            if each is not first
        }
        for name in names
    }
    if not any(one.pairs for each in compared.values() for one in each.values()):
        raise InputError(f"no run in common with {first.name} that has {', '.join(names)}", file=paths[-1])
    if form == "json":
        say_json(
            {
                "baseline": first.name,
                "metrics": {
                    name: {other: one.as_dict() for other, one in each.items()} for name, each in compared.items()
                },
            }
        )
        return
    if form == "csv":
        say_table(_numbers(compared), form)
        return
    if form != "text":
        rows: list[tuple[str, ...]] = [("metric", *HEAD)]
        rows += [(name, *row) for name, each in compared.items() for row in _rows(each)]
        say_table(rows, form, right=(2, 3, 4, 5))
        return
    for name, each in compared.items():
        say(f"{with_unit(name)}, against {literal(first.name)}")
        say_table([HEAD, *_rows(each)], right=(1, 2, 3, 4))


def _rows(each: dict[str, Comparison]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for name, one in each.items():
        interval = "-" if one.low is None else f"{_signed(one.low)} to {_signed(one.high)}"
        rows.append(
            (
                name,
                *(str(count) for count in (one.pairs, one.wins, one.losses, one.ties)),
                _signed(one.median),
                interval,
                f"{one.p:.2g}",
                str(one.failed[1]),
                str(one.failed[0]),
            )
        )
    return rows


def _numbers(compared: dict[str, dict[str, Comparison]]) -> list[tuple[str, ...]]:
    """The table for programs: a column a number, with all digits, empty where there is none."""
    rows: list[tuple[str, ...]] = [
        (
            "metric",
            "configuration",
            "pairs",
            "better",
            "worse",
            "equal",
            "median",
            "low",
            "high",
            "p",
            "failed",
            "failed_first",
        )
    ]
    for name, each in compared.items():
        for other, one in each.items():
            numbers = (one.pairs, one.wins, one.losses, one.ties, one.median, one.low, one.high, one.p)
            found = ("" if number is None else repr(number) for number in (*numbers, *one.failed[::-1]))
            rows.append((name, other, *found))
    return rows


def _signed(value: float | None) -> str:
    if value is None or isnan(value):
        return "-"
    return "failed" if abs(value) == float("inf") else f"{value:+.3g}"
