"""The offset and the rate of a clock by which two drives through one path fit each other best."""

from __future__ import annotations

from math import inf

import numpy as np

from moteslam.eval.metrics.association import Indices, evenly, in_space, nearest_rotation, spatial
from moteslam.eval.tables import length
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.robot.trajectory import FARTHEST, Trajectory

LONGEST, TRIES = 120.0, 1200
"""Offsets up to this are tried [s], of clocks without a common time all, and so many at most."""
STEP, ROUNDS = 0.1, 20
"""The search begins with offsets so far apart [s], and ends with so many steps of Gauss-Newton."""
LEAST, COARSE, FINE = 10, 200, 5000
"""Positions of the reference that are compared at least, in the search, and at its end."""
GAIN, GAIN_METRES, FITS = 0.5, 0.01, 0.1
"""A rate must leave less than this share of what an offset leaves, and the error fall by more than this [m]; without a
common time to less than this share of the spread of the reference."""
SHAPE, DRIFTS = 0.3, 0.1
"""By a clock, arm, scale or sign the error must fall to less than this share, by a clock to less the less of the drives
is left in common; clocks drift by less."""
OVERLAP, ALIKE = 0.6, 1.2
"""Of the shorter drive they must have this share in common; errors that differ by less than this factor are alike: the
smallest offset is taken, clock and arm are both told."""
LATEST, LEAST_SHOWN = 2.0, 0.01
"""With another point of the robot, offsets up to this are found [s], where a step of them moves the estimate by such a
share of what one of the rotation or the point does: at an even speed along a straight line none."""
DENSE = 0.5  # Poses nearer to each other than this [s] are interpolated


def clock_offset(estimate: Trajectory, reference: Trajectory, before: float | None = None) -> tuple[float, str] | None:
    """What is said of an offset or a rate of the estimate's clock that fits much better (``SHAPE``, ``GAIN``), and
    the RMSE [m] after alignment with it; ``before`` is the error to be named, of clocks with a time in common.
    """
    if min(len(estimate), len(reference)) < LEAST:
        return None
    space = in_space(estimate, reference)
    drives = [(one.stamps, spatial(one).positions if space else one.poses[:, :2]) for one in (estimate, reference)]
    if any(np.ptp(stamps) <= 0 or np.abs(path).max() > FARTHEST for stamps, path in drives):
        return None
    swapped = float(np.median(np.diff(drives[0][0]))) > float(np.median(np.diff(drives[1][0])))
    if (found := _offset(_Search(*drives[swapped], *drives[not swapped]))) is None:
        return None
    if before is not None and found[2] > SHAPE * before:  # a sparse reference says more at its own stamps than between
        return None
    seconds, slow, rmse = found if not swapped else (-found[0], -found[1], found[2])
    fits = f"the estimate fits with an ATE of {length(rmse)}{f' in place of {length(before)}' if before else ''}"
    if slow:
        rate = f"{100 * abs(slow):.2f} % {'slow' if slow > 0 else 'fast'}"
        return rmse, f"{fits} if its clock runs {rate}: the stamps of one are to be scaled, or they are two drives"
    option = shifting(f"{seconds:.3f}")
    if before is not None and not (estimate.oriented or reference.oriented):
        option += ", or this is a point of the robot ahead of the other's or behind it: no orientations tell"
    return rmse, f"moved by {seconds:+.3f} s {fits}: its clock seems to be another one {option}"


