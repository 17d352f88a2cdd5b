"""Text files of poses: TUM, EuRoC and other CSV, KITTI.

TUM: ``stamp x y z qx qy qz qw`` a line, seconds and metres; the RGB-D benchmark of TU Munich (Sturm et al. 2012).
EuRoC: ``timestamp [ns],x,y,z,qw,qx,qy,qz``; the ground truth of the EuRoC MAV data sets (Burri et al. 2016),
``state_groundtruth_estimate0/data.csv``. Of both, and of other tables, a header may name the columns.

KITTI: the upper three rows of a pose's matrix, twelve numbers a line; the stamps lie in a file beside. Source: its
odometry benchmark (Geiger, Lenz and Urtasun 2012), ``poses/NN.txt`` and ``times.txt``. Its poses are of the left
camera, whose x points right, y down and z ahead. Others write poses of a robot (x ahead, y left) in the same twelve
numbers, and nothing in a file says which: as evo does, the axes are taken as they are.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.files import write_atomically
from moteslam.robot.formats.streams import MAX_STAMP
from moteslam.robot.trajectories.columns import (
    EUROC,
    TUM,
    Columns,
    all_lines,
    columns_of,
    data_lines,
    finite_numbers,
    is_table,
    named,
    seconds,
    separator_of,
    split,
)
from moteslam.robot.trajectory import UNIT, Array, Trajectory, quaternion_of_yaw, quaternions_of, trajectory_of
from moteslam.robot.values import Issue, counted, expect_type

EUROC_HEADER = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
MAX_TURN = 6.3
"""Angles beyond this must have a unit."""
KITTI = "r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z"


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
        InputError: columns that are not named and not in the order of TUM or EuRoC, a line without finite numbers in
            them, a quaternion of another length than 1, stamps that go back or lie beyond 1e11 s, or no pose.
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
                try:
                    if finite_numbers(words[:1]) is None and (columns := named(words, header=True)):
                        continue
                    columns = columns_of(comments, words, separator)
                except ValueError as error:
                    raise InputError(str(error), file=path, line=number) from error
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


def times_file(path: Path) -> Path:
    """The file beside a trajectory that has its stamps: ``NAME.times.txt`` beside ``NAME.kitti``."""
    return path.with_name(f"{path.stem}.times.txt")


def stamps_beside(path: Path, count: int) -> tuple[Array, tuple[Issue, ...]]:
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


def read_kitti(path: str | PathLike[str]) -> Trajectory:
    """Read a KITTI trajectory, projected to the plane.

    The stamps are those of ``NAME.times.txt`` or ``times.txt`` beside it, one a line; where there is neither, one a
    second, which its ``warnings`` say.
    """
    path = Path(path)
    rows, lines = [], []
    for number, line in data_lines(path, "a KITTI trajectory"):
        row = finite_numbers(line.split())
        if row is None or len(row) != 12:
            raise InputError(f"expected 12 finite numbers: {KITTI}", file=path, line=number)
        rows.append(row)
        lines.append(number)
    if not rows:
        raise InputError(f"no poses, expected KITTI lines: {KITTI}", file=path)
    matrices = np.array(rows).reshape(-1, 3, 4)
    rotation, position = matrices[:, :, :3], matrices[:, :, 3]
    off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
    if (bad := (off > UNIT) | (np.linalg.det(rotation) <= 0)).any():
        raise InputError("expected a rotation matrix in columns 1 to 3", file=path, line=lines[int(np.argmax(bad))])
    stamps, issues = stamps_beside(path, len(rows))
    found = trajectory_of(path, stamps, position, quaternions_of(rotation), lines=lines, warnings=issues)
    # as written, without a way through quaternions
    heading = se2.wrap(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
    return Trajectory(stamps, np.column_stack((position[:, :2], heading)), found.oriented, found.space, found.warnings)


def write_kitti(path: str | PathLike[str], trajectory: Trajectory) -> None:
    """Write twelve numbers a line, and the stamps to ``NAME.times.txt`` beside.

    Both have the fewest digits that read back the same: stamps and positions bit for bit, the heading, which goes
    through its cosine and sine, to within an ulp or two.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    path = Path(path)
    cos, sin = np.cos(trajectory.poses[:, 2]), np.sin(trajectory.poses[:, 2])
    rotation = np.zeros((len(trajectory), 3, 3))
    rotation[:, 0, 0], rotation[:, 1, 1], rotation[:, 2, 2] = cos, cos, 1.0
    rotation[:, 1, 0], rotation[:, 0, 1] = sin, -sin
    position = np.column_stack((trajectory.poses[:, :2], np.zeros(len(trajectory))))
    rows = np.dstack((rotation, position[:, :, None])).reshape(-1, 12) + 0.0  # + 0.0: no -0
    lines = [" ".join(map(_shortest, row)) for row in rows.tolist()]
    write_atomically(times_file(path), "".join(f"{stamp!r}\n" for stamp in trajectory.stamps.tolist()))
    write_atomically(path, "\n".join(lines) + "\n")


def _shortest(number: float) -> str:
    """The fewest digits that read back the same."""
    return str(int(number)) if number in (0.0, 1.0) else repr(number)


def _is_kitti(comments: str, line: str) -> bool:
    """Twelve numbers; asked after those whose columns may be named."""
    row = finite_numbers(line.split())
    return row is not None and len(row) == 12


TUM_FORMAT = TrajectoryFormat(f"TUM ({TUM})", is_table, read_tum, write_tum, (".tum",))
EUROC_FORMAT = TrajectoryFormat(
    f"CSV with named columns or EuRoC's ({EUROC})", is_table, read_euroc, write_euroc, (".csv",)
)
KITTI_FORMAT = TrajectoryFormat(f"KITTI ({KITTI})", _is_kitti, read_kitti, write_kitti, (".kitti",))
