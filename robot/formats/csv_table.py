"""Columns of CSV files that nobody vouches for: found by name or number, read as numbers, bad lines counted."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError
from moteslam.robot.formats.csv_model import RANGE, Column, CsvTable
from moteslam.robot.formats.lines import BrokenLines, TextLines, broken_issues
from moteslam.robot.issues import Issue
from moteslam.robot.specs import MAX_BEAMS
from moteslam.robot.summary import Summarised
from moteslam.robot.wording import counted, shortened

EMPTY = "no line of numbers, expected a CSV file"


@dataclass(frozen=True)
class Wanted:
    """The columns that are asked for.

    Attributes:
        finite: columns of finite numbers, by the key that asks for each.
        ranges: first and last of the columns that may be empty, infinite or NaN; None where none are asked for.
        metres: unit of these [m].
    """

    finite: dict[str, Column]
    ranges: str | None = None
    metres: float = 1.0


@dataclass(frozen=True, eq=False, repr=False)
class Columns(Summarised):
    """What they hold: finite [n, k] in the order asked for, in the units of the file, ranges [n, m] [m].

    The range of an empty cell is 0.
    """

    finite: NDArray[np.float64]
    ranges: NDArray[np.float32]


def read_columns(path: Path, table: CsvTable, wanted: Wanted, *, description: Path, issues: list[Issue]) -> Columns:
    """Read columns of a CSV file; empty lines and comments (``#``) are passed over.

    Args:
        path: of the file, plain or gzip.
        table: how it is read.
        wanted: the columns.
        description: the file that asks for them, for messages.
        issues: what was dropped is added.

    Raises:
        ConfigError: a column that is not there.
        InputError: not readable, no line of numbers, or too many broken lines.
    """
    lines = TextLines(path)
    rows = _cells(lines, table.delimiter)
    header: list[str] | None = None
    if table.header:
        _, first = next(rows, (1, []))
        if not first:
            broken_issues(lines, BrokenLines(), 0, EMPTY)  # raises
        header = [cell.decode("utf-8", "replace") for cell in first]
    finite = [_index(header, column, field, description, path) for field, column in wanted.finite.items()]
    span = range(0)
    if wanted.ranges is not None:
        span = _span(header, wanted.ranges, description, path)
    values, ranges, broken = array("d"), array("f"), BrokenLines()
    last = max(*finite, *span) if span else max(finite)
    for number, cells in rows:
        try:
            if len(cells) <= last:
                raise ValueError(f"{counted(len(cells), 'cell')}, expected at least {last + 1}")
            row = _finite([cells[index] for index in finite])
            ranges.extend(array("f", [float(cells[index] or b"0") * wanted.metres for index in span]))
        except (ValueError, OverflowError) as error:
            broken.add(number, _in_words(error))
            continue
        values.extend(row)
    count = len(values) // len(finite)
    issues.extend(broken_issues(lines, broken, count, EMPTY))
    return Columns(
        np.array(values, np.float64).reshape(count, len(finite)), np.array(ranges, np.float32).reshape(count, len(span))
    )


def _cells(lines: TextLines, delimiter: str) -> Iterator[tuple[int, list[bytes]]]:
    """The cells of every line that is neither empty nor a comment, without blanks and quotes, and its number from 1."""
    mark = None if delimiter == " " else delimiter.encode()
    for number, line in enumerate(lines, start=1):
        line = line.strip(b" \r" if mark == b"\t" else None)
        if line and not line.startswith(b"#"):
            yield number, [cell.strip().strip(b'"') for cell in line.split(mark)]


def _finite(cells: Sequence[bytes]) -> list[float]:
    values = [float(cell) for cell in cells]
    if not np.isfinite(values).all():
        raise ValueError("NaN or infinite, expected finite numbers")
    return values


def _in_words(error: Exception) -> str:
    """What is wrong with a cell, without Python's words for it."""
    text = str(error)
    return "a cell that is no number, expected numbers" if text.startswith("could not convert") else text


def _index(header: list[str] | None, column: Column, field: str, description: Path, path: Path) -> int:
    """The index from 0 of a column."""
    if isinstance(column, int):
        if column > MAX_BEAMS or (header is not None and column > len(header)):
            most = MAX_BEAMS if header is None else len(header)
            raise ConfigError(f"{column}, expected a column of {path.name}, 1 to {most}", file=description, field=field)
        return column - 1
    if header is None:
        raise ConfigError(f"{column!r}, expected a number: {path.name} has no header", file=description, field=field)
    if header.count(column) == 1:
        return header.index(column)
    problem = "stands twice" if column in header else "is no column"
    known = shortened(", ".join(header))
    raise ConfigError(f"{column!r} {problem} of {path.name}, expected one of {known}", file=description, field=field)


def _span(header: list[str] | None, ranges: str, description: Path, path: Path) -> range:
    """The indices of the ranges, from the first to the last column."""
    field = "lidar.ranges"
    ends = [int(end) if end.isdecimal() and len(end) < 10 else end for end in ranges.split(RANGE)]
    if len(ends) != 2 or "" in ends or 0 in ends:
        raise ConfigError(
            f"{ranges!r}, expected first and last column, r0..r359 or 2..361", file=description, field=field
        )
    if header is not None:  # a column may be named by a number
        ends = [str(end) if str(end) in header else end for end in ends]
    first, last = (_index(header, end, field, description, path) for end in ends)
    if last < first:
        raise ConfigError(f"{ranges!r}, expected the first column before the last", file=description, field=field)
    if last - first >= MAX_BEAMS:
        raise ConfigError(f"{last - first + 1} beams, expected at most {MAX_BEAMS}", file=description, field=field)
    return range(first, last + 1)
