"""The runs of a sweep as tables: a row a configuration and scenario, with its intervals, or a row a run."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.eval.metrics.catalogue import COSTS
from moteslam.eval.metrics.registry import metric
from moteslam.eval.statistics import Better, Proportion, Summary
from moteslam.eval.sweep.store import Row, opened
from moteslam.eval.tables import comma_separated, literal
from moteslam.robot.files import read_text, write_atomically

MAX_BYTES = 1_000_000_000
"""No exported table is larger."""
ABOUT = ("id", "scenario", "recording", "platform", "noise", "seed", "configuration")
"""Columns that say which run a row is, beside those with a point that vary."""

Table = dict[str, dict[str, str]]
"""Of each run, by its id, every column as text."""


@dataclass(frozen=True)
class GroupSummary:
    """The runs of one configuration on one scenario, over its seeds: what they have in common by column, how many were
    made, and how many of these succeeded, as of ``SweepSpec.success``; summaries by metric.
    """

    about: dict[str, Any]
    runs: int
    success: Proportion
    values: dict[str, Summary]


def group_of(row: Row) -> dict[str, Any]:
    """What a run has in common with those of other seeds, by column."""
    run = row.run
    place = run.scenario or Path(run.recording).name
    return {
        "scenario": Path(place).stem if place.endswith(".toml") else place,
        "platform": Path(run.platform).stem,
        "noise": run.noise,
        "configuration": run.configuration,
        "version": run.version,
        **dict(run.varied),
    }


def summaries(rows: Iterable[Row], metrics: Sequence[str], success: dict[str, float]) -> list[GroupSummary]:
    """A summary for each configuration on each scenario, in the order of their first runs; of runs that were made."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        if row.status:
            groups.setdefault(tuple(group_of(row).items()), []).append(row)
    found = []
    for group, members in groups.items():
        good = [row.known for row in members if row.status == "ok"]
        failed = len(members) - len(good)
        values = {name: Summary.of([one.get(name) for one in good], failed, better=better(name)) for name in metrics}
        succeeded = Proportion(sum(succeeds(row, success) for row in members), len(members))
        found.append(GroupSummary(dict(group), len(members), succeeded, values))
    return found


def varying(groups: Sequence[dict[str, Any]]) -> list[str]:
    """The columns in which some of the groups have something."""
    keys = dict.fromkeys(key for group in groups for key in group)
    return [key for key in keys if any(group.get(key, "") != "" for group in groups)]


def better(name: str) -> Better:
    """Which values of a metric are better; lower of one where neither is."""
    try:
        return metric(name).better or "lower"
    except ConfigError:  # scans, distance
        return "lower"


def succeeds(row: Row, success: dict[str, float]) -> bool:
    """Whether a run ended well, with each value present and within its limit."""
    values = [(row.values.get(name), limit) for name, limit in success.items()]
    return row.status == "ok" and all(value is not None and value <= limit for value, limit in values)


def read_table(path: Path) -> Table:
    """The runs of a sweep, or of a table that ``sweep export`` wrote, those that were made."""
    if path.suffix == ".csv":
        rows = list(csv.DictReader(read_text(path, "a table of a sweep", limit=MAX_BYTES).splitlines()))
        if not rows or not set(rows[0]) >= {*ABOUT, "status", "error"}:
            raise InputError("expected a table that `moteslam sweep export` wrote", file=path)
    else:
        with opened(path) as store:
            rows = list(csv.DictReader(as_csv(list(store.rows())).splitlines()))
    return {row["id"]: {name: value or "" for name, value in row.items()} for row in rows if row["status"]}


def differences(first: Table, second: Table) -> list[dict[str, str]]:
    """The cells of the runs that both have which differ, times and memory left out, in the order of the first.

    Of each: ``run``, in words, ``column``, and what stands there in the ``first`` and the ``second``.
    """
    found = []
    for run, row in first.items():
        other = second.get(run)
        if other is None:
            continue
        for column in dict.fromkeys((*row, *other)):
            one, two = row.get(column, ""), other.get(column, "")
            if one != two and column not in COSTS:
                found.append({"run": _name(row), "column": column, "first": one, "second": two})
    return found


def columns(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Every run as a row: what it is, what became of it, its values, and its times at the end, by column."""

    def each(*mappings: Mapping[str, Any]) -> dict[str, list[Any]]:
        """A column for each key that any of these has, a mapping a row."""
        names = dict.fromkeys(name for one in mappings for name in one)
        return {name: [one.get(name) for one in mappings] for name in names}

    table: dict[str, list[Any]] = {name: [getattr(row.run, name) for row in rows] for name in ABOUT}
    if any(row.run.version for row in rows):
        table["version"] = [row.run.version for row in rows]
    table |= each(*(dict(row.run.varied) for row in rows))
    table |= {"status": [row.status for row in rows], "error": [literal(row.error) for row in rows]}
    return table | each(*(row.values for row in rows)) | each(*(row.costs for row in rows))


def as_csv(rows: Sequence[Row]) -> str:
    """The columns as CSV: numbers with the fewest digits that read back the same, empty for None."""
    table = columns(rows)
    return comma_separated([list(table), *(list(map(_text, row)) for row in zip(*table.values(), strict=True))]) + "\n"


def write_parquet(path: Path, rows: Sequence[Row]) -> None:
    """Write the columns as Parquet."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise OutputError("needs pyarrow, expected it installed: pip install 'moteslam[parquet]'", file=path) from error
    table = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(columns(rows)), table)
    write_atomically(path, table.getvalue().to_pybytes())


def _text(value: object) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


def _name(row: Mapping[str, str]) -> str:
    parts = [row["scenario"] or Path(row["recording"]).name, row["platform"], row["noise"], f"seed {row['seed']}"]
    varied = [f"{name}={value}" for name, value in row.items() if name.startswith(("slam.", "scenario.", "platform."))]
    return ", ".join([part for part in parts if part] + [row["configuration"], *varied])
