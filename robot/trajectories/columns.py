"""Tables of numbers in text, as files of trajectories have them: lines, stamps, and which column is what.

Columns are TUM's or EuRoC's, or those that a header names. Names are known by their last word and those before it:
``x``, ``tx``, ``p_RS_R_x [m]``, ``pose.position.x``; ``qw``, ``q_RS_w []``, ``orientation.w``; ``yaw [deg]``; ``t``,
``timestamp [ns]``, ``header.stamp``. Columns of other names (velocities, covariances) are passed over.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.files import read_bytes
from moteslam.robot.formats.streams import MAX_STAMP
from moteslam.robot.values import Issue

MAX_BYTES = 500_000_000
"""No file of a trajectory is larger: some five million poses."""
UNITS = {"s": 0, "ms": 3, "us": 6, "ns": 9}
"""Of stamps, with the power of ten that a second has of them."""
LONG = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
LEAST_STEP, MAX_STEP = 1e-5, 1e4
"""Stamps typically nearer or further apart than this [s] are hardly in the unit that they were taken for."""

_HEAD = 100_000
"""Bytes by which a file of positions is known."""

TUM, EUROC = "stamp x y z qx qy qz qw", "timestamp [ns],x,y,z,qw,qx,qy,qz"
TIME = ("header.stamp", "stamp", "timestamp", "time", "t")
"""Last words of the name of a stamp's column; the first that a header has is taken."""
POSITION = {"p", "pos", "pose", "position", "translation", "trans", "t", "point", "location"}
ROTATION = {"q", "quat", "quaternion", "orientation", "rotation", "rot", "attitude"}
OTHER = {
    *("cov", "covariance", "vel", "velocity", "v", "twist", "linear", "angular", "acc", "accel", "acceleration"),
    *("b", "bias", "std", "sigma", "var", "variance", "omega", "gyro", "err", "error", "scale", "w", "a"),
}
"""Words that make a column one of something else."""
TURNS = {"roll": "roll", "pitch": "pitch", "yaw": "yaw", "theta": "yaw", "psi": "yaw"}
EAST = {"easting": "x", "east": "x", "northing": "y", "north": "y", "up": "z"}
UNITS_OF_TIME = {
    **dict.fromkeys(("s", "sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanoseconds"), "ns"),
}
LENGTHS, ANGLES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0}, {"rad": 1.0, "deg": np.pi / 180}


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


@dataclass(frozen=True)
class Columns:
    """Where the numbers of a pose stand in a line.

    Attributes:
        at: column by name: ``t`` (with ``nsec`` where seconds and nanoseconds stand apart), ``x``, ``y``, ``z``, ``qx``
            to ``qw``, ``roll``, ``pitch``, ``yaw``.
        scale: by name, of metres or radians.
        unit: of the stamps, where it is stated.
        count: of columns, where it must be that.
        stated: whether names say so.
    """

    at: dict[str, int]
    scale: dict[str, float] = field(default_factory=dict)
    unit: str | None = None
    count: int | None = None
    stated: bool = True


def is_table(comments: str, line: str) -> bool:
    """Whether a file is a table of poses, by its first comments and its first line that is none."""
    separator = separator_of(line)
    words = split(line, separator)
    try:
        if finite_numbers(words[:1]) is None:
            return named(words, header=True) is not None
        if finite_numbers(words[:8]) is None and separator is None:
            return False
        columns_of(comments.splitlines(), words, separator)
    except ValueError:  # named, or of numbers, and yet not understood: the reader says why
        names = [name for text in comments.splitlines() for name in split(text.lstrip("#%"), separator)]
        known = len(words) >= 8 or any(_time_of(_words(name) or [""]) for name in names)
        return finite_numbers(words[:1]) is None or (separator is not None and known)
    return True


def separator_of(line: str) -> str | None:
    """Comma, semicolon or tabulator, whichever stands oftenest in a line; None for blanks."""
    if ";" in line:
        return ";"
    counts = {mark: line.count(mark) for mark in (",", "\t")}
    best = max(counts, key=lambda mark: counts[mark])
    return best if counts[best] > 1 else None


def split(line: str, separator: str | None) -> list[str]:
    """The words of a line, without space around them; with semicolons a comma is a decimal point."""
    if separator is None:
        return line.replace(",", " ").split()
    words = next(csv.reader([line], delimiter=separator), []) if '"' in line else line.split(separator)
    return [word.strip().replace(",", ".") if separator == ";" else word.strip() for word in words]


