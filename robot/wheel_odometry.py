"""The path that wheel counters measure, with a gyro's turns where there are some: what a base reports, and SLAM reads.

A file of its own since simulation and SLAM, which never import each other, integrate the same streams. Distances are
integrated from wheel counts, never from velocities: the real robot's encoder intervals run from 3 to 68 ms at a
constant speed, so a count divided by its interval spikes to ten times the truth (docs/reference/formats.md).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.kinematics import arc_increment, wheel_motion
from moteslam.robot.platform import Wheels
from moteslam.robot.recording import ImuStream, Recording
from moteslam.robot.stamps import gaps

Array = NDArray[np.float64]


def side_travel(counts: NDArray[np.int64], wheels: Wheels) -> tuple[Array, Array]:
    """The mean travel of the left and of the right wheels [n] [m] of counts [n, 4]."""
    front_right, front_left, rear_right, rear_left = counts.T.astype(np.float64)
    left = (front_left + rear_left) / 2 * wheels.metres_per_count
    right = (front_right + rear_right) / 2 * wheels.metres_per_count
    return left, right


def gyro_covers(stamps: Array, imu: ImuStream | None) -> NDArray[np.bool_]:
    """At which stamps [n] the turn since the stamp before is the gyro's; nowhere with less than two readings of it.

    From its first reading to its last, but where it has a gap in between: the yaw rates before and after say nothing of
    the turns in it, of which wheels may have counted all.
    """
    if imu is None or len(imu) < 2:
        return np.zeros(len(stamps), np.bool_)
    covered = (stamps >= imu.stamps[0]) & (stamps <= imu.stamps[-1])
    for k in np.flatnonzero(gaps(imu.stamps)).tolist():
        first, last = np.searchsorted(stamps, (imu.stamps[k - 1], imu.stamps[k]), side="right")
        covered[first : last + 1] = False
    return np.asarray(covered)


def gyro_turn(stamps: Array, imu: ImuStream, yaw_rate: Array | None = None) -> Array:
    """The turn [n] [rad] between consecutive stamps [n], the integral of yaw rates that are linear between readings.

    Args:
        stamps: rising [s].
        imu: at least two readings; outside their time there is no turn.
        yaw_rate: one for each of its readings [rad/s], where they are filtered; the readings themselves if None.

    Returns:
        turns; the first is 0 where the gyro starts after the first stamp, and counts from its start otherwise.
    """
    rate = imu.angular_velocity[:, 2].astype(np.float64) if yaw_rate is None else yaw_rate
    steps = (rate[1:] + rate[:-1]) / 2 * np.diff(imu.stamps)
    heading = np.concatenate(([0.0], np.cumsum(steps)))
    return np.diff(np.interp(stamps, imu.stamps, heading), prepend=0.0)


def wheel_path(
    recording: Recording,
    *,
    turn_of: Callable[[Array, ImuStream], Array] | None = gyro_turn,
    increment: Callable[[ArrayLike, ArrayLike], se2.Poses] = arc_increment,
) -> se2.Poses:
    """Dead reckoning at the encoders' stamps, [n, 3], from the identity; the first count has no interval before it.

    Args:
        recording: with encoders.
        turn_of: gives the turns [n] between stamps [n] by the gyro. The wheels' own are taken where it does not
            measure, or where this is None.
        increment: of a distance and a turn.

    Raises:
        InputError: no encoder readings, or a platform without wheels.
    """
    encoders, imu, wheels = recording.encoders, recording.imu, recording.platform.wheels
    if encoders is None or not len(encoders):
        raise InputError("no encoder readings, expected at least one", file=recording.name, field="encoders")
    if wheels is None:
        raise InputError("encoders without wheels, expected a platform with [wheels]", file=recording.name)
    distance, turn = wheel_motion(*side_travel(encoders.counts, wheels), wheels.effective_track)
    covered = gyro_covers(encoders.stamps, imu)
    if turn_of is not None and imu is not None and covered.any():
        turn = np.where(covered, turn_of(encoders.stamps, imu), turn)
    distance[0], turn[0] = 0.0, 0.0
    return se2.accumulate(increment(distance, turn))
