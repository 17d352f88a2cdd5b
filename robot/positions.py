"""Measured positions: where a point of the robot was, without a heading; a truth of cameras and total stations."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.arrays import frozen
from moteslam.robot.reading import open_regular
from moteslam.robot.summary import Summarised, span
from moteslam.robot.trajectories.rows import data_lines, finite_numbers
from moteslam.robot.wording import counted

HEAD = 100_000
"""Bytes by which a file of positions is known."""

MILLI = 0.001


@dataclass(frozen=True, eq=False, repr=False)
class Positions(Summarised):
    """Where a point was over time.

    Attributes:
        stamps: [n] float64 [s], not decreasing.
        points: [n, 2] float64: x, y [m].
    """

    stamps: NDArray[np.float64]
    points: NDArray[np.float64]

    def __post_init__(self) -> None:
        stamps, points = frozen(self.stamps, np.float64), frozen(self.points, np.float64)
        if stamps.ndim != 1 or points.shape != (len(stamps), 2):
            raise InputError(f"stamps {list(stamps.shape)} and points {list(points.shape)}, expected [n] and [n, 2]")
        if (np.diff(stamps) < 0).any():
            raise InputError("stamps go back, expected rising seconds", field="stamps")
        object.__setattr__(self, "stamps", stamps)
        object.__setattr__(self, "points", points)

    def __len__(self) -> int:
        return len(self.stamps)

    def _summary(self) -> str:
        return f"{counted(len(self), 'position')}, {span(self.stamps)}"


def is_positions(path: str | PathLike[str]) -> bool:
    """Whether the first line of a file that is neither empty nor a comment is ``P`` and three words."""
    try:
        with open_regular(path, "positions") as file:
            head = file.read(HEAD)
    except (InputError, OSError):
        return False
    lines = (line.split() for line in head.split(b"\n"))
    first = next((words for words in lines if words and not words[0].startswith(b"#")), [])
    return len(first) == 4 and first[0] == b"P"


def read_positions(path: str | PathLike[str]) -> Positions:
    """Read ``P t x y`` lines: milliseconds and millimetres (C. Brenner's LEGO robot); other kinds are passed over.

    Raises:
        InputError: no text file of at most 500 MB, a line without three finite numbers, stamps that go back,
            or no position.
    """
    path = Path(path)
    rows: list[list[float]] = []
    for number, line in data_lines(path, "positions"):
        kind, *words = line.split()
        if kind != "P":
            continue
        row = finite_numbers(words)
        if row is None or len(row) != 3:
            raise InputError("expected 3 finite numbers after P: t [ms], x and y [mm]", file=path, line=number)
        if rows and row[0] < rows[-1][0]:
            raise InputError("stamp before the one above it, expected rising stamps", file=path, line=number)
        rows.append(row)
    if not rows:
        raise InputError("no positions, expected lines: P t x y", file=path)
    table = MILLI * np.array(rows)
    return Positions(table[:, 0], table[:, 1:])
