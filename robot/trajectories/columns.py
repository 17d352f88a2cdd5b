"""Tables of poses, a line each: TUM's and EuRoC's columns, or those that a header names.

Names are known by their last word and those before it: ``x``, ``tx``, ``p_RS_R_x [m]``, ``pose.position.x``; ``qw``,
``q_RS_w []``, ``orientation.w``; ``yaw [deg]``; ``t``, ``timestamp [ns]``, ``header.stamp``. Columns of other names
(velocities, covariances) are passed over.

Sources: TUM, the file formats of the RGB-D benchmark of TU Munich (Sturm et al. 2012); EuRoC, the ground truth files of
the EuRoC MAV data sets (Burri et al. 2016), ``state_groundtruth_estimate0/data.csv``.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.files import write_atomically
from moteslam.robot.formats.stamps import MAX_STAMP
from moteslam.robot.trajectories.rows import TrajectoryFormat, all_lines, finite_numbers, seconds
from moteslam.robot.trajectory import Array, Trajectory, quaternion_of_yaw, trajectory_of
from moteslam.robot.values import Issue, expect_type

TUM, EUROC = "stamp x y z qx qy qz qw", "timestamp [ns],x,y,z,qw,qx,qy,qz"
EUROC_HEADER = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
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
MAX_TURN = 6.3
"""Angles beyond this must have a unit."""


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


def read_tum(path: str | PathLike[str]) -> Trajectory:
    """Read a TUM trajectory, projected to the plane (x, y and the rotation about z); commas count as blanks."""
    return read_poses(Path(path), "a TUM trajectory")


def write_tum(path: str | PathLike[str], trajectory: Trajectory) -> None:
    """Write ``stamp x y z qx qy qz qw`` lines that read back to the same stamps, bit for bit.

    Stamps and coordinates are written with the fewest digits that round-trip (Unix seconds with microseconds keep
    them). The heading goes through a quaternion and comes back to within an ulp or two.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    lines += [f"{stamp!r} {x!r} {y!r} 0 0 0 {qz!r} {qw!r}" for stamp, x, y, qz, qw in _rows(trajectory)]
    write_atomically(path, "\n".join(lines) + "\n")


def read_euroc(path: str | PathLike[str]) -> Trajectory:
    """Read a CSV of poses, projected to the plane (x, y and the rotation about z).

    A stamp is the float64 next to its whole number of nanoseconds.
    """
    return read_poses(Path(path), f"EuRoC lines: {EUROC}")


def write_euroc(path: str | PathLike[str], trajectory: Trajectory) -> None:
    """Write ``timestamp [ns],x,y,z,qw,qx,qy,qz`` lines under EuRoC's header.

    Stamps, from 0 to 1e11 s, are rounded to whole nanoseconds, which is as fine as a float64 beyond 97 days and finer
    than one of Unix time: those read back the same, bit for bit, as coordinates do. The heading comes back to within an
    ulp or two.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    if len(trajectory) and not 0 <= trajectory.stamps[0] <= trajectory.stamps[-1] <= MAX_STAMP:
        raise InputError("stamps below 0 or beyond 1e11 s, expected seconds between", field="stamps")
    rows = ((round(Fraction(stamp) * 10**9), *row) for stamp, *row in _rows(trajectory))
    lines = [EUROC_HEADER, *(f"{stamp},{x!r},{y!r},0,{qw!r},0,0,{qz!r}" for stamp, x, y, qz, qw in rows)]
    write_atomically(path, "\n".join(lines) + "\n")


def _rows(trajectory: Trajectory) -> list[list[float]]:
    """Stamp, x, y and the z and w of the heading's quaternion of each pose."""
    x, y, theta = trajectory.poses.T
    rows: list[list[float]] = np.column_stack((trajectory.stamps, x, y, *quaternion_of_yaw(theta))).tolist()
    return rows


def read_poses(path: Path, what: str) -> Trajectory:
    """Read a table of poses; ``what`` it should be: ``a TUM trajectory``.

    Raises:
        InputError: no text file of at most 500 MB; columns that are not named and not in the order of TUM or EuRoC; a
            line without finite numbers in them, a quaternion that is not of length 1, stamps that go back or lie beyond
            1e11 s, or no pose.
    """
    columns: Columns | None = None
    comments: list[str] = []
    separator: str | None = None
    stamps: list[str] = []
    rows, lines = array("d"), array("q")
    names: list[str] = []
    wanted: list[int] = []
    for number, line in all_lines(path, what):
        if line.startswith("#" if columns else ("#", "%")):
            comments.append(line)
            continue
        if not names:
            if columns is None:
                separator = separator_of(line)
                words = split(line, separator)
                if finite_numbers(words[:1]) is None and (columns := _named(words, path, number, header=True)):
                    continue
                columns = _columns(comments, words, separator, path, number)
            names = [name for name in columns.at if name not in ("t", "nsec")]
            wanted = [columns.at[name] for name in names]
            separator = None if separator == "," and not columns.stated and columns.count else separator
        assert columns is not None
        words = split(line, separator)
        row = finite_numbers([words[k] for k in wanted]) if len(words) > max(columns.at.values()) else None
        if row is None or columns.count not in (None, len(words)) or (stamp := _stamp(words, columns)) is None:
            numbers = f"{columns.count} finite numbers" if columns.count else "finite numbers"
            numbers = f"whole nanoseconds and {numbers}" if columns.unit == "ns" else numbers
            raise InputError(f"expected {numbers}: {', '.join(columns.at)}", file=path, line=number)
        stamps.append(stamp)
        rows.extend(row)
        lines.append(number)
    if columns is None or not lines:
        raise InputError(f"no poses, expected {what}", file=path)
    times, issues = seconds(stamps, path, lines, "ns" if "nsec" in columns.at else columns.unit)
    values = np.array(rows).reshape(len(lines), -1).T
    table = {name: some * columns.scale.get(name, 1.0) for name, some in zip(names, values, strict=True)}
    nothing = np.zeros(len(lines))
    positions = np.column_stack((table["x"], table["y"], table.get("z", nothing)))
    quaternions = None
    if "qw" in table:
        quaternions = np.column_stack([table[name] for name in ("qx", "qy", "qz", "qw")])
        if not columns.stated and ((separator is not None and columns.unit == "ns") or _turns_about_x(quaternions)):
            order = " ".join(name for name in names if name[0] == "q")
            text = f"{path}: no names of columns: its orientations are taken for {order}; a header would say so"
            issues += (Issue("orientation-order", text, len(lines)),)
    elif "yaw" in table:
        if "yaw" not in columns.scale and np.abs(table["yaw"]).max() > MAX_TURN:
            raise InputError("angles beyond 6.3, expected a unit in the header: yaw [rad] or yaw [deg]", file=path)
        quaternions = _of_angles(*(table.get(name, nothing) for name in ("roll", "pitch", "yaw")))
    return trajectory_of(path, times, positions, quaternions, lines=lines, warnings=issues)


