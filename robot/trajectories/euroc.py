"""CSV: columns that a header names, as EuRoC's ``timestamp [ns],x,y,z,qw,qx,qy,qz``; it is written as EuRoC has it.

Source: the ground truth files of the EuRoC MAV data sets (Burri et al. 2016), ``state_groundtruth_estimate0/data.csv``.
"""

from __future__ import annotations

from fractions import Fraction
from os import PathLike
from pathlib import Path

from moteslam.errors import InputError
from moteslam.robot.files import write_atomically
from moteslam.robot.formats.stamps import MAX_STAMP
from moteslam.robot.trajectories.columns import EUROC, read_poses, recognise
from moteslam.robot.trajectories.rows import TrajectoryFormat
from moteslam.robot.trajectories.space import quaternion_of_yaw
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.wording import expect_type

HEADER = (
    "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"  # as EuRoC has it
)


def read_euroc(path: str | PathLike[str]) -> Trajectory:
    """Read a CSV of poses, projected to the plane (x, y and the rotation about z).

    A stamp is the float64 next to its whole number of nanoseconds.

    Raises:
        InputError: as of `read_poses`.
    """
    return read_poses(Path(path), f"EuRoC lines: {EUROC}")


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
    stamps = [round(Fraction(stamp) * 10**9) for stamp in trajectory.stamps.tolist()]
    x, y, theta = trajectory.poses.T
    rows = zip(stamps, x.tolist(), y.tolist(), *quaternion_of_yaw(theta), strict=True)
    lines = [HEADER, *(f"{stamp},{x!r},{y!r},0,{qw!r},0,0,{qz!r}" for stamp, x, y, qz, qw in rows)]
    write_atomically(path, "\n".join(lines) + "\n")


FORMAT = TrajectoryFormat(
    f"CSV with named columns or EuRoC's ({EUROC})",
    lambda comments, line: recognise(comments, line) == "euroc",
    read_euroc,
    write_euroc,
    (".csv",),
)