def offset_and_arm(estimate: Trajectory, reference: Trajectory, before: float) -> tuple[float, str] | None:
    """What is said of an offset of the estimate's clock and a point of the robot that together fit best, in the plane,
    and the RMSE [m] after alignment with both; ``before`` is the one without [m].

    Gauss-Newton of ``goal = Q (there(t - offset) + R arm)`` over rotation, arm and offset.
    """
    begin, end = estimate.stamps[[0, -1]] + (LATEST, -LATEST)
    keep = evenly(np.flatnonzero((reference.stamps >= begin) & (reference.stamps <= end)), FINE)
    if not estimate.oriented or len(keep) < LEAST or before < GAIN_METRES:
        return None
    at, goal = reference.stamps[keep], reference.poses[keep, :2] - reference.poses[keep, :2].mean(axis=0)
    size, offset, arm, best = float(goal.std(axis=0).max()), 0.0, np.zeros(2), (inf, 0.0, np.zeros(2))
    if size < GAIN_METRES or max(np.abs(one.poses).max() for one in (estimate, reference)) > FARTHEST:
        return None

    def points(times: Array) -> tuple[Array, Array]:
        """Where the point is at times [k, 2], and the axes of the body there [2, k, 2]."""
        x, y, heading = se2.interpolate(estimate.stamps, estimate.poses, times).T
        cos, sin = np.cos(heading), np.sin(heading)
        axes = np.stack((np.column_stack((cos, sin)), np.column_stack((-sin, cos))))
        return np.column_stack((x, y)) + arm @ axes.swapaxes(0, 1), axes

    for _ in range(ROUNDS):
        (there, axes), *beside = (points(at - offset + by) for by in (0.0, -STEP / 2, STEP / 2))
        turn, _ = nearest_rotation(goal.T @ (there - there.mean(axis=0)))
        moved = (there - there.mean(axis=0)) @ turn.T
        best = min(best, (rmse_of(goal - moved), offset, arm), key=lambda one: one[0])
        back = (beside[0][0] - beside[1][0]) / STEP @ turn.T
        design = np.stack((moved[:, ::-1] * (-1, 1) / size, *(axes @ turn.T), back))
        design -= design.mean(axis=1, keepdims=True)
        step = np.linalg.lstsq(design.reshape(len(design), -1).T, (goal - moved).ravel(), rcond=LEAST_SHOWN)[0]
        arm, offset = arm + step[1:3], offset + float(step[3])
        if abs(offset) > LATEST:
            break
    rmse, offset, (x, y) = best
    if np.hypot(x, y) < GAIN_METRES:  # no other point, and of a clock alone ``clock_offset`` says more
        return None
    text = f"moved by {offset:+.3f} s, the point at x {x:.3f} m, y {y:.3f} m on the robot fits with an ATE of "
    text += f"{length(rmse)} in place of {length(before)}: is the reference of another clock, and of another "
    return rmse, f"{text}point? (evaluate --time-offset {offset:.3f} --est-offset {x:.3f} {y:.3f} 0)"


def shifting(seconds: str) -> str:
    """What to do where the clock of an estimate is another one."""
    return f"(shift the estimate's stamps, in its file or by evaluate --time-offset {seconds})"


def _offset(search: _Search) -> tuple[float, float, float] | None:
    """The offset [s] to add, by what share the clock is slow, and the RMSE [m]."""
    before, middle, reach = float("nan"), float(search.times[0] - search.stamps[0]), search.longer  # may begin before
    if search.common(0.0) > 0:
        before, middle, reach = search.rmse(0.0, FINE), 0.0, min(LONGEST, search.shorter)
    if before < GAIN_METRES:
        return None
    step = max(STEP, 2 * reach / TRIES)
    offsets = middle + step * np.arange(-np.floor(reach / step), np.floor(reach / step) + 1)
    errors = np.array([search.rmse(float(offset), COARSE) for offset in offsets])
    if not np.isfinite(errors).any():
        return None
    good = offsets[errors <= ALIKE * np.nanmin(errors) + 1e-9]
    nearest = np.abs(offsets - good[np.argmin(np.abs(good - middle))]) <= 5 * step
    best = float(offsets[nearest][np.nanargmin(errors[nearest])])
    best, _, rmse = search.fitted(best, drifts=False)
    share = (search.common(best) / search.shorter - OVERLAP) / (1 - OVERLAP)
    if np.isnan(before):  # hardly a time in common
        fits = rmse < FITS * search.spread * share and rmse + GAIN_METRES < search.spread
        return (best, 0.0, rmse) if fits else None
    # parts that are left out by an offset, as where a run got lost, are no reason for one: in laps any lap fits
    begin, end = max(search.at[0], search.stamps[0] + best), min(search.at[-1], search.stamps[-1] + best)
    parts = (begin, end), (begin - best, end - best)  # of either drive
    before = float(np.nanmin([before, *(search.rmse(0.0, FINE, part) for part in parts)]))
    start, slow, left = search.fitted(0.0 if before < rmse else best, drifts=True)
    if left < min(GAIN * rmse, SHAPE * before) and rmse - left > GAIN_METRES and abs(slow) < DRIFTS:
        return (start, slow, left) if left < GAIN * min(map(search.scaled, (0.0, best))) else None
    return (best, 0.0, rmse) if rmse < SHAPE * before * share and before - rmse > GAIN_METRES else None


