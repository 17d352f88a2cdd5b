"""Pairs of scans all over a recording, registered, and the scale of the angles at which they fit best."""

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.se2 import Array
from moteslam.slam.calibration.hand_eye import Pairs
from moteslam.slam.calibration.parts import Change, clearest_change, parts_of
from moteslam.slam.calibration.scan_pairs import LEAST_FIT, Beams, cost, refine, register, seen_through
from moteslam.slam.calibration.unmeasured import FEWEST, UnfitScansError, turned_round
from moteslam.slam.inputs.odometry_path import OdometryPath
from moteslam.slam.inputs.synchronise import sweep_seconds

Indices = NDArray[np.intp]

MOTION, SHORTEST, LONGEST = (0.5, 0.4), 0.3, 2.0
"""A pair is about this far apart [m], or turned [rad], and apart from at least to at most this long [s]."""
GOOD = 0.75
"""A smaller share of the pairs that are registered says nothing."""
BEAMS = 360
"""Of a scan, about."""
TURNS = (0.0, -0.3, 0.3)
"""Turns that the registration of a pair begins with, one after the other [rad]."""
ROUNDS = 8
"""Of the scale of the angles, at most."""
OFFSET = 0.1
"""Prior standard deviation of a common offset of the ranges [m]; it would pass for a scale of the angles."""
ANGLE_FLOOR, OFFSET_FLOOR, NOISY = 0.0015, 0.004, 1.5
"""The standard deviations of that scale, and of the offset [m], are no smaller; nor is the latter than ``NOISY`` times
the usual residual: noise that grows with the range biases it, by 0.015 m of ranges that are off by 0.1 m at 1 %."""
ORDER = 5.0
"""Standard errors by which scans fit better in one reading, of the beams in one order in time, say: then that is it."""
SWEEP, SLOWEST, LEAST_OFF, BACK = 0.02, 2.0, 0.25, 0.1
"""A sweep that is off by less than the first moves no result by a tenth of a metre, and no lidar takes as long for one
as the second: stamps are in other units [s]. A smaller share of the stated one, or of the scans' interval, may be an
error of the odometry's turns; one below 0 by more than the last is in another order."""
LEAST_DEVIATION = 0.003
"""Pairs do not count more than those of residuals of this size [m]."""
LEAST_COST = 1e-4
"""A pair costs no less [m]: all endpoints in one place fit, too."""
THROUGH, LEAST_THROUGH = 0.3, 0.01
"""Endpoints are no surfaces that are seen through in a larger share than the first: the excess is at least the second
share of all that could be, and at most 0.0003 in sound recordings."""
MANY_PARTS = 1.7
"""It is seen in three of the `BLOCKS` parts of the recording, at least: a door that is opened is seen in one."""
UNEVEN, UNEVEN_SIGMAS = 0.015, 3.0
"""Angles are uneven where those of a sector are of a scale that differs by more from all, and by so many deviations: of
sound lidars by 0.006 at most."""
SCALES = 1.1 ** np.arange(-8, 9)
"""Scales of the angles between beams that are tried, from less than half to more than twice, ..."""
SOME = 60
"""... with as many pairs."""
TURNING = 0.05
"""Scans whose turns deviate by less show nothing of odometry [rad]."""
BESIDE, MOSTLY = 0.26, 0.5
"""A side of the robot is seen within this angle of the side on [rad], as a fan of 180 degrees may be wrong by as much,
in more than this share of the scans."""
OPPOSITE, AGAINST, SEVERAL = 0.8, 0.05, 10
"""Turns by scans times those by the odometry are of one sign in a part and of the other elsewhere, by the first share
of all; either has the second, and the part so many pairs."""
LINE, BENT = 0.03, 1.2
"""Endpoints lie on a line that is as near as the nearest, by this share of that, at angles of which so many [rad] apart
are tried; and on no arc if they do more often by the second factor."""


