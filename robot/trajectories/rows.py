"""Lines of numbers, as files of trajectories have them: read within bounds, refused with their line."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.reading import read_text

MAX_BYTES = 500_000_000
"""No file of a trajectory is larger: some five million poses."""


def data_lines(path: Path, what: str) -> Iterator[tuple[int, str]]:
    """The lines that are neither blank nor comments (``#``), with their numbers from 1, without space around them.

    Args:
        path: of the file.
        what: was expected there, for the message: ``a TUM trajectory``.

    Raises:
        InputError: no text file of at most ``MAX_BYTES``.
    """
    for number, line in enumerate(read_text(path, what, limit=MAX_BYTES).splitlines(), start=1):
        line = line.strip()
        if line and not line.startswith("#"):
            yield number, line


def finite_numbers(words: Sequence[str]) -> list[float] | None:
    """The words as numbers, None where one is none or not finite."""
    try:
        row = [float(word) for word in words]
    except ValueError:
        return None
    return row if all(map(isfinite, row)) else None


class Table:
    """Rows of numbers as they are read, eight bytes a number.

    Args:
        columns: of every row.
    """

    def __init__(self, columns: int) -> None:
        self._columns, self._numbers = columns, array("d")

    def __len__(self) -> int:
        return len(self._numbers) // self._columns

    def append(self, row: Sequence[float]) -> None:
        """Take in a row."""
        self._numbers.extend(row)

    @property
    def values(self) -> NDArray[np.float64]:
        """The rows [n, columns]."""
        return np.array(self._numbers, np.float64).reshape(-1, self._columns)


def check_rising(stamp: float, before: float | None, path: Path, line: int) -> None:
    """Refuse a stamp that is less than the one above it.

    Raises:
        InputError: it is; file and line are named.
    """
    if before is not None and stamp < before:
        raise InputError("stamp before the one above it, expected rising stamps", file=path, line=line)
