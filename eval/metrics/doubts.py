"""What is doubtful where a trajectory is compared with another one: clocks, units, axes, planes, few partners."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.metrics.association import evenly, in_space, spatial
from moteslam.eval.metrics.ate import AteResult
from moteslam.robot.se2 import transform_points, umeyama
from moteslam.robot.trajectory import FARTHEST, TILT, Trajectory, tilt_of
from moteslam.robot.values import Issue

Array = NDArray[np.float64]

LONGEST, TRIES = 120.0, 1200
"""Offsets up to this are tried [s], of clocks without a common time all, and so many at most."""
STEP, PRECISION = 0.1, 1e-4
"""The search begins with offsets the first apart [s], and ends with the second."""
LEAST, COARSE, FINE = 10, 200, 5000
"""Positions of the reference that are compared at least, in the search, and at its end."""
DENSE = 0.5
"""Poses nearer to each other than this [s] are interpolated."""
GAIN, GAIN_METRES, FITS = 0.5, 0.01, 0.1
"""The error must fall to less than this share of itself, the less the less of the drives is left in common, and by more
than this [m]; without a common time to less than this share of the spread of the reference."""
OVERLAP = 0.6
"""Share of the shorter drive that they must have in common."""
WINDOW, CHORDS = 3.0, 0.7
"""Over this much path [m] the distances moved must differ less, by this factor."""
ALIKE = 1.2
"""Of offsets whose errors differ by less than this factor the smallest is taken."""
SMALL, LARGER = 0.1, 50.0
"""Errors and sizes below this [m], and ratios of sizes below that, are no other unit."""
AXES = np.deg2rad(30.0)
"""Orientations that differ by more than this throughout [rad] are of other axes."""
HEIGHTS = 0.05
"""Heights that are left out are reported where they are spread by more [m]."""
UNLIKE, FEW = 0.5, 0.5
"""Two paths have nothing in common where the error is more than this share of the spread of the reference, and may not
belong together where less than this share of the shorter one's poses has a partner."""


@dataclass(frozen=True)
class ClockOffset:
    """An offset to add to the estimate's stamps [s] that fits much better than none, the RMSE after alignment with it
    [m], and the one before, without it: None where the two have no time in common.
    """

    seconds: float
    rmse: float
    before: float | None

    def __str__(self) -> str:
        instead = "" if self.before is None else f" in place of {self.before:.4f} m"
        fits = f"moved by {self.seconds:+.3f} s the estimate fits with an ATE of {self.rmse:.4f} m{instead}"
        return f"{fits}: its clock seems to be another one (--time-offset {self.seconds:.3f})"


def clock_offset(estimate: Trajectory, reference: Trajectory) -> ClockOffset | None:
    """The offset of the estimate's clock that lays it on its reference best, where it helps much: see ``GAIN``.

    The RMSE after rigid alignment is least there, among offsets that leave most of the shorter drive in common; with
    and without the offset the same positions are compared. The distances moved in some metres of path must fit
    better, too.
    """
    if min(len(estimate), len(reference)) < LEAST:
        return None
    space = in_space(estimate, reference)
    drives = [(one.stamps, spatial(one).positions if space else one.poses[:, :2]) for one in (estimate, reference)]
    if any(np.ptp(stamps) <= 0 or np.abs(path).max() > FARTHEST for stamps, path in drives):
        return None
    swapped = float(np.median(np.diff(drives[0][0]))) > float(np.median(np.diff(drives[1][0])))
    found = _offset(_Search(*drives[swapped], *drives[not swapped]))
    return replace(found, seconds=-found.seconds) if found is not None and swapped else found


def _offset(search: _Search) -> ClockOffset | None:
    common = search.common(0.0) > 0
    if common and search.rmse(0.0, FINE) < GAIN_METRES:
        return None
    middle = 0.0 if common else float(search.times[0] - search.stamps[0])
    reach = min(LONGEST, search.shorter) if common else search.shorter
    if not common:  # the longer one may have begun before
        reach += abs(float(np.ptp(search.times) - np.ptp(search.stamps)))
    step = max(STEP, 2 * reach / TRIES)
    offsets = middle + step * np.arange(-np.floor(reach / step), np.floor(reach / step) + 1)
    errors = search.errors(offsets, COARSE)
    if not np.isfinite(errors).any():
        return None
    good = offsets[errors <= ALIKE * np.nanmin(errors) + 1e-9]
    nearest = np.abs(offsets - good[np.argmin(np.abs(good - middle))]) <= 5 * step
    best = float(offsets[nearest][np.nanargmin(errors[nearest])])
    while step > PRECISION:
        around = best + np.linspace(-step, step, 11)
        errors = search.errors(around, FINE)
        if not np.isfinite(errors).any():
            return None
        best, step = float(around[np.nanargmin(errors)]), step / 5
    rmse, before, after = (search.rmse(at, FINE, also=also) for at, also in ((best, None), (0.0, best), (best, 0.0)))
    share = (search.common(best) / search.shorter - OVERLAP) / (1 - OVERLAP)
    if np.isnan(before):  # hardly a time in common
        fits = rmse < FITS * search.spread * share and rmse + GAIN_METRES < search.spread
        return ClockOffset(best, rmse, None) if fits else None
    much = after < GAIN * before * share and before - after > GAIN_METRES
    # else it is a fit of another shape, not of another time
    if not much or not search.chords(best, also=0.0) < CHORDS * search.chords(0.0, also=best):
        return None
    return ClockOffset(best, rmse, search.rmse(0.0, FINE))


