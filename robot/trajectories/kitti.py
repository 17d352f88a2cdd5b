"""KITTI: the upper three rows of a pose's matrix, twelve numbers a line; the stamps lie in a file beside.

Source: the odometry benchmark of KITTI (Geiger, Lenz and Urtasun 2012), ``poses/NN.txt`` and ``times.txt``. Its poses
are of the left camera, whose x points right, y down and z ahead. Others write poses of a robot (x ahead, y left) in
the same twelve numbers, and nothing in a file says which: as evo does, the axes are taken as they are.
"""

from __future__ import annotations

import warnings
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError, MoteslamWarning
from moteslam.robot.files import write_atomically
from moteslam.robot.trajectories.format import TrajectoryFormat
from moteslam.robot.trajectories.plane import is_rotation, rotation_of_yaw, yaw_of_rotation
from moteslam.robot.trajectories.rows import Table, data_lines, finite_numbers
from moteslam.robot.trajectories.times import stamps_beside, times_file, write_times
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.wording import expect_type

Array = NDArray[np.float64]

LINE = "r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z"
ROBOT_FROM_CAMERA = np.array([(0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
"""Turns a camera's axes (right, down, ahead) to a robot's (ahead, left, up)."""
TURNS = 0.98
"""Mean cosine between an axis and where the rotations take it, below which they are not about it."""


def read_kitti(path: str | PathLike[str], *, camera_axes: bool = False) -> Trajectory:
    """Read a KITTI trajectory, projected to the plane.

    The stamps are those of ``NAME.times.txt`` or ``times.txt`` beside it, one a line; where there is neither, one a
    second, with a warning.

    Args:
        path: of the file.
        camera_axes: the poses are of a camera (x right, y down, z ahead), in the frame of its first pose; the plane is
            that of x and z, and the trajectory that of a robot whose x axis is the camera's z axis. Else the plane is
            that of x and y.

    Raises:
        InputError: no text file of at most 500 MB, a line without twelve finite numbers, a matrix that is no rotation,
            no pose, or times that do not fit the poses.
    """
    path = Path(path)
    table, lines = Table(12), []
    for number, line in data_lines(path, "a KITTI trajectory"):
        row = finite_numbers(line.split())
        if row is None or len(row) != 12:
            raise InputError(f"expected 12 finite numbers: {LINE}", file=path, line=number)
        table.append(row)
        lines.append(number)
    if not len(table):
        raise InputError(f"no poses, expected KITTI lines: {LINE}", file=path)
    matrices = table.values.reshape(-1, 3, 4)
    rotation, position = matrices[:, :, :3], matrices[:, :, 3]
    if not (fits := is_rotation(rotation)).all():
        raise InputError("expected a rotation matrix in columns 1 to 3", file=path, line=lines[int(np.argmin(fits))])
    if camera_axes:
        rotation = ROBOT_FROM_CAMERA @ rotation @ ROBOT_FROM_CAMERA.T
        position = position @ ROBOT_FROM_CAMERA.T
    elif _turns_about_y(rotation):
        text = (
            f"{path}: turns about its y axis as a camera's poses do, not about z; read_kitti has camera_axes for those"
        )
        warnings.warn(MoteslamWarning(text), stacklevel=2)
    poses = np.column_stack((position[:, :2], yaw_of_rotation(rotation)))
    return Trajectory(stamps_beside(path, len(poses)), poses)


def write_kitti(path: str | PathLike[str], trajectory: Trajectory, *, camera_axes: bool = False) -> None:
    """Write twelve numbers a line, and the stamps to ``NAME.times.txt`` beside.

    Both have the fewest digits that read back the same: stamps and positions bit for bit, the heading, which goes
    through its cosine and sine, to within an ulp or two.

    Args:
        path: of the file.
        trajectory: to write.
        camera_axes: write the poses of a camera, as `read_kitti` reads them with it.

    Raises:
        OutputError: one of the files cannot be written.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    path = Path(path)
    rotation = rotation_of_yaw(trajectory.poses[:, 2])
    position = np.column_stack((trajectory.poses[:, :2], np.zeros(len(trajectory))))
    if camera_axes:
        rotation = ROBOT_FROM_CAMERA.T @ rotation @ ROBOT_FROM_CAMERA
        position = position @ ROBOT_FROM_CAMERA
    rows = np.dstack((rotation, position[:, :, None])).reshape(-1, 12) + 0.0  # + 0.0: no -0
    lines = [" ".join(map(_shortest, row)) for row in rows.tolist()]
    write_times(times_file(path), trajectory.stamps)
    write_atomically(path, "\n".join(lines) + "\n")


def _shortest(number: float) -> str:
    """The fewest digits that read back the same."""
    return str(int(number)) if number in (0.0, 1.0) else repr(number)


def _turns_about_y(rotation: Array) -> bool:
    """Whether rotations [n, 3, 3] leave the y axis where it is, and not the z axis."""
    _, about_y, about_z = rotation.mean(axis=0).diagonal().tolist()
    return bool(about_y > TURNS > about_z)


def _recognise(comments: str, line: str) -> bool:
    del comments
    row = finite_numbers(line.split())
    return row is not None and len(row) == 12


FORMAT = TrajectoryFormat(f"KITTI ({LINE})", _recognise, read_kitti, write_kitti, (".kitti",))
