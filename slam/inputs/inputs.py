"""What SLAM takes in, be it of a recording or of messages as they come: scans, and the motion between them.

It is causal: a scan and the motion up to it depend on what has arrived when the scan is complete and the odometry has
given its next reading (wheels with a gyro: when the gyro has given its next one after that). Interpolation between
readings costs this delay of one reading. No statistic of the complete recording is used.
"""

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.platform import Platform
from moteslam.robot.recording import LidarStream, chunks
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue, counted
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.lapses import Lapse, Open, about_lapses, lapses
from moteslam.slam.inputs.odometry_path import OdometryPath, about_hanging, jumps
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.travelling import Follower
from moteslam.slam.rows import Rows


class Inputs:
    """What SLAM takes in: n scans, and the motion between them."""

    scans: Scans  # their endpoints
    logged: Array | None = None  # [n] the stamps that the recording gives them, where it has them in another order [s]

    def __init__(self, platform: Platform, config: SyncConfig, lidar: LidarStream) -> None:
        self._platform, self._config = platform, config
        self._rows, self._flags = Rows(7), Rows(2, np.bool_)  # stamp, odometry, motion; jumped, measured
        self.follower = Follower(lidar, platform.lidar) if config.travelling else None  # of what travels with the robot
        self._seen: dict[tuple[str, float], Lapse] = {}
        self._start: NDArray[np.float32] | None = None  # the first scan, until the robot has left it
        # what is left open of the motion to scans of which more is known than the velocity before, by scan
        self.open: dict[int, Open] = {}
        self.path: OdometryPath | None = None  # by odometry, at its own stamps, as far as it is kept; None without
        self.moves = False  # whether the odometry measures any motion

    def __len__(self) -> int:
        return len(self._rows)

    stamps = property(lambda self: self._rows.values[:, 0])  # [n] in the order in which they were taken [s]
    odometry = property(lambda self: self._rows.values[:, 1:4])  # [n, 3] the pose by odometry; zeros without
    # [n, 3] the increment since the scan before, in the frame of the pose there; zeros where nothing measured it
    motions = property(lambda self: self._rows.values[:, 4:7])
    jumped = property(lambda self: self._flags.values[:, 0])  # [n] whether the odometry jumps
    # [n] whether the odometry measured the motion since the scan before: it does not jump there, and it is of wheel
    # encoders, has moved by then, or the robot is seen to stand
    measured = property(lambda self: self._flags.values[:, 1])

    @property
    def issues(self) -> tuple[Issue, ...]:
        """Odometry that never moves, what was seen to travel with the robot, and the lapses."""
        issues = () if self.follower is None else self.follower.issues(self.stamps)
        if self.path is not None and not self.moves and (still := int((~self.measured).sum())):
            text = f"odometry that never moves: constant velocity over {counted(still, 'scan')}"
            issues = (Issue("still-odometry", text, still), *issues)
        issues += about_hanging(self.path.hung) if self.path else ()
        seen = sorted(self._seen.values(), key=lambda one: one.begin)
        return (*issues, *about_lapses(seen, self.stamps))

    def take(
        self,
        lidar: LidarStream,
        odometry: Array,
        path: OdometryPath | None,
        *,
        first: int = 0,
        last: int | None = None,
        absent: NDArray[np.bool_],
        counted: bool,
        lapsing: bool = True,
    ) -> None:
        """Take in the scans from ``first`` to before ``last`` of a stretch of k, with the odometry [k, 3] at them.

        The others, before and after, say what is usual. It is causal: what is taken in of a scan follows from those
        before and, of odometry, from the reading after.

        The path is by odometry, over the stretch; it did not measure the motion to scans that are ``absent`` [m]. Wheel
        counters (``counted``) measure from the first turn on. ``lapsing``: whether the stamps show lapses.
        """
        self.path, last = path, len(lidar) if last is None else last
        n, new, stamps = len(self), slice(first, last), lidar.stamps
        unmeasured, motions = absent, dict[int, Array]()
        jumped = np.zeros(last - first, np.bool_)
        if path is not None and not lapsing:
            unmeasured = jumped = jumps(stamps, odometry, self._config)[new]
        elif path is not None and not absent.all():
            since = float(stamps[first - 1]) if first else -np.inf
            by_wheels = counted and lidar.odometry is None
            found = lapses(path, odometry, lidar, self._platform.lidar, self._config, counted=by_wheels, since=since)
            unmeasured, jumped = absent | found.unmeasured[new], found.jumped[new]
            motions = {scan - first: motion for scan, motion in found.motions.items() if first <= scan < last}
            self.open |= {n + scan - first: left for scan, left in found.open.items() if first <= scan < last}
            self._seen |= {(lapse.kind, lapse.begin): lapse for lapse in found.seen}
        places = odometry[new]
        if self.follower is not None and path is not None:
            begin = max(first - 1, 0)
            steps = se2.between(odometry[begin : last - 1], odometry[begin + 1 : last])
            driven = np.append(np.zeros(int(not first)), np.hypot(steps[:, 0], steps[:, 1]) + np.abs(steps[:, 2]))
            places = np.empty((last - first, 3))
            scans = (ranges for some in chunks(lidar.ranges[new] if first else lidar.ranges) for ranges in some)
            each = zip(scans, odometry[new], driven.tolist(), unmeasured.tolist(), strict=False)
            for scan, of_scan in enumerate(each):
                places[scan] = self.follower.add(n + scan, *of_scan)
        before = self.odometry[-1:] if n else places[:1]
        moved = np.asarray(se2.between(np.vstack((before, places[:-1])), places))
        for scan, motion in motions.items():
            moved[scan] = motion
        if not n:
            moved[0] = 0.0
        measured = np.zeros(last - first, np.bool_) if path is None else self._measures(lidar, new, places, counted)
        self._rows.add(stamps[new], places, moved)
        self._flags.add(jumped, measured & ~unmeasured)

    def _measures(self, lidar: LidarStream, new: slice, places: Array, counted: bool) -> NDArray[np.bool_]:
        """Whether the odometry has moved by each new scan, or the robot is seen to stand where it began."""
        origin = self.odometry[0] if len(self) else places[0]
        moved = np.logical_or.accumulate((places != origin).any(axis=1)) | self.moves | counted
        self._start = lidar.ranges[new.start].copy() if not len(self) else self._start
        self.moves, measures = bool(moved[-1]), moved.copy()
        for scan in np.flatnonzero(~moved).tolist():
            if self._start is None:
                break
            here = lidar.ranges[new.start + scan]
            both = np.isfinite(self._start) & np.isfinite(here)
            differs = np.abs(here[both] - self._start[both]) > self._config.same_range
            left = differs.sum() > self._config.moved_share * both.sum()
            measures[scan] = both.any() and not left
            if left:
                self._start = None
        return measures