class _Search:
    """Positions [n, d] and [m, d] of two drives at stamps [n] and, sparser, [m]; an offset is added to the former."""

    def __init__(self, stamps: Array, positions: Array, times: Array, goal: Array) -> None:
        self.stamps, self.positions, self.times = stamps, positions, times
        self.shorter, self.longer = sorted((float(np.ptp(stamps)), float(np.ptp(times))))
        self.spread = float(np.linalg.norm(goal.std(axis=0)))
        self.at, self.there = times, goal
        if float(np.median(np.diff(times))) < DENSE:  # anywhere between: noise is least between poses, at any offset
            at = np.linspace(times[0], times[-1], FINE)
            after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
            self.at = at[times[after] - times[after - 1] < DENSE]
            self.there = _at(self.at, times, goal)
        self.middle = float(self.at.mean())

    def laid(
        self, offset: float, rate: float, most: int, part: tuple[float, float] = (-inf, inf)
    ) -> tuple[Indices, Array, Array] | None:
        """Which positions are compared, what is left of them [k, d] after rigid alignment, and its rotation.

        None where too little of the shorter drive is left, or what is left stands still.
        """
        at = self.at - offset - rate * (self.at - self.middle)
        inside = (at >= max(self.stamps[0], part[0])) & (at <= min(self.stamps[-1], part[1]))
        keep = evenly(np.flatnonzero(inside), most)
        if len(keep) < LEAST or np.ptp(self.at[keep]) < OVERLAP * self.shorter:
            return None
        a, b = _at(at[keep], self.stamps, self.positions), self.there[keep]
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        if np.linalg.norm(b.std(axis=0)) < 0.5 * self.spread:
            return None
        turn, _ = nearest_rotation(b.T @ a)
        return keep, b - a @ turn.T, turn

    def rmse(self, offset: float, most: int, part: tuple[float, float] = (-inf, inf)) -> float:
        """After rigid alignment [m], or NaN."""
        found = self.laid(offset, 0.0, most, part)
        return float("nan") if found is None else rmse_of(found[1])

    def fitted(self, offset: float, *, drifts: bool) -> tuple[float, float, float]:
        """The best offset near one [s], with ``drifts`` the rate of the clock too, and the RMSE [m]; Gauss-Newton."""
        best, rate = (offset, 0.0, inf), 0.0
        for _ in range(ROUNDS):
            if (found := self.laid(offset, rate, FINE)) is None:
                break
            keep, off, turn = found
            best = min(best, (offset, rate, rmse_of(off)), key=lambda one: one[2])
            since = self.at[keep] - self.middle
            times = self.at[keep] - offset - rate * since
            before, after = (_at(times + by, self.stamps, self.positions) for by in (-STEP / 2, STEP / 2))
            back = (before - after) / STEP @ turn.T
            design = np.stack((back, back * since[:, None])[: 1 + drifts])
            design -= design.mean(axis=1, keepdims=True)
            step = np.linalg.lstsq(design.reshape(len(design), -1).T, off.ravel(), rcond=None)[0]
            offset, rate = offset + float(step[0]), rate + (float(step[1]) if drifts else 0.0)
        return best

    def scaled(self, offset: float) -> float:
        """After alignment with a scale [m], or NaN: along a line, at one speed, what the rate of a clock does."""
        if (found := self.laid(offset, 0.0, FINE)) is None:
            return float("nan")
        keep, off, _ = found
        there = self.there[keep] - self.there[keep].mean(axis=0)
        own = there - off
        return rmse_of(there - own * (there * own).sum() / max(float(np.square(own).sum()), 1e-12))

    def common(self, offset: float) -> float:
        """How long both last at an offset [s]; below 0 the gap between them."""
        end, begin = min(self.stamps[-1] + offset, self.times[-1]), max(self.stamps[0] + offset, self.times[0])
        return float(end - begin)


def rmse_of(off: Array) -> float:
    """Of what is left [n, d]."""
    return float(np.sqrt(np.square(off).sum(axis=1).mean()))


def _at(times: Array, stamps: Array, positions: Array) -> Array:
    """Positions [k, d] at times [k] of a drive through positions [n, d] at stamps [n]."""
    return np.column_stack([np.interp(times, stamps, column) for column in positions.T])