class RegisteredPairs:
    def __init__(self, recording: Recording, lidar: LidarStream, before: Indices, after: Indices) -> None:
        total, sweep = lidar.ranges.shape[1], sweep_seconds(recording, lidar)
        # [k] times of the scans, in the middle of their sweeps [s]
        self.first, self.last = lidar.stamps[before] + sweep / 2, lidar.stamps[after] + sweep / 2
        self._seconds = self.last - self.first
        self._scans = before, after
        beams = np.arange(0, total, max(1, round(total / BEAMS)))
        self._beams = Beams(lidar.angles[beams], beams / max(total - 1, 1), sweep)
        scans = np.unique(np.concatenate((before, after)))
        ranges = np.asarray(lidar.ranges[scans], np.float64)[:, beams]
        ranges[~np.isfinite(ranges)] = np.nan
        self._ranges = ranges[np.searchsorted(scans, before)], ranges[np.searchsorted(scans, after)]
        self._found = register(*self._ranges, self._beams, self._seconds, TURNS)

    @property
    def costs(self) -> Array:
        """[k] Of all pairs the logarithm of what they cost: the less, the better they fit."""
        return np.asarray(np.log(np.maximum(cost(self._found), LEAST_COST)))

    def fits_better(self, other: Self) -> bool | None:
        """Whether the pairs clearly fit better than they do in another reading, or clearly worse; None if neither."""
        return _clearly_above_zero(other.costs - self.costs)

    def expect(self, share: float) -> None:
        """Raise ``UnfitScansError`` unless enough pairs are registered, and this share of all."""
        good, total = int(self._found.good.sum()), len(self._seconds)
        if good < FEWEST or good < share * total:
            text = f"lidar: {good} of {total} pairs of scans fit each other, and no more with other angles between "
            text += "beams: angles, unit of ranges or what stands for no return are other ones, or scans are too far "
            text += "apart, or show thin things, glass or next to nothing. They cannot be held against the odometry, "
            text += "and a map of them may be wrong"
            raise UnfitScansError("scans-unfit", text, float((self._found.fit > LEAST_FIT).mean()))

    def expect_one_way(self, path: OdometryPath, wrong: Callable[[Pairs], str]) -> None:
        """Raise ``UnmeasuredError`` where scans turn against the odometry for a time; ``wrong`` says which is, then."""
        pairs, headings = self.pairs, np.unwrap(path.poses[:, 2])
        order = np.argsort(pairs.first)
        first, last = (np.interp(stamps[order], path.stamps, headings) for stamps in (pairs.first, pairs.last))
        alike = pairs.motions[order, 2] * (last - first)
        until, total = np.append(0.0, np.cumsum(alike)), float(np.abs(alike).sum())
        gains = np.maximum.accumulate(until) - until  # by what turns against it, from wherever that begins
        end = int(gains.argmax())
        begin, against = int(until[: end + 1].argmax()), float(gains[end])
        clear = until[-1] + 2 * against > OPPOSITE * total and end - begin >= SEVERAL
        if clear and min(against, until[-1] + against) > AGAINST * total:
            time = [f"from about {pairs.first[order[begin]]:.0f} s on"] if until[begin] > AGAINST * total else []
            if until[-1] - until[end] > AGAINST * total:
                time.append(f"until about {pairs.last[order[end - 1]]:.0f} s")
            turned_round(wrong(Pairs(*(each[order[begin:end]] for each in pairs))), " and ".join(time))

    @property
    def pairs(self) -> Pairs:
        good = self._found.good
        return Pairs(self.first[good], self.last[good], self._found.motions[good], self._found.covariances[good])

    def sees_both_sides(self, yaw: float) -> bool:
        """Whether there mostly is an endpoint to the left and to the right of the robot, of a lidar turned by yaw."""
        bearings, known = yaw + self._stated.angles, np.isfinite(self._ranges[0])
        sides = [known[:, np.abs(se2.wrap(bearings - side)) < BESIDE] for side in (np.pi / 2, -np.pi / 2)]
        return all(side.shape[1] and side.any(axis=1).mean() > MOSTLY for side in sides)

    def stated(self) -> Self:
        """The same with the angles as they were before ``scale_angles``."""
        other = copy(self)
        other._beams = self._stated
        other.refine(self._found.motions, anew=True)
        return other

    def refine(self, motions: Array, rates: tuple[Array, Array] | None = None, *, anew: bool = False) -> None:
        """Register from motions [k, 3], ``rates`` as of ``mirror``; unless it is done anew, keep what fits better."""
        found = None if anew else self._found
        self._found = refine(*self._ranges, self._beams, self._seconds, motions, found, rates=rates)

    def no_surfaces_beyond(self) -> float | None:
        """From which range on [m] endpoints clearly are no surfaces: from nearer the lidar sees through them.

        It does through people who have gone on, and panes, but hardly through those that are farthest off. Negative
        where these mostly lie on one straight line in the lidar's frame, as floor before one that is tilted.
        """
        there = self._found.motions
        ranges, bearings, through, pairs = list[Array](), list[Array](), list[Array](), list[Indices]()
        for scans, motions in ((self._ranges, there), (self._ranges[::-1], np.asarray(se2.inverse(there)))):
            nearer, passed = seen_through(*scans, self._beams, self._seconds, motions)
            nearer &= self._found.good[:, None]
            ranges.append(scans[1][nearer])
            bearings.append(np.broadcast_to(self._beams.angles, nearer.shape)[nearer])
            through.append(np.where(passed[nearer], 1 - THROUGH, -THROUGH))
            pairs.append(np.nonzero(nearer)[0])
        order = np.argsort(-(all_ranges := np.concatenate(ranges)))
        beyond = np.cumsum(np.concatenate(through)[order])  # of an endpoint and those that are farther
        most = int(beyond.argmax()) if len(beyond) else 0
        far = order[: most + 1]
        of_pairs = np.bincount(np.concatenate(pairs)[far], np.concatenate(through)[far], minlength=len(there))
        chance = MANY_PARTS * float(np.linalg.norm(parts_of(np.asarray(of_pairs, np.float64))))
        clear = len(beyond) and beyond[most] > max(LEAST_THROUGH * len(beyond), chance)
        if not clear:
            return None
        limit, none = float(all_ranges[far[-1]]), far[np.concatenate(through)[far] > 0]
        before = all_ranges[none] * np.cos(np.concatenate(bearings)[none] - np.arange(0, 2 * np.pi, LINE)[:, None])
        line, arc = ((np.abs(off - limit) < LINE * limit).mean(axis=-1).max() for off in (before, all_ranges[none]))
        return -limit if line > max(MOSTLY, BENT * arc) else limit

    def mirror(self, lidar: LidarStream, rates: tuple[Array, Array]) -> bool | None:
        """Take the beams the other way round; whether they are measured in the other order, too.

        The wrong order bends a scan by as much as the robot turns in its sweep. Where it turns evenly both scans of a
        pair are bent alike, and fit; each is straightened by its own turn, so that those of unlike turns tell.

        ``rates``: [k] at which the robot turns during the former sweeps and during the latter ones [rad/s].

        Returns None where the scans fit alike; then the order is taken for right.
        """
        beams, motions = self._beams, self._found.motions * (1, -1, -1)
        turned = beams._replace(angles=-beams.angles)
        backwards = beams._replace(angles=lidar.angles[0] + lidar.angles[-1] - beams.angles, shares=1 - beams.shares)
        is_reversed: bool | None = False
        if beams.sweep > 0:
            readings = turned, backwards
            as_is, new = (refine(*self._ranges, each, self._seconds, motions, rates=rates) for each in readings)
            both = as_is.good & new.good
            is_reversed = _clearly_above_zero(np.log(cost(as_is)[both] / cost(new)[both]))
        self._beams = backwards if is_reversed else turned
        self.refine(motions, anew=True)
        return is_reversed

    def sweep_taken(self, recording: Recording, lidar: LidarStream, rates: tuple[Array, Array]) -> float | None:
        """How long a sweep takes by the scans [s] where that clearly is not as stated, or none is stated; below 0 where
        beams are measured in another order.

        By how much more the lidar turns in the latter sweep of a pair than in the former bends their scans apart. It is
        regressed on ``rates`` as of ``mirror``, whose errors would pass for a shorter sweep: those by the scans beside
        each, with errors of their own, are the instrument.
        """
        share, free, deviation, stated, as_is = 1.0, 1.0, 0.0, self._beams.sweep, self._found
        period = float(np.median(np.diff(lidar.stamps)))
        sweep = stated or period
        if max(sweep, period) < SWEEP:
            return None
        beside = [np.clip(scans, 1, len(lidar) - 2) for scans in self._scans]
        own = [RegisteredPairs(recording, lidar, scans - 1, scans + 1) for scans in beside]
        former, latter = (each._found.motions[:, 2] / each._seconds for each in own)
        known = own[0]._found.good & own[1]._found.good
        for _ in range(ROUNDS):
            beams = self._beams._replace(sweep=share * sweep)
            found = refine(*self._ranges, beams, self._seconds, self._found.motions, rates=rates)
            as_is = found if share == 1 else as_is
            use = known & found.good
            if use.sum() < FEWEST:
                return None
            by = (latter - former)[use] / np.maximum(found.deviation[use], LEAST_DEVIATION) ** 2
            slope = by * found.gradients[use, -1]
            about = by * found.about_warps[use, -1, -1] * sweep * (rates[1] - rates[0])[use]
            step = -float(slope.sum() / about.sum())
            deviation = float(np.linalg.norm(parts_of(slope + step * about)) / abs(about.sum()))
            before, free = share, share + step
            share = float(np.clip(free, 0.0, max(1.0, 1.1 * period / sweep)))  # it ends before the next begins
            if abs(share - before) < 0.02:
                break
        if free < -max(BACK, ORDER * deviation, SWEEP / sweep):
            return free * sweep
        both = as_is.good & found.good
        better = _clearly_above_zero(np.log(cost(as_is)[both] / cost(found)[both]))
        off = abs(1 - share) if stated else share
        clearly = off > max(LEAST_OFF, ORDER * deviation, SWEEP / sweep)
        borne_out = better or not stated or (share > 1 and better is None)  # motions take up what a short one leaves
        return share * sweep if clearly and borne_out and share * sweep < SLOWEST else None

    def scale_angles(self) -> tuple[float, float, tuple[float, float]]:
        """The scale of the angles between beams at which the scans fit each other best, and its deviation.

        And by how much all ranges are too long, with the deviation of that [m].

        Gauss-Newton of what all pairs have in common, this scale and an offset of the ranges; a scale that differs
        between the sectors of the fan adds to the deviation, and the pairs are registered again after each step; one
        that clearly does raises ``UnfitScansError``.
        """
        self._stated = self._beams
        scale, offset, deviation, stated = 1.0, 0.0, 1.0, self._beams.angles
        for _ in range(ROUNDS):
            good = self._found.good
            weight = 1 / np.maximum(self._found.deviation[good], LEAST_DEVIATION) ** 2
            gradient = self._found.gradients[good][:, :-1] * weight[:, None]
            about = np.einsum("kvw,k->vw", self._found.about_warps[good][:, :-1, :-1], weight)
            about[0, 0] += 1 / OFFSET**2
            slope = gradient.sum(axis=0)
            slope[0] += offset / OFFSET**2
            both = np.zeros((len(about), 2))
            both[0, 0], both[1:, 1] = 1.0, 1.0
            inverse = np.linalg.inv(both.T @ about @ both + 1e-6 * np.eye(2))
            shift, step = np.clip(-inverse @ (slope @ both), -0.1, 0.1)
            parts = parts_of(gradient @ both)
            each = np.linalg.inv(about + 1e-6 * np.eye(len(about)))[1:]
            sectors, of_parts = -each @ slope, parts_of(gradient) @ each.T
            about_offset, spread = np.sqrt((inverse @ (parts.T @ parts) @ inverse).diagonal())
            deviation = float(np.linalg.norm((spread, sectors.std() / np.sqrt(len(sectors)), ANGLE_FLOOR)))
            scale, offset = scale * (1 + step), offset + shift
            if abs(step) < 0.002 and abs(shift) < 0.003:
                break
            self._beams = self._beams._replace(angles=stated[0] + scale * (stated - stated[0]))
            self._ranges = self._ranges[0] + shift, self._ranges[1] + shift
            self.refine(self._found.motions, anew=True)
        off, about_off = (np.abs(of - of.mean(axis=-1, keepdims=True)) for of in (sectors, of_parts))
        if ((off > UNEVEN) & (off > UNEVEN_SIGMAS * np.linalg.norm(about_off, axis=0))).any():
            text = f"lidar: angles between beams are not even, by {100 * np.ptp(sectors):.0f} % over a quarter of the "
            text += "fan: of a disc off its axis, a motor that wobbles, or columns of a camera? Walls are bent, and "
            text += "turns wrong: give each beam its own angle before it is laid on an even fan"
            raise UnfitScansError("lidar-angles", text)
        noise = float(np.median(self._found.deviation[self._found.good]))
        return float(scale), deviation, (-float(offset), max(float(about_offset), OFFSET_FLOOR, NOISY * noise))

    def change_of_offset(self, deviation: float) -> Change:
        """Where in the recording the ranges become longer or shorter than before most clearly, and by how much [m].

        A step of Gauss-Newton from what all pairs have in common, known to a deviation [m]: of larger changes it finds
        a part.
        """
        good = self._found.good
        weight = 1 / np.maximum(self._found.deviation[good], LEAST_DEVIATION) ** 2
        slope, about = self._found.gradients[good][:, 0] * weight, self._found.about_warps[good][:, 0, 0] * weight

        def excess(some: NDArray[np.bool_]) -> tuple[float, float]:
            total = max(float(about[some].sum()), 1e-9)
            mean = float(slope[some].sum()) / total
            spread = float(np.linalg.norm(parts_of(slope[some] - mean * about[some]))) / total
            return mean, float(np.hypot(spread, deviation / 2 / np.sqrt(total / about.sum())))

        return clearest_change(self.first[good], excess)


