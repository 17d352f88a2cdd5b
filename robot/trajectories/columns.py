"""Tables of poses in text: their lines, which column is what, and stamps of any unit.

Columns are TUM's or EuRoC's, or those that a header names: ``tx``, ``p_RS_R_x [m]``, ``pose.position.x``,
``q_RS_w []``, ``orientation.w``, ``yaw [deg]``, ``timestamp [ns]``, ``header.stamp``. Others are passed over.
"""

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.files import read_bytes
from moteslam.robot.formats.streams import MAX_STAMP
from moteslam.robot.values import Issue, counted, unpadded

MAX_BYTES = 500_000_000  # Of a file: some five million poses
UNITS = {"s": 0, "ms": 3, "us": 6, "ns": 9}  # Of stamps, with the power of ten that a second has of them
LATEST = 1e10  # Stamps without a stated unit are not farther from 1970 [s]: 20261126142000 is a date
LEAST_STEP, MAX_STEP = 1e-5, 1e4
"""Stamps typically nearer or further apart than this [s] are hardly in the unit that they were taken for."""

TUM, EUROC = "t x y z qx qy qz qw", "t x y z qw qx qy qz"
"""Columns without names; of the second the stamps are whole nanoseconds."""
TIMES = ("header", "stamp", "timestamp", "time", "t", "sec", "nsec", "part")
"""What a name may say of a stamp; of several the first is taken, seconds with nanoseconds apart before all."""
OTHER = {
    *("cov", "covariance", "vel", "velocity", "v", "twist", "linear", "angular", "acc", "accel", "acceleration"),
    *("b", "bias", "std", "sigma", "var", "variance", "omega", "gyro", "err", "error", "scale", "w", "a"),
}
"""Words before the last of a name that make a column one of something else."""
_PLACE = "(?:p|pos|pose|position|translation|trans|t|point|location)"
_TURN = "(?:q|quat|quaternion|orientation|rotation|rot|attitude)"
ROLES = (
    (r"(?:.* )?header stamp", "header"),
    (r"(?:(?:.* )?stamp )?secs?", "sec"),
    (r"(?:(?:.* )?stamp )?(?:nsecs?|nanosec)", "nsec"),
    (r"(?:.* )?(?:[mu]secs?|microsec|millis|micros)", "part"),
    (r"(?:.* )?(stamp|timestamp|time)s?", r"\1"),
    (r"t", "t"),
    (rf"([xyz])(?: .*)? {_PLACE}", r"\1"),
    (r"(?:.* )?(q[xyzw])", r"\1"),
    (r"(?:.* )?(roll|pitch|yaw)", r"\1"),
    (r"(?:.* )?(?:theta|psi)", "yaw"),
    (r"east(?:ing)?", "x"),
    (r"north(?:ing)?", "y"),
    (r"up", "z"),
    (r"(?:\w+ )?(?:t|p|pos|position)([xyz])", r"\1"),
    (rf"(?:.* )?{_TURN}(?: .*)? ([xyzw])", r"q\1"),
    (rf"(?:(?:.* )?{_PLACE}(?: .*)? )?([xyz])", r"\1"),
)
"""What the words of a name say: the first pattern that fits them all."""
LONGEST_NAME, MOST_NAMES = 200, 1000  # Characters of a name, and names of columns, that are looked at
SECONDS = {"sec": "s", "secs": "s", "seconds": "s", "nsecs": "ns", "nanosec": "ns", **{unit: unit for unit in UNITS}}
SECONDS |= {"msec": "ms", "milliseconds": "ms", "usec": "us", "microseconds": "us", "nsec": "ns", "nanoseconds": "ns"}
METRES, RADIANS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0}, {"rad": 1.0, "deg": np.pi / 180}
"""Units by the names that they have in headers."""


