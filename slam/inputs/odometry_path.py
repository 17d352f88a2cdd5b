"""The robot's path by its own odometry: wheel counters with the gyro's yaw rate, or the poses that a log has.

Readings are taken in as they come, or all of a recording at once: to the same bytes. How counts and yaw rates are
integrated is in `robot/wheel_odometry.py`; here are the choices of a configuration.

Readings of a gyro that hangs are left out, as if none had come: a driver that repeats the last reading while the robot
drives on would turn the path for ever. Every real gyro's readings differ in their last bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.platform import Platform
from moteslam.robot.recording import LATEST, Recording, nearest_stamp
from moteslam.robot.se2 import Array
from moteslam.robot.sensor_reports import odometry_of
from moteslam.robot.values import Issue, when
from moteslam.robot.wheel_odometry import arc_increment, gyro_covers, wheel_motion
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.rows import Rows, summed

HANGS = 2.0  # A gyro that turns hangs once it has repeated a yaw rate to the last bit for so long [s]


class LowPass:
    """A causal first-order Butterworth low-pass, settled at the first value.

    The readings are taken to be evenly spaced: stamps jitter more than a sensor does. The rate is the mean one up to
    each reading, so that no output follows from a later reading. A cut-off of 0 [Hz] filters nothing, and nor does one
    at or above half the rate.
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


class Gyro:
    """What it has measured; readings may be forgotten from the beginning on."""

    def __init__(self, config: SyncConfig) -> None:
        self._config, self._low_pass = config, LowPass(config.low_pass_hz)
        self._rows = Rows(3, order="F")  # stamp, yaw rate, heading
        self._rate, self._since = np.nan, -np.inf  # the latest yaw rate as it came, and since when it is the same
        self.heard = -np.inf  # stamp of the latest reading, of one left out, too [s]
        self.hung = list[tuple[float, float]]()  # from when to when [s]

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, stamps: Array, rates: Array) -> None:
        """Take in yaw rates [m, 1] [rad/s]."""
        sound = self._sound(stamps, rates[:, 0])
        stamps, rates = stamps[sound], rates[sound, 0]
        if not len(stamps):
            return
        if self._config.low_pass_hz > 0:
            rates = np.array([self._low_pass.of(*each) for each in zip(rates.tolist(), stamps.tolist(), strict=True)])
        last, rate, heading = self._rows.values[-1].tolist() if len(self) else (stamps[0], rates[0], 0.0)
        before, since = np.concatenate(([rate], rates[:-1])), np.concatenate(([last], stamps[:-1]))
        turns = (rates + before) / 2 * (stamps - since)
        self._rows.add(stamps, rates, summed(heading, turns))

    def turns(self, stamps: Array, turn: Array) -> Array:
        """The turns [m] between stamps [m + 1], its own where it measured them, else the wheels' [rad]."""
        known, rate, heading = self._rows.values.T
        covered = gyro_covers(stamps, known)[1:]
        if not covered.any():
            return turn
        if self._config.method == "nearest":
            own = rate[nearest_stamp(known, stamps[1:])] * np.diff(stamps)
        else:
            own = np.diff(np.interp(stamps, known, heading))
        return np.where(covered, own, turn)

    def forget(self, before: float, kept: int) -> None:
        """Forget those of before a stamp [s], but for so many and, until as many have come, all."""
        if len(self) > 2 * kept:
            since = np.searchsorted(self._rows.values[:, 0], before)
            self._rows.keep(max(kept, len(self) - int(since) + 1))

    def _sound(self, stamps: Array, rates: Array) -> NDArray[np.bool_]:
        """Which readings [m] are not of a gyro that hangs; one that reports 0 may be of a robot at rest."""
        changed = np.append(rates[:1] != self._rate, np.diff(rates) != 0)
        since = np.maximum.accumulate(np.where(changed, stamps, self._since))
        hangs = (stamps - since > HANGS) & (rates != 0)
        for begin, end in zip(since[hangs].tolist(), stamps[hangs].tolist(), strict=True):
            if self.hung and self.hung[-1][0] == begin:
                self.hung.pop()
            self.hung.append((begin, end))
        self._rate, self._since, self.heard = rates[-1], since[-1], stamps[-1]
        return np.asarray(~hangs)


