"""EuRoC: CSV of ``timestamp [ns],x,y,z,qw,qx,qy,qz``, and more columns that are passed over.

Source: the ground truth files of the EuRoC MAV data sets (Burri et al. 2016), ``state_groundtruth_estimate0/data.csv``.
"""

from __future__ import annotations

from fractions import Fraction
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.files import write_atomically
from moteslam.robot.formats.stamps import MAX_STAMP
from moteslam.robot.trajectories.format import TrajectoryFormat
from moteslam.robot.trajectories.plane import check_quaternion, quaternion_of_yaw
from moteslam.robot.trajectories.rows import Table, check_rising, data_lines, finite_numbers
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.wording import expect_type

LINE = "timestamp [ns],x,y,z,qw,qx,qy,qz"
HEADER = (
    "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"  # as EuRoC has it
)
NANOSECONDS = 10**9
MAX_DIGITS = 20
"""Of a stamp in nanoseconds: they end at ``MAX_STAMP``."""


def read_euroc(path: str | PathLike[str]) -> Trajectory:
    """Read an EuRoC trajectory, projected to the plane (x, y and the rotation about z).

    A stamp is the float64 next to its whole number of nanoseconds.

    Raises:
        InputError: no text file of at most 500 MB, a line without whole nanoseconds and seven finite numbers, a
            quaternion of no length, stamps that go back or lie beyond 1e11 s, or no pose.
    """
    path = Path(path)
    table, before = Table(8), None
    for number, line in data_lines(path, "an EuRoC trajectory"):
        first, *words = (word.strip() for word in line.split(","))
        row = finite_numbers(words[:7])
        if not _is_whole(first) or row is None or len(row) != 7:
            raise InputError(f"expected whole nanoseconds and 7 finite numbers or more: {LINE}", file=path, line=number)
        stamp = int(first) / NANOSECONDS  # of integers: correctly rounded
        check_quaternion(row[3:], path, number)
        check_rising(stamp, before, path, number)
        table.append((stamp, *row))
        before = stamp
    if not len(table):
        raise InputError(f"no poses, expected EuRoC lines: {LINE}", file=path)
    rows = table.values
    return Trajectory(rows[:, 0], np.column_stack((rows[:, 1:3], se2.heading(rows[:, [5, 6, 7, 4]]))))


def write_euroc(path: str | PathLike[str], trajectory: Trajectory) -> None:
    """Write ``timestamp [ns],x,y,z,qw,qx,qy,qz`` lines under EuRoC's header.

    Stamps are rounded to whole nanoseconds, which is as fine as a float64 beyond 97 days and finer than one of Unix
    time: those read back the same, bit for bit, as coordinates do. The heading comes back to within an ulp or two.

    Raises:
        InputError: a stamp below 0 or beyond 1e11 s, which the format cannot hold.
        OutputError: it cannot be written.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    if len(trajectory) and not 0 <= trajectory.stamps[0] <= trajectory.stamps[-1] <= MAX_STAMP:
        raise InputError("stamps below 0 or beyond 1e11 s, expected seconds between", field="stamps")
    stamps = [round(Fraction(stamp) * NANOSECONDS) for stamp in trajectory.stamps.tolist()]
    x, y, theta = trajectory.poses.T
    rows = zip(stamps, x.tolist(), y.tolist(), *quaternion_of_yaw(theta), strict=True)
    lines = [HEADER, *(f"{stamp},{x!r},{y!r},0,{qw!r},0,0,{qz!r}" for stamp, x, y, qz, qw in rows)]
    write_atomically(path, "\n".join(lines) + "\n")


def _is_whole(word: str) -> bool:
    return word.isascii() and word.isdecimal() and len(word) <= MAX_DIGITS


def _recognise(comments: str, line: str) -> bool:
    """By the header, or else by more columns than TUM has, or by a stamp that is no whole number of seconds."""
    words = [word.strip() for word in line.split(",")]
    if len(words) < 8 or not _is_whole(words[0]):
        return False
    return "q_RS_w" in comments or "[ns]" in comments or len(words) > 8 or int(words[0]) > MAX_STAMP


FORMAT = TrajectoryFormat(f"EuRoC ({LINE})", _recognise, read_euroc, write_euroc, (".csv",))
