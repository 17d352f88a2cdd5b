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
        unwrapped: [n] the headings without a step of a whole turn, where the path has a beginning that is forgotten.
    """

    stamps: Array
    poses: Array
    by_wheels: Array | None = None
    unwrapped: Array | None = None

    def at(self, stamps: Array) -> Array:
        """The poses [m, 3] interpolated at stamps [m] [s]."""
        if self.unwrapped is None:
            return se2.interpolate(self.stamps, self.poses, stamps)
        columns = (*self.poses.T[:2], self.unwrapped)
        x, y, heading = (np.interp(stamps, self.stamps, each) for each in columns)
        return np.stack((x, y, se2.wrap(heading)), axis=-1)


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


class LowPass:
    """A causal first-order Butterworth low-pass, settled at the first value.

    The readings are taken to be evenly spaced: stamps jitter more than a sensor does. The rate is the mean one up to
    each reading, so that no output follows from a later reading.

    Args:
        cut_off: [Hz]; 0 filters nothing, and nor does one at or above half the rate.
    """

    def __init__(self, cut_off: float) -> None:
        self._cut_off, self._readings, self._first = cut_off, 0, 0.0
        self._input = self._output = 0.0  # the latest

    def of(self, value: float, stamp: float) -> float:
        """The filtered value of the next reading; stamps rise [s]."""
        if not self._cut_off > 0:
            return value
        self._first = self._first if self._readings else stamp
        elapsed, before, pole = stamp - self._first, self._input, 0.0
        self._input = value
        if elapsed * 2 * self._cut_off < self._readings:
            # the bilinear transform of the analogue filter: y_i = (1 - p) (x_i + x_{i-1}) / 2 + p y_{i-1}
            warped = float(np.tan(np.pi * self._cut_off * elapsed / self._readings))
            pole = (1 - warped) / (1 + warped)
            value = (1 - pole) * (value + before) / 2
        self._readings += 1
        self._output = value + pole * self._output
        return self._output


def low_pass(values: Array, stamps: Array, cut_off: float) -> Array:
    """The values [n] of rising stamps [n] [s], filtered."""
    passing = LowPass(cut_off)
    return np.array([passing.of(value, stamp) for value, stamp in zip(values.tolist(), stamps.tolist(), strict=True)])


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


def jumps(
    stamps: Array, odometry: Array, config: SyncConfig | None = None, since: float = -np.inf
) -> NDArray[np.bool_]:
    """At which readings the odometry has jumped since the reading before.

    A step has jumped if it is faster than a robot drives and ``jump_factor`` times as long as the 90th percentile of
    the latest 1000 steps. These end with the step itself, so that the result is causal. With a factor of ten none of
    the first nine steps is a jump: a single long step does not stand out among nine. Log writers stamp readings in
    bursts: a step counts as having taken at least the median time of the latest steps.

    Args:
        stamps: [n] of the readings [s]; where two are equal there is no speed, and no jump.
        odometry: [n, 3] poses there.
        config: the bounds; the defaults if None.
        since: those before are not asked for [s].

    Returns:
        [n]; the first is False.
    """
    c = config or SyncConfig()
    jump = np.zeros(len(stamps), np.bool_)
    begin = max(int(np.searchsorted(stamps, since)) - 1, 0)
    for first in (begin, 0) if begin else (0,):  # most often none is so fast, and the rest need not be looked at
        dt = np.diff(stamps[first:])
        motion = se2.between(odometry[first:-1], odometry[first + 1 :])
        steps = (
            (np.hypot(motion[:, 0], motion[:, 1]), c.max_speed, c.min_jump_distance),
            (np.abs(motion[:, 2]), c.max_turn_rate, c.min_jump_rotation),
        )
        fast = [np.flatnonzero((dt > 0) & (size > np.maximum(most * dt, least))) for size, most, least in steps]
        if not any(len(some) for some in fast):
            return jump
    for (size, most, _), some in zip(steps, fast, strict=True):
        for step in some.tolist():
            latest = slice(max(0, step + 1 - LATEST), step + 1)
            farthest = max(most * np.median(dt[latest]), c.jump_factor * np.percentile(size[latest], USUAL))
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
    there = np.zeros(len(moved), np.bool_)
    for scan in range(int((~moved).sum())):
        left, there[scan] = has_left(ranges[0], ranges[scan], config or SyncConfig())
        if left:
            there[scan] = False
            break
    return there


def has_left(first: NDArray[np.float32], here: NDArray[np.float32], config: SyncConfig) -> tuple[bool, bool]:
    """Whether two scans [beams] [m] are of different places, and whether any beam has an endpoint in both."""
    both = np.isfinite(first) & np.isfinite(here)
    differs = np.abs(here[both] - first[both]) > config.same_range
    return bool(differs.sum() > config.moved_share * both.sum()), bool(both.any())
