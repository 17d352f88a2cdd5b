"""What the commands of sweeps print: summaries, what a budget allows, and differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli.text import note, say, say_json, say_table, table
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.eval.sweep.differences import Difference
    from moteslam.eval.sweep.spec import SweepSpec
    from moteslam.eval.sweep.store import Row, Store
    from moteslam.eval.sweep.tables import GroupSummary

MOST_SHOWN = 40
"""Differences in the table that is printed."""
SHOWN = 16
"""Digits of a hash there."""


def say_specs(*, as_json: bool) -> None:
    """The specifications that come with the package: how many runs each has, their hash, what it is for."""
    from moteslam.eval.sweep.bundled import bundled_specs, digest
    from moteslam.eval.sweep.plan import plan
    from moteslam.eval.sweep.spec import read_spec

    found = []
    for name, file in bundled_specs().items():
        spec = read_spec(file)
        runs = plan(spec, check=False)
        found.append({"name": name, "runs": len(runs), "hash": digest(runs), "description": spec.description})
    if as_json:
        say_json(found)
        return
    rows = [("name", "runs", "hash", "what it is for")]
    rows += [(f"{one['name']}", f"{one['runs']}", f"{one['hash']}"[:SHOWN], f"{one['description']}") for one in found]
    say(table(rows, right=(1,)))


def say_summaries(store: Store, spec: SweepSpec, wanted: list[str] | None, form: str) -> None:
    """A row a configuration and scenario: runs, successes, and of each metric the median with its intervals.

    As ``text``, ``json`` or a format of ``moteslam.eval.tables``; in ``csv`` every number has a column of its own, with
    all of its digits. Runs without a result are counted below the table, or on stderr.

    Raises:
        ConfigError: a metric was not measured; those that were are named.
    """
    from moteslam.eval.sweep.tables import summaries

    counts, runs = store.counts(), list(store.rows())
    names = _measured(runs, wanted, store.path)
    found = summaries(runs, names, dict(spec.success))
    if form == "json":
        say_json(
            {
                "hash": store.digest,
                "runs": {name or "pending": count for name, count in counts.items()},
                "groups": list(map(_as_dict, found)),
            }
        )
        return
    if found:
        rows, words = _numbers(found, names) if form == "csv" else _rows(found, names)
        say_table(rows, form, right=() if form == "text" else range(words, len(rows[0])))
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


def say_affordable(file: Path, text: str, metrics: list[str], form: str) -> None:
    """The configurations of a sweep within a budget, the best first."""
    from moteslam.eval.populations import populations
    from moteslam.eval.sweep.budget import affordable, parse_budget
    from moteslam.robot.values import interval

    budget = parse_budget(text)
    if len(metrics) > 1:
        raise ConfigError("more than one with --budget, expected what the best is chosen by", field="--metric")
    try:
        choices = affordable(populations([file]), budget, metrics[0])
    except InputError as error:
        raise InputError(error.problem, file=file, field=error.field) from error
    if form == "json":
        say_json(
            [
                {
                    "configuration": each.name,
                    "cpu_per_scan_ms": each.cost,
                    metrics[0]: each.value.as_dict(),
                    "best_against_it": None if each.against is None else each.against.as_dict(),
                }
                for each in choices
            ]
        )
        return
    rows = [("configuration", "ms a scan", metrics[0], "95 %", "the best beats it in")]
    for each in choices:
        beaten = "" if each.against is None else f"{each.against.wins} of {each.against.pairs}, p {each.against.p:.2g}"
        within = interval(_number(each.value.low), _number(each.value.high))
        rows.append((each.name, f"{each.cost:.3g}", _number(each.value.median), within, beaten))
    say_table(rows, form, right=(1,))


def say_differences(
    found: Sequence[Difference], files: tuple[Path, Path], common: int, alone: int, *, as_json: bool
) -> None:
    """Where two sweeps differ: how many runs both have, and how many one of the two alone."""
    from moteslam.robot.values import counted

    if as_json:
        say_json({"runs": common, "in_one_alone": alone, "differences": [asdict(each) for each in found]})
        return
    if found:
        rows: list[tuple[str, ...]] = [("run", "column", *map(literal, files))]
        rows += [tuple(map(literal, (each.run, each.column, each.first, each.second))) for each in found[:MOST_SHOWN]]
        say(table(rows))
    if len(found) > MOST_SHOWN:
        say(f"... and {len(found) - MOST_SHOWN} more: --json has all")
    more = f", {alone} in one of the two alone" if alone else ""
    say(f"{counted(len(found), 'difference')} in {counted(common, 'run')}{more}")


def _as_dict(group: GroupSummary) -> dict[str, Any]:
    return {
        "group": group.about,
        "runs": group.runs,
        "success": group.success.as_dict(),
        "metrics": {name: summary.as_dict() for name, summary in group.values.items()},
    }


def _rows(groups: list[GroupSummary], names: list[str]) -> tuple[list[list[str]], int]:
    """The table for people, and how many of its columns are words."""
    from moteslam.eval.sweep.tables import varying
    from moteslam.robot.values import interval

    about = varying(groups)
    head = [*about, "runs", "success"]
    for name in names:
        head += [with_unit(name), "95 %", "quartiles"]
    rows = [head]
    for group in groups:
        row = [str(group.about.get(key, "")) for key in about]
        row += [str(group.runs), f"{group.success.count} ({_share(group.success.interval)})"]
        for name in names:
            summary = group.values[name]
            row += [
                _number(summary.median),
                interval(_number(summary.low), _number(summary.high)),
                interval(_number(summary.low_quartile), _number(summary.high_quartile)),
            ]
        rows.append(row)
    return rows, len(about)


def with_unit(name: str) -> str:
    """A metric with its unit, as ``final.ate [m]``; what is no metric as it is."""
    from moteslam.eval.metrics.registry import metric

    try:
        unit = metric(name).unit
    except ConfigError:  # scans, distance, or of a plug-in that is not here
        return name
    return f"{name} [{unit}]" if unit else name


def _numbers(groups: list[GroupSummary], names: list[str]) -> tuple[list[list[str]], int]:
    """The table for programs: a column a number, with all digits, empty where there is none, ``inf`` for failures."""
    from moteslam.eval.sweep.tables import varying

    about = varying(groups)
    parts = ("median", "low", "high", "low_quartile", "high_quartile")
    rows = [[*about, "runs", "success", *(f"{name}.{part}" for name in names for part in parts)]]
    for group in groups:
        numbers = [getattr(group.values[name], part) for name in names for part in parts]
        row = [str(group.about.get(key, "")) for key in about]
        row += [str(group.runs), str(group.success.count)]
        rows.append(row + ["" if number is None else repr(number) for number in numbers])
    return rows, len(about)


def _share(interval: tuple[float, float]) -> str:
    return f"{100 * interval[0]:.0f} to {100 * interval[1]:.0f} %"


def _number(value: float | None) -> str:
    return "-" if value is None else "failed" if abs(value) == float("inf") else f"{value:.4g}"
