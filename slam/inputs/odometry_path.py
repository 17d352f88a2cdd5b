"""The robot's path by its own odometry: wheel counters with the gyro's yaw rate, or the poses that a log has.

Distances are integrated from wheel counts, never from velocities: the real robot's encoder intervals run from 3 to
68 ms at a constant speed, so a count divided by its interval spikes to ten times the truth (docs/reference/formats.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.kinematics import arc_increment, euler_increment, wheel_motion
from moteslam.robot.platform import Wheels
from moteslam.robot.recording import EncoderStream, ImuStream, Recording
from moteslam.robot.stamps import nearest_stamp
from moteslam.slam.inputs.config import SyncConfig

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OdometryPath:
    """A path by odometry alone.

    Attributes:
        stamps: [n] [s].
        poses: [n, 3]; the path of wheel encoders starts at the identity.
    """

    stamps: Array
    poses: Array

    def at(self, stamps: Array) -> Array:
        """The poses [m, 3] interpolated at stamps [m] [s]."""
        return se2.interpolate(self.stamps, self.poses, stamps)


def odometry_path(recording: Recording, config: SyncConfig) -> OdometryPath | None:
    """The path at the stamps that the odometry has; None where a recording has no odometry of any kind.

    Wheel encoders with the gyro's yaw rate where there are encoders (wheels alone before the gyro starts, after it
    ends, or without one), else the odometry's poses, else the poses logged with the scans.

    Raises:
        InputError: encoders on a platform without wheels.
    """
    if recording.encoders is not None and len(recording.encoders):
        wheels = recording.platform.wheels
        if wheels is None:
            raise InputError("encoders without wheels, expected a platform with [wheels]", file=recording.name)
        return _integrated(recording.encoders, recording.imu, wheels, config)
    if recording.odometry is not None and len(recording.odometry):
        return OdometryPath(recording.odometry.stamps, recording.odometry.poses)
    if recording.lidar is not None and recording.lidar.odometry is not None:
        return OdometryPath(recording.lidar.stamps, recording.lidar.odometry)
    return None


def low_pass(values: Array, stamps: Array, cut_off: float) -> Array:
    """A causal first-order Butterworth low-pass, settled at the first value.

    The readings are taken to be evenly spaced: stamps jitter more than a sensor does. The rate is the mean one up to
    each reading, so that no output follows from a later reading.

    Args:
        values: [n].
        stamps: [n] of the readings, rising [s].
        cut_off: [Hz]; 0 filters nothing, and nor does one at or above half the rate.
    """
    if not cut_off > 0:
        return values
    intervals, elapsed = np.arange(len(values)), stamps - stamps[:1]
    passed = elapsed * 2 * cut_off >= intervals
    # the bilinear transform of the analogue filter: y_i = (1 - p) (x_i + x_{i-1}) / 2 + p y_{i-1}
    warped = np.tan(np.pi * cut_off * np.where(passed, 0.0, elapsed) / np.maximum(intervals, 1))
    poles = np.where(passed, 0.0, (1 - warped) / (1 + warped))
    inputs = np.where(passed, values, (1 - poles) * (values + np.roll(values, 1)) / 2)
    filtered, last = np.empty(len(values)), 0.0
    for index, (pole, value) in enumerate(zip(poles.tolist(), inputs.tolist(), strict=True)):
        filtered[index] = last = value + pole * last
    return filtered


def _integrated(encoders: EncoderStream, imu: ImuStream | None, wheels: Wheels, config: SyncConfig) -> OdometryPath:
    """The path at the encoders' stamps from counts [n, 4] and yaw rates; the first count has no interval before it."""
    front_right, front_left, rear_right, rear_left = encoders.counts.T.astype(np.float64)
    left = (front_left + rear_left) / 2 * wheels.metres_per_count
    right = (front_right + rear_right) / 2 * wheels.metres_per_count
    distance, wheel_turn = wheel_motion(left, right, wheels.effective_track)
    turn = wheel_turn
    if imu is not None and len(imu) > 1:
        covered = (encoders.stamps >= imu.stamps[0]) & (encoders.stamps <= imu.stamps[-1])
        turn = np.where(covered, _gyro_turn(encoders.stamps, imu, config), wheel_turn)
    distance[0], turn[0] = 0.0, 0.0
    increment = euler_increment if config.kinematics == "euler" else arc_increment
    return OdometryPath(encoders.stamps, se2.accumulate(increment(distance, turn)))


def _gyro_turn(stamps: Array, imu: ImuStream, config: SyncConfig) -> Array:
    """The turn [n] [rad] between consecutive stamps [n] by the gyro; the first is 0."""
    yaw_rate = low_pass(imu.angular_velocity[:, 2].astype(np.float64), imu.stamps, config.low_pass_hz)
    if config.method == "nearest":
        return np.asarray(yaw_rate[nearest_stamp(imu.stamps, stamps)] * np.diff(stamps, prepend=stamps[0]))
    steps = (yaw_rate[1:] + yaw_rate[:-1]) / 2 * np.diff(imu.stamps)
    heading = np.concatenate(([0.0], np.cumsum(steps)))
    return np.diff(np.interp(stamps, imu.stamps, heading), prepend=0.0)