def decoded(content: bytes, errors: str = "strict") -> str:
    """UTF-8, or UTF-16 where a byte order mark or the zeros of its ASCII characters show it."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", errors)
    return content.decode("utf-16-le" if content[1:2000:2].count(0) > 8 else "utf-8-sig", errors)


def all_lines(path: Path, what: str) -> Iterator[tuple[int, str]]:
    """The lines that are not blank, stripped, with their numbers from 1; ``what`` is expected."""
    try:
        text = decoded(read_bytes(path, what, limit=MAX_BYTES))
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text, expected {what}", file=path) from error
    return numbered(text)


def numbered(text: str) -> Iterator[tuple[int, str]]:
    """The lines that are not blank, stripped, with their numbers from 1."""
    return ((number, line) for number, raw in enumerate(text.splitlines(), start=1) if (line := raw.strip()))


def number_lines(path: Path, what: str, count: int, expected: str) -> tuple[list[list[str]], list[int]]:
    """The words of lines that each are so many finite numbers, and the lines' numbers; ``#`` begins a comment."""
    rows, lines = [], []
    for number, line in all_lines(path, what):
        if line.startswith("#"):
            continue
        words = line.split()
        if len(words) != count or finite_numbers(words) is None:
            raise InputError(f"expected {counted(count, 'finite number')}: {expected}", file=path, line=number)
        rows.append(words)
        lines.append(number)
    if not rows:
        raise InputError(f"no lines, expected {what}: {expected}", file=path)
    return rows, lines


def finite_numbers(words: Sequence[str]) -> list[float] | None:
    """The words as numbers, if they all are finite ones."""
    try:
        row = [float(word) for word in words]
    except ValueError:
        return None
    return row if all(map(isfinite, row)) else None


def seconds(
    words: Sequence[str], path: Path, lines: Sequence[int], unit: str | None = None
) -> tuple[NDArray[np.float64], tuple[Issue, ...]]:
    """Stamps [n] [s] of finite numbers, of whole ones the nearest float64, and what was assumed of their unit.

    Without a unit that the file states, 1e18 are nanoseconds, 1e15 microseconds and 1e12 milliseconds.
    """
    values = np.array([float(word) for word in words])
    largest = float(np.abs(values).max(initial=0.0))
    by_size = "ns" if largest > 1e17 else "us" if largest > 1e14 else "ms" if largest > MAX_STAMP else "s"
    issues: tuple[Issue, ...] = ()
    if unit in (None, "s") and by_size != "s":
        text = f"{path}: stamps of {largest:.3g} are taken for {by_size}, not seconds"
        issues = (Issue("stamps-scaled", text, len(values)),)
        unit = by_size
    if power := UNITS[unit or "s"]:
        values = np.array([(int(word) if word.isdecimal() else float(word)) / 10**power for word in words])
    steps = np.diff(values)
    for wrong, problem in (
        (np.abs(values) > MAX_STAMP, "stamp beyond 1e11 s, expected seconds or whole nanoseconds"),
        (np.abs(values) > (LATEST if issues else MAX_STAMP), f"stamp taken for {unit} after 2286, expected seconds"),
        (np.append(False, steps < 0), "stamp before the one above it, expected rising stamps"),
    ):
        if wrong.any():
            raise InputError(problem, file=path, line=lines[int(np.argmax(wrong))])
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    if not LEAST_STEP < step < MAX_STEP:
        text = f"{path}: stamps {step:.3g} s apart: if they are in another unit, times and rates are wrong"
        issues += (Issue("stamps-unlikely", text, len(values)),)
    return values, issues + unpadded(str(path), values, words)


@dataclass(frozen=True)
class Columns:
    """Where the numbers of a pose stand in a line, by name: ``t`` (with ``nsec`` where seconds and nanoseconds stand
    apart), ``x``, ``y``, ``z``, ``qx`` to ``qw``, ``roll``, ``pitch``, ``yaw``.
    """

    at: dict[str, int]
    scale: dict[str, float] = field(default_factory=dict)  # of metres or radians
    unit: str | None = None  # of the stamps, where it is stated
    names: bool = True  # else a line has 8 columns, or 8 and more whose stamps are nanoseconds


def separator_of(line: str) -> str | None:
    """Comma, semicolon or tabulator, whichever stands oftenest in a line; None for blanks."""
    if ";" in line:
        return ";"
    best = max(",\t", key=line.count)
    return best if line.count(best) > 1 else None


def split(line: str, separator: str | None) -> list[str]:
    """The words of a line, without space around them; with semicolons a comma is a decimal point."""
    if separator is None:
        return line.replace(",", " ").split()
    words = next(csv.reader([line], delimiter=separator), []) if '"' in line else line.split(separator)
    return [word.strip().replace(",", ".") if separator == ";" else word.strip() for word in words]


