"""How sure a filter said it was, against the truth: NEES of its covariances, precision and recall of its states.

A pose is compared with the map around the robot, not with a frame laid over the run: what it is relative to the poses
from which that map was made (``docs/theory/am-i-lost.md``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import covered, evenly
from moteslam.eval.metrics.consistency import squared_errors
from moteslam.robot import se2
from moteslam.robot.se2 import Poses
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Summarised, counted, expect_type
from moteslam.slam.estimate import Correction
from moteslam.slam.filter.certainty import NEIGHBOURHOOD, LocalisationState
from moteslam.slam.mapping.config import LOST_DISTANCE, LOST_ROTATION

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

MAX_SCANS, MAX_AROUND = 5000, 60
"""At most this many scans are scored, each by at most this many poses of the map around it, evenly chosen."""
AT_ONCE = 256
"""Scans whose distances to all poses of the map are held at once."""
CHI_SQUARED_95 = 7.815
"""The squared error of three normal variables, in variances, is below this in 95 % of cases."""
ROUNDS = 8
"""Of reweighting, for the offset of the robot's frame."""
TYPICAL = np.array([0.02, 0.02, 0.003])
"""Errors of this size weigh half in that offset [m], [m], [rad]."""
ASTRAY_DISTANCE, ASTRAY_ROTATION = 0.5, 0.15
"""A robot that has moved by this much more than it thinks since an update is astray [m], [rad]: that is no drift. Less
says nothing: where another particle is the best one the estimate jumps."""


@dataclass(frozen=True, eq=False, repr=False)
class LocalisationResult(Summarised):
    """Covariances and states against the truth.

    Attributes:
        stamps: [n] of the scans that were scored [s]: all that have a map around them, at most ``MAX_SCANS``.
        errors: [n, 3] of the online poses relative to the map around the robot, in its frame (x, y [m], theta).
        nees: [n] normalised estimation error squared, e^T C^-1 e: 3 in the mean if the covariances C are right.
        states: [n] as the filter had them, ``LocalisationState``.
        offset: [3] of the robot's frame that was taken out, the same for all scans: the lidar stands elsewhere than the
            recording states.
        astray: [n] whether it is elsewhere than it thinks: since a step that was off by more than drift, until it is
            right about a place that was mapped before.
    """

    stamps: Array
    errors: Array
    nees: Array
    states: NDArray[np.int64]
    offset: Array
    astray: Flags

    @property
    def wrong(self) -> Flags:
        """[n] whether the pose is off by more than ``LOST_DISTANCE`` or ``LOST_ROTATION``, or the robot is astray."""
        return np.asarray(_beyond(self.errors, LOST_DISTANCE, LOST_ROTATION) | self.astray)

    def precision(self, least: LocalisationState) -> float | None:
        """The share of wrong poses among those of this state or a worse one, if there are any."""
        return _share(self.wrong, self.states >= least)

    def recall(self, least: LocalisationState) -> float | None:
        """The share of this state or a worse one among the wrong poses, if there are any."""
        return _share(self.states >= least, self.wrong)

    def as_dict(self) -> dict[str, Any]:
        """Fit for JSON. The NEES is that of poses that are not wrong."""
        right = self.nees[~self.wrong]
        nees = None
        if len(right):
            within = float((right < CHI_SQUARED_95).mean())
            nees = {"mean": float(right.mean()), "median": float(np.median(right)), "within_95": within}
        lost, doubtful = (
            {"precision": self.precision(least), "recall": self.recall(least)}
            for least in (LocalisationState.LOST, LocalisationState.DOUBTFUL)
        )
        return {
            "scans": len(self.stamps),
            "wrong": int(self.wrong.sum()),
            "states": state_counts(self.states),
            "nees": nees,
            "lost": lost,
            "doubtful_or_lost": doubtful,
        }

    def _summary(self) -> str:
        return f"{counted(len(self.stamps), 'scan')}, {int(self.wrong.sum())} wrong, {int(self.states.sum())} doubted"


def state_counts(states: Array | NDArray[np.int64]) -> dict[str, int]:
    """How many scans are in each state, by its name in small letters."""
    return {state.name.lower(): int((states == state).sum()) for state in LocalisationState}


