"""Lapses of the odometry: gaps in the log, odometry that is stale, and jumps.

The step over one is no measurement of the usual accuracy. What can be known of it is said here, and how well; where the
robot is then is for the scans to say (``docs/theory/default-filter.md``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.platform import LidarSpec
from moteslam.robot.recording import LATEST, LidarStream, gaps
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue, when
from moteslam.slam.inputs.comparison import ComparedBeams, Flags, compare_scans
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import OdometryPath, jumps

BEFORE = 0.5  # The speed before a lapse is the mean over so long [s]
HARDEST, USUAL = 3.0, 1.0
"""Robots on wheels do not brake harder than the first, nor in a gap, which they know nothing of, than the second
[m/s^2]."""
TURN_USUAL, LEAST_TURN = 5.0, 0.02
"""Nor do they stop turning harder than the first [rad/s^2]; stops of less than the second say nothing [rad]."""
RESOLVED, LEAST_STOPPED = 4.0, 0.002
"""Odometry stands still where it should have gone so many of the smallest steps that it has and so far [m], [rad]."""
STILL = 1e-9  # Odometry that moves by less stands still, to the last bits of its place [m]
TURNS, WEAVES = 0.5, 0.05
"""How fast a robot that drives turns [rad/s]; how far aside one is that went round things, as a share of the way."""
CURVATURE = 0.02  # Standard deviation of the heading that wheels alone measure [rad/m], as of the calibration's prior
APART, FARTHEST = 0.25, 1.5
"""Whether the robot stands while its odometry does is asked when it would have gone as far as the first [m], again each
time as far, up to the second."""
BEAMS, LEAST_SCANS = 5, 3
"""As many endpoints say so; fewer scans while the odometry stands do not: a robot that was carried stands elsewhere."""
ANEW, ELSEWHERE, ANYWHERE = 0.05, 1.0, 30.0
"""Poses begin anew that are, after a gap, no farther from 0 than the first [m], [rad], and were farther than the second
[m] before: it is another run, and the robot may be as far off as the third [m]."""
CAUGHT_UP = 2.0  # Odometry has caught up that goes on in a step this many times as fast as before it stood


class Lapse(NamedTuple):
    """One of them, from a reading of the odometry to another [s]; ``named`` if it is worth a warning."""

    kind: Literal["gap", "held", "anew", "stale", "missing"]  # held: a gap, then the pose from before it
    begin: float
    end: float
    named: bool = True


class Open(NamedTuple):
    """What is left open of a motion that was not measured: standard deviations."""

    place: float = 0.0  # of a robot that may have turned aside on the way [m]
    heading: float = 0.0  # likewise [rad]
    arc: float = 0.0  # of the place if it did not [m]

    def plus(self, other: Open) -> Open:
        """After another such motion."""
        return Open(*map(math.hypot, self, other))


CLOSED = Open()  # Nothing is left open


@dataclass(frozen=True, eq=False)
class Lapses:
    """Where the odometry did not measure."""

    unmeasured: Flags  # [n] the scans since the one before which nothing measured the motion
    jumped: Flags  # [n] those of them where the odometry jumps
    motions: dict[int, Array]  # of those over a gap what the motion was as far as is known, by scan
    open: dict[int, Open]  # how well that is known, by scan
    seen: tuple[Lapse, ...]  # what there was besides jumps


def about_lapses(seen: Sequence[Lapse], stamps: Array) -> tuple[Issue, ...]:
    """What there was, each kind with its times, among scans at stamps [n] [s]."""
    drove, where = "nothing was recorded while the robot drove on", "is then the scans must say"
    held = f"{drove}, and the next scan carries an odometry pose from before: where the robot {where}"
    issues = []
    for kind, code, text in (
        ("gap", "gap", f"{drove}: where it {where}"),
        ("held", "gap", held),
        ("anew", "gap", "nothing was recorded, then odometry begins anew: two runs in one file? Cut it there"),
        ("stale", "stale-odometry", "the odometry stood still while the robot drove: the scans alone there"),
        ("missing", "no-odometry", "no odometry was recorded while the robot moved: the scans alone there"),
    ):
        spans = [(s.begin, s.end) for s in seen if s.kind == kind and s.named and s.begin < stamps[-1]]
        count = len(spans)
        if kind in ("stale", "missing"):
            count = max(sum(int(((stamps > begin) & (stamps <= end)).sum()) for begin, end in spans), 1)
        if spans:
            issues.append(Issue(code, f"{when(spans)}: {text}", count))
    return tuple(issues)


def lapses(
    path: OdometryPath,
    odometry: Array,
    lidar: LidarStream,
    mount: LidarSpec,
    config: SyncConfig,
    *,
    counted: bool,
    since: float = -np.inf,
) -> Lapses:
    """Where the odometry, [n, 3] at the scans, did not measure.

    It is causal: what is said of a scan follows from it, and from the reading after. Wheel counters (``counted``) do
    not say which way a robot took in a gap, but poses do. Lapses that end before ``since`` are not asked for [s].
    """
    stamps = lidar.stamps
    readings = path if lidar.odometry is None else OdometryPath(stamps, odometry)
    jumped = jumps(stamps, odometry, config, since)
    if lidar.odometry is None:
        leaps = jumps(readings.stamps, readings.poses, config, since)
        if path.by_wheels is not None:  # the gyro's turns hide what the counters say
            leaps = leaps | jumps(readings.stamps, path.by_wheels, config, since)
        for k in np.flatnonzero(leaps).tolist():
            over = _over(stamps, readings.stamps[k - 1], readings.stamps[k])
            jumped[over] = True
    unmeasured, motions, left = jumped.copy(), dict[int, Array](), dict[int, Open]()
    seen, fan = list[Lapse](), None
    gapped = np.flatnonzero(gaps(readings.stamps, since)).tolist()
    recent = readings.poses[max(int(np.searchsorted(readings.stamps, since)) - 2, 0) :, :2]
    stands = (np.abs(recent[1:] - recent[:-1]) < 2 * STILL).all(axis=1).any()
    if not gapped and not stands:  # most often
        return Lapses(jumped, jumped, motions, left, ())
    steps = _Steps(readings)
    for k in gapped:
        begin, end = float(readings.stamps[k - 1]), float(readings.stamps[k])
        over = _over(stamps, begin, end)
        if not len(over):
            continue
        before, after = readings.poses[k - 1 : k + 1]  # at 0 odometry begins
        anew = not counted and bool(np.abs(after).max() < ANEW and np.hypot(*before[:2]) > ELSEWHERE)
        lost = steps.lost(k)
        inside = (stamps[over] > begin) & (stamps[over] < end)
        if inside.sum() > 2:  # the scans go on
            if lost or steps.exceeds(k, turning=True):  # when it moved is open
                unmeasured[over] = True
                seen.append(Lapse("stale" if lost else "missing", begin, end))
            continue
        longest = int(over[np.argmax(np.diff(stamps)[over - 1])])
        if anew or lost or steps.exceeds(k, turning=False):
            poses = lidar.odometry
            is_held = poses is not None and (
                np.array_equal(poses[longest], poses[longest - 1])
                or not np.array_equal(poses[longest], odometry[longest])  # that of a reading before the gap
            )
            seen.append(Lapse("anew" if anew else "held" if is_held else "gap", begin, end))
        jumped[over] = False
        if anew:
            motions[longest], left[longest] = np.zeros(3), Open(ANYWHERE, math.pi / math.sqrt(3), ANYWHERE)
        elif lost:
            motions[longest], left[longest] = steps.extrapolated(k)
        elif counted:
            moved = se2.between(odometry[longest - 1], odometry[longest])
            motions[longest], left[longest] = np.asarray(moved), steps.bounded(k)
        unmeasured[over] = lost or anew
        unmeasured[longest] = longest in left
    for first, sure, last in steps.standstills(since):
        scans = np.flatnonzero((stamps > readings.stamps[first]) & (stamps < readings.stamps[last]))
        if len(scans) < LEAST_SCANS:
            continue
        fan = fan or ComparedBeams(lidar, mount)
        found = _stale(steps, first, last, lidar, fan)
        seen.append(found)
        over = _over(stamps, float(readings.stamps[sure - 1]), found.end)
        unmeasured[over[over >= scans[LEAST_SCANS - 1]]] = True
    unmeasured |= jumped
    return Lapses(unmeasured, jumped, motions, left, tuple(seen))


def _over(stamps: Array, begin: float, end: float) -> NDArray[np.intp]:
    """The scans whose motion since the one before is not all before or after this time."""
    return np.flatnonzero((stamps[1:] > begin) & (stamps[:-1] < end)) + 1


def _stale(steps: _Steps, first: int, last: int, lidar: LidarStream, fan: ComparedBeams) -> Lapse:
    """The lapse of odometry that stops dead; it ends where the scans say that the robot stands."""
    stamps, speed = steps.stamps, steps.rate(steps.lengths, first, late=True)
    begin, end = float(stamps[first]), float(stamps[min(last + 1, len(stamps) - 1)])
    since = max(int(np.searchsorted(lidar.stamps, begin, side="right")) - 1, 0)
    confirmed = last + 1 < len(stamps) and steps.lengths[last + 1] > CAUGHT_UP * speed * steps.seconds[last + 1]
    for far in np.arange(APART, FARTHEST + 1e-9, APART):
        scan = int(np.searchsorted(lidar.stamps, begin + far / speed))
        if scan >= len(lidar) or lidar.stamps[scan] >= end:
            break
        turn = float(se2.wrap(steps.heading(float(lidar.stamps[scan])) - steps.heading(float(lidar.stamps[since]))))
        going = np.array((speed * (lidar.stamps[scan] - lidar.stamps[since]), 0.0, turn))
        some = np.asarray(lidar.ranges[np.array((since, scan))])[:, fan.beams]
        travel, stand, _ = (int(flags.sum()) for flags in compare_scans(fan, some, np.vstack((np.zeros(3), going))))
        if travel >= BEAMS and stand <= travel / 4:
            return Lapse("stale", begin, float(lidar.stamps[scan]), named=False)
        if stand >= BEAMS and travel <= stand / 4:
            confirmed = True
            break
    return Lapse("stale", begin, end, named=bool(confirmed))


class _Steps:
    def __init__(self, path: OdometryPath) -> None:
        self.stamps, self._path = path.stamps, path  # [m] of the readings; of the step to each, the first 0:
        moved = np.asarray(se2.between(path.poses[:-1], path.poses[1:]))
        self.seconds = np.diff(path.stamps, prepend=path.stamps[:1])
        self.lengths = np.concatenate(([0.0], np.hypot(moved[:, 0], moved[:, 1])))  # [m]
        self.turns = np.concatenate(([0.0], moved[:, 2]))  # [rad]
        self._forward = np.concatenate(([1.0], np.where(moved[:, 0] < 0, -1.0, 1.0)))
        self._still = self.lengths < STILL

    def heading(self, stamp: float) -> float:
        """By the odometry [rad]."""
        return float(self._path.at(np.array([stamp]))[0, 2])

    def rate(self, values: Array, k: int, *, late: bool = False) -> float:
        """Of the steps' values at reading k, to a second, the mean of ``BEFORE``; with ``late`` of the last two steps,
        if that is less.
        """
        first = min(int(np.searchsorted(self.stamps, self.stamps[k] - BEFORE, side="right")), k)
        seconds = float(self.seconds[first : k + 1].sum())
        if seconds <= 0 or k == 0:
            return 0.0
        mean = float(values[first : k + 1].sum()) / seconds
        last = slice(max(k - 1, 1), k + 1)  # two, since stamps come in bursts
        return min(mean, float(values[last].sum()) / max(float(self.seconds[last].sum()), 1e-9)) if late else mean

    def travelled(self, k: int) -> float:
        """The length of step k along an arc [m]."""
        return float(self.lengths[k] / max(abs(np.sinc(self.turns[k] / (2 * np.pi))), 0.1))

    def exceeds(self, k: int, *, turning: bool) -> bool:
        """Whether step k is clearly longer, or turns by more, than the latest before it, their 90th percentile."""
        most = CAUGHT_UP * self.usual(k, self.turns) + LEAST_STOPPED if turning else np.inf
        return bool(abs(self.turns[k]) > most or self.travelled(k) > CAUGHT_UP * self.usual(k))

    def usual(self, k: int, of: Array | None = None) -> float:
        """The 90th percentile of the latest steps before step k [m]; of their turns [rad]."""
        return float(np.percentile(abs((self.lengths if of is None else of)[max(0, k - LATEST) : k]), 90)) if k else 0

    def lost(self, k: int) -> bool:
        """Whether step k is shorter than braking takes, on the way or in a turn: its motion was not counted."""
        speed, seconds = self.rate(self.lengths, k - 1), float(self.seconds[k])
        braking = min(speed / USUAL, seconds)
        least = speed * braking - USUAL * braking**2 / 2
        if least > LEAST_STOPPED and self.travelled(k) < least:
            return True
        rate = max(self.rate(self.turns * np.sign(self.turns[k - 1]), k - 1, late=True), 0.0)  # it turns on the spot
        least = rate * min(rate / TURN_USUAL, seconds) / 2
        stopped = least > LEAST_TURN and abs(float(self.turns[k])) < least
        return bool(stopped and self.travelled(k) <= CAUGHT_UP * self.usual(k))

    def bounded(self, k: int) -> Open:
        """What counters leave open of a step over a gap: its length is known, and how far it turned, not when.

        For a turn at any time the place deviates, on either axis, by the length times the turn over the square root of
        12. A robot that turned aside and back may be anywhere within the length.
        """
        length, turn = self.travelled(k), min(abs(float(self.turns[k])), 1.0)
        place, arc = length * min(TURNS * float(self.seconds[k]) / 2, 1.0) / 3, length * (WEAVES + turn / math.sqrt(12))
        return Open(max(place, arc), CURVATURE * length, arc)

    def extrapolated(self, k: int) -> tuple[Array, Open]:
        """A step over a gap not counted: with the speed from before, ever less in its direction.

        As if the heading on the way were anything up to what the robot can have turned by: the mean of its cosine.
        """
        speed, seconds = self.rate(self.lengths, k - 1), float(self.seconds[k])
        widest = min(TURNS * seconds / 2, math.pi)
        length, ahead = speed * seconds, math.sin(widest) / widest
        turns = self.turns[max(k - 2, 0) : k].sum() / max(float(self.seconds[max(k - 2, 0) : k].sum()), 1e-9)
        turn = float(np.clip(turns, -TURNS, TURNS)) * min(seconds, BEFORE)
        mean = length * ahead * float(self._forward[k - 1])
        moved = np.array((mean * math.cos(turn / 2), mean * math.sin(turn / 2), turn))
        heading = min(widest, math.pi / math.sqrt(3))
        recent = slice(max(0, k - LATEST), k)  # one that turns on the spot drives on, as fast as it usually does
        fast = max(speed, self.usual(k) * (len(self.seconds[recent]) / max(float(self.seconds[recent].sum()), 1e-9)))
        place = fast * seconds * min(heading, 1.0) / 3
        return moved, Open(place, heading, place)

    def standstills(self, since: float) -> Iterator[tuple[int, int, int]]:
        """Where the odometry has stopped dead, harder than a robot brakes, and goes on at a stamp or later [s].

        That is the reading from which on it stands still, the one at which that is sure, and the last that does.
        """
        smallest = np.minimum.accumulate(np.where(self._still, np.inf, self.lengths))
        edges = np.flatnonzero(np.diff(np.concatenate(([False], self._still, [False])).astype(np.int8)))
        for begin, end in edges.reshape(-1, 2).tolist():
            first, last = begin - 1, end - 1
            if self.stamps[min(end, len(self.stamps) - 1)] < since:
                continue
            speed = self.rate(self.lengths, first, late=True) if first > 0 else 0.0
            if speed <= 0:
                continue
            braking = np.minimum(speed / HARDEST, self.stamps[begin:end] - self.stamps[first])
            least = speed * braking - HARDEST * braking**2 / 2
            sure = least > max(LEAST_STOPPED, RESOLVED * float(smallest[first]))
            if sure.any():
                yield first, begin + int(sure.argmax()), last
