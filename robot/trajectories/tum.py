"""TUM: ``stamp x y z qx qy qz qw`` a line, seconds and metres.

Source: the file formats of the RGB-D benchmark of TU Munich (Sturm et al. 2012).
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.files import write_atomically
from moteslam.robot.trajectories.format import TrajectoryFormat
from moteslam.robot.trajectories.plane import check_quaternion, quaternion_of_yaw
from moteslam.robot.trajectories.rows import Table, check_rising, data_lines, finite_numbers
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.wording import expect_type

LINE = "stamp x y z qx qy qz qw"


def read_tum(path: str | PathLike[str]) -> Trajectory:
    """Read a TUM trajectory, projected to the plane (x, y and the rotation about z); commas count as blanks.

    Raises:
        InputError: no text file of at most 500 MB, a line without eight finite numbers, a quaternion of no length,
            stamps that go back, or no pose.
    """
    path = Path(path)
    table, before = Table(8), None
    for number, line in data_lines(path, "a TUM trajectory"):
        row = finite_numbers(line.replace(",", " ").split())
        if row is None or len(row) != 8:
            raise InputError(f"expected 8 finite numbers: {LINE}", file=path, line=number)
        check_quaternion(row[4:], path, number)
        check_rising(row[0], before, path, number)
        table.append(row)
        before = row[0]
    if not len(table):
        raise InputError(f"no poses, expected TUM lines: {LINE}", file=path)
    rows = table.values
    return Trajectory(rows[:, 0], np.column_stack((rows[:, 1:3], se2.heading(rows[:, 4:]))))


def write_tum(path: str | PathLike[str], trajectory: Trajectory) -> None:
    """Write ``stamp x y z qx qy qz qw`` lines that read back to the same stamps, bit for bit.

    Stamps and coordinates are written with the fewest digits that round-trip (Unix seconds with microseconds keep
    them). The heading goes through a quaternion and comes back to within an ulp or two.

    Raises:
        OutputError: it cannot be written.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    x, y, theta = trajectory.poses.T
    rows = zip(trajectory.stamps.tolist(), x.tolist(), y.tolist(), *quaternion_of_yaw(theta), strict=True)
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    lines += [f"{stamp!r} {x!r} {y!r} 0 0 0 {qz!r} {qw!r}" for stamp, x, y, qz, qw in rows]
    write_atomically(path, "\n".join(lines) + "\n")


def _recognise(comments: str, line: str) -> bool:
    del comments
    row = finite_numbers(line.replace(",", " ").split())
    return row is not None and len(row) == 8


FORMAT = TrajectoryFormat(f"TUM ({LINE})", _recognise, read_tum, write_tum, (".tum",))
