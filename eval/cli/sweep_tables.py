"""What ``moteslam sweep show`` finds and prints: a summary for each configuration and scenario."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from math import isinf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moteslam.errors import ConfigError
from moteslam.eval.tables import FORMATS

if TYPE_CHECKING:
    from moteslam.eval.sweep.spec import SweepSpec
    from moteslam.eval.sweep.store import Row, Store

PARTS = ("median", "low", "high", "low_quartile", "high_quartile")
"""Of a summary, in the table for programs."""


def metric_names(given: list[str] | None) -> list[str]:
    """The metrics that are asked for, ``final.ate`` by default; an unknown one is refused."""
    from moteslam.eval.metrics.registry import chosen

    chosen(given or ())
    return given or ["final.ate"]


def summed_up(store: Store, spec: SweepSpec, wanted: list[str] | None) -> dict[str, Any]:
    """A sweep's hash, its numbers of runs by status, and its groups: what they have in common, successes, summaries."""
    from moteslam.eval.sweep.tables import summaries

    runs = list(store.rows())
    groups = [
        {
            "group": group.about,
            "runs": group.runs,
            "success": group.success.as_dict(),
            "metrics": {name: asdict(summary) for name, summary in group.values.items()},
        }
        for group in summaries(runs, _measured(runs, wanted, store.path), dict(spec.success))
    ]
    counts = {name or "pending": count for name, count in store.counts().items()}
    return {"hash": store.digest, "runs": counts, "groups": groups}


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


def summary_lines(found: dict[str, Any], form: str) -> Iterator[str]:
    """A row a group: of each metric the median with its intervals; in ``csv`` every number has a column of its own."""
    from moteslam.eval.sweep.tables import varying
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
            cells = [
                *(str(each["group"].get(key, "")) for key in about),
                str(each["runs"]),
                f"{success['count']}{share}",
            ]
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
    from moteslam.eval.metrics.registry import metric

    try:
        unit = metric(name).unit
    except ConfigError:  # scans, distance, or of a plug-in that is not here
        return name
    return f"{name} [{unit}]" if unit else name


def digits(value: float | None) -> str:
    """For programs: all digits, nothing where there is no number, ``inf`` for failures."""
    return "" if value is None else repr(value)


def shown(value: float | None) -> str:
    """For people."""
    return "-" if value is None else "failed" if isinf(value) else f"{value:.4g}"
