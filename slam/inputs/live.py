"""Streams that arrive message by message: a scan is taken in once its motion is known.

A stretch of the latest readings is looked at alone: a scan costs the same at any time, and what is not needed again is
forgotten.
"""

import math
from array import array
from bisect import bisect_left
from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.streams import CODES, MAX_STAMP
from moteslam.robot.inspection import SPEEDS
from moteslam.robot.platform import Platform
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording, gaps
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue, given_up, when
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.inputs import Inputs
from moteslam.slam.inputs.odometry_path import KEPT, OdometryPath, OdometryReadings
from moteslam.slam.inputs.scans import Scans, without
from moteslam.slam.inputs.synchronise import about_blind, apart, at_scans, sweeps
from moteslam.slam.rows import Rows

BEFORE_WHEELS = 0.5  # Scans this long before the first reading of the wheels are not of a robot known to stand [s]
FAR_AHEAD = 3600.0
"""A scan this much later than every message before, where other streams are heard, is of another clock [s]: the sound
scans after it would be out of order. After a pause as long the other streams go on too, and the next scan is taken. So
is any message this much older than the newest. Of the first two, so far apart, the first is."""

STRAY = 0.5
"""A scan that comes so long before the latest one [s], to which no other message has come, says that this was stamped
wrongly: it is left out."""

FIRST, FIRST_MESSAGES = 2000, 100_000
"""So many scans, and as many messages of the other streams, are kept to be held against each other: three minutes at
ten scans a second, in which a robot turns, and some ten megabytes however long it drives."""
FEW, SOON = 10, 10.0
"""Units are first looked at after so many scans and seconds: speeds are of a second each, and a single jump is none."""
SURELY = 1.0
"""Odometry faster than any robot in ``FEW`` steps in a row, and for so long [s], is in other units: no jump is so long,
and nor are readings that come in a burst."""
BLOCK = 256


