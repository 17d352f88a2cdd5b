"""The path by odometry while its readings arrive: the same as ``odometry_path``, a reading at a time."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.platform import Platform
from moteslam.robot.recording import LATEST, gaps, nearest_stamp
from moteslam.robot.wheel_odometry import arc_increment, wheel_motion
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import LowPass, OdometryPath, euler_increment

Array = NDArray[np.float64]
KEPT = LATEST + 100
"""Readings that are kept from before the last scan: what is unusual is seen by the latest ``LATEST``."""
MOST_KEPT = 4 * LATEST
"""The same of odometry that stands still: from before it did, up to as many."""


class Rows:
    """Rows [n, columns] that are added at the end, and may be forgotten from the beginning on."""

    def __init__(self, columns: int, dtype: type = np.float64) -> None:
        self._table: NDArray[Any] = np.empty((64, columns), dtype)
        self._first = self._last = 0

    def __len__(self) -> int:
        return self._last - self._first

    def add(self, *row: Any) -> None:
        """Add one."""
        if self._last == len(self._table):
            kept = self.values
            larger = np.empty((2 * len(kept), kept.shape[1]), kept.dtype) if len(kept) > self._first else self._table
            larger[: len(kept)] = kept
            self._table, self._first, self._last = larger, 0, len(kept)
        self._table[self._last] = np.concatenate(row, axis=None)
        self._last += 1

    @property
    def values(self) -> NDArray[Any]:
        """[n, columns]; they hold until the next row is added."""
        return self._table[self._first : self._last]

    def keep(self, count: int) -> None:
        """Forget all but the latest."""
        self._first = max(self._first, self._last - count)


class LiveOdometry:
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
        self._rows = Rows(8)  # stamp; x, y, heading; the heading not wrapped; x, y, heading of the wheels alone
        self._poses = np.zeros((2, 3))  # the latest, headings not wrapped: with the gyro, and of the wheels alone
        self._turns = 0.0  # what unwraps the heading
        self._waiting: deque[tuple[float, float, float]] = deque()  # readings of the wheels: stamp, distance, turn
        self._low_pass = LowPass(config.low_pass_hz)
        self._gyro = Rows(3)  # stamp, yaw rate, heading
        self._gyro_from = self._read = np.inf  # its first stamp; that of the wheels' latest reading
        self.counted, self.begins, self.still = False, np.inf, False

    @property
    def path(self) -> OdometryPath | None:
        """Its latest part; None without a reading."""
        if not len(self._rows):
            return None
        rows = self._rows.values
        alone = rows[:, 5:] if self.counted and len(self._gyro) else None
        return OdometryPath(rows[:, 0], rows[:, 1:4], alone, rows[:, 4])

    @property
    def until(self) -> float:
        """Stamp of the latest reading that is part of the path [s]."""
        return float(self._rows.values[-1, 0]) if len(self._rows) else -np.inf

    def add_pose(self, stamp: float, pose: Array) -> None:
        """Take in a pose [3] that the base has integrated."""
        self._add(stamp, pose, pose)

    def add_counts(self, stamp: float, counts: NDArray[np.int64]) -> None:
        """Take in the counts [4] of the wheels since the reading before."""
        if self._wheels is None:
            raise InputError("wheel counts, expected a platform with [wheels]", field="counts")
        if len(self._rows) and not self.counted:
            raise InputError("after poses, expected poses or counts", field="odometry")
        (distance,), (turn,) = wheel_motion(counts[None], self._wheels)
        self.counted = True
        self._waiting.append((stamp, float(distance), float(turn)))

    def add_gyro(self, stamp: float, yaw_rate: float) -> None:
        """Take in a yaw rate [rad/s]."""
        rate, heading = self._low_pass.of(yaw_rate, stamp), 0.0
        if len(self._gyro):
            before, last, heading = self._gyro.values[-1].tolist()
            heading += (rate + last) / 2 * (stamp - before)
        self._gyro_from = min(self._gyro_from, stamp)
        self._gyro.add(stamp, rate, heading)

    def integrate(self, *, waited: float) -> None:
        """Add the wheels' readings to the path of which the gyro has said how the robot turned.

        Those up to a stamp have waited long enough [s], and go without.
        """
        newest = float(self._gyro.values[-1, 0]) if len(self._gyro) else -np.inf
        while self._waiting:
            stamp, distance, turn = self._waiting[0]
            if (self._has_gyro or len(self._gyro)) and newest < stamp and waited < stamp:
                return
            self._waiting.popleft()
            self._integrate(stamp, distance, turn)

    def forget(self, before: float) -> None:
        """Forget the readings that nothing of after a stamp [s] is compared with."""
        if len(self._gyro) > 2 * KEPT:
            since = np.searchsorted(self._gyro.values[:, 0], self._read)
            self._gyro.keep(max(KEPT, len(self._gyro) - int(since) + 1))
        if len(self._rows) < 2 * KEPT:
            return
        first = int(np.searchsorted(self._rows.values[:, 0], before)) - KEPT
        moved = np.flatnonzero((np.diff(self._rows.values[: max(first, 0), 1:4], axis=0) != 0).any(axis=1))
        stood = first - (int(moved[-1]) if len(moved) else 0)
        kept = len(self._rows) - first + (stood + 100 if stood > 1 else 0)
        self.still = kept > MOST_KEPT or (self.still and not len(moved))
        self._rows.keep(min(kept, MOST_KEPT))

    def _integrate(self, stamp: float, distance: float, turn: float) -> None:
        before, self._read = self._read, stamp
        if not len(self._rows):
            distance = turn = 0.0
        increment = euler_increment if self._config.kinematics == "euler" else arc_increment
        turned = self._turn(before, stamp) if self._covers(before, stamp) and len(self._rows) else turn
        steps = np.stack((increment(distance, turned), arc_increment(distance, turn)))
        cos, sin = np.cos(self._poses[:, 2]), np.sin(self._poses[:, 2])
        self._poses[:, 0] += cos * steps[:, 0] - sin * steps[:, 1]
        self._poses[:, 1] += sin * steps[:, 0] + cos * steps[:, 1]
        self._poses[:, 2] += steps[:, 2]
        self._add(stamp, *np.column_stack((self._poses[:, :2], se2.wrap(self._poses[:, 2]))))

    def _add(self, stamp: float, pose: Array, alone: Array) -> None:
        self.begins = min(self.begins, stamp)
        turn = float(pose[2] - self._rows.values[-1, 3]) if len(self._rows) else 0.0
        if abs(turn) >= np.pi:  # as np.unwrap, to the last bit
            wrapped = (turn + np.pi) % (2 * np.pi) - np.pi
            self._turns += (np.pi if wrapped == -np.pi and turn > 0 else wrapped) - turn
        self._rows.add(stamp, pose, pose[2] + self._turns, alone)

    def _covers(self, before: float, stamp: float) -> bool:
        """Whether the gyro measured the turn between two stamps."""
        stamps = self._gyro.values[:, 0]
        if len(stamps) < 2 or not self._gyro_from <= stamp <= stamps[-1]:
            return False
        ends = np.flatnonzero(gaps(stamps))
        return not ((stamps[ends - 1] < stamp) & (before <= stamps[ends])).any()

    def _turn(self, before: float, stamp: float) -> float:
        """The turn between two stamps by the gyro [rad]."""
        stamps, rate, heading = self._gyro.values.T
        if self._config.method == "nearest":
            return float(rate[nearest_stamp(stamps, np.array(stamp))] * (stamp - before))
        return float(np.interp(stamp, stamps, heading) - np.interp(before, stamps, heading))