def score_localisation(
    trajectory: Trajectory,
    covariances: Array,
    states: Array,
    updated: Array,
    truth: Trajectory,
    *,
    corrections: Sequence[Correction] = (),
) -> LocalisationResult:
    """Score covariances and states.

    The map around the robot is made of the scans of the updates so far from poses within ``NEIGHBOURHOOD`` of where the
    robot is, or of where it was estimated to be. The error of an online pose is the mean, over these updates, of the
    difference between its estimated and its true pose relative to the update's. Where a back end corrected the path,
    and the map with it, the updates before count where the correction put them. A robot that was carried off is astray
    until it is right about what it mapped before.

    Args:
        trajectory: [n] online poses.
        covariances: [n, 3, 3] of them.
        states: [n] as of ``LocalisationState``.
        updated: [n] above 0 where the scan went into the map.
        truth: on their clock.
        corrections: of the path while the robot drove, in order.

    Raises:
        InputError: arrays that do not fit together, or a covariance that is not positive definite; or, of the field
            ``truth``, no scan with a map around it there.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    expect_type(truth, Trajectory, "truth", "read_trajectory(path) reads one")
    n = len(trajectory)
    if np.shape(covariances) != (n, 3, 3) or np.shape(states) != (n,) or np.shape(updated) != (n,):
        raise InputError(f"expected [n, 3, 3], [n] and [n] of {counted(n, 'pose')}", field="covariances")
    there = np.flatnonzero(covered(trajectory.stamps, truth.stamps))
    estimated = trajectory.poses[there]
    true = se2.interpolate(truth.stamps, truth.poses, trajectory.stamps[there]) if len(there) else estimated
    updates = np.flatnonzero(updated > 0)
    numbers = np.full(n, -1)
    numbers[updates] = np.arange(len(updates))
    chosen, errors, effects = _errors(estimated, true, numbers[there], corrections)
    if not len(chosen):
        raise InputError("it covers no scan with a map around it, expected two updates or more", field="truth")
    offset = _frame_offset(errors, effects)
    errors = errors - effects @ offset
    scans = there[chosen]
    if not (np.linalg.eigvalsh(covariances[scans]) > 0).all():
        raise InputError("a covariance that is not positive definite", field="covariances")
    nees = squared_errors(errors, covariances[scans])
    astray = _astray(estimated, true, numbers[there], corrections)[chosen]
    return LocalisationResult(trajectory.stamps[scans], errors, nees, states[scans].astype(np.int64), offset, astray)


def _errors(
    estimated: Poses, true: Poses, numbers: NDArray[np.intp], corrections: Sequence[Correction]
) -> tuple[NDArray[np.intp], Array, Array]:
    """The scans [k] with a map around them, their errors [k, 3], and how an offset of the frame moves these [k, 3, 3].

    Args:
        estimated, true: [n, 3] poses.
        numbers: [n] of those whose scans went into the map among all updates; -1 of the others.
        corrections: see ``score_localisation``.
    """
    parts = [(np.empty(0, np.intp), np.empty((0, 3)), np.empty((0, 3, 3)))]
    updates = np.flatnonzero(numbers >= 0)
    for mapped, of_epoch in _epochs(estimated, evenly(np.arange(len(estimated)), MAX_SCANS), numbers, corrections):
        for first in range(0, len(of_epoch), AT_ONCE):
            scans = of_epoch[first : first + AT_ONCE]
            before = updates[updates < scans[-1]]
            near = _near(estimated[scans], mapped[before]) | _near(true[scans], true[before])
            which, around = np.nonzero(near & (before < scans[:, None]))
            parts.append(_mean_errors(estimated, true, mapped, scans, which, before[around]))
    chosen, errors, effects = zip(*parts, strict=True)
    return np.concatenate(chosen), np.concatenate(errors), np.concatenate(effects)


def _epochs(
    estimated: Poses, scans: NDArray[np.intp], numbers: NDArray[np.intp], corrections: Sequence[Correction]
) -> Iterator[tuple[Poses, NDArray[np.intp]]]:
    """Where the map has the poses [n, 3] after each correction, and which of the scans come then: see ``_errors``."""
    after = np.searchsorted([correction.scan for correction in corrections], scans, side="left")
    for epoch in np.unique(after).tolist():
        yield _mapped(estimated, numbers, corrections[epoch - 1] if epoch else None), scans[after == epoch]


def _astray(estimated: Poses, true: Poses, numbers: NDArray[np.intp], corrections: Sequence[Correction]) -> Flags:
    """[n] whether the robot is elsewhere than it thinks: see ``LocalisationResult``; arguments as of ``_errors``."""
    astray = np.zeros(len(estimated), np.bool_)
    updates = np.flatnonzero(numbers >= 0)
    known = 0  # updates before the robot went astray; 0 where it did not
    for mapped, of_epoch in _epochs(estimated, np.arange(len(estimated)), numbers, corrections):
        count = np.searchsorted(updates, of_epoch)  # of the updates before each scan
        of_epoch, count = of_epoch[count > 0], count[count > 0]
        last = updates[count - 1]
        moved, thought = se2.between(true[last], true[of_epoch]), se2.between(mapped[last], estimated[of_epoch])
        distance = np.hypot(moved[:, 0], moved[:, 1]) - np.hypot(thought[:, 0], thought[:, 1])
        jumps = (distance > ASTRAY_DISTANCE) | (np.abs(moved[:, 2]) - np.abs(thought[:, 2]) > ASTRAY_ROTATION)
        for scan, before, jump in zip(of_epoch, count.tolist(), jumps.tolist(), strict=True):
            if known:
                around, here = updates[:known], scan[None]
                around = around[(_near(estimated[here], mapped[around]) | _near(true[here], true[around]))[0]]
                relative = se2.between(true[around], true[scan])
                off = se2.between(relative, se2.between(mapped[around], estimated[scan]))
                if len(off) and not _beyond(off.mean(axis=0)[None], LOST_DISTANCE, LOST_ROTATION)[0]:
                    known = 0
            elif jump:
                known = before
            astray[scan] = known > 0
    return astray


def _beyond(errors: Array, distance: float, rotation: float) -> Flags:
    """[n] whether errors [n, 3] are larger than a distance [m] or a rotation [rad]."""
    return np.asarray((np.hypot(errors[:, 0], errors[:, 1]) > distance) | (np.abs(errors[:, 2]) > rotation))


def _near(some: Poses, others: Poses) -> Flags:
    """[k, m] whether poses [k, 3] are within ``NEIGHBOURHOOD`` of others [m, 3]."""
    squares = np.square(some[:, None, 0] - others[:, 0])
    squares += np.square(some[:, None, 1] - others[:, 1])
    return squares <= NEIGHBOURHOOD**2


def _mean_errors(
    estimated: Poses,
    true: Poses,
    mapped: Poses,
    scans: NDArray[np.intp],
    which: NDArray[np.intp],
    around: NDArray[np.intp],
) -> tuple[NDArray[np.intp], Array, Array]:
    """The scans that have a map around them, their errors and their effects: see ``_errors``.

    Args:
        estimated, true: [n, 3] poses.
        mapped: [n, 3] where the map has them.
        scans: [k] of the poses, in order.
        which: [p] of the scans, in order, for each pair of a scan and a pose of the map around it.
        around: [p] these poses.
    """
    counts = np.bincount(which, minlength=len(scans))
    scans, counts = scans[counts > 0], counts[counts > 0]
    if not len(scans):
        return scans, np.empty((0, 3)), np.empty((0, 3, 3))
    begins = np.cumsum(counts) - counts
    pairs = zip(begins.tolist(), counts.tolist(), strict=True)
    around = around[np.concatenate([begin + evenly(np.arange(count), MAX_AROUND) for begin, count in pairs])]
    counts = np.minimum(counts, MAX_AROUND)
    begins, each = np.cumsum(counts) - counts, np.repeat(scans, counts)
    relative = se2.between(true[around], true[each])
    off = se2.between(relative, se2.between(mapped[around], estimated[each]))
    effects = np.eye(3) - np.add.reduceat(_seen_from(relative), begins) / counts[:, None, None]
    return scans, np.add.reduceat(off, begins) / counts[:, None], effects


def _mapped(estimated: Poses, numbers: NDArray[np.intp], correction: Correction | None) -> Poses:
    """Where the map has the poses [n, 3] after a correction: see ``_errors``."""
    if correction is None:
        return estimated
    corrected = (numbers >= 0) & (numbers < len(correction.path))
    return np.where(corrected[:, None], correction.path[np.where(corrected, numbers, 0)], estimated)


def _seen_from(relative: Poses) -> Array:
    """How small offsets of frames [k] move the relative poses [k, 3] of another frame, seen from there: [k, 3, 3]."""
    x, y, theta = relative.T
    cos, sin = np.cos(theta), np.sin(theta)
    moves = np.zeros((len(relative), 3, 3))
    moves[:, 0] = np.stack((cos, sin, sin * x - cos * y), axis=-1)
    moves[:, 1] = np.stack((-sin, cos, cos * x + sin * y), axis=-1)
    moves[:, 2, 2] = 1.0
    return moves


def _frame_offset(errors: Array, effects: Array) -> Array:
    """The offset [3] of the robot's frame that explains most of the errors [n, 3]: least squares, large errors less."""
    offset = np.zeros(3)
    scaled, rows = errors / TYPICAL, effects / TYPICAL[:, None]
    prior = np.diag(0.01 / TYPICAL**2)  # where the robot has not turned some of it cannot be seen
    for _ in range(ROUNDS):
        left = np.square(scaled - rows @ offset).sum(axis=1)
        weights = 1 / np.square(1 + left)
        normal = np.einsum("nij,n,nik->jk", rows, weights, rows) + prior
        offset = np.linalg.solve(normal, np.einsum("nij,n,ni->j", rows, weights, scaled))
    return np.asarray(offset)


def _share(some: Flags, among: Flags) -> float | None:
    return float(some[among].mean()) if among.any() else None
