"""The robot's path by its own odometry: wheel counters with the gyro's yaw rate, or the poses that a log has.

Readings are taken in as they come, or all of a recording at once: to the same bytes. How counts and yaw rates are
integrated is in `robot/wheel_odometry.py`; here are the choices of a configuration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.platform import Platform
from moteslam.robot.recording import Recording, nearest_stamp
from moteslam.robot.wheel_odometry import arc_increment, gyro_covers, wheel_motion
from moteslam.slam.inputs.config import SyncConfig

Array = NDArray[np.float64]
LATEST = 1000  # How many steps are compared with
KEPT, MOST_KEPT = LATEST + 100, 4 * LATEST
"""Readings that are kept from before the last scan, and of odometry that stands still from before it did at most."""


@dataclass(frozen=True, eq=False)
class OdometryPath:
    """A path by odometry alone."""

    stamps: Array  # [n] [s]
    poses: Array  # [n, 3]; the path of wheel encoders starts at the identity
    by_wheels: Array | None = None  # [n, 3] the same with the wheels' own turns; None without a gyro
    # [n] the headings without a step of a whole turn, where the path has a beginning that is forgotten
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
    encoders, imu = recording.encoders, recording.imu
    if encoders is not None and len(encoders):
        if recording.platform.wheels is None:
            raise InputError("encoders without wheels, expected a platform with [wheels]", file=recording.name)
        readings = OdometryReadings(recording.platform, config)
        if imu is not None and len(imu):
            readings.add_yaw_rates(imu.stamps, imu.angular_velocity[:, 2:].astype(np.float64))
        readings.add_counts(encoders.stamps, encoders.counts)
        readings.integrate(waited=np.inf)
        return readings.path
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


class Rows:
    """Rows [n, columns] that are added at the end, and may be forgotten from the beginning on.

    With the ``order`` F each column lies in one piece: to be searched, which otherwise copies it first.
    """

    def __init__(self, columns: int, dtype: type = np.float64, order: Literal["C", "F"] = "C") -> None:
        self._table: NDArray[Any] = np.empty((64, columns), dtype, order)
        self._order = order
        self._first = self._last = 0

    def __len__(self) -> int:
        return self._last - self._first

    def add(self, *columns: NDArray[Any]) -> None:
        """Add rows, of columns [m] and [m, k]."""
        count, kept, column = len(columns[0]), self.values, 0
        if self._last + count > len(self._table):
            size = 2 * len(kept) + count
            if size > len(self._table):
                self._table = np.empty((size, kept.shape[1]), kept.dtype, self._order)
            self._table[: len(kept)] = kept
            self._first, self._last = 0, len(kept)
        self._last += count
        for some in columns:
            wide = some if some.ndim > 1 else some[:, None]
            self._table[self._last - count : self._last, column : column + wide.shape[1]] = wide
            column += wide.shape[1]

    @property
    def values(self) -> NDArray[Any]:
        """[n, columns]; they hold until the next row is added."""
        return self._table[self._first : self._last]

    def keep(self, count: int) -> None:
        """Forget all but the latest."""
        self._first = max(self._first, self._last - count)


class OdometryReadings:
    """Takes in what wheels and gyro, or a base that integrates them itself, report.

    A reading of the wheels waits for the gyro's reading after it, where the robot has a gyro.

    Attributes:
        counted: whether it is of wheel counters.
        begins: stamp of the first reading that is part of the path [s].
        still: whether it has stood still for longer than is kept.
    """

    def __init__(self, platform: Platform, config: SyncConfig) -> None:
        self._wheels, self._config = platform.wheels, config
        self._has_gyro = platform.imu is not None
        # stamp; x, y, heading; the heading not wrapped; x, y, heading of the wheels alone
        self._rows = Rows(8, order="F")
        self._poses = np.zeros((2, 3))  # the latest, headings not wrapped: with the gyro, and of the wheels alone
        self._turns = 0.0  # what unwraps the heading
        self._waiting = Rows(3, order="F")  # readings of the wheels: stamp, distance, turn
        self._low_pass = LowPass(config.low_pass_hz)
        self._gyro = Rows(3, order="F")  # stamp, yaw rate, heading
        self._heard: dict[str, list[list[float]]] = {stream: [] for stream in ("imu", "encoders", "odometry")}
        self.counted, self.begins, self.still = False, np.inf, False

    @property
    def path(self) -> OdometryPath | None:
        """What is kept of it; None without a reading."""
        if not len(self._rows):
            return None
        rows = self._rows.values
        alone = rows[:, 5:] if self.counted and len(self._gyro) else None
        return OdometryPath(rows[:, 0], rows[:, 1:4], alone, rows[:, 4])

    @property
    def until(self) -> float:
        """Stamp of the latest reading that is part of the path [s]."""
        return float(self._rows.values[-1, 0]) if len(self._rows) else -np.inf

    def reaches(self, stamp: float, *, waited: float) -> bool:
        """Whether ``integrate`` would lead to a stamp or beyond [s]."""
        turned = [message[0] for message in self._heard["imu"]] or self._gyro.values[-1:, 0].tolist()
        known = max(waited, *turned[-1:], -np.inf) if turned or self._has_gyro else np.inf
        waiting = (*self._waiting.values[:, 0].tolist(), *(message[0] for message in self._heard["encoders"]))
        after = [each for each in waiting if stamp <= each <= known]
        return bool(after or self.until >= stamp or any(pose[0] >= stamp for pose in self._heard["odometry"]))

    def hear(self, stream: str, message: list[float]) -> None:
        """Note a message of ``odometry``, ``encoders`` or ``imu``, its stamp first: they are taken in together."""
        if stream == "encoders" and self._wheels is None:
            raise InputError("wheel counts, expected a platform with [wheels]", field="counts")
        kinds, heard = {"encoders": "counts", "odometry": "poses"}, len(self._rows) or self._heard["odometry"]
        before = "counts" if self.counted else "poses" if heard else None
        if before and before != kinds.get(stream, before):
            raise InputError(f"{kinds[stream]}, expected {before} as before", field="odometry")
        self.counted |= stream == "encoders"
        self._heard[stream].append(message)

    def add_poses(self, stamps: Array, poses: Array) -> None:
        """Take in poses [m, 3] that the base has integrated."""
        self._add(stamps, poses, poses)

    def add_counts(self, stamps: Array, counts: NDArray[Any]) -> None:
        """Take in the counts [m, 4] of the wheels, each since the reading before."""
        assert self._wheels is not None
        self.counted = True
        self._waiting.add(stamps, *wheel_motion(counts, self._wheels))

    def add_yaw_rates(self, stamps: Array, rates: Array) -> None:
        """Take in the gyro's yaw rates [m, 1] [rad/s]."""
        rates = rates[:, 0]
        if self._config.low_pass_hz > 0:
            rates = np.array([self._low_pass.of(*each) for each in zip(rates.tolist(), stamps.tolist(), strict=True)])
        last, rate, heading = self._gyro.values[-1] if len(self._gyro) else (stamps[:1], rates[:1], 0.0)
        turns = (rates + np.append(rate, rates[:-1])) / 2 * np.diff(stamps, prepend=last)
        self._gyro.add(stamps, rates, _summed(heading, turns))

    def integrate(self, *, waited: float) -> None:
        """Take in what was heard: poses, and the wheels' readings of which the gyro has said how the robot turned.

        Those up to a stamp have waited long enough [s], and go without.
        """
        for heard, take in zip(
            self._heard.values(), (self.add_yaw_rates, self.add_counts, self.add_poses), strict=True
        ):
            if heard:
                table = np.array(heard)
                take(table[:, 0], table[:, 1:])
                heard.clear()
        stamps, distance, turn = self._waiting.values.T
        if self._has_gyro or len(self._gyro):
            newest = self._gyro.values[-1, 0] if len(self._gyro) else -np.inf
            ready = np.searchsorted(stamps, max(newest, waited), side="right")
            stamps, distance, turn = stamps[:ready], distance[:ready], turn[:ready]
        if not len(stamps):
            return
        self._waiting.keep(len(self._waiting) - len(stamps))
        if not len(self._rows):
            distance[0] = turn[0] = 0.0  # has no interval before it
        before = self.until if len(self._rows) else stamps[0]
        turned = self._gyro_turns(np.append(before, stamps), turn)
        steps = arc_increment(distance, np.stack((turned, turn)))
        if self._config.kinematics == "euler":
            steps[0] = euler_increment(distance, turned)
        table = np.concatenate((self._poses[:, None], steps), axis=1)  # from the latest on, [2, m + 1, 3]
        headings = np.cumsum(table[..., 2], axis=1)
        cos, sin = np.cos(headings[:, :-1]), np.sin(headings[:, :-1])
        table[:, 1:, 0] = cos * steps[..., 0] - sin * steps[..., 1]
        table[:, 1:, 1] = sin * steps[..., 0] + cos * steps[..., 1]
        paths = np.cumsum(table, axis=1)
        self._poses = paths[:, -1].copy()
        paths[..., 2] = se2.wrap(headings)
        self._add(stamps, *paths[:, 1:])

    def forget(self, before: float) -> None:
        """Forget the readings that nothing of after a stamp [s] is compared with."""
        if len(self._gyro) > 2 * KEPT:
            since = np.searchsorted(self._gyro.values[:, 0], self.until)
            self._gyro.keep(max(KEPT, len(self._gyro) - int(since) + 1))
        if len(self._rows) < 2 * KEPT:
            return
        first = int(np.searchsorted(self._rows.values[:, 0], before)) - KEPT
        moved = np.flatnonzero((np.diff(self._rows.values[: max(first, 0), 1:4], axis=0) != 0).any(axis=1))
        stood = first - (int(moved[-1]) if len(moved) else 0)
        kept = len(self._rows) - first + (stood + 100 if stood > 1 else 0)
        self.still = kept > MOST_KEPT or (self.still and not len(moved))
        self._rows.keep(min(kept, MOST_KEPT))

    def _gyro_turns(self, stamps: Array, turn: Array) -> Array:
        """The turns [m] between stamps [m + 1], the gyro's where it measured them, else the wheels' own [rad]."""
        known, rate, heading = self._gyro.values.T
        covered = gyro_covers(stamps, known)[1:]
        if not covered.any():
            return turn
        if self._config.method == "nearest":
            by_gyro = rate[nearest_stamp(known, stamps[1:])] * np.diff(stamps)
        else:
            by_gyro = np.diff(np.interp(stamps, known, heading))
        return np.where(covered, by_gyro, turn)

    def _add(self, stamps: Array, poses: Array, alone: Array) -> None:
        last = self._rows.values[-1, 3] if len(self._rows) else poses[0, 2]
        self.begins = min(self.begins, float(stamps[0]))
        steps = np.diff(poses[:, 2], prepend=last)
        wrapped = (steps + np.pi) % (2 * np.pi) - np.pi  # as np.unwrap, to the last bit
        wrapped[(wrapped == -np.pi) & (steps > 0)] = np.pi
        turns = _summed(self._turns, np.where(np.abs(steps) < np.pi, 0.0, wrapped - steps))
        self._turns = float(turns[-1])
        self._rows.add(stamps, poses, poses[:, 2] + turns, alone)


