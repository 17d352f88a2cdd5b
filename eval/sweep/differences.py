"""Where two sweeps of the same specification differ: between two commits, two computers, or a published table."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from moteslam.errors import InputError
from moteslam.eval.metrics.registry import COSTS
from moteslam.eval.sweep.store import opened
from moteslam.eval.sweep.tables import columns
from moteslam.robot.files import read_text

MAX_BYTES = 1_000_000_000
"""No exported table is larger."""
ABOUT = frozenset({"id", "scenario", "recording", "platform", "noise", "seed", "configuration"})
"""Columns that say which run a row is, beside those with a point that vary."""

Table = dict[str, dict[str, str]]
"""Of each run, by its id, every column as text."""


@dataclass(frozen=True)
class Difference:
    """A cell that differs.

    Attributes:
        run: which, in words.
        column: of the table.
        first, second: what stands there; empty for nothing.
    """

    run: str
    column: str
    first: str
    second: str


def read_table(path: Path) -> Table:
    """The runs of a sweep, or of a table that ``sweep export`` wrote, those that were made.

    Raises:
        InputError: it is neither.
    """
    if path.suffix == ".csv":
        rows = list(csv.DictReader(read_text(path, "a table of a sweep", limit=MAX_BYTES).splitlines()))
        if not rows or not set(rows[0]) >= ABOUT | {"status", "error"}:
            raise InputError("expected a table that `moteslam sweep export` wrote", file=path)
        table = {row["id"]: {name: value or "" for name, value in row.items() if name is not None} for row in rows}
    else:
        with opened(path) as store:
            found = columns(list(store.rows()))
        names = list(found)
        table = {
            str(values[0]): {name: _text(value) for name, value in zip(names, values, strict=True)}
            for values in zip(*found.values(), strict=True)
        }
    return {run: row for run, row in table.items() if row["status"]}


def differences(first: Mapping[str, Mapping[str, str]], second: Mapping[str, Mapping[str, str]]) -> list[Difference]:
    """The cells of the runs that both have which differ, times and memory left out, in the order of the first."""
    found = []
    for run, row in first.items():
        other = second.get(run)
        if other is None:
            continue
        for column in dict.fromkeys((*row, *other)):
            one, two = row.get(column, ""), other.get(column, "")
            if one != two and column not in COSTS:
                found.append(Difference(_name(row), column, one, two))
    return found


def _text(value: object) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


def _name(row: Mapping[str, str]) -> str:
    parts = [row["scenario"] or Path(row["recording"]).name, row["platform"], row["noise"], f"seed {row['seed']}"]
    varied = [f"{name}={value}" for name, value in row.items() if name.startswith(("slam.", "scenario.", "platform."))]
    return ", ".join([part for part in parts if part] + [row["configuration"], *varied])