class LiveScans(Scans):
    """The scans that are kept, each as it was taken in."""

    def __init__(self, lidar: LidarStream, platform: Platform, max_range: float) -> None:
        super().__init__(lidar, platform.lidar, max_range=max_range)
        self._indices = array("q")
        self._blocks: list[NDArray[np.float32]] = []  # rows of ranges and, as they are in memory, sweep

    def __len__(self) -> int:
        return len(self._indices)

    def keep(self, index: int, ranges: NDArray[np.float32], sweep: Array) -> None:
        """Keep a scan: its ranges [beams] [m], and how the robot moved while it was taken [3]."""
        block, place = divmod(len(self), BLOCK)
        if block == len(self._blocks):
            self._blocks.append(np.empty((BLOCK, len(ranges) + 6), np.float32))
        self._blocks[block][place] = np.concatenate((ranges, sweep.view(np.float32)))
        self._indices.append(index)

    def forget_latest(self) -> None:
        self._indices.pop()

    def _some(self, first: int, last: int) -> tuple[NDArray[np.float32], Array | None]:
        places = [bisect_left(self._indices, index) for index in range(first, last)]
        assert [self._indices[place] for place in places] == list(range(first, last))
        rows = np.stack([self._blocks[place // BLOCK][place % BLOCK] for place in places])
        return rows[:, :-6], np.ascontiguousarray(rows[:, -6:]).view(np.float64)


WIDTHS = {"lidar": 4, "odometry": 4, "encoders": 5, "imu": 2}  # Numbers of a message: its stamp, and the values


class Beginning:
    """The first messages, kept as they came: they are checked as a recording is."""

    def __init__(self, platform: Platform, lidar: LidarStream) -> None:
        self._platform, self._lidar = platform, lidar
        self._ranges = Rows(lidar.ranges.shape[1], np.float32)
        self._rows: dict[str, array[float]] = {}  # stamps and values, one message after the other, by stream
        self._messages, self._next = 0, FEW

    def __len__(self) -> int:
        return len(self._ranges)

    @property
    def full(self) -> bool:
        return len(self) >= FIRST or self._messages >= FIRST_MESSAGES

    def add(self, stream: str, message: list[float], ranges: NDArray[np.float32] | None = None) -> None:
        """Keep stamp and values of ``lidar`` (the pose logged with it), ``odometry``, ``encoders`` or ``imu``."""
        if self.full:
            return
        if ranges is None:
            self._messages += 1
        else:
            self._ranges.add(ranges[None])
        self._rows.setdefault(stream, array("d")).extend(message)

    def forget_latest(self) -> None:
        """Forget the latest scan."""
        if not self.full:
            self._ranges.forget_latest()
            del self._rows["lidar"][-WIDTHS["lidar"] :]

    def is_due(self) -> bool:
        """Whether units are to be looked at: now and then, each time with twice as many scans."""
        rows = self._rows["lidar"]
        if len(self) < self._next or rows[-WIDTHS["lidar"]] - rows[0] < SOON:
            return False
        self._next = min(2 * len(self), FIRST) if len(self) < FIRST else FIRST + 1
        return True

    def recording(self, name: str, *, limited: bool = True) -> Recording:
        """All of them; ranges beyond the lidar's limit are no return, unless they are all that there is and no codes,
        and it need not be ``limited``.
        """
        given = {each: np.array(rows).reshape(-1, WIDTHS[each]) for each, rows in self._rows.items()}
        ranges = self._ranges.values
        streams: dict[str, Any] = {}
        if len(self):
            beyond = np.isfinite(ranges) & (ranges >= np.float32(self._lidar.range_max))
            if limited or (np.isfinite(ranges) & ~beyond).any() or len(np.unique(ranges[beyond])) <= CODES:
                ranges = np.where(beyond, np.float32(np.inf), ranges)
            stamps, logged = given["lidar"][:, 0], given["lidar"][:, 1:]
            odometry = None if np.isnan(logged).any() else logged
            streams["lidar"] = replace(self._lidar, stamps=stamps, ranges=ranges, odometry=odometry)
        if (rows := given.get("odometry")) is not None:
            streams["odometry"] = OdometryStream(rows[:, 0], rows[:, 1:])
        if (rows := given.get("encoders")) is not None:
            streams["encoders"] = EncoderStream(rows[:, 0], rows[:, 1:].astype(np.int64))
        if (rows := given.get("imu")) is not None:
            rates = rows[:, 1:] * (0.0, 0.0, 1.0)
            streams["imu"] = ImuStream(rows[:, 0], rates, np.zeros_like(rates))
        return Recording(name, self._platform, **streams)


class Waiting(NamedTuple):
    """A scan that has arrived: ``Scan`` of a ``LidarStream``, its odometry pose [3] where the driver gives one."""

    stamp: float
    ranges: NDArray[np.float32]
    odometry: Array | None


class LiveInputs(Inputs):
    """The scans that were taken in so far.

    With ``patience`` a scan waits for odometry that comes later [s], and wheels half as long for the gyro; then its
    motion counts as not measured, and their own turns are taken.
    """

    scans: LiveScans

    def __init__(self, platform: Platform, config: SyncConfig, *, max_range: float, patience: float) -> None:
        figures = platform.lidar.scan
        geometry = figures.angle_min, figures.angle_increment, figures.range_min, figures.range_max
        empty = np.empty((0, figures.beams), np.float32)
        self._lidar = LidarStream(np.empty(0), empty, *geometry, platform.lidar.time_increment)
        super().__init__(platform, config, self._lidar)
        # how long the odometry is asked for beyond the stamp of a scan
        self._sweep_seconds = self._lidar.time_increment * (figures.beams - 1) if config.deskew else 0.0
        self._patience = patience
        self.scans = LiveScans(self._lidar, platform, max_range)
        self.odometry_in, self.beginning = OdometryReadings(platform, config), Beginning(platform, self._lidar)
        self.waiting: deque[Waiting] = deque()  # scans that are not taken in yet
        self.too_fast: tuple[Issue, ...] = ()  # what is told of odometry that no robot can have driven
        self.awaited: tuple[str, ...] = ()  # streams that a scan waits for besides, until they have come to its stamp
        self._newest, self.messages = -np.inf, 0  # of all messages
        self._other_clock: tuple[Issue, ...] = ()
        self._blind = 0
        self._fast: dict[str, list[tuple[float, ...]]] = {}  # the latest steps, all too fast: stamp, way, x, y
        self._latest: dict[str, float] = {}  # stamps, by stream
        # of the latest scans stamp, odometry with wheels that spin, that logged with them; their ranges
        self._tail, self._ranges = Rows(7, order="F"), Rows(figures.beams, np.float32)
        self._late: list[int] = []  # scans that did not wait for their odometry any longer ...
        self._unheard: deque[int] = deque()  # ... and for which none has come since

    def arrives(self, stream: str, stamp: float) -> None:
        """Note a message of a stream; its stamps do not fall."""
        if not abs(stamp) <= MAX_STAMP:
            raise InputError(f"{stamp:.6g}, expected seconds below {MAX_STAMP:g}", field=f"{stream}.stamp")
        off = stamp - self._newest
        if self.messages == 1 and abs(off) > FAR_AHEAD and not self._other_clock:
            text = f"the first message, at {self._newest} s, is left out: the next is at {stamp} s, by another clock"
            self._other_clock = (Issue("other-clock", text),)
            self.waiting.clear()
            self.odometry_in, self._latest = OdometryReadings(self._platform, self._config), {}
            self.beginning = Beginning(self._platform, self._lidar)
            self._newest, self.messages = -np.inf, 0
        if stream == "lidar" and self.waiting and self._newest == self.waiting[-1].stamp > stamp + STRAY:
            stray = self.waiting.pop().stamp
            self.beginning.forget_latest()
            del self._latest["lidar"]
            self._newest = max(self._latest.values(), default=-np.inf)
            text = f"a scan at {stray} s is left out: the next is at {stamp} s"
            self._other_clock = (*self._other_clock, Issue("other-clock", text))
        if stamp < self._latest.get(stream, -np.inf):
            text = f"{stamp} s, before the one before it, {self._latest[stream]} s, expected rising seconds"
            raise InputError(text, field=f"{stream}.stamp")
        far = off < -FAR_AHEAD or (stream == "lidar" and off > FAR_AHEAD)
        if far and (others := ", ".join(sorted(self._latest.keys() - {stream}))):
            text = f"{stamp} s, {abs(off):.0f} s {'after' if off > 0 else 'before'} the newest of {others}"
            raise InputError(f"{text}, expected one clock for all streams", field=f"{stream}.stamp")
        self._latest[stream] = stamp
        self._newest = max(self._newest, stamp)
        self.messages += 1

    def hear(self, stream: str, stamp: float, values: NDArray[Any]) -> None:
        self.arrives("odometry" if stream == "encoders" else stream, stamp)
        message = [float(stamp), *values.tolist()]
        self.odometry_in.hear(stream, message)
        if stream == "odometry":
            self._expect_speed(stream, *message[:3])
        self.beginning.add(stream, message)

    def add_scan(self, ranges: Any, stamp: float, odometry: Array | None) -> None:
        """Let a scan wait for its turn."""
        lidar, row = self._lidar, np.array(ranges, np.float32)
        if row.shape != lidar.ranges.shape[1:]:
            shown = f"{len(row)} ranges" if row.ndim == 1 else f"shape {list(row.shape)}"
            raise InputError(f"{shown}, expected {lidar.ranges.shape[1]}", field="ranges")
        self.arrives("lidar", stamp)
        if odometry is not None:
            self._expect_speed("lidar", stamp, *odometry[:2].tolist())
        none = np.isin(row, np.array(self._platform.lidar.no_return, np.float32))
        row[row < lidar.range_min] = np.nan
        row[none] = np.inf
        self.beginning.add("lidar", [stamp, *((np.nan,) * 3 if odometry is None else odometry.tolist())], row)
        row[row >= np.float32(lidar.range_max)] = np.inf
        self.waiting.append(Waiting(stamp, given_up(row), odometry))

    def _expect_speed(self, stream: str, stamp: float, x: float, y: float) -> None:
        """Note where the odometry is; ``too_fast`` if it has been faster than any robot for long enough."""
        run = self._fast.setdefault(stream, [])
        way = math.hypot(x - run[-1][2], y - run[-1][3]) if run else 0.0
        if run and way <= SPEEDS[1] * (stamp - run[-1][0]):
            run.clear()
        run.append((stamp, way + run[-1][1] if run else 0.0, x, y))
        if len(run) > FEW and (seconds := stamp - run[0][0]) >= SURELY:
            text = f"odometry: moves at {run[-1][1] / seconds:.3g} m/s over {len(run)} readings, expected a robot's "
            self.too_fast = (Issue("odometry-units", text + "speed: are its stamps in s and its lengths in m?"),)

    def take_next(self, *, finish: bool = False) -> int | None:
        """Take in the scan that waits longest, if the odometry covers it, it has waited long enough, or nothing more is
        to come. Its index; None if there is none.
        """
        if not self.waiting:
            return None
        scan = self.waiting[0]
        ends = scan.stamp + self._sweep_seconds
        in_time = self._newest - ends <= self._patience and not finish
        waited = np.inf if finish else self._newest - self._patience / 2
        if in_time and scan.odometry is None and not self.odometry_in.reaches(ends, waited=waited):
            return None
        self.odometry_in.integrate(waited=waited)
        path = self.odometry_in.path
        ready = covered = path is not None and self.odometry_in.until >= ends
        if scan.odometry is not None:  # the reading after its own is that of the next scan
            ready = (covered or path is None) and len(self.waiting) > 1
        if in_time and not (ready and all(self._latest.get(each, -np.inf) >= scan.stamp for each in self.awaited)):
            return None
        self.waiting.popleft()
        if finish and not covered and path is not None:  # the log ends with its scans
            covered = not gaps(np.append(path.stamps, (self.waiting or [scan])[-1].stamp))[-1]
        covered |= scan.odometry is not None
        self._blind += not np.isfinite(scan.ranges).any()
        self._take(scan, path, covered=covered)
        return len(self) - 1

    @property
    def issues(self) -> tuple[Issue, ...]:
        """What was noticed: of clocks, what all inputs tell, blind scans, and those without odometry."""
        told = [*self._other_clock, *super().issues]
        if self._blind:
            told.append(Issue("blind-scans", about_blind(self._blind, len(self), self._lidar), self._blind))
        if len(self) and self.odometry_in.counted and self._platform.imu is not None and "imu" not in self._latest:
            text = f"no message of the platform's IMU: wheel counts, and scans, wait {self._patience / 2:g} s for one; "
            told.append(Issue("no-gyro", f"{text}turns from the wheels alone"))
        scans, begin, end = self.stamps, self.odometry_in.begins, self.odometry_in.until
        if len(self) and min(scans[-1] - scans[0], end - begin) > SOON and (text := apart(scans, begin, end)):
            told.append(Issue("other-clock", text))
        if not len(late := np.array(self._late)):
            return tuple(told)
        spans = np.split(self.stamps[late], np.flatnonzero(np.diff(late) > 1) + 1)
        text = f"{len(late)} of {len(self)} scans for which no odometry came within {self._patience:g} s: how the "
        text += f"robot moved is not known; {when([(float(some[0]), float(some[-1])) for some in spans])}"
        return (*told, Issue("no-odometry", text, len(late)))

    def _take(self, scan: Waiting, path: OdometryPath | None, *, covered: bool) -> None:
        index, pose = len(self), self._pose(scan.stamp, scan.odometry, path)
        self._correct(path)
        self._tail.add(np.array([scan.stamp]), pose[None], pose[None] if scan.odometry is None else scan.odometry[None])
        self._ranges.add(scan.ranges[None])
        rows, ranges = self._tail.values, self._ranges.values
        last, logged = len(rows), rows[:, 4:] if scan.odometry is not None else None
        if logged is not None and self.waiting and (after := self.waiting[0]).odometry is not None:
            rows = np.vstack((rows, (after.stamp, *after.odometry, *after.odometry)))  # the reading after
            ranges, logged = np.vstack((ranges, after.ranges)), rows[:, 4:]
        stamps, odometry = given_up(rows[:, 0]), rows[:, 1:4]
        lidar = replace(self._lidar, stamps=stamps, ranges=given_up(ranges[:]), odometry=logged)
        if path is None and logged is not None:
            path = OdometryPath(stamps, odometry)
        absent = not covered
        if self.odometry_in.counted and scan.odometry is None:
            absent |= scan.stamp < self.odometry_in.begins - BEFORE_WHEELS
        if index and self.odometry_in.still and (pose == odometry[last - 2]).all():
            absent |= not self.measured[-1]  # odometry that failed longer ago than is kept
        if not covered:
            self._unheard.append(index)
            self._late.append(index)
        counted = self.odometry_in.counted
        self.take(lidar, odometry, path, first=last - 1, last=last, absent=np.array([absent]), counted=counted)
        hidden = None if self.follower is None or path is None else self.follower.hides(index, scan.ranges)
        sweep = np.zeros(3)
        if (seconds := self._sweep_seconds) > 0 and path is not None:
            sweep = np.asarray(sweeps(path, np.array([scan.stamp]), seconds, self._config)[0])
        self.scans.keep(index, without(scan.ranges, hidden), sweep)
        if len(self._tail) > 2 * KEPT:
            self._tail.keep(KEPT)
            self._ranges.keep(KEPT)
        self.odometry_in.forget(scan.stamp)

    def _pose(self, stamp: float, logged: Array | None, path: OdometryPath | None) -> Array:
        """The pose [3] by odometry at a scan, with which one is logged [3]."""
        if path is None:
            return np.zeros(3) if logged is None else logged
        return np.asarray(
            at_scans(np.array([stamp]), logged if logged is None else logged[None], path, self._config)[0]
        )

    def _correct(self, path: OdometryPath | None) -> None:
        """Scans that did not wait for their odometry have it now, for what is driven from them on."""
        while path is not None and self._unheard and self.stamps[self._unheard[0]] <= path.stamps[-1]:
            index = self._unheard.popleft()
            pose = self._pose(float(self.stamps[index]), None, path)
            self._rows.values[index, 1:4] = pose if self.follower is None else self.follower.corrected(pose)
            if index - len(self) + len(self._tail) >= 0:
                self._tail.values[index - len(self), 1:4] = pose
