"""The robot's path by its own odometry: wheel counters with the gyro's yaw rate, or the poses that a log has.

How counts and yaw rates are integrated is in `robot/wheel_odometry.py`; here are the choices of a configuration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.robot import se2
from moteslam.robot.recording import ImuStream, Ranges, Recording, nearest_stamp
from moteslam.robot.wheel_odometry import arc_increment, gyro_turn, wheel_path
from moteslam.slam.inputs.config import SyncConfig

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OdometryPath:
    """A path by odometry alone.

    Attributes:
        stamps: [n] [s].
        poses: [n, 3]; the path of wheel encoders starts at the identity.
        by_wheels: [n, 3] the same with the wheels' own turns; None without a gyro.
    """

    stamps: Array
    poses: Array
    by_wheels: Array | None = None

    def at(self, stamps: Array) -> Array:
        """The poses [m, 3] interpolated at stamps [m] [s]."""
        return se2.interpolate(self.stamps, self.poses, stamps)


def euler_increment(distance: ArrayLike, turn: ArrayLike) -> se2.Poses:
    """Equation III.1 of the paper: straight along the old heading by v tau [...] [m], then a turn omega tau [rad]."""
    distance, turn = np.asarray(distance, np.float64), np.asarray(turn, np.float64)
    return np.stack(np.broadcast_arrays(distance, np.zeros_like(distance), turn), axis=-1)


def odometry_path(recording: Recording, config: SyncConfig) -> OdometryPath | None:
    """The path at the stamps that the odometry has; None without odometry of any kind.

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


def between_known(path: Array, known: NDArray[np.intp], motion: Array) -> Array:
    """The poses [n, 3] of all n places along a motion, where those of some are known.

    Motion on from the place before and back from the place after do not quite meet; the misfit is spread evenly over
    the places between.

    Args:
        path: [u, 3] poses of the known places.
        known: [u] which of the n places they are, rising.
        motion: [n, 3] poses of all places, as the motion has them, in a frame of its own.
    """
    places = np.arange(len(motion))
    before = np.clip(np.searchsorted(known, places, side="right") - 1, 0, len(known) - 1)
    after = np.minimum(before + 1, len(known) - 1)
    forward = se2.compose(path[before], se2.between(motion[known[before]], motion))
    backward = se2.compose(path[after], se2.between(motion[known[after]], motion))
    span = known[after] - known[before]
    share = np.where(span > 0, (places - known[before]) / np.maximum(span, 1), 0.0)[:, None]
    misfit = backward - forward
    misfit[:, 2] = se2.wrap(misfit[:, 2])
    poses = forward + share * misfit
    poses[:, 2] = se2.wrap(poses[:, 2])
    return np.asarray(poses)


USUAL = 90
"""The percentile of the latest steps that a step is compared with."""
LATEST = 1000
"""How many steps are compared with."""


def jumps(stamps: Array, odometry: Array, config: SyncConfig | None = None) -> NDArray[np.bool_]:
    """At which readings the odometry has jumped since the reading before.

    A step has jumped if it is faster than a robot drives and ``jump_factor`` times as long as the 90th percentile of
    the latest 1000 steps. These end with the step itself, so that the result is causal. With a factor of ten none of
    the first nine steps is a jump: a single long step does not stand out among nine. Log writers stamp readings in
    bursts: a step counts as having taken at least the median time of the latest steps.

    Args:
        stamps: [n] of the readings [s]; where two are equal there is no speed, and no jump.
        odometry: [n, 3] poses there.
        config: the bounds; the defaults if None.

    Returns:
        [n]; the first is False.
    """
    c = config or SyncConfig()
    dt = np.diff(stamps)
    motion = se2.between(odometry[:-1], odometry[1:])
    jump = np.zeros(len(stamps), np.bool_)
    for size, fastest, least in (
        (np.hypot(motion[:, 0], motion[:, 1]), c.max_speed, c.min_jump_distance),
        (np.abs(motion[:, 2]), c.max_turn_rate, c.min_jump_rotation),
    ):
        for step in np.flatnonzero((dt > 0) & (size > np.maximum(fastest * dt, least))).tolist():
            latest = slice(max(0, step + 1 - LATEST), step + 1)
            farthest = max(fastest * np.median(dt[latest]), c.jump_factor * np.percentile(size[latest], USUAL))
            jump[step + 1] |= size[step] > farthest
    return jump


def has_moved(odometry: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the odometry [n, 3] has moved by each scan, [n]."""
    return np.logical_or.accumulate((odometry != odometry[0]).any(axis=1))


def stands(ranges: Ranges, moved: NDArray[np.bool_], config: SyncConfig | None = None) -> NDArray[np.bool_]:
    """At which scans the robot is seen to stand where it began, before its odometry moves.

    Args:
        ranges: [n, beams] of the scans [m].
        moved: [n] whether the odometry has moved by each.
        config: what counts as another place; the defaults if None.

    Returns:
        [n]; False from the first scan on that differs from scan 0, and where no beam has an endpoint in both.
    """
    c = config or SyncConfig()
    there = np.zeros(len(moved), np.bool_)
    first = ranges[0]
    for scan in range(int((~moved).sum())):
        here = ranges[scan]
        both = np.isfinite(first) & np.isfinite(here)
        differs = np.abs(here[both] - first[both]) > c.same_range
        if differs.sum() > c.moved_share * both.sum():
            break
        there[scan] = both.any()
    return there
