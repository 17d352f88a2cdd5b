"""The stamps of formats that have none: from a file beside, or one a second."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError, MoteslamWarning
from moteslam.robot.files import write_atomically
from moteslam.robot.trajectories.rows import Table, check_rising, data_lines, finite_numbers
from moteslam.robot.wording import counted


def times_file(path: Path) -> Path:
    """The file beside a trajectory that has its stamps: ``NAME.times.txt`` beside ``NAME.kitti``."""
    return path.with_name(f"{path.stem}.times.txt")


def read_times(path: Path, count: int) -> NDArray[np.float64]:
    """The stamps [count] [s] of the poses of a trajectory, one a line.

    Raises:
        InputError: no text file of as many rising, finite numbers.
    """
    table, before = Table(1), None
    for number, line in data_lines(path, "times [s]"):
        row = finite_numbers(line.split())
        if row is None or len(row) != 1:
            raise InputError("expected a finite number [s]", file=path, line=number)
        check_rising(row[0], before, path, number)
        table.append(row)
        before = row[0]
    if len(table) != count:
        raise InputError(f"{counted(len(table), 'time')}, expected {count}, one a pose", file=path)
    return table.values[:, 0]


def stamps_beside(path: Path, count: int) -> NDArray[np.float64]:
    """The stamps [count] [s] of a trajectory without any: ``NAME.times.txt``, ``times.txt``, else one a second.

    The last with a warning.

    Raises:
        InputError: one of these files is there, and has not as many rising, finite numbers.
    """
    for file in (times_file(path), path.with_name("times.txt")):
        if file.exists():
            return read_times(file, count)
    text = f"{path}: has no stamps, and no {times_file(path).name} or times.txt lies beside it; taken as one a second"
    warnings.warn(MoteslamWarning(text), stacklevel=3)
    return np.arange(count, dtype=np.float64)


def write_times(path: Path, stamps: NDArray[np.float64]) -> None:
    """Write stamps [n] [s], one a line, with the fewest digits that read back the same.

    Raises:
        OutputError: it cannot be written.
    """
    write_atomically(path, "".join(f"{stamp!r}\n" for stamp in stamps.tolist()))
