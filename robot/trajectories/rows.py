"""Lines of numbers, as files of trajectories have them: decoded, read within bounds, refused with their line."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.files import open_regular, read_bytes
from moteslam.robot.formats.streams import MAX_STAMP
from moteslam.robot.trajectory import Positions, Trajectory
from moteslam.robot.values import Issue, counted

MAX_BYTES = 500_000_000
"""No file of a trajectory is larger: some five million poses."""
UNITS = {"s": 0, "ms": 3, "us": 6, "ns": 9}
"""Of stamps, with the power of ten that a second has of them."""
LONG = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
LEAST_STEP, MAX_STEP = 1e-5, 1e4
"""Stamps typically nearer or further apart than this [s] are hardly in the unit that they were taken for."""

_HEAD = 100_000
"""Bytes by which a file of positions is known."""


@dataclass(frozen=True)
class TrajectoryFormat:
    """How a trajectory is stored, in lines of text.

    Attributes:
        name: what it is called, and what its lines are.
        recognise: ``recognise(comments, line)``: whether a file is of this format, by the comments that it begins with
            (``#``, with their line ends) and its first line that is none; must not raise for any other.
        read: ``read(path)``.
        write: ``write(path, trajectory)`` writes a file that reads back the same, but for what the format cannot hold.
        endings: of the names of its files, by which one to be written is known.
    """

    name: str
    recognise: Callable[[str, str], bool]
    read: Callable[[Path], Trajectory]
    write: Callable[[Path, Trajectory], None]
    endings: tuple[str, ...]


def decoded(content: bytes, errors: str = "strict") -> str:
    """UTF-8, or UTF-16 where a byte order mark or the zeros of its ASCII characters show it."""
    zeros = [content[k:2000:2].count(0) for k in (0, 1)]
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", errors)
    if max(zeros) > 4 * min(zeros) + 8:
        return content.decode("utf-16-le" if zeros[1] > zeros[0] else "utf-16-be", errors)
    return content.decode("utf-8-sig", errors)


def all_lines(path: Path, what: str) -> Iterator[tuple[int, str]]:
    """The lines that are not blank, with their numbers from 1, without space around them; ``what`` is expected."""
    content = read_bytes(path, what, limit=MAX_BYTES)
    try:
        text = decoded(content)
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text, expected {what}", file=path) from error
    for number, line in enumerate(text.splitlines(), start=1):
        if line := line.strip():
            yield number, line


def data_lines(path: Path, what: str) -> Iterator[tuple[int, str]]:
    """Those that are no comments (``#``)."""
    return ((number, line) for number, line in all_lines(path, what) if not line.startswith("#"))


def finite_numbers(words: Sequence[str]) -> list[float] | None:
    """The words as numbers, None where one is none or not finite."""
    try:
        row = [float(word) for word in words]
    except ValueError:
        return None
    return row if all(map(isfinite, row)) else None


def seconds(
    words: Sequence[str], path: Path, lines: Sequence[int], unit: str | None = None
) -> tuple[NDArray[np.float64], tuple[Issue, ...]]:
    """Stamps in seconds, and what was taken for granted of their unit.

    Args:
        words: [n] finite numbers.
        path, lines: where they stand.
        unit: that the file states; else 1e18 are nanoseconds, 1e15 microseconds, 1e12 milliseconds.

    Returns:
        stamps [n] [s], of whole numbers the nearest float64.
    """
    values = np.array([float(word) for word in words])
    largest = float(np.abs(values).max(initial=0.0))
    by_size = "ns" if largest > 1e17 else "us" if largest > 1e14 else "ms" if largest > MAX_STAMP else "s"
    found = by_size if unit is None or (unit == "s" and by_size != "s") else unit
    issues: tuple[Issue, ...] = ()
    if found != (unit or "s"):
        text = f"{path}: stamps of {largest:.3g} are taken for {LONG[found]}, not seconds"
        issues = (Issue("stamps-scaled", text, len(values)),)
    scale = 10 ** UNITS[found]
    if scale > 1:
        values = np.array([(int(word) if word.isdecimal() else float(word)) / scale for word in words])
    if np.abs(values).max(initial=0.0) > MAX_STAMP:
        at = lines[int(np.argmax(np.abs(values) > MAX_STAMP))]
        raise InputError("stamp beyond 1e11 s, expected seconds or whole nanoseconds", file=path, line=at)
    steps = np.diff(values)
    if (steps < 0).any():
        line = lines[int(np.argmax(steps < 0)) + 1]
        raise InputError("stamp before the one above it, expected rising stamps", file=path, line=line)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    if not LEAST_STEP < step < MAX_STEP:
        text = f"{path}: stamps {step:.3g} s apart: if they are in another unit, times and rates are wrong"
        issues += (Issue("stamps-unlikely", text, len(values)),)
    return values, issues


def times_file(path: Path) -> Path:
    """The file beside a trajectory that has its stamps: ``NAME.times.txt`` beside ``NAME.kitti``."""
    return path.with_name(f"{path.stem}.times.txt")


def stamps_beside(path: Path, count: int) -> tuple[NDArray[np.float64], tuple[Issue, ...]]:
    """The stamps [count] [s] of a trajectory without any: ``NAME.times.txt``, ``times.txt``, else one a second."""
    for file in (times_file(path), path.with_name("times.txt")):
        if file.exists():
            words, lines = [], []
            for number, line in data_lines(file, "times [s]"):
                if len(line.split()) != 1 or finite_numbers([line]) is None:
                    raise InputError("expected a finite number [s]", file=file, line=number)
                words.append(line)
                lines.append(number)
            stamps, issues = seconds(words, file, lines)
            if len(stamps) != count:
                raise InputError(f"{counted(len(stamps), 'time')}, expected {count}, one a pose", file=file)
            return stamps, issues
    text = f"{path}: has no stamps, and no {times_file(path).name} or times.txt lies beside it; taken as one a second"
    return np.arange(count, dtype=np.float64), (Issue("no-stamps", text, count),)


def is_positions(path: str | PathLike[str]) -> bool:
    """Whether the first line of a file that is neither empty nor a comment is ``P`` and three words."""
    try:
        with open_regular(path, "positions") as file:
            head = file.read(_HEAD)
    except (InputError, OSError):
        return False
    lines = (line.split() for line in head.split(b"\n"))
    first = next((words for words in lines if words and not words[0].startswith(b"#")), [])
    return len(first) == 4 and first[0] == b"P"


def read_positions(path: str | PathLike[str]) -> Positions:
    """Read ``P t x y`` lines: milliseconds and millimetres (C. Brenner's LEGO robot); other kinds are passed over."""
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
    table = 0.001 * np.array(rows)
    return Positions(table[:, 0], table[:, 1:])