def columns_of(comments: Sequence[str], line: str) -> tuple[Columns, bool]:
    """The columns of a table by its comments and first other line, and whether this is a header; else ValueError."""
    separator = separator_of(line)
    words = split(line, separator)
    if finite_numbers(words[:1]) in (None, []):
        if (found := named(words, header=True)) is None:
            raise ValueError(f"not a line of a trajectory, expected {TUM}, a header of names, KITTI or g2o")
        return found, True
    for comment in reversed(comments):
        text = re.sub(r"\s+([\[(])", r"\1", comment.lstrip("#% "))
        mark = separator_of(text)
        names = split(text, mark)
        try:
            found = named(names) if len(names) == len(words) else None
        except ValueError:
            if mark is not None:
                raise
            continue  # a sentence
        if found is not None and (mark is not None or len(found.at) > len(names) / 2):
            return found, False
    stated = any("[ns]" in text or "q_RS_w" in text for text in comments)
    whole = words[0].isdecimal() and len(words[0]) <= 20
    if len(words) >= 8 and whole and (stated or (separator is not None and int(words[0]) > 10**11)):
        upright = finite_numbers(words[4:6]) == [0.0, 0.0]  # of x y z w; of w x y z a half turn out of the plane
        if stated or len(words) > 8 or not upright:
            return Columns({name: k for k, name in enumerate(EUROC.split())}, unit="ns", names=stated), False
    if len(words) == 8:
        return Columns({name: k for k, name in enumerate(TUM.split())}, names=False), False
    commas = "; decimal commas need semicolons between columns" if re.search(r"\d,\d", line) else ""
    expected = f"expected {TUM}, or a header that names as many columns{commas}"
    raise ValueError(f"{len(words)} columns without names, {expected}")


def named(names: Sequence[str], *, header: bool = False) -> Columns | None:
    """The columns that names stand for, of a stamp and a position; a header must name both, a comment need not."""
    found: dict[str, tuple[int, str]] = {}  # column and unit, by role
    scale: dict[str, float] = {}
    for index, name in enumerate(names[:MOST_NAMES]):
        role, unit = _role(name)
        if role in found and role not in TIMES:
            both = f"both {names[found[role][0]].strip()[:60]} and {name.strip()[:60]}"
            raise ValueError(f"{both} may be {role}, expected one")
        units = METRES if role in ("x", "y", "z") else RADIANS if role in ("roll", "pitch", "yaw") else {}
        if unit and units:
            if unit not in units:
                raise ValueError(f"{name.strip()[:60]}: expected {', '.join(units)}")
            scale[role] = units[unit]
        if role:
            found.setdefault(role, (index, unit))
    times = [role for role in TIMES if role in found]
    at = {role: index for role, (index, _) in found.items() if role not in TIMES}
    if not (at and (times or {"x", "y"} <= set(at))) and not (header and times and len(names) > 2):
        return None
    whole = ("qx", "qy", "qz", "qw") if any(role[0] == "q" for role in at) else ()
    if missing := [role for role in ("x", "y", *whole) if role not in at] + ([] if times else ["a stamp"]):
        if len(names) < 4:
            return None
    elif {"sec", "nsec"} <= set(times):
        at = {"t": found["sec"][0], "nsec": found["nsec"][0], **at}
    elif times[0] in ("nsec", "part") or (times[0] == "sec" and "part" in times):
        missing = ["a stamp"]
    else:
        at = {"t": found[times[0]][0], **at}
    if missing:
        shown = ", ".join(name.strip()[:30] for name in names[:12])
        raise ValueError(f"no column of {missing[0]} among {shown}, expected its name")
    return Columns(at, scale, "ns" if "nsec" in at else SECONDS.get(found[times[0]][1]))


def _role(name: str) -> tuple[str, str]:
    """What a column's name stands for, empty if nothing of a pose, and its unit, in brackets or the last word."""
    bracket = re.search(r"[\[(]([^\])]*)[\])]\s*$", name[:LONGEST_NAME])
    unit = bracket[1].strip().lower() if bracket else ""
    words = [word for word in re.split(r"[^a-z0-9]+", re.sub(r"[\[(].*$", "", name[:LONGEST_NAME]).lower()) if word]
    is_unit = len(words) > 1 and words[-1] in (*SECONDS, "m", "mm", "deg", "rad")
    if is_unit and not (words[-2] == "stamp" and words[-1] in ("sec", "secs", "nsec", "nsecs", "nanosec")):
        last = words.pop()
        unit = unit or last
    if not OTHER.intersection(words[:-1]):
        for pattern, role in ROLES:
            if match := re.fullmatch(pattern, " ".join(words)):
                return match.expand(role), unit
    return "", unit
