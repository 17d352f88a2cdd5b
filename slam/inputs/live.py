"""Streams that arrive message by message: what SLAM takes in of them, a scan at a time, once its motion is known.

The same as ``synchronise`` makes of the complete recording, to the last bit, with the same functions over the latest
readings alone: a scan costs the same at any time, and what is not needed again is forgotten.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.platform import Platform
from moteslam.robot.recording import LidarStream, gaps, nearest_stamp
from moteslam.robot.values import Issue, given_up, when
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.lapses import Lapse, Lapses, Open, lapses
from moteslam.slam.inputs.live_odometry import KEPT, LiveOdometry, Rows
from moteslam.slam.inputs.odometry_path import OdometryPath, has_left
from moteslam.slam.inputs.scans import Scans, without
from moteslam.slam.inputs.synchronise import is_stale, sweeps
from moteslam.slam.inputs.travelling import Follower

Array = NDArray[np.float64]
BEFORE_WHEELS = 0.5
"""Scans this long before the first reading of the wheels are not of a robot that is known to stand [s]."""

NOTHING = np.empty(0, np.float32)


class LiveScans(Scans):
    """The scans that are kept, each as it was taken in."""

    def __init__(self, lidar: LidarStream, platform: Platform, max_range: float) -> None:
        super().__init__(lidar, platform.lidar, max_range=max_range)
        self._kept: dict[int, tuple[NDArray[np.float32], Array | None]] = {}

    def keep(self, index: int, ranges: NDArray[np.float32], sweep: Array | None) -> None:
        """Keep a scan: its ranges [beams] [m], and how the robot moved while it was taken [3]."""
        self._kept[index] = ranges, sweep

    def forget(self, index: int) -> None:
        """Keep a scan no longer."""
        del self._kept[index]

    def _some(self, first: int, last: int) -> tuple[NDArray[np.float32], Array | None]:
        ranges, sweeps = zip(*(self._kept[index] for index in range(first, last)), strict=True)
        return np.stack(ranges), None if sweeps[0] is None else np.stack(sweeps)


class Waiting(NamedTuple):
    """A scan that has arrived: ``Scan`` of a ``LidarStream``, its odometry pose [3] where the driver gives one."""

    stamp: float
    ranges: NDArray[np.float32]
    odometry: Array | None


class LiveInputs:
    """What ``Inputs`` is of a recording, of the scans that were taken in so far.

    Args:
        patience: a scan waits this long for odometry that comes later [s], and wheels half as long for the gyro; then
            its motion counts as not measured, and their own turns are taken.

    Attributes:
        odometry_in: takes in the odometry's messages.
        waiting: scans that are not taken in yet.
        open: what is left open of motions that were not measured, by scan.
    """

    logged = None

    def __init__(self, platform: Platform, config: SyncConfig, *, max_range: float, patience: float) -> None:
        figures = platform.lidar.scan
        self._platform, self._config, self._patience = platform, config, patience
        geometry = figures.angle_min, figures.angle_increment, figures.range_min, figures.range_max
        empty = np.empty((0, figures.beams), np.float32)
        self._lidar = LidarStream(np.empty(0), empty, *geometry, platform.lidar.time_increment)
        self.scans = LiveScans(self._lidar, platform, max_range)
        self.odometry_in = LiveOdometry(platform, config)
        self.waiting: deque[Waiting] = deque()
        self.open: dict[int, Open] = {}
        self._newest = -np.inf  # of all messages
        self._latest: dict[str, float] = {}  # stamps, by stream
        self._rows, self._flags = Rows(7), Rows(2, np.bool_)  # stamp, odometry, motion; jumped, measured
        self._tail = Rows(4)  # stamp, odometry with wheels that spin, of the latest scans
        self._ranges = Rows(figures.beams, np.float32)  # of the same
        self._follower = Follower(self._lidar, platform.lidar) if config.travelling else None
        self._seen: dict[tuple[str, float], Lapse] = {}
        self._late: list[int] = []  # scans that did not wait for their odometry any longer ...
        self._unheard: deque[int] = deque()  # ... and for which none has come since
        self._start: NDArray[np.float32] | None = None  # the first scan, until the robot has left it
        self.moves = False

    def __len__(self) -> int:
        return len(self._rows)

    stamps = property(lambda self: self._rows.values[:, 0], doc="[n] of the scans [s].")
    odometry = property(lambda self: self._rows.values[:, 1:4], doc="[n, 3] the pose at every scan by odometry.")
    motions = property(lambda self: self._rows.values[:, 4:7], doc="[n, 3] the increment since the scan before.")
    jumped = property(lambda self: self._flags.values[:, 0], doc="[n] whether the odometry jumps at the scan.")
    measured = property(lambda self: self._flags.values[:, 1], doc="[n] whether it measured the motion.")

    @property
    def path(self) -> OdometryPath | None:
        """The latest part of the path by odometry; None without any."""
        return self.odometry_in.path

    def arrives(self, stream: str, stamp: float) -> None:
        """Note a message of a stream; its stamps do not fall."""
        if not np.isfinite(stamp) or stamp < self._latest.get(stream, -np.inf):
            raise InputError(f"{stamp} s, expected rising seconds", field=f"{stream}.stamp")
        self._latest[stream] = stamp
        self._newest = max(self._newest, stamp)

    def add_scan(self, ranges: Any, stamp: float, odometry: Array | None) -> None:
        """Let a scan wait for its turn."""
        lidar, row = self._lidar, np.array(ranges, np.float32)
        if row.shape != lidar.ranges.shape[1:]:
            raise InputError(f"{list(row.shape)}, expected [{lidar.ranges.shape[1]}]", field="ranges")
        row[row < lidar.range_min] = np.nan
        row[(row > lidar.range_max) | np.isin(row, np.array(self._platform.lidar.no_return, np.float32))] = np.inf
        self.waiting.append(Waiting(stamp, given_up(row), odometry))

    def take(self, *, finish: bool = False) -> int | None:
        """Take in the scan that waits longest, if the odometry covers it, or it has waited long enough.

        Args:
            finish: nothing more is to come.

        Returns:
            its index; None if there is none.
        """
        self.odometry_in.integrate(waited=np.inf if finish else self._newest - self._patience / 2)
        if not self.waiting:
            return None
        scan, path = self.waiting[0], self.path
        covered = path is not None and self.odometry_in.until >= scan.stamp + self._sweep_seconds
        ready = covered
        if scan.odometry is not None:  # the reading after its own is that of the next scan
            ready = (covered or path is None) and len(self.waiting) > 1
        in_time = self._newest - scan.stamp - self._sweep_seconds <= self._patience
        if not ready and in_time and not finish:
            return None
        self.waiting.popleft()
        if finish and not covered and path is not None:  # the log ends with its scans
            covered = not gaps(np.append(path.stamps, (self.waiting or [scan])[-1].stamp))[-1]
        covered |= scan.odometry is not None
        self._take(scan, path, covered=covered)
        return len(self) - 1

    @property
    def issues(self) -> tuple[Issue, ...]:
        """What was seen to travel with the robot, the lapses, and scans without odometry."""
        issues = list[Issue]()
        if self._follower is not None and (found := self._follower.found(np.empty(0, bool), np.empty((0, 3)))):
            issues += found.issues(self.stamps)
        seen = tuple(sorted(self._seen.values(), key=lambda one: one.begin))
        none = np.empty(0, np.bool_)
        issues += Lapses(none, none, {}, {}, seen).issues(self.stamps)
        if len(late := np.array(self._late)):
            spans = np.split(self.stamps[late], np.flatnonzero(np.diff(late) > 1) + 1)
            text = f"{len(late)} of {len(self)} scans for which no odometry came within {self._patience:g} s: how the "
            text += f"robot moved is not known; {when([(float(some[0]), float(some[-1])) for some in spans])}"
            issues.append(Issue("no-odometry", text, len(late)))
        return tuple(issues)

    @property
    def _sweep_seconds(self) -> float:
        """How long the odometry is asked for beyond the stamp of a scan."""
        lidar = self._lidar
        return lidar.time_increment * (lidar.ranges.shape[1] - 1) if self._config.deskew else 0.0

    def _take(self, scan: Waiting, path: OdometryPath | None, *, covered: bool) -> None:
        index = len(self)
        pose = self._pose(scan, path)
        self._correct(path)
        self._tail.add(scan.stamp, pose)
        self._ranges.add(scan.ranges)
        unmeasured, jumped, motion, left = True, False, None, None
        if covered:
            unmeasured, jumped, motion, left = self._lapse(scan, path)
        else:
            self._unheard.append(index)
            self._late.append(index)
        before = self._tail.values[-2, 1:] if index else pose
        if index and self.odometry_in.still and (pose == before).all():
            unmeasured |= not self.measured[-1]  # odometry that failed longer ago than is kept
        driven = se2.between(before[None], pose[None])[0] if index else np.zeros(3)
        ranges, place = scan.ranges, pose
        if self._follower is not None and path is not None:
            place = self._follower.add(ranges, pose, float(np.hypot(*driven[:2]) + np.abs(driven[2])), unmeasured)
            ranges = without(ranges, self._follower.hides(ranges))
        if motion is None:
            last = self.odometry[-1:] if index else place[None]
            motion = np.asarray(se2.between(last, place[None])[0])
        if left is not None:
            self.open[index] = left
        measured = covered and not unmeasured and self._measures(scan, place)
        self._rows.add(scan.stamp, place, motion if index else np.zeros(3))
        self._flags.add(jumped, measured)
        self.scans.keep(index, ranges, self._sweep(scan, path))
        if len(self._tail) > 2 * KEPT:
            self._tail.keep(KEPT)
            self._ranges.keep(KEPT)
        self.odometry_in.forget(scan.stamp)

    def _pose(self, scan: Waiting, path: OdometryPath | None) -> Array:
        """The pose [3] by odometry."""
        stamp = np.array([scan.stamp])
        if scan.odometry is not None and not (path and is_stale(stamp, scan.odometry[None], path)[0]):
            return scan.odometry
        if path is None:
            return np.zeros(3)
        if self._config.method == "interpolate" or scan.odometry is not None:
            return np.asarray(path.at(stamp)[0])
        return np.asarray(path.poses[nearest_stamp(path.stamps, stamp)[0]])

    def _correct(self, path: OdometryPath | None) -> None:
        """Scans that did not wait for their odometry have it now, for what is driven from them on."""
        while path is not None and self._unheard and self.stamps[self._unheard[0]] <= path.stamps[-1]:
            index = self._unheard.popleft()
            pose = self._pose(Waiting(float(self.stamps[index]), NOTHING, None), path)
            self._rows.values[index, 1:4] = pose if self._follower is None else self._follower.corrected(pose)
            if index - len(self) + len(self._tail) >= 0:
                self._tail.values[index - len(self), 1:] = pose

    def _lapse(self, scan: Waiting, path: OdometryPath | None) -> tuple[bool, bool, Array | None, Open | None]:
        """Whether the motion to the latest scan was not measured, whether it is a jump, and what is known of it."""
        rows, counted = self._tail.values, self.odometry_in.counted and scan.odometry is None
        stamps, odometry = rows[:, 0], np.ascontiguousarray(rows[:, 1:])
        lidar = replace(self._lidar, stamps=stamps, ranges=given_up(self._ranges.values[:]))
        if path is None or scan.odometry is not None:  # the scans' poses are its readings, with that of the next
            path = OdometryPath(stamps, odometry)
            if self.waiting and (after := self.waiting[0]).odometry is not None:
                path = OdometryPath(np.append(stamps, after.stamp), np.vstack((odometry, after.odometry)))
        last = len(rows) - 1
        since = float(rows[last - 1, 0]) if last else -np.inf
        found = lapses(path, odometry, lidar, self._platform.lidar, self._config, counted=counted, since=since)
        for lapse in found.seen:
            self._seen[lapse.kind, lapse.begin] = lapse
        early = counted and scan.stamp < self.odometry_in.begins - BEFORE_WHEELS
        return (
            bool(found.unmeasured[last]) or early,
            bool(found.jumped[last]),
            found.motions.get(last),
            found.open.get(last),
        )

    def _measures(self, scan: Waiting, place: Array) -> bool:
        """Whether the odometry has moved by now, or the robot is seen to stand; wheels count from the first turn."""
        if self.odometry_in.counted:
            self.moves = True
            return True
        first = self.odometry[0] if len(self) else place
        self._start = scan.ranges if not len(self) else self._start
        self.moves = self.moves or bool((place != first).any())
        if self.moves or self._start is None:
            return self.moves
        left, seen = has_left(self._start, scan.ranges, self._config)
        self._start = None if left else self._start
        return seen and not left

    def _sweep(self, scan: Waiting, path: OdometryPath | None) -> Array | None:
        """How the robot moves while the scan is taken, [3]; None if unknown."""
        if not self._config.deskew or self._sweep_seconds <= 0 or path is None:
            return None
        return np.asarray(sweeps(path, np.array([scan.stamp]), self._sweep_seconds, self._config)[0])