def _summed(start: float, steps: Array) -> Array:
    """The running sum [m], added up one by one from a start."""
    return np.cumsum(np.append(start, steps))[1:]


USUAL = 90  # The percentile of the latest steps that a step is compared with


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
    begin = max(int(stamps.searchsorted(since)) - 1, 0)
    dt, off = np.diff(stamps[begin:]), np.abs(odometry[begin + 1 :] - odometry[begin:-1])
    # most often none is nearly so fast, and the motions need not be known
    near = (off[:, 0] + off[:, 1] > 0.9 * np.maximum(c.max_speed * dt, c.min_jump_distance)) | (
        off[:, 2] > 0.9 * np.maximum(c.max_turn_rate * dt, c.min_jump_rotation)
    )
    if not (near & (dt > 0)).any():
        return jump
    dt, motion = np.diff(stamps), se2.between(odometry[:-1], odometry[1:])
    for size, most, least in (
        (np.hypot(motion[:, 0], motion[:, 1]), c.max_speed, c.min_jump_distance),
        (np.abs(motion[:, 2]), c.max_turn_rate, c.min_jump_rotation),
    ):
        fast = (dt > 0) & (size > np.maximum(most * dt, least))
        for step in (begin + np.flatnonzero(fast[begin:])).tolist():
            latest = slice(max(0, step + 1 - LATEST), step + 1)
            farthest = max(most * np.median(dt[latest]), c.jump_factor * np.percentile(size[latest], USUAL))
            jump[step + 1] |= size[step] > farthest
    return jump
