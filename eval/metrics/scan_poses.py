"""Where the robot was when each scan was taken, how far it had come, and an even choice of scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import MAX_DIFFERENCE, covered, from_to, within
from moteslam.robot import se2
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.se2 import Poses
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import counted, expect_type
from moteslam.slam.inputs.synchronise import require_lidar

Array = NDArray[np.float64]


def poses_of_scans(stamps: Array, trajectory: Trajectory) -> tuple[NDArray[np.intp], Poses]:
    """The scans that have a pose: their indices [k] among the stamps [n] of all, and the poses [k, 3].

    Where the trajectory has a pose for every scan, in order, these are taken; else poses are interpolated at the scans'
    stamps: if it has more poses than there are scans wherever it covers them, if not at the scans within
    ``MAX_DIFFERENCE`` of a pose.

    Raises:
        InputError: a trajectory without poses, or fewer than two scans with one.
    """
    if not len(trajectory):
        raise InputError("a trajectory without poses, expected one for every scan", field="trajectory")
    times = trajectory.stamps
    if len(times) == len(stamps) and np.abs(times - stamps).max() <= MAX_DIFFERENCE:
        return np.arange(len(stamps)), trajectory.poses  # scans that share a stamp keep a pose of their own
    if len(times) > len(stamps):
        index = np.flatnonzero(covered(stamps, times, MAX_DIFFERENCE))
    else:
        index, _ = within(stamps, times, MAX_DIFFERENCE)
    if len(index) < 2:
        raise InputError(
            f"poses at {len(index)} of {counted(len(stamps), 'scan')}, expected at two or more: the scans cover "
            f"{from_to(stamps)}, the trajectory {from_to(times)}",
            field="trajectory",
        )
    return index, se2.interpolate(times, trajectory.poses, stamps[index])


def placed_scans(recording: Recording, trajectory: Trajectory) -> tuple[LidarStream, NDArray[np.intp], Poses]:
    """The lidar of a recording, the indices [k] of its scans that have a pose, and the poses [k, 3].

    Raises:
        InputError: something of another type, no scans, poses that are not finite, or fewer than two scans with one.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    expect_type(trajectory, Trajectory, "trajectory", "read_trajectory(path) reads one")
    lidar = require_lidar(recording)
    if not np.isfinite(trajectory.poses).all():
        raise InputError("poses that are not finite, expected x, y and theta", field="trajectory")
    return lidar, *poses_of_scans(lidar.stamps, trajectory)


def travelled(poses: Poses) -> tuple[Array, Array]:
    """The path [m] and the turns, left or right, [rad] up to each of the poses [n, 3], both [n]."""
    x, y, turns = np.diff(poses, axis=0).T
    steps = np.stack((np.hypot(x, y), np.abs(se2.wrap(turns))))
    path, turned = np.concatenate((np.zeros((2, 1)), np.cumsum(steps, axis=1)), axis=1)
    return path, turned


def evenly(some: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Those [n], or ``most`` of them where there are more: evenly spread, the first and the last among them."""
    return some if len(some) <= most else some[np.linspace(0, len(some) - 1, most).round().astype(np.intp)]
