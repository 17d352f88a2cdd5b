"""What travels with the robot: carts, floor that a tilted lidar sees, repeated scans, wheels that spin on the spot.

An endpoint that keeps its bearing and range while the odometry moves is no wall, where the place at which a wall would
be is seen to be empty. Walls along a corridor keep both, too; but they are where walls would be. If all that stood
still before travels now, it is the robot that stands (``docs/theory/default-filter.md``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.platform import LidarSpec
from moteslam.robot.recording import LidarStream, chunks
from moteslam.robot.values import Issue, when
from moteslam.slam.inputs.comparison import ComparedBeams, compare_scans

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STEP = 0.25
"""Scans this far apart by odometry are compared [m]; a turn counts as a metre a radian."""
FARTHEST = 0.6
"""Scans farther apart are not compared [m]: on the way the odometry errs and the view changes too much."""
TRAVELS = 3
"""An endpoint travels that was seen to do so in this many comparisons, less those in which it did not."""
MOST = 12
"""As many speak for it at most."""
NEAR, NEAR_SHARE = 0.1, 0.03
"""A range within this [m], and this share of it, of one that travels does so, too."""
WIDE = 3
"""Fewer beams than this side by side are no load: a glancing ray, a corner."""
LINE_BEAMS, LINE_WIDTH = 8, 1.0
"""A straight line that travels is seen by as many beams, and is this wide [m]: wider than what a robot pushes."""
LEAST_FACING = 0.2
"""It is met by beams at this cosine to its normal at least."""
STANDS = 1e-3
"""Odometry that moves by less than this [m] or [rad] stands."""
BEAMS = 5
"""Fewer beams than this say nothing of the wheels."""
TRUSTED = 0.5
"""Share of the endpoints that may stand or travel that stood so far: 0.6 to 0.95 where odometry, mount and clock are
right; 0.1 to 0.45 where they are not, and nothing follows from walls that are elsewhere."""
MEMORY = 4
"""Walls that were seen in the latest comparisons, this many, must be seen now."""
PAIRS_AT_ONCE = 256
"""Comparisons that are made at once."""


class Episode(NamedTuple):
    """What was seen, ``along``, ``repeated`` or ``spins``, from one scan to another [index]."""

    kind: str
    first: int
    last: int


@dataclass(frozen=True, eq=False)
class Travelling:
    """What travels with the robot.

    Attributes:
        begins: [e] the scan from which on each row of ``ranges`` holds, in order.
        ranges: [e, beams] the range at which something travels along each beam [m]; NaN where nothing does.
        repeated: [n] scans that are not new: the driver gave the one before again.
        odometry: [n, 3] without the motion of wheels that spun on the spot.
        seen: what there was, in order.
    """

    begins: NDArray[np.intp]
    ranges: NDArray[np.float32]
    repeated: Flags
    odometry: Array
    seen: tuple[Episode, ...]

    def hides(self, scan: int, ranges: NDArray[np.float32]) -> Flags | None:
        """Which ranges [beams] of a scan are no measurement of the walls; None if all may be."""
        if self.repeated[scan]:
            return np.ones(len(ranges), np.bool_)
        epoch = int(np.searchsorted(self.begins, scan, side="right")) - 1
        if epoch < 0:
            return None
        held = self.ranges[epoch]
        return np.asarray(np.abs(ranges - held) <= NEAR + NEAR_SHARE * held)

    def issues(self, lidar: LidarStream) -> tuple[Issue, ...]:
        """What there was, each kind with its stamps."""
        along = any(one.kind == "along" for one in self.seen)
        near, far = np.nanpercentile(self.ranges, (0, 50)) if along else (0.0, 0.0)
        load = f"something {near:.1f} to {far:.1f} m away travels with the robot (a load, or the floor before a tilted "
        issues = []
        for kind, code, text in (
            ("along", "travels-along", load + "lidar): left out"),
            (
                "repeated",
                "scans-repeat",
                "the lidar gives the same scan again while the odometry moves: odometry alone there",
            ),
            (
                "spins",
                "wheels-spin",
                "the wheels turn while all that the lidar sees stands still: the robot is taken to stand",
            ),
        ):
            if some := [one for one in self.seen if one.kind == kind]:
                spans = [(float(lidar.stamps[one.first]), float(lidar.stamps[one.last])) for one in some]
                count = sum(one.last - one.first + 1 for one in some)
                issues.append(Issue(code, f"{when(spans)}: {text}", count))
        return tuple(issues)


def travelling(
    lidar: LidarStream, mount: LidarSpec, odometry: Array, unmeasured: Flags | None = None
) -> Travelling | None:
    """Find what travels with the robot; causal: what is said of a scan depends on those before and itself.

    Args:
        odometry: [n, 3] the robot's pose at each by odometry.
        unmeasured: [n] at which scans that does not say how the robot has moved since the one before.

    Returns:
        None if nothing does.
    """
    motion = se2.between(odometry[:-1], odometry[1:])
    path = np.concatenate(([0.0], np.cumsum(np.hypot(motion[:, 0], motion[:, 1]) + np.abs(motion[:, 2]))))
    repeated = _repeated(lidar, path)
    if unmeasured is not None:  # as far apart as is not compared
        path = path + FARTHEST * np.cumsum(unmeasured)
    fresh = np.flatnonzero(~repeated)
    compared = fresh[np.flatnonzero(np.diff(np.floor(path[fresh] / STEP), prepend=-1.0))]
    fan = ComparedBeams(lidar, mount)
    beams = fan.beams
    found = _Follower(lidar.angles[beams], odometry)
    for first in range(0, len(compared) - 1, PAIRS_AT_ONCE):
        some = compared[first : first + PAIRS_AT_ONCE + 1]
        ranges = np.asarray(lidar.ranges[some])[:, beams]
        travel, stand, may = compare_scans(fan, ranges, odometry[some])
        for k in np.flatnonzero(np.diff(path[some]) < FARTHEST).tolist():
            found.compare(int(some[k]), int(some[k + 1]), ranges[k + 1], travel[k], stand[k], may[k])
    along = () if found.along is None else (found.along,)
    there_was = sorted((*_runs("repeated", repeated), *found.seen, *along), key=lambda one: one.first)
    if not there_was:
        return None
    nearest = np.searchsorted(beams[:-1] + np.diff(beams) / 2, np.arange(lidar.ranges.shape[1]))
    return Travelling(
        np.array(found.begins, np.intp),
        np.array(found.epochs, np.float32).reshape(-1, len(beams))[:, nearest],
        repeated,
        found.odometry,
        tuple(there_was),
    )


def _repeated(lidar: LidarStream, path: Array) -> Flags:
    """Which scans [n] are the same as the one before, to the last digit, though the robot has moved since it was new.

    Args:
        path: [n] driven and turned by odometry.
    """
    same = np.zeros(len(lidar), np.bool_)
    done, last = 0, None
    for ranges in chunks(lidar.ranges):
        both = ranges if last is None else np.concatenate((last, ranges))
        equal = (both[1:] == both[:-1]) | (np.isnan(both[1:]) & np.isnan(both[:-1]))
        known = np.isfinite(both[1:]).sum(axis=1) >= BEAMS
        same[done + len(ranges) - len(equal) : done + len(ranges)] = equal.all(axis=1) & known
        done, last = done + len(ranges), ranges[-1:]
    if not same.any():
        return same
    new = np.maximum.accumulate(np.where(same, 0, np.arange(len(same))))
    return np.asarray(same & (path > path[new] + STANDS))


def _line(angles: Array, ranges: Array) -> Array:
    """The straight line along which something travels, as the range [b] of every beam that meets it; NaN without one.

    The floor before a tilted lidar is such a line: a beam that ends on it need not be seen to travel first.

    Args:
        angles: [b] of the beams [rad].
        ranges: [b] at which something travels; NaN elsewhere [m].
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
        on = np.abs(x * across[0] + y * across[1] - distance) < NEAR / 2
    if np.ptp(points @ (-across[1], across[0])) < LINE_WIDTH:
        return line
    facing = (np.cos(angles) * across[0] + np.sin(angles) * across[1]) * np.sign(distance)
    ahead = facing > LEAST_FACING
    line[ahead] = abs(distance) / facing[ahead]
    return line