@dataclass(frozen=True)
class LeverArm:
    """Where the reference's point is on the estimate's body, x ahead and y to the left, and the RMSE left [m]."""

    x: float
    y: float
    rmse: float


def lever_arm(ate: AteResult) -> LeverArm | None:
    """The fixed offset on the robot that explains much of the error in the plane, by as much as ``clock_offset``.

    Least squares of ``true - there = e J there + R(theta) arm + t`` over ``e``, ``arm`` and ``t``; J is a quarter turn.
    """
    if ate.motion is not None or ate.rotation_errors is None or ate.rmse < GAIN_METRES:
        return None
    there, true, n = ate.aligned[:, :2], ate.reference[:, :2], len(ate.aligned)
    c, s, one, none = np.cos(ate.aligned[:, 2]), np.sin(ate.aligned[:, 2]), np.ones(n), np.zeros(n)
    x = np.column_stack((-there[:, 1], c, -s, one, none))
    y = np.column_stack((there[:, 0], s, c, none, one))
    design, goal = np.vstack((x, y)), (true - there).T.ravel()
    found, _, rank, _ = np.linalg.lstsq(design, goal, rcond=None)
    rmse = float(np.linalg.norm(goal - design @ found) / np.sqrt(n))
    if rank < design.shape[1] or not (rmse < GAIN * ate.rmse and ate.rmse - rmse > GAIN_METRES):
        return None
    return LeverArm(float(found[1]), float(found[2]), rmse)


def doubts(estimate: Trajectory, reference: Trajectory, ate: AteResult) -> tuple[Issue, ...]:
    """What was assumed when both were read, the space they are compared in, and units and axes that seem other ones."""
    left_out = "out-of-plane" if in_space(estimate, reference) else ""  # it matters in x and y
    issues = [issue for issue in (*estimate.warnings, *reference.warnings) if issue.code != left_out]
    found = (*dict.fromkeys(issues), _of_space(estimate, reference), _of_shape(ate))
    return tuple(issue for issue in found if issue is not None)


def few_matched(matched: int, shorter: int, what: str, question: str) -> tuple[Issue, ...]:
    """The issue that few of the shorter one's stamps have a partner, if they are few."""
    if matched >= FEW * shorter:
        return ()
    return (Issue("few-matched", f"{matched} of {shorter} {what} have a partner: {question}", matched),)


def _of_space(estimate: Trajectory, reference: Trajectory) -> Issue | None:
    spaces = [one.space for one in (estimate, reference) if one.space is not None]
    if not spaces:
        return None
    if in_space(estimate, reference):
        tilt = np.rad2deg(max(tilt_of(space.positions) for space in spaces))
        why = f"moves in a plane {tilt:.0f} degrees out of x and y" if tilt > np.rad2deg(TILT) else "moves in z, too"
        compared = "aligned and compared in space; errors are those of three coordinates, turns those about any axis"
        return Issue("in-space", f"{why}: {compared}", len(reference))
    spread = float(spaces[0].positions[:, 2].std())
    if spread < HEIGHTS:
        return None
    whose = "estimate" if estimate.space is not None else "reference"
    text = f"heights of the {whose}, spread by {spread:.2f} m, are left out: the other one is in the plane"
    return Issue("heights-left-out", text, len(reference))