def columns_of(comments: Sequence[str], words: Sequence[str], separator: str | None) -> Columns:
    """The columns of a file by its comments and its first line of numbers."""
    for text in (re.sub(r"\s+([\[(])", r"\1", text) for text in reversed(comments)):
        for mark in (",", ";", "\t", None):
            names = split(text.lstrip("#% "), mark)
            try:
                found = named(names) if len(names) == len(words) else None
            except ValueError:
                if mark is not None:
                    raise
                continue  # a sentence
            if found is not None and (mark is not None or len(found.at) > len(names) / 2):
                return found
    first = words[0] if words else ""
    stated = any("[ns]" in text or "q_RS_w" in text for text in comments)
    whole = first.isdecimal() and len(first) <= 20
    order = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
    if len(words) >= 8 and whole and (stated or (separator is not None and int(first) > 10**11)):
        upright = finite_numbers(words[4:6]) == [0.0, 0.0]  # of x y z w; of w x y z a half turn out of the plane
        if stated or len(words) > 8 or not upright:
            return Columns({name: k for k, name in enumerate(order)}, unit="ns", stated=stated)
    if len(words) == 8:
        return Columns({name: k for k, name in enumerate(TUM.replace("stamp", "t").split())}, count=8, stated=False)
    expected = f"expected {TUM}, {EUROC}, or a header that names as many columns"
    raise ValueError(f"{len(words)} columns without names, {expected}")


def named(names: Sequence[str], *, header: bool = False) -> Columns | None:
    """The columns that names stand for, of a stamp and a position; a header must name both, a comment need not."""
    at: dict[str, int] = {}
    scale: dict[str, float] = {}
    times: dict[str, tuple[int, str | None]] = {}
    for index, name in enumerate(names):
        unit_found = re.search(r"[\[(]([^\])]*)[\])]\s*$", name)
        unit = unit_found[1].strip().lower() if unit_found else ""
        words = _words(name)
        if len(words) > 1 and words[-1] in (*UNITS_OF_TIME, "m", "mm", "deg", "rad"):
            unit = unit or words[-1]
            if not (words[-2:-1] == ["stamp"] and words[-1] in ("sec", "secs", "nsec", "nsecs", "nanosec")):
                words.pop()
        if not words:
            continue
        if (time := _time_of(words)) is not None:
            times.setdefault(time, (index, UNITS_OF_TIME.get(unit)))
        elif (role := _role(words)) is not None:
            if role in at:
                both = f"both {names[at[role]].strip()[:60]} and {name.strip()[:60]}"
                raise ValueError(f"{both} may be {role}, expected one")
            at[role] = index
            known = LENGTHS if role in ("x", "y", "z") else ANGLES
            if unit and role[0] != "q":
                if unit not in known:
                    raise ValueError(f"{name.strip()[:60]}: expected {', '.join(known)}")
                scale[role] = known[unit]
    if not (at and (times or {"x", "y"} <= set(at))) and not (header and times and len(names) > 2):
        return None
    shown = ", ".join(name.strip()[:30] for name in names[:12])
    quaternion = [name for name in ("qx", "qy", "qz", "qw") if name in at]
    missing = [name for name in ("x", "y") if name not in at] + ([] if times else ["a stamp"])
    if missing or len(quaternion) not in (0, 4):
        missing = missing or [name for name in ("qx", "qy", "qz", "qw") if name not in at]
        if len(names) < 4:
            return None
        raise ValueError(f"no column of {missing[0]} among {shown}, expected its name")
    if "sec" in times and "nsec" in times:
        return Columns({"t": times["sec"][0], "nsec": times["nsec"][0], **at}, scale)
    first = next((name for name in (*TIME, "sec") if name in times), None)
    if first is None or (first == "sec" and "part" in times):
        raise ValueError(f"no column of a stamp among {shown}, expected its name")
    column, unit_of_time = times[first]
    return Columns({"t": column, **at}, scale, unit_of_time)


def _time_of(words: list[str]) -> str | None:
    """Which of the columns of a stamp a name stands for."""
    if words[-1] in ("sec", "secs") and words[-2:-1] in ([], ["stamp"]):
        return "sec"
    if words[-1] in ("nsec", "nsecs", "nanosec") and words[-2:-1] in ([], ["stamp"]):
        return "nsec"
    if words[-1] in ("msec", "msecs", "usec", "usecs", "microsec", "millis", "micros"):
        return "part"
    if words[-2:] == ["header", "stamp"]:
        return "header.stamp"
    last = {"times": "time", "timestamps": "timestamp", "stamps": "stamp"}.get(words[-1], words[-1])
    return last if last in TIME and not OTHER.intersection(words[:-1]) and (last != "t" or len(words) == 1) else None


def _words(name: str) -> list[str]:
    """The words of a column's name, without its unit in brackets."""
    return [word for word in re.split(r"[^a-z0-9]+", re.sub(r"[\[(].*$", "", name).lower()) if word]


def _role(words: list[str]) -> str | None:
    """Which number of a pose a name stands for, by its last word and those before."""
    *before, last = words
    if OTHER.intersection(before):
        return None
    if before and before[0] in ("x", "y", "z") and last in POSITION:
        return before[0]
    if re.fullmatch("q[xyzw]", last):
        return last
    if last in TURNS:
        return TURNS[last]
    if last in EAST and not before:
        return EAST[last]
    if (short := re.fullmatch("(?:t|p|pos|position)([xyz])", last)) and len(before) < 2:
        return short[1]
    if last in ("x", "y", "z", "w") and ROTATION.intersection(before):
        return f"q{last}"
    if last in ("x", "y", "z") and (not before or POSITION.intersection(before)):
        return last
    return None
