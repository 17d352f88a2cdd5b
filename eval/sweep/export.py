"""The runs of a sweep as a table, a row a run, and where two such tables differ."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from moteslam.errors import InputError, OutputError
from moteslam.eval.literal import literal
from moteslam.eval.metrics.catalogue import COSTS
from moteslam.eval.sweep.store import Row, opened
from moteslam.robot.files import read_text, write_atomically

MAX_BYTES = 1_000_000_000
"""No exported table is larger."""
ABOUT = frozenset({"id", "scenario", "recording", "platform", "noise", "seed", "configuration"})
"""Columns that say which run a row is, beside those with a point that vary."""

Table = dict[str, dict[str, str]]
"""Of each run, by its id, every column as text."""


def read_table(path: Path) -> Table:
    """The runs of a sweep, or of a table that ``sweep export`` wrote, those that were made.

    Raises:
        InputError: it is neither.
    """
    if path.suffix == ".csv":
        rows = list(csv.DictReader(read_text(path, "a table of a sweep", limit=MAX_BYTES).splitlines()))
        if not rows or not set(rows[0]) >= ABOUT | {"status", "error"}:
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
    """The columns as CSV: numbers with the fewest digits that read back the same, empty for None."""
    table = columns(rows)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    for values in zip(*table.values(), strict=True):
        writer.writerow(map(_text, values))
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


def _text(value: object) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


def _name(row: Mapping[str, str]) -> str:
    parts = [row["scenario"] or Path(row["recording"]).name, row["platform"], row["noise"], f"seed {row['seed']}"]
    varied = [f"{name}={value}" for name, value in row.items() if name.startswith(("slam.", "scenario.", "platform."))]
    return ", ".join([part for part in parts if part] + [row["configuration"], *varied])
