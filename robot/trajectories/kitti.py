"""KITTI: the upper three rows of a pose's matrix, twelve numbers a line; the stamps lie in a file beside.

Source: the odometry benchmark of KITTI (Geiger, Lenz and Urtasun 2012), ``poses/NN.txt`` and ``times.txt``. Its poses
are of the left camera, whose x points right, y down and z ahead. Others write poses of a robot (x ahead, y left) in
the same twelve numbers, and nothing in a file says which: as evo does, the axes are taken as they are.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.files import write_atomically
from moteslam.robot.trajectories.rows import TrajectoryFormat, data_lines, finite_numbers, stamps_beside, times_file
from moteslam.robot.trajectory import UNIT, Trajectory, quaternions_of, trajectory_of
from moteslam.robot.values import expect_type

LINE = "r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z"
ROBOT_FROM_CAMERA = np.array([(0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
"""Turns a camera's axes (right, down, ahead) to a robot's (ahead, left, up)."""


def read_kitti(path: str | PathLike[str], *, camera_axes: bool = False) -> Trajectory:
    """Read a KITTI trajectory, projected to the plane.

    The stamps are those of ``NAME.times.txt`` or ``times.txt`` beside it, one a line; where there is neither, one a
    second, which its ``warnings`` say.

    Args:
        path: of the file.
        camera_axes: the poses are of a camera (x right, y down, z ahead), in the frame of its first pose; the plane is
            that of x and z, and the trajectory that of a robot whose x axis is the camera's z axis. Else the plane is
            that of x and y.
    """
    path = Path(path)
    rows, lines = [], []
    for number, line in data_lines(path, "a KITTI trajectory"):
        row = finite_numbers(line.split())
        if row is None or len(row) != 12:
            raise InputError(f"expected 12 finite numbers: {LINE}", file=path, line=number)
        rows.append(row)
        lines.append(number)
    if not rows:
        raise InputError(f"no poses, expected KITTI lines: {LINE}", file=path)
    matrices = np.array(rows).reshape(-1, 3, 4)
    rotation, position = matrices[:, :, :3], matrices[:, :, 3]
    off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
    if (bad := (off > UNIT) | (np.linalg.det(rotation) <= 0)).any():
        raise InputError("expected a rotation matrix in columns 1 to 3", file=path, line=lines[int(np.argmax(bad))])
    if camera_axes:
        rotation = ROBOT_FROM_CAMERA @ rotation @ ROBOT_FROM_CAMERA.T
        position = position @ ROBOT_FROM_CAMERA.T
    stamps, issues = stamps_beside(path, len(rows))
    found = trajectory_of(path, stamps, position, quaternions_of(rotation), lines=lines, warnings=issues)
    # as written, without a way through quaternions
    heading = se2.wrap(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
    return Trajectory(stamps, np.column_stack((position[:, :2], heading)), found.oriented, found.space, found.warnings)


def write_kitti(path: str | PathLike[str], trajectory: Trajectory, *, camera_axes: bool = False) -> None:
    """Write twelve numbers a line, and the stamps to ``NAME.times.txt`` beside.

    Both have the fewest digits that read back the same: stamps and positions bit for bit, the heading, which goes
    through its cosine and sine, to within an ulp or two.

    Args:
        path: of the file.
        trajectory: to write.
        camera_axes: write the poses of a camera, as `read_kitti` reads them with it.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    path = Path(path)
    cos, sin = np.cos(trajectory.poses[:, 2]), np.sin(trajectory.poses[:, 2])
    rotation = np.zeros((len(trajectory), 3, 3))
    rotation[:, 0, 0], rotation[:, 1, 1], rotation[:, 2, 2] = cos, cos, 1.0
    rotation[:, 1, 0], rotation[:, 0, 1] = sin, -sin
    position = np.column_stack((trajectory.poses[:, :2], np.zeros(len(trajectory))))
    if camera_axes:
        rotation = ROBOT_FROM_CAMERA.T @ rotation @ ROBOT_FROM_CAMERA
        position = position @ ROBOT_FROM_CAMERA
    rows = np.dstack((rotation, position[:, :, None])).reshape(-1, 12) + 0.0  # + 0.0: no -0
    lines = [" ".join(map(_shortest, row)) for row in rows.tolist()]
    write_atomically(times_file(path), "".join(f"{stamp!r}\n" for stamp in trajectory.stamps.tolist()))
    write_atomically(path, "\n".join(lines) + "\n")


def _shortest(number: float) -> str:
    """The fewest digits that read back the same."""
    return str(int(number)) if number in (0.0, 1.0) else repr(number)


def _recognise(comments: str, line: str) -> bool:
    """Twelve numbers; asked after those whose columns may be named."""
    row = finite_numbers(line.split())
    return row is not None and len(row) == 12


FORMAT = TrajectoryFormat(f"KITTI ({LINE})", _recognise, read_kitti, write_kitti, (".kitti",))
