"""The path that wheel counters measure, with a gyro's turns where there are some: what a base reports, and SLAM reads.

Distances are integrated from wheel counts, never from velocities: the real robot's encoder intervals run from 3 to 68
ms at a constant speed, so a count divided by its interval spikes to ten times the truth (docs/reference/formats.md). An
increment is a pose in the frame of the pose before it.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.platform import Wheels
from moteslam.robot.recording import ImuStream, Recording, gaps


def arc_increment(distance: ArrayLike, turn: ArrayLike) -> se2.Poses:
    """The exact arc of constant v and omega, of lengths [...] [m] and angles [...] [rad]; straight as these go to 0.

    Probabilistic Robotics, table 5.3.
    """
    distance, turn = np.asarray(distance, np.float64), np.asarray(turn, np.float64)
    # chord = d sinc(turn / 2), at half the turn: exact, and smooth through zero
    chord = distance * np.sinc(turn / (2 * np.pi))
    return se2.stack(chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn)


def wheel_motion(counts: NDArray[np.int64], wheels: Wheels) -> tuple[se2.Array, se2.Array]:
    """Distance of the centre [n] [m] and turn [n] [rad] of counts [n, 4]: the mean travel of each side's wheels.

    They are the effective track apart, which on a skid-steered robot is larger than the drawn one.
    """
    front_right, front_left, rear_right, rear_left = counts.T.astype(np.float64)
    left = (front_left + rear_left) / 2 * wheels.metres_per_count
    right = (front_right + rear_right) / 2 * wheels.metres_per_count
    return (left + right) / 2, (right - left) / wheels.effective_track


def gyro_covers(stamps: se2.Array, readings: se2.Array) -> NDArray[np.bool_]:
    """At which stamps [n] the turn since the stamp before is the gyro's; nowhere with less than two readings of it.

    From its first reading to its last [m] [s], but for gaps: rates before and after one say nothing of the turns in it.
    """
    if len(readings) < 2:
        return np.zeros(len(stamps), np.bool_)
    covered = (stamps >= readings[0]) & (stamps <= readings[-1])
    for k in np.flatnonzero(gaps(readings)).tolist():
        first, last = np.searchsorted(stamps, (readings[k - 1], readings[k]), side="right")
        covered[first : last + 1] = False
    return np.asarray(covered)


def gyro_turn(stamps: se2.Array, imu: ImuStream) -> se2.Array:
    """The turn [n] [rad] between rising stamps [n] [s], of yaw rates linear between readings; 0 outside of these."""
    rate = imu.angular_velocity[:, 2].astype(np.float64)
    heading = np.append(0.0, np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(imu.stamps)))
    return np.diff(np.interp(stamps, imu.stamps, heading), prepend=0.0)


def wheel_path(recording: Recording, *, gyro: bool = True) -> se2.Poses:
    """Dead reckoning at the encoders' stamps, [n, 3], from the identity; the first count has no interval before it.

    The turns are the gyro's where it measures, unless ``gyro`` is False, else the wheels' own.
    """
    encoders, imu, wheels = recording.encoders, recording.imu, recording.platform.wheels
    if encoders is None or not len(encoders):
        raise InputError("no encoder readings, expected at least one", file=recording.name, field="encoders")
    if wheels is None:
        raise InputError("encoders without wheels, expected a platform with [wheels]", file=recording.name)
    distance, turn = wheel_motion(encoders.counts, wheels)
    if gyro and imu is not None and (covered := gyro_covers(encoders.stamps, imu.stamps)).any():
        turn = np.where(covered, gyro_turn(encoders.stamps, imu), turn)
    distance[0], turn[0] = 0.0, 0.0
    return se2.accumulate(arc_increment(distance, turn))
