"""TUM: ``stamp x y z qx qy qz qw`` a line, seconds and metres.

Source: the file formats of the RGB-D benchmark of TU Munich (Sturm et al. 2012).
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from moteslam.robot.files import write_atomically
from moteslam.robot.trajectories.columns import TUM, read_poses, recognise
from moteslam.robot.trajectories.rows import TrajectoryFormat
from moteslam.robot.trajectories.space import quaternion_of_yaw
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.wording import expect_type


def read_tum(path: str | PathLike[str]) -> Trajectory:
    """Read a TUM trajectory, projected to the plane (x, y and the rotation about z); commas count as blanks.

    Raises:
        InputError: as of `read_poses`.
    """
    return read_poses(Path(path), "a TUM trajectory")


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


FORMAT = TrajectoryFormat(
    f"TUM ({TUM})", lambda comments, line: recognise(comments, line) == "tum", read_tum, write_tum, (".tum",)
)