class _Follower:
    """Goes through the comparisons in order.

    Attributes:
        begins, epochs, seen, odometry: as of ``Travelling``.
        along: where anything was seen that travels; None without.
    """

    def __init__(self, angles: Array, odometry: Array) -> None:
        beams = len(angles)
        self._angles = angles
        self.begins: list[int] = []
        self.epochs: list[Array] = []
        self.seen: list[Episode] = []
        self.along: Episode | None = None
        self.odometry = odometry
        self._measured = odometry
        self._for = np.zeros(beams)  # comparisons that speak for it
        self._range = np.full(beams, np.nan)
        self._walls = [0] * MEMORY  # beams that were seen to stand, of the latest comparisons
        self._stood = self._might = 0  # of all comparisons, and those that might have
        self._spins = False

    def compare(
        self, first: int, last: int, ranges: NDArray[np.float32], travel: Flags, stand: Flags, may: int
    ) -> None:
        """Take in a comparison.

        Args:
            ranges: [beams] of the latter [m].
            travel, stand, may: [beams] of the endpoints of the former.
        """
        if self.epochs and (np.abs(ranges - self.epochs[-1]) <= NEAR + NEAR_SHARE * self.epochs[-1]).any():
            self.along = (self.along or Episode("along", last, last))._replace(last=last)
        new = int((travel & (self._for < TRAVELS)).sum())
        walls = int(stand.sum())
        if self._wheels(first, last, new, int(travel.sum()), walls):
            return
        self._walls = [*self._walls[1:], walls]
        self._stood, self._might = self._stood + walls, self._might + int((may & ~travel).sum())
        if not travel.any() and not self._for.any():
            return
        again = travel & (np.abs(ranges - self._range) <= NEAR + NEAR_SHARE * self._range)
        other = travel & ~again
        self._range[again] += (ranges[again] - self._range[again]) / 2
        self._range[other] = ranges[other]
        self._for[other] = 0
        self._for[travel] = np.minimum(self._for[travel] + 1, MOST)
        self._for[stand] = np.maximum(self._for[stand] - 1, 0)
        self._begin(last)

    @property
    def _trusted(self) -> bool:
        """Whether walls are where the odometry says."""
        return self._stood > TRUSTED * self._might

    def _begin(self, scan: int) -> None:
        """From a scan on, what is known by then."""
        if not self._trusted:
            return
        travels = self._for >= TRAVELS
        beside = np.convolve(travels, np.ones(WIDE), "valid") >= WIDE  # runs of as many
        travels = np.convolve(beside, np.ones(WIDE), "full") > 0
        held = np.where(travels, self._range, _line(self._angles, np.where(travels, self._range, np.nan)))
        before = self.epochs[-1] if self.epochs else np.full_like(held, np.nan)
        if np.array_equal(held, before, equal_nan=True):
            return
        self.begins.append(scan)
        self.epochs.append(held)

    def _wheels(self, first: int, last: int, new: int, travel: int, walls: int) -> bool:
        """Whether the wheels spin on the spot from one scan to the other; then the odometry is corrected."""
        went_on = self._spins
        if went_on:
            self._spins = travel > walls
        else:
            self._spins = self._trusted and new >= BEAMS and walls <= new / 4 and max(self._walls) >= BEAMS
        if not went_on and not self._spins:
            return False
        if self.odometry is self._measured:
            self.odometry = self._measured.copy()
        if went_on:  # between the two the robot was taken to stand
            self.odometry[first + 1 : last] = self.odometry[first]
        if not self._spins:
            return False
        if went_on:
            self.seen[-1] = self.seen[-1]._replace(last=last)
        else:
            self.seen.append(Episode("spins", first, last))
        # the motion since the former scan is taken back, and all that follows goes on from there
        rest = se2.between(self._measured[last], self._measured[last:])
        self.odometry[last:] = se2.compose(self.odometry[first], rest)
        return True


def _runs(kind: str, flags: Flags) -> list[Episode]:
    """The runs of flagged scans."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False]))))
    return [Episode(kind, int(first), int(last) - 1) for first, last in edges.reshape(-1, 2)]
