"""What travels with the robot: carts, floor that a tilted lidar sees, repeated scans, wheels that spin on the spot.

An endpoint that keeps its bearing and range while the odometry moves is no wall, where the place at which a wall would
be is seen to be empty. Walls along a corridor keep both, too; but they are where walls would be. If all that stood
still before travels now, it is the robot that stands (``docs/theory/default-filter.md``).
"""

from __future__ import annotations

from bisect import bisect
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.platform import LidarSpec
from moteslam.robot.recording import LidarStream
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue, when
from moteslam.slam.inputs.comparison import ComparedBeams, Flags, compare_scans

STEP = 0.25  # Scans this far apart by odometry are compared [m]; a turn counts as a metre a radian
FARTHEST = 0.6  # Scans farther apart are not compared [m]: on the way the odometry errs and the view changes too much
TRAVELS = 3  # An endpoint travels that was seen to do so in this many comparisons, less those in which it did not
MOST = 12  # As many speak for it at most
NEAR, NEAR_SHARE = 0.1, 0.03  # A range within this [m], and this share of it, of one that travels does so, too
WIDE = 3  # Fewer beams than this side by side are no load: a glancing ray, a corner
LINE_BEAMS, LINE_WIDTH = 8, 1.0
"""A straight line that travels is seen by as many beams, and is this wide [m]: wider than what a robot pushes."""
LEAST_FACING = 0.2  # It is met by beams at this cosine to its normal at least
STANDS = 1e-3  # Odometry that moves by less than this [m] or [rad] stands
BEAMS, ALONE = 5, 3
"""Fewer beams than the first say nothing of the wheels, or than the second where no range changes but by noise."""
REPEATED = 5e-3
"""A scan is the one before again where no range differs by more [m], as the noise of a lidar does in some beams, though
the robot has moved by ``STEP`` and ``ALONE`` endpoints travel: along a bare corridor none does."""
TURNED = 0.5  # An endpoint that keeps its range to ``REPEATED`` while the robot turns by this [rad] travels, too
ROUNDED = 0.02  # Ranges in steps of more than this keep theirs by chance [m]
TRUSTED = 0.5
"""Share of the endpoints that may stand or travel that stood so far: 0.6 to 0.95 where odometry, mount and clock are
right; 0.1 to 0.45 where they are not, and nothing follows from walls that are elsewhere."""
MEMORY = 4  # Walls that were seen in the latest comparisons, this many, must be seen now


def near(ranges: NDArray[Any], held: NDArray[Any]) -> Flags:
    """Which ranges [...] are those at which something travels, ``held`` [...] [m]."""
    return np.asarray(np.abs(ranges - held) <= NEAR + NEAR_SHARE * held)


def _line(angles: Array, ranges: Array) -> Array:
    """The straight line along which something travels, as the range [b] of every beam that meets it; NaN without one.

    The floor before a tilted lidar is such a line: a beam that ends on it need not be seen to travel first. Of angles
    [b] [rad], and ranges [b] at which something travels, NaN elsewhere [m].
    """
    line = np.full(len(angles), np.nan)
    x, y = ranges * np.cos(angles), ranges * np.sin(angles)
    on = np.isfinite(ranges)
    for _ in range(3):
        if on.sum() < LINE_BEAMS:
            return line
        points = np.stack((x[on], y[on]), axis=1)
        middle = points.mean(axis=0)
        across = np.linalg.svd(points - middle, full_matrices=False)[2][1]
        distance = float(middle @ across)
        facing = (np.cos(angles) * across[0] + np.sin(angles) * across[1]) * np.sign(distance)
        on = (np.abs(x * across[0] + y * across[1] - distance) < NEAR / 2) & (facing > LEAST_FACING)
    if np.ptp(points @ (-across[1], across[0])) < LINE_WIDTH:
        return line
    ahead = facing > LEAST_FACING
    line[ahead] = abs(distance) / facing[ahead]
    return line


def _side_by_side(flags: Flags) -> Flags:
    """Those flags [b] that are in a run of ``WIDE`` at least."""
    runs = np.convolve(flags, np.ones(WIDE), "valid") >= WIDE
    return np.asarray(np.convolve(runs, np.ones(WIDE), "full") > 0)