def about_hanging(hung: Sequence[tuple[float, float]]) -> tuple[Issue, ...]:
    """That a gyro hung from when to when [s]."""
    text = f"{when([*hung])}: the gyro repeats one yaw rate to the last bit: it hangs; turns from the wheels there"
    return (Issue("no-gyro", text, len(hung)),) if hung else ()


KEPT, MOST_KEPT = LATEST + 100, 4 * LATEST
"""Readings that are kept from before the last scan, and of odometry that stands still from before it did at most."""


@dataclass(frozen=True, eq=False)
class OdometryPath:
    stamps: Array  # [n] [s]
    poses: Array  # [n, 3]; the path of wheel encoders starts at the identity
    by_wheels: Array | None = None  # [n, 3] the same with the wheels' own turns; None without a gyro
    # [n] the headings without a step of a whole turn, where the path has a beginning that is forgotten
    unwrapped: Array | None = None
    hung: tuple[tuple[float, float], ...] = ()  # from when to when the gyro hung [s]

    def at(self, stamps: Array) -> Array:
        """The poses [m, 3] interpolated at stamps [m] [s]."""
        headings = np.unwrap(self.poses[:, 2]) if self.unwrapped is None else self.unwrapped
        x, y, heading = (np.interp(stamps, self.stamps, each) for each in (*self.poses.T[:2], headings))
        return se2.stack(x, y, se2.wrap(heading))


def euler_increment(distance: ArrayLike, turn: ArrayLike) -> se2.Poses:
    """Equation III.1 of the paper: straight along the old heading by v tau [...] [m], then a turn omega tau [rad]."""
    distance, turn = np.asarray(distance, np.float64), np.asarray(turn, np.float64)
    return np.stack(np.broadcast_arrays(distance, np.zeros_like(distance), turn), axis=-1)


def odometry_path(recording: Recording, config: SyncConfig) -> OdometryPath | None:
    """The path at the stamps that the odometry has; None without odometry of any kind.

    Wheel encoders with the gyro's yaw rate where there are encoders (wheels alone before the gyro starts, after it
    ends, or without one), else the odometry's poses, else the poses logged with the scans. Refused are encoders on a
    platform without wheels.
    """
    encoders, imu = recording.encoders, recording.imu
    if encoders is not None and len(encoders):
        if recording.platform.wheels is None:
            raise InputError("encoders without wheels, expected a platform with [wheels]", file=recording.name)
        readings = OdometryReadings(recording.platform, config)
        if imu is not None and len(imu):
            readings.gyro.add(imu.stamps, imu.angular_velocity[:, 2:].astype(np.float64))
        readings.add_counts(encoders.stamps, encoders.counts)
        readings.integrate(waited=np.inf)
        return readings.path
    found = odometry_of(recording)
    return None if found is None else OdometryPath(*found)


