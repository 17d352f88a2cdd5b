"""The robot's path by its own odometry: wheel counters with the gyro's yaw rate, or the poses that a log has.

How counts and yaw rates are integrated is in `robot/wheel_odometry.py`; here are the choices of a configuration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.recording import ImuStream, Recording, nearest_stamp
from moteslam.robot.wheel_odometry import arc_increment, euler_increment, gyro_turn, wheel_path
from moteslam.slam.inputs.config import SyncConfig

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OdometryPath:
    """A path by odometry alone.

    Attributes:
        stamps: [n] [s].
        poses: [n, 3]; the path of wheel encoders starts at the identity.
        by_wheels: [n, 3] the same with the wheels' own turns; None where the turns are no gyro's.
    """

    stamps: Array
    poses: Array
    by_wheels: Array | None = None

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
        increment = euler_increment if config.kinematics == "euler" else arc_increment
        poses = wheel_path(recording, turn_of=partial(_gyro_turn, config=config), increment=increment)
        alone = wheel_path(recording, turn_of=None) if recording.imu is not None else None
        return OdometryPath(recording.encoders.stamps, poses, alone)
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


def _gyro_turn(stamps: Array, imu: ImuStream, config: SyncConfig) -> Array:
    """The turn [n] [rad] between consecutive stamps [n] by the gyro; the first is 0."""
    yaw_rate = low_pass(imu.angular_velocity[:, 2].astype(np.float64), imu.stamps, config.low_pass_hz)
    if config.method == "nearest":
        return np.asarray(yaw_rate[nearest_stamp(imu.stamps, stamps)] * np.diff(stamps, prepend=stamps[0]))
    return gyro_turn(stamps, imu, yaw_rate)