class Follower:
    """Goes through the scans in order: what it says of one depends on those before and itself."""

    def __init__(self, lidar: LidarStream, mount: LidarSpec) -> None:
        self._fan = fan = ComparedBeams(lidar, mount)
        beams, count = fan.beams, len(fan.beams)
        self._angles = lidar.angles[beams]
        self._nearest = np.searchsorted(beams[:-1] + np.diff(beams) / 2, np.arange(lidar.ranges.shape[1]))
        self._repeats = False  # the latest scan is the one before again, though the robot has moved since it was new
        self._repeated = set[int]()  # such scans
        self._last, self._at_last = lidar.ranges[:0], np.zeros(3)  # the latest that was new, and the odometry then
        self._driven, self._new, self._unmeasured = 0.0, 0.0, 0  # and turned; by the latest new scan; flags so far
        self._place = -1.0  # of the latest new scan, in ``STEP``
        self._compared: _Compared | None = None
        self._begins: list[int] = []  # the scan from which on each of these holds:
        self._epochs: list[Array] = []  # [b] at which range something travels along each beam [m], NaN where nothing
        # what there was, by its code: from one scan to another, in order
        self._seen: dict[str, list[tuple[int, int]]] = {}
        self._away: list[float] = []  # at which distances something travels, whenever it was seen to [m]
        self._for = np.zeros(count)  # comparisons that speak for it
        self._range = np.full(count, np.nan)
        self._kept, self._heading = np.full((2, count), np.nan)  # a range, and the heading since when it is the same
        self._looked = 0.0  # the heading at the latest comparison
        self._rounding = np.inf  # the least step between ranges of one scan so far [m]
        self._walls = [0] * MEMORY  # beams that were seen to stand, of the latest comparisons
        self._stood = self._might = 0  # of all comparisons, and those that might have
        self._spins = False
        self._stands = np.zeros(3)  # where the robot is while the wheels spin
        self._since: tuple[Array, Array] | None = None  # the odometry when they last did, and the robot's pose then

    def add(self, scan: int, ranges: NDArray[np.float32], odometry: Array, driven: float, unmeasured: bool) -> Array:
        """Take in the next scan: its index, ranges [beams] [m] and pose [3] by odometry.

        It was ``driven``, and turned, so far since the scan before [m], unless odometry left that ``unmeasured``.

        Returns the pose [3] without the motion of wheels that spun on the spot.
        """
        self._driven, self._unmeasured = self._driven + driven, self._unmeasured + unmeasured
        moved = self._driven - self._new
        with np.errstate(invalid="ignore"):  # most often some differ
            same = len(self._last) == len(ranges) and not (np.abs(ranges - self._last) > REPEATED).any()
        same = same and np.isfinite(ranges).sum() >= BEAMS
        same = same and np.array_equal(np.isnan(ranges), np.isnan(self._last))
        again = same and moved > STANDS and np.array_equal(ranges, self._last, equal_nan=True)
        if same and not again and not self._repeats and moved > STEP:
            both = np.stack((self._last, ranges))[:, self._fan.beams], np.stack((self._at_last, odometry))
            again = bool(compare_scans(self._fan, *both)[0].sum() >= ALONE)
        self._repeats = bool(same and (again or self._repeats))
        if not same:
            self._last, self._at_last, self._new = ranges, odometry, self._driven
        if self._repeats:
            self._repeated.add(scan)
            self._see("scans-repeat", scan, scan)
        else:
            path = self._driven + FARTHEST * self._unmeasured  # as far apart as is not compared
            place, self._place = self._place, float(np.floor(path / STEP))
            if self._place != place:
                before, self._compared = self._compared, _Compared(scan, path, ranges[self._fan.beams], odometry)
                if before is not None and path - before.path < FARTHEST:
                    self._compare(before, self._compared)
                else:
                    self._spins = False
        return self._stands if self._spins else self.corrected(odometry)

    def corrected(self, odometry: Array) -> Array:
        """The pose [3] of a robot that drives, without the motion of wheels that spun before."""
        if self._since is None:
            return odometry
        return np.asarray(se2.compose(self._since[1], se2.between(self._since[0], odometry)))

    def hides(self, scan: int, ranges: NDArray[np.float32]) -> Flags | None:
        """Which ranges [beams] of a scan are no measurement of the walls; None if all may be."""
        if scan in self._repeated:
            return np.ones(len(ranges), np.bool_)
        epoch = bisect(self._begins, scan) - 1
        return None if epoch < 0 else near(ranges, self._epochs[epoch][self._nearest].astype(np.float32))

    def issues(self, stamps: Array) -> tuple[Issue, ...]:
        """What there was so far, each kind with its times; ``stamps`` [n] are those of the scans [s]."""
        away = self._away and (min(self._away), max(self._away))
        load = f"something {' to '.join(dict.fromkeys(f'{one:.1f}' for one in away))} m away travels with the robot "
        load += "(a load, stuck beams, glass beside it, or floor before a tilted lidar): left out"
        again = "the lidar gives the same scan again while the odometry moves: odometry alone there"
        stands = "the wheels turn while all that the lidar sees stands still: the robot is taken to stand"
        issues = []
        for code, text in (("travels-along", load), ("scans-repeat", again), ("wheels-spin", stands)):
            if some := self._seen.get(code):
                spans = [(float(stamps[first]), float(stamps[last])) for first, last in some]
                count = sum(last - first + 1 for first, last in some)
                issues.append(Issue(code, f"{when(spans)}: {text}", count))
        return tuple(issues)

    def _see(self, code: str, first: int, last: int, *, apart: int = 1) -> None:
        """Note what was seen: it goes on with the latest of its kind that ended this many scans before at most."""
        before = self._seen.setdefault(code, [])
        if before and before[-1][1] + apart >= first:
            first, _ = before.pop()
        before.append((first, last))

    def _compare(self, before: _Compared, now: _Compared) -> None:
        # and back: floor behind the robot is where it saw through the place of a wall before
        ranges = np.stack((before.ranges, now.ranges, before.ranges))
        poses = np.stack((before.odometry, now.odometry, before.odometry))
        if len(distinct := np.unique(now.ranges[np.isfinite(now.ranges)])) > 1:
            self._rounding = min(self._rounding, float(np.diff(distinct).min()))
        travels, stands, mays = compare_scans(self._fan, ranges, poses)
        line = _line(self._angles, np.where(travels.any(axis=0), now.ranges, np.nan))
        travel, stand, may = travels[0] | travels[1] & near(now.ranges, line), stands[0], mays[0]
        new = travel & (self._for < TRAVELS)
        if self._epochs and (known := near(now.ranges, self._epochs[-1])).any():  # of floor new beams, too
            if (known & (self._for >= TRAVELS)).any():
                self._see("travels-along", now.scan, now.scan, apart=now.scan)
                self._away.append(float(np.median(now.ranges[known])))
            new &= ~known
        walls = int(stand.sum())
        with np.errstate(invalid="ignore"):
            changed = bool((np.abs(now.ranges - before.ranges) > NEAR / 2).any())
        if self._wheels(before, now, int(new.sum()), walls, changed):
            return
        held = np.isfinite(now.ranges) & (np.abs(np.nan_to_num(now.ranges) - self._kept) <= REPEATED)
        self._kept = np.where(held, self._kept, now.ranges)
        self._heading = np.where(held, self._heading, now.odometry[2])
        held &= (np.abs(se2.wrap(now.odometry[2] - self._heading)) > TURNED) & (self._rounding <= ROUNDED)
        if abs(se2.wrap(now.odometry[2] - self._looked)) > TURNED / 2:  # at once: along another wall it may be the same
            self._heading, held = np.full_like(self._heading, now.odometry[2]), held & False
        self._looked = float(now.odometry[2])
        travel, stand = travel | held, stand & ~held
        self._walls = [*self._walls[1:], walls]
        self._stood, self._might = self._stood + walls, self._might + int((may & ~travel).sum())
        if not travel.any() and not self._for.any():
            return
        again = travel & near(now.ranges, self._range)
        other = travel & ~again
        self._range[again] += (now.ranges[again] - self._range[again]) / 2
        self._range[other] = now.ranges[other]
        self._for[other] = 0
        self._for[travel] = np.minimum(self._for[travel] + 1, MOST)
        self._for[stand] = np.maximum(self._for[stand] - 1, 0)
        self._begin(now.scan)

    @property
    def _trusted(self) -> bool:
        """Whether walls are where the odometry says."""
        return self._stood > TRUSTED * self._might

    def _begin(self, scan: int) -> None:
        if not self._trusted:
            return
        travels, suspected = (_side_by_side(self._for >= least) for least in (TRAVELS, 1))
        held = np.where(travels, self._range, _line(self._angles, np.where(suspected, self._range, np.nan)))
        before = self._epochs[-1] if self._epochs else np.full_like(held, np.nan)
        if np.array_equal(held, before, equal_nan=True):
            return
        self._begins.append(scan)
        self._epochs.append(held)

    def _wheels(self, before: _Compared, now: _Compared, new: int, walls: int, changed: bool) -> bool:
        """Whether the wheels spin on the spot from one scan to the other: then the robot stands from there on."""
        went_on = self._spins
        if went_on:
            self._spins = new > walls or not changed
        else:
            enough = new >= (BEAMS if changed else ALONE)
            self._spins = self._trusted and enough and walls <= new / 4 and max(self._walls) >= BEAMS
        if not self._spins:
            return False
        if not went_on:  # the motion since the former scan is taken back
            self._stands = self.corrected(before.odometry)
        self._since = now.odometry, self._stands
        self._see("wheels-spin", now.scan if not went_on else before.scan, now.scan, apart=0)
        return True


class _Compared(NamedTuple):
    """A scan that is compared: how far the robot has driven and turned by then [m], its ranges [b], its pose [3]."""

    scan: int
    path: float
    ranges: NDArray[np.float32]
    odometry: Array
