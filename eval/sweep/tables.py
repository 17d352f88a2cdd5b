"""What a sweep came to: a row a run, and a row a configuration with its intervals."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from moteslam.errors import ConfigError, OutputError
from moteslam.eval.literal import literal
from moteslam.eval.metrics.registry import metric
from moteslam.eval.statistics import Better, Proportion, Summary
from moteslam.eval.sweep.store import Row
from moteslam.robot.files import write_atomically

Group = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class GroupSummary:
    """The runs of one configuration on one scenario, over its seeds.

    Attributes:
        about: what they have in common, by column.
        runs: how many were made.
        success: how many of these succeeded.
        values: summaries by metric.
    """

    about: dict[str, Any]
    runs: int
    success: Proportion
    values: dict[str, Summary]


def group_of(row: Row) -> Group:
    """What a run has in common with those of other seeds."""
    run = row.run
    place = run.scenario or Path(run.recording).name
    return (
        ("scenario", Path(place).stem if place.endswith(".toml") else place),
        ("platform", Path(run.platform).stem),
        ("noise", run.noise),
        ("configuration", run.configuration),
        ("version", run.version),
        *run.varied,
    )


def summaries(rows: Iterable[Row], metrics: Sequence[str], success: dict[str, float]) -> list[GroupSummary]:
    """A summary for each configuration on each scenario, in the order of their first runs.

    Args:
        rows: of a sweep; those not made yet are left out.
        metrics: names of those to sum up.
        success: see ``SweepSpec.success``.
    """
    groups: dict[Group, list[Row]] = {}
    for row in rows:
        if row.status:
            groups.setdefault(group_of(row), []).append(row)
    found = []
    for group, members in groups.items():
        good = [row for row in members if row.status == "ok"]
        values = {
            name: Summary.of(
                [row.values.get(name, row.costs.get(name)) for row in good],
                len(members) - len(good),
                better=better(name),
            )
            for name in metrics
        }
        succeeded = sum(succeeds(row, success) for row in members)
        found.append(GroupSummary(dict(group), len(members), Proportion(succeeded, len(members)), values))
    return found


def varying(groups: Sequence[GroupSummary]) -> list[str]:
    """The columns of ``about`` in which some of the groups have something."""
    keys = dict.fromkeys(key for group in groups for key in group.about)
    return [key for key in keys if any(group.about.get(key, "") != "" for group in groups)]


def better(name: str) -> Better:
    """Which values of a metric are better; lower of one where neither is."""
    try:
        return metric(name).better or "lower"
    except ConfigError:  # scans, distance
        return "lower"


def succeeds(row: Row, success: dict[str, float]) -> bool:
    """Whether a run did, and none of its values is above its limit or absent."""
    values = [(row.values.get(name), limit) for name, limit in success.items()]
    return row.status == "ok" and all(value is not None and value <= limit for value, limit in values)


def columns(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Every run as a row: what it is, what became of it, its values, and its times at the end, by column."""
    names = list(dict.fromkeys(name for row in rows for name in row.values))
    costs = list(dict.fromkeys(name for row in rows for name in row.costs))
    varied = list(dict.fromkeys(key for row in rows for key, _ in row.run.varied))
    table: dict[str, list[Any]] = {
        "id": [row.run.id for row in rows],
        "scenario": [row.run.scenario for row in rows],
        "recording": [row.run.recording for row in rows],
        "platform": [row.run.platform for row in rows],
        "noise": [row.run.noise for row in rows],
        "seed": [row.run.seed for row in rows],
        "configuration": [row.run.configuration for row in rows],
    }
    if any(row.run.version for row in rows):
        table["version"] = [row.run.version for row in rows]
    table |= {key: [dict(row.run.varied).get(key) for row in rows] for key in varied}
    table |= {"status": [row.status for row in rows], "error": [literal(row.error) for row in rows]}
    table |= {name: [row.values.get(name) for row in rows] for name in names}
    return table | {name: [row.costs.get(name) for row in rows] for name in costs}


def as_csv(rows: Sequence[Row]) -> str:
    """The columns as CSV: numbers with the fewest digits that read back the same, empty where there is none."""
    table = columns(rows)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    for values in zip(*table.values(), strict=True):
        writer.writerow(
            ["" if value is None else repr(value) if isinstance(value, float) else value for value in values]
        )
    return text.getvalue()


def write_parquet(path: Path, rows: Sequence[Row]) -> None:
    """Write the columns as Parquet.

    Raises:
        OutputError: pyarrow is not installed (extra ``parquet``), or the file cannot be written.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise OutputError("needs pyarrow, expected it installed: pip install 'moteslam[parquet]'", file=path) from error
    table = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(columns(rows)), table)
    write_atomically(path, table.getvalue().to_pybytes())
