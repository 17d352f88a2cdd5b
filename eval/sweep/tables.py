"""Tables of a sweep with every column of every run: exported as CSV and Parquet, and compared cell by cell."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from moteslam.errors import InputError, OutputError
from moteslam.eval.metrics.registry import COSTS
from moteslam.eval.sweep.spec import PREFIXES
from moteslam.eval.sweep.store import Row, opened
from moteslam.eval.tables import comma_separated, literal
from moteslam.files import read_text, write_atomically

MAX_TABLE = 1_000_000_000  # No exported table is larger
ABOUT = ("id", "scenario", "recording", "platform", "noise", "seed", "configuration")
"""Columns that say which run a row is, beside those with a point that vary."""

Table = dict[str, dict[str, str]]  # Of each run, by its id, every column as text


def read_table(path: Path) -> Table:
    """The runs of a sweep, or of a table that ``sweep export`` wrote, those that were made."""
    if path.suffix == ".csv":
        rows = list(csv.DictReader(read_text(path, "a table of a sweep", limit=MAX_TABLE).splitlines()))
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
    for row, other in ((row, second[run]) for run, row in first.items() if run in second):
        place = row["scenario"] or Path(row["recording"]).name
        varied = (f"{key}={value}" for key, value in row.items() if key.startswith(PREFIXES))
        parts = (place, row["platform"], row["noise"], f"seed {row['seed']}", row["configuration"], *varied)
        for column in (name for name in dict.fromkeys((*row, *other)) if name not in COSTS):
            one, two = row.get(column, ""), other.get(column, "")
            if one != two:
                found.append({"run": ", ".join(filter(None, parts)), "column": column, "first": one, "second": two})
    return found


def columns(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Every run as a row: what it is, what became of it, its values, and its times at the end, by column."""

    def each(*mappings: Mapping[str, Any]) -> dict[str, list[Any]]:
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
    made = zip(*table.values(), strict=True)
    cells = ([repr(one) if isinstance(one, float) else "" if one is None else str(one) for one in row] for row in made)
    return comma_separated([list(table), *cells]) + "\n"


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