def _clearly_above_zero(values: Array) -> bool | None:
    """Whether the mean of some values [k] is, or else below; None where they are few, or neither is clear."""
    certain = len(values) >= FEWEST and abs(values.mean()) > ORDER * values.std() / np.sqrt(len(values))
    return bool(values.mean() > 0) if certain else None


def best_scale(recording: Recording, lidar: LidarStream, before: Indices, after: Indices) -> float:
    """Of `SCALES` that of the angles at which some of the pairs fit best.

    The cost has a narrow minimum, and others beside it, where Gauss-Newton ends that begins far off.
    """
    some = np.unique(np.linspace(0, len(before) - 1, SOME).astype(np.intp))
    whole = abs(lidar.angle_increment) * (lidar.ranges.shape[1] - 1.5)  # round once at most

    def cost_at(scale: float) -> float:
        scaled = replace(lidar, angle_increment=scale * lidar.angle_increment)
        return float(RegisteredPairs(recording, scaled, before[some], after[some]).costs.mean())

    return float(min(SCALES[(SCALES * whole < 2 * np.pi) | (SCALES == 1)].tolist(), key=cost_at))


def choose_pairs(lidar: LidarStream, odometry: Array, count: int, far: float = 1.0) -> tuple[Indices, Indices]:
    """Pairs of scans all over a recording: a third of them evenly by scans, by the way, and by turns of the odometry.

    Those by odometry begin a scan after the step that they are chosen by, or before: its noise is in none of them.
    ``far`` is how far apart a pair is, over `MOTION`.
    """
    stamps, n = lidar.stamps, len(lidar)
    motion, seconds = np.abs(se2.between(odometry[:-1], odometry[1:])), np.diff(stamps)
    size = (np.hypot(motion[:, 0], motion[:, 1]) / MOTION[0] + motion[:, 2] / MOTION[1]) / far
    moving = size > 0.1 * np.percentile(size, 90)
    span, usual = LONGEST, 1.0
    if moving.any():
        usual = float(np.median(size[moving]))
        rate = float(np.median(size[moving] / np.maximum(seconds[moving], 1e-3)))
        span = min(max(1 / rate, SHORTEST), LONGEST * far)
    evenly = (np.arange(count // 3) + 0.5) / (count // 3)
    beside = np.where(np.arange(count // 3) % 2, 1, -1)
    begins = [evenly * (n - 1)]
    for step in (np.minimum(size, 5 * usual), np.minimum(motion[:, 2], np.pi / 4)):
        way = np.concatenate(([0.0], np.cumsum(step)))
        begins.append(np.interp(evenly * way[-1], way, np.arange(n)) + beside)
    first = np.unique(np.clip(np.concatenate(begins), 0, n - 1).astype(np.intp))
    last = np.maximum(np.searchsorted(stamps, stamps[first] + span), first + 1)
    first, last = first[last < n], last[last < n]
    apart = stamps[last] - stamps[first]
    use = (apart > 0) & (apart < 3 * max(span, float(np.median(seconds))))
    return first[use], last[use]