def recognise(comments: str, line: str) -> str | None:
    """``tum``, ``euroc`` (any CSV whose columns are named) or None, by the first comments and the first line."""
    separator = separator_of(line)
    words = split(line, separator)
    numbers = finite_numbers(words[:1]) is not None
    try:
        if not numbers:
            return None if _named(words, Path(), 0, header=True) is None else "euroc"
        if finite_numbers(words[:8]) is None and separator is None:
            return None
        found = _columns(comments.splitlines(), words, separator, Path(), 0)
    except InputError:  # named, or of numbers, and yet not understood: the reader says why
        named = any(
            _time_of(_words(name) or [""]) is not None
            for text in comments.splitlines()
            for name in split(text.lstrip("#%"), separator)
        )
        return "euroc" if (separator is not None and (named or len(words) >= 8)) or not numbers else None
    return "euroc" if found.unit == "ns" or (found.stated and separator is not None) else "tum"


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


def _columns(comments: Sequence[str], words: Sequence[str], separator: str | None, path: Path, line: int) -> Columns:
    """The columns of a file by its comments and its first line of numbers."""
    for text in (re.sub(r"\s+([\[(])", r"\1", text) for text in reversed(comments)):
        for mark in (",", ";", "\t", None):
            names = split(text.lstrip("#% "), mark)
            try:
                found = _named(names, path, line) if len(names) == len(words) else None
            except InputError:
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
    raise InputError(f"{len(words)} columns without names, {expected}", file=path, line=line)


def _named(names: Sequence[str], path: Path, line: int, *, header: bool = False) -> Columns | None:
    """The columns that names stand for; None where they are no names of a stamp and a position.

    A header must name both; a comment need not.
    """
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
                raise InputError(f"{both} may be {role}, expected one", file=path, line=line)
            at[role] = index
            known = LENGTHS if role in ("x", "y", "z") else ANGLES
            if unit and role[0] != "q":
                if unit not in known:
                    raise InputError(f"{name.strip()[:60]}: expected {', '.join(known)}", file=path, line=line)
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
        raise InputError(f"no column of {missing[0]} among {shown}, expected its name", file=path, line=line)
    if "sec" in times and "nsec" in times:
        return Columns({"t": times["sec"][0], "nsec": times["nsec"][0], **at}, scale)
    first = next((name for name in (*TIME, "sec") if name in times), None)
    if first is None or (first == "sec" and "part" in times):
        raise InputError(f"no column of a stamp among {shown}, expected its name", file=path, line=line)
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


def _stamp(words: Sequence[str], columns: Columns) -> str | None:
    """The word of a stamp; of seconds and nanoseconds apart, nanoseconds."""
    stamp = words[columns.at["t"]]
    if "nsec" in columns.at:
        rest = words[columns.at["nsec"]]
        whole = stamp.isdecimal() and rest.isdecimal() and max(len(stamp), len(rest)) < 12
        return str(int(stamp) * 10**9 + int(rest)) if whole else None
    number = finite_numbers([stamp[:40]])
    return stamp[:40] if number is not None and (columns.unit != "ns" or number[0].is_integer()) else None


def _turns_about_x(quaternions: Array) -> bool:
    """Whether quaternions [n, 4] turn about x alone, and turn: as those of a robot whose w stands first."""
    return bool((np.abs(quaternions[:, 1:3]) < 1e-6).all() and np.ptp(np.abs(quaternions[:, 0])) > 0.05)


def _of_angles(roll: Array, pitch: Array, yaw: Array) -> Array:
    """The quaternions [n, 4] of angles [n] about the fixed axes x, y, z, in this order (ROS REP 103)."""
    (a, b, c), (i, j, k) = np.cos([roll / 2, pitch / 2, yaw / 2]), np.sin([roll / 2, pitch / 2, yaw / 2])
    return np.column_stack((i * b * c - a * j * k, a * j * c + i * b * k, a * b * k - i * j * c, a * b * c + i * j * k))


TUM_FORMAT = TrajectoryFormat(
    f"TUM ({TUM})", lambda comments, line: recognise(comments, line) == "tum", read_tum, write_tum, (".tum",)
)
EUROC_FORMAT = TrajectoryFormat(
    f"CSV with named columns or EuRoC's ({EUROC})",
    lambda comments, line: recognise(comments, line) == "euroc",
    read_euroc,
    write_euroc,
    (".csv",),
)