def _of_shape(ate: AteResult) -> Issue | None:
    there, true, turns = ate.aligned[:, :2], ate.reference[:, :2], ate.rotation_errors
    spread = float(np.linalg.norm(true.std(axis=0)))
    if ate.rmse > SMALL:
        size = float(np.linalg.norm(there.std(axis=0)) / max(spread, SMALL))
        if not 1 / LARGER < size < LARGER:
            return Issue("sizes-differ", f"the estimate is {size:.3g} times as large as the reference: other units?")
        mirrored = there * (1.0, -1.0)
        off = transform_points(umeyama(mirrored, true), mirrored) - true
        if ate.motion is None and float(np.sqrt(np.square(off).sum(axis=1).mean())) < ate.rmse / 5:
            text = "the estimate fits the reference as its mirror image: y or turns of the wrong sign?"
            return Issue("mirrored", text)
        if ate.rmse > UNLIKE * spread:
            text = f"errors of {ate.rmse:.2f} m where the reference itself is spread by {spread:.2f} m"
            return Issue("unlike", f"{text}: another drive or building, or an estimate that is lost")
    if turns is None or np.median(turns) < AXES or turns.std() > 0.2 * AXES:
        return None
    degrees = np.rad2deg(float(np.median(turns)))
    why = f"orientations differ by {degrees:.0f} degrees throughout: other axes of the body, or a mirrored path"
    return Issue("body-axes", f"{why}; errors of rotation and relative errors hold that", len(ate.stamps))


class _Search:
    """Positions [n, d] and [m, d] of two drives at stamps [n] and, sparser, [m]; an offset is added to the former."""

    def __init__(self, stamps: Array, positions: Array, times: Array, goal: Array) -> None:
        self.stamps, self.positions, self.times, self.goal = stamps, positions, times, goal
        self.shorter = float(min(np.ptp(stamps), np.ptp(times)))
        self.spread = float(np.linalg.norm(goal.std(axis=0)))
        self.at, self.there = times, goal
        if float(np.median(np.diff(times))) < DENSE:  # anywhere between: noise is least between poses, at any offset
            at = np.linspace(times[0], times[-1], FINE)
            after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
            self.at = at[times[after] - times[after - 1] < DENSE]
            self.there = _at(self.at, times, goal)

    def errors(self, offsets: Array, most: int) -> Array:
        return np.array([self.rmse(float(offset), most) for offset in offsets])

    def rmse(self, offset: float, most: int, *, also: float | None = None) -> float:
        """After rigid alignment, of at most this many positions, to be had with the offset ``also``, too.

        NaN where too little of the shorter drive is left, or what is left stands still.
        """
        keep = evenly(np.arange(len(self.at)), most)
        for each in (offset, also):
            keep = keep if each is None else keep[self._inside(self.at[keep], each)]
        if len(keep) < LEAST or np.ptp(self.at[keep]) < OVERLAP * self.shorter:
            return float("nan")
        a, b = _at(self.at[keep] - offset, self.stamps, self.positions), self.there[keep]
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        if np.linalg.norm(b.std(axis=0)) < 0.5 * self.spread:
            return float("nan")
        cross = b.T @ a
        size = np.linalg.svd(cross, compute_uv=False)
        size[-1] *= np.sign(np.linalg.det(cross))
        return float(np.sqrt(max(0.0, float((a * a).sum() + (b * b).sum()) - 2 * float(size.sum())) / len(a)))

    def chords(self, offset: float, *, also: float) -> float:
        """How far the distances moved in some ``WINDOW`` of path differ, RMS [m]; they know no frame."""
        length = float(np.linalg.norm(np.diff(self.goal, axis=0), axis=1).sum())
        window = min(max(1.0, WINDOW / length * float(np.ptp(self.times))), self.shorter / 10)
        begin = np.linspace(self.times[0], self.times[-1] - window, 1200)
        inside = [self._inside(at, one) for at in (begin, begin + window) for one in (offset, also)]
        begin = begin[np.logical_and.reduce(inside)]
        drives = ((begin, self.times, self.goal), (begin - offset, self.stamps, self.positions))
        moved = [_at(at + window, *drive) - _at(at, *drive) for at, *drive in drives]
        off = np.subtract(*(np.linalg.norm(one, axis=1) for one in moved))
        return float(np.sqrt(np.square(off).mean())) if len(off) else float("nan")

    def common(self, offset: float) -> float:
        """How long both last at an offset [s]; below 0 the gap between them."""
        end, begin = min(self.stamps[-1] + offset, self.times[-1]), max(self.stamps[0] + offset, self.times[0])
        return float(end - begin)

    def _inside(self, times: Array, offset: float) -> NDArray[np.bool_]:
        return np.asarray((times - offset >= self.stamps[0]) & (times - offset <= self.stamps[-1]))


def _at(times: Array, stamps: Array, positions: Array) -> Array:
    """Positions [k, d] at times [k] of a drive through positions [n, d] at stamps [n]."""
    return np.column_stack([np.interp(times, stamps, column) for column in positions.T])
