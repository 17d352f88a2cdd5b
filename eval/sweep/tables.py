"""The runs of a sweep summed up: a row a configuration and scenario, with its intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from moteslam.errors import ConfigError
from moteslam.eval.metrics.registry import metric
from moteslam.eval.statistics import Better, Proportion, Summary
from moteslam.eval.sweep.store import Row


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
    """A summary for each configuration on each scenario, in the order of their first runs.

    Args:
        rows: of a sweep; those not made yet are left out.
        metrics: names of those to sum up.
        success: see ``SweepSpec.success``.
    """
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
