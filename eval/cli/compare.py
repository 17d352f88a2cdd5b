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
    from moteslam.eval.statistics import Comparison

COUNTS = ("configuration", "pairs", "better", "worse", "equal")
HEAD = (*COUNTS, "median difference", "95 %", "p", "failed", "failed, first")
CSV_HEAD = ("metric", *COUNTS, "median", "low", "high", "p", "failed", "failed_first")


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
    from moteslam.eval import statistics
    from moteslam.eval.metrics.registry import chosen
    from moteslam.eval.populations import populations
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
    others = [each for each in found if each is not first]
    compared: dict[str, dict[str, Comparison]] = {}
    for name in names:
        ours = first.values(name)
        compared[name] = {
            each.name: statistics.compare(ours, each.values(name), better=better(name)) for each in others
        }
    if not any(one.pairs for each in compared.values() for one in each.values()):
        raise InputError(f"no run in common with {first.name} that has {', '.join(names)}", file=paths[-1])
    if form == "json":
        tables = {name: {other: one.as_dict() for other, one in each.items()} for name, each in compared.items()}
        say_json({"baseline": first.name, "metrics": tables})
    elif form == "text":
        for name, each in compared.items():
            say(f"{with_unit(name)}, against {literal(first.name)}")
            say_table([HEAD, *(_shown(other, one) for other, one in each.items())], right=(1, 2, 3, 4))
    else:
        row = _numbers if form == "csv" else _shown
        rows = [(name, *row(other, one)) for name, each in compared.items() for other, one in each.items()]
        head = CSV_HEAD if form == "csv" else ("metric", *HEAD)
        say_table([head, *rows], form, right=() if form == "csv" else (2, 3, 4, 5))


def _shown(name: str, one: Comparison) -> tuple[str, ...]:
    interval = "-" if one.low is None else f"{_signed(one.low)} to {_signed(one.high)}"
    counts = (str(count) for count in (one.pairs, one.wins, one.losses, one.ties))
    return (name, *counts, _signed(one.median), interval, f"{one.p:.2g}", str(one.failed[1]), str(one.failed[0]))


def _numbers(name: str, one: Comparison) -> tuple[str, ...]:
    """For programs: all digits, empty for an absent number."""
    numbers = (one.pairs, one.wins, one.losses, one.ties, one.median, one.low, one.high, one.p, *one.failed[::-1])
    return (name, *("" if number is None else repr(number) for number in numbers))


def _signed(value: float | None) -> str:
    if value is None or isnan(value):
        return "-"
    return "failed" if abs(value) == float("inf") else f"{value:+.3g}"