class OdometryReadings:
    """Takes in what wheels and gyro, or a base that integrates them itself, report.

    A reading of the wheels waits for the gyro's reading after it, where the robot has a gyro.
    """

    def __init__(self, platform: Platform, config: SyncConfig) -> None:
        self._wheels, self._config = platform.wheels, config
        self._has_gyro = platform.imu is not None
        # stamp; x, y, heading; the heading not wrapped; x, y, heading of the wheels alone
        self._rows = Rows(8, order="F")
        self._poses = np.zeros((2, 3))  # the latest, headings not wrapped: with the gyro, and of the wheels alone
        self._turns = 0.0  # what unwraps the heading
        self._waiting = Rows(3, order="F")  # readings of the wheels: stamp, distance, turn
        self.gyro = Gyro(config)
        self._heard: dict[str, list[list[float]]] = {stream: [] for stream in ("imu", "encoders", "odometry")}
        # whether it is of wheel counters; the first stamp of the path [s]; whether it stood for longer than is kept
        self.counted, self.begins, self.still = False, np.inf, False

    @property
    def path(self) -> OdometryPath | None:
        if not len(self._rows):
            return None
        rows = self._rows.values
        alone = rows[:, 5:] if self.counted and len(self.gyro) else None
        return OdometryPath(rows[:, 0], rows[:, 1:4], alone, rows[:, 4], tuple(self.gyro.hung))

    @property
    def until(self) -> float:
        """Stamp of the latest reading that is part of the path [s]."""
        return float(self._rows.values[-1, 0]) if len(self._rows) else -np.inf

    def reaches(self, stamp: float, *, waited: float) -> bool:
        """Whether ``integrate`` would lead to a stamp or beyond [s]."""
        turned = self._heard["imu"][-1][0] if self._heard["imu"] else self.gyro.heard
        known = max(waited, turned) if turned > -np.inf or self._has_gyro else np.inf
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

    def integrate(self, *, waited: float) -> None:
        """Take in what was heard: poses, and the wheels' readings of which the gyro has said how the robot turned.

        Those up to a stamp have waited long enough [s], and go without.
        """
        for heard, take in zip(self._heard.values(), (self.gyro.add, self.add_counts, self.add_poses), strict=True):
            if heard:
                table = np.array(heard)
                take(table[:, 0], table[:, 1:])
                heard.clear()
        stamps, distance, turn = self._waiting.values.T
        if self._has_gyro or len(self.gyro):
            ready = np.searchsorted(stamps, max(self.gyro.heard, waited), side="right")
            stamps, distance, turn = stamps[:ready], distance[:ready], turn[:ready]
        if not len(stamps):
            return
        self._waiting.keep(len(self._waiting) - len(stamps))
        if not len(self._rows):
            distance[0] = turn[0] = 0.0  # has no interval before it
        before = self.until if len(self._rows) else stamps[0]
        turned = self.gyro.turns(np.append(before, stamps), turn)
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
        self.gyro.forget(self.until, KEPT)
        if len(self._rows) < 2 * KEPT:
            return
        first = int(np.searchsorted(self._rows.values[:, 0], before)) - KEPT
        moved = np.flatnonzero((np.diff(self._rows.values[: max(first, 0), 1:4], axis=0) != 0).any(axis=1))
        stood = first - (int(moved[-1]) if len(moved) else 0)
        kept = len(self._rows) - first + (stood + 100 if stood > 1 else 0)
        self.still = kept > MOST_KEPT or (self.still and not len(moved))
        self._rows.keep(min(kept, MOST_KEPT))

    def _add(self, stamps: Array, poses: Array, alone: Array) -> None:
        last = self._rows.values[-1, 3] if len(self._rows) else poses[0, 2]
        self.begins = min(self.begins, float(stamps[0]))
        steps = poses[:, 2] - np.concatenate(([last], poses[:-1, 2]))
        wrapped = (steps + np.pi) % (2 * np.pi) - np.pi  # as np.unwrap, to the last bit
        wrapped[(wrapped == -np.pi) & (steps > 0)] = np.pi
        turns = summed(self._turns, np.where(np.abs(steps) < np.pi, 0.0, wrapped - steps))
        self._turns = float(turns[-1])
        self._rows.add(stamps, poses, poses[:, 2] + turns, alone)


USUAL = 90  # The percentile of the latest steps that a step is compared with


def jumps(
    stamps: Array, odometry: Array, config: SyncConfig | None = None, since: float = -np.inf
) -> NDArray[np.bool_]:
    """At which readings the odometry has jumped since the reading before.

    A step has jumped if it is faster than a robot drives and ``jump_factor`` times as long as the 90th percentile of
    the latest 1000 steps. These end with the step itself, so that the result is causal. With a factor of ten none of
    the first nine steps is a jump: a single long step does not stand out among nine. Log writers stamp readings in
    bursts: a step counts as having taken at least the median time of the latest steps. Where two stamps [n] are equal
    there is no speed, and no jump. Those before ``since`` are not asked for [s].

    Returns [n], of poses [n, 3]; the first is False.
    """
    c = config or SyncConfig()
    jump = np.zeros(len(stamps), np.bool_)
    begin = max(int(stamps.searchsorted(since)) - 1, 0)
    off = np.abs(odometry[begin + 1 :] - odometry[begin:-1])
    # most often none is nearly so far, or so fast, and the motions need not be known
    if off.max(initial=0.0) <= 0.45 * min(c.min_jump_distance, c.min_jump_rotation):
        return jump
    dt = stamps[begin + 1 :] - stamps[begin:-1]
    far = off[:, 0] + off[:, 1] > np.maximum(0.9 * c.max_speed * dt, 0.9 * c.min_jump_distance)
    if not (far | (off[:, 2] > np.maximum(0.9 * c.max_turn_rate * dt, 0.9 * c.min_jump_rotation))).any():
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
