"""How sure a filter said it was, against the truth: NEES of its covariances, precision and recall of its states."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import Flags, Indices, covered, evenly
from moteslam.eval.statistics import CONFIDENCE
from moteslam.robot import se2
from moteslam.robot.se2 import Array, Poses
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Summarised, counted, expect_type
from moteslam.slam.estimate import Correction
from moteslam.slam.filter.certainty import NEIGHBOURHOOD, LocalisationState
from moteslam.slam.mapping.config import LOST_DISTANCE, LOST_ROTATION

MAX_SCANS, MAX_AROUND = 5000, 60
"""At most this many scans are scored, each by at most this many poses of the map around it, evenly chosen."""
DEGREES_OF_FREEDOM, CHI_SQUARED_95 = 3, 7.815
"""The squared error of three normal variables, in variances, is below this in 95 % of cases."""
ROUNDS, TYPICAL = 8, np.array([0.02, 0.02, 0.003])
"""Of reweighting, for the offset of the robot's frame, in which errors of this size weigh half [m], [m], [rad]."""
ASTRAY_DISTANCE, ASTRAY_ROTATION = 0.5, 0.15
"""A robot that has moved by this much more than it thinks since an update is astray [m], [rad]: that is no drift. Less
says nothing: where another particle is the best one the estimate jumps."""


@dataclass(frozen=True, eq=False, repr=False)
class LocalisationResult(Summarised):
    """Covariances and states against the truth.

    Attributes:
        stamps, states: [n] of the scans that were scored: all that have a map around them, at most ``MAX_SCANS``.
        errors: [n, 3] of the online poses relative to the map around the robot, in its frame (x, y [m], theta).
        nees: [n] normalised estimation error squared, e^T C^-1 e: 3 in the mean if the covariances C are right.
        offset: [3] of the robot's frame that was taken out: the lidar stands elsewhere than the recording states.
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
        return np.asarray(_wrong(self.errors) | self.astray)

    def precision(self, least: LocalisationState) -> float | None:
        """The share of wrong poses among those of this state or a worse one, if there are any."""
        return _share(self.wrong, self.states >= least)

    def recall(self, least: LocalisationState) -> float | None:
        """The share of this state or a worse one among the wrong poses, if there are any."""
        return _share(self.states >= least, self.wrong)

    def as_dict(self) -> dict[str, Any]:
        """Fit for JSON. The NEES is that of poses that are not wrong."""
        found: dict[str, Any] = {"scans": len(self.stamps), "wrong": int(self.wrong.sum())}
        found |= {"states": state_counts(self.states), "nees": None}
        if len(right := self.nees[~self.wrong]):
            within = float((right < CHI_SQUARED_95).mean())
            found["nees"] = {"mean": float(right.mean()), "median": float(np.median(right)), "within_95": within}
        for name, least in (("lost", LocalisationState.LOST), ("doubtful_or_lost", LocalisationState.DOUBTFUL)):
            found[name] = {"precision": self.precision(least), "recall": self.recall(least)}
        return found


def state_counts(states: ArrayLike) -> dict[str, int]:
    """How many scans are in each state, by its name in small letters."""
    return {state.name.lower(): int((np.asarray(states) == state).sum()) for state in LocalisationState}


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
        trajectory, covariances, states: [n] online poses, [n, 3, 3] of them, [n] as of ``LocalisationState``.
        updated: [n] above 0 where the scan went into the map.
        truth: on their clock; ``InputError`` of this field where no scan has a map around it there.
        corrections: of the path while the robot drove, in order.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    expect_type(truth, Trajectory, "truth", "read_trajectory(path) reads one")
    n = len(trajectory)
    if np.shape(covariances) != (n, 3, 3) or np.shape(states) != (n,) or np.shape(updated) != (n,):
        raise InputError(f"expected [n, 3, 3], [n] and [n] of {counted(n, 'pose')}", field="covariances")
    there = np.flatnonzero(covered(trajectory.stamps, truth.stamps))
    estimated = trajectory.poses[there]
    true = se2.interpolate(truth.stamps, truth.poses, trajectory.stamps[there]) if len(there) else estimated
    numbers = np.where(updated > 0, np.cumsum(updated > 0) - 1, -1)[there]  # of each update among all, -1 of the others
    scored, astray = _around(estimated, true, numbers, corrections)
    if not scored:
        raise InputError("it covers no scan with a map around it, expected two updates or more", field="truth")
    chosen = np.array([scan for scan, _, _ in scored])
    counts = np.array([len(around) for _, around, _ in scored])
    each, begins = np.repeat(chosen, counts), counts.cumsum() - counts
    around, mapped = (np.concatenate([one[k] for one in scored]) for k in (1, 2))
    off, relative = _differences(estimated[each], true[each], mapped, true[around])
    errors = np.add.reduceat(off, begins) / counts[:, None]
    effects = np.eye(3) - np.add.reduceat(_seen_from(relative), begins) / counts[:, None, None]
    offset = _frame_offset(errors, effects)
    errors = errors - effects @ offset
    scans = there[chosen]
    if not (np.linalg.eigvalsh(covariances[scans]) > 0).all():
        raise InputError("a covariance that is not positive definite", field="covariances")
    nees, known = squared_errors(errors, covariances[scans]), states[scans].astype(np.int64)
    return LocalisationResult(trajectory.stamps[scans], errors, nees, known, offset, astray[chosen])


def _around(
    estimated: Poses, true: Poses, numbers: Indices, corrections: Sequence[Correction]
) -> tuple[list[tuple[int, Indices, Poses]], Flags]:
    """Scans to score, the updates around each, and where the map has these; and which of all scans [n] are astray."""
    n, updates = len(estimated), np.flatnonzero(numbers >= 0)
    to_score = np.isin(np.arange(n), evenly(np.arange(n), MAX_SCANS))
    counts = np.searchsorted(updates, np.arange(n))  # of the updates before each scan
    epochs = np.searchsorted([correction.scan for correction in corrections], np.arange(n), side="left")
    scored: list[tuple[int, Indices, Poses]] = []
    astray, known = np.zeros(n, np.bool_), 0  # updates from before the robot went astray; 0 where it did not
    for epoch in np.unique(epochs).tolist():
        mapped = estimated
        if epoch:
            path = corrections[epoch - 1].path
            corrected = (numbers >= 0) & (numbers < len(path))
            mapped = np.where(corrected[:, None], path[np.where(corrected, numbers, 0)], estimated)
        scans = np.flatnonzero((epochs == epoch) & (counts > 0))
        last = updates[counts[scans] - 1]
        moved, thought = se2.between(true[last], true[scans]), se2.between(mapped[last], estimated[scans])
        further = np.hypot(moved[:, 0], moved[:, 1]) - np.hypot(thought[:, 0], thought[:, 1]) > ASTRAY_DISTANCE
        jumps = further | (np.abs(moved[:, 2]) - np.abs(thought[:, 2]) > ASTRAY_ROTATION)
        for scan, before, jump in zip(scans.tolist(), counts[scans].tolist(), jumps.tolist(), strict=True):
            earlier = updates[:before]
            near = _near(estimated[scan], mapped[earlier]) | _near(true[scan], true[earlier])
            if known and (around := earlier[:known][near[:known]]).size:
                off, _ = _differences(estimated[scan], true[scan], mapped[around], true[around])
                if not _wrong(off.mean(axis=0)[None])[0]:
                    known = 0
            elif not known and jump:
                known = before
            astray[scan] = known > 0
            if to_score[scan] and near.any():
                around = evenly(earlier[near], MAX_AROUND)
                scored.append((scan, around, mapped[around]))
    return scored, astray


def _differences(estimated: Poses, true: Poses, mapped_around: Poses, true_around: Poses) -> tuple[Array, Poses]:
    """Estimated poses seen from the true ones, both relative to poses [k, 3] around, and the true relative ones."""
    relative = se2.between(true_around, true)
    return se2.between(relative, se2.between(mapped_around, estimated)), relative


def _near(pose: Poses, others: Poses) -> Flags:
    """[m] whether other poses [m, 3] are within ``NEIGHBOURHOOD`` of a pose [3]."""
    return np.asarray(np.square(others[:, 0] - pose[0]) + np.square(others[:, 1] - pose[1]) <= NEIGHBOURHOOD**2)


def _wrong(errors: Array) -> Flags:
    """[n] whether errors [n, 3] are those of a robot that is lost."""
    return np.asarray((np.hypot(errors[:, 0], errors[:, 1]) > LOST_DISTANCE) | (np.abs(errors[:, 2]) > LOST_ROTATION))


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
        weights = 1 / np.square(1 + np.square(scaled - rows @ offset).sum(axis=1))
        normal = np.einsum("nij,n,nik->jk", rows, weights, rows) + prior
        offset = np.linalg.solve(normal, np.einsum("nij,n,ni->j", rows, weights, scaled))
    return np.asarray(offset)


def _share(some: Flags, among: Flags) -> float | None:
    return float(some[among].mean()) if among.any() else None


@dataclass(frozen=True, eq=False, repr=False)
class NeesResult(Summarised):
    """The NEES [n] of poses whose covariances grow from the start, e^T C^-1 e: 3 in the mean if these, C, are right.

    The errors [n, 3] are of each pose relative to the true one, both seen from the start, in the robot's frame.
    ``effective`` is how many independent values the n are worth, since errors stay.
    """

    stamps: Array
    errors: Array
    nees: Array
    effective: float

    @property
    def mean(self) -> float:
        return float(self.nees.mean())

    @property
    def end(self) -> float:
        """Of the last pose; over many seeds these are independent."""
        return float(self.nees[-1])

    @property
    def interval(self) -> tuple[float, float]:
        """Where the mean of a consistent filter lies in 95 of 100 runs."""
        return nees_interval(self.effective)


def nees_interval(count: float) -> tuple[float, float]:
    """Where the mean NEES of ``count`` independent poses of a consistent filter lies in 95 of 100 runs (Bar-Shalom, Li
    and Kirubarajan 2001, section 5.4): quantiles of chi^2 with 3 degrees of freedom each, divided by their number.
    """
    degrees = DEGREES_OF_FREEDOM * count
    low, high = (_chi2_quantile((1 + sign * CONFIDENCE) / 2, degrees) for sign in (-1, 1))
    return low / count, high / count


def nees_from_start(trajectory: Trajectory, covariances: Array, truth: Trajectory) -> NeesResult:
    """The NEES of a trajectory [n] whose covariances [n, 3, 3] (x, y [m], theta [rad]) are relative to the first pose.

    Estimate and truth are laid on each other at the first pose that the truth covers, whose covariance is taken as the
    origin's; no later pose is used for the alignment, as it would hide what drifts. Poses before the covariances have
    rank three are left out.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    expect_type(truth, Trajectory, "truth", "read_trajectory(path) reads one")
    covariances = np.asarray(covariances, np.float64)
    if covariances.shape != (len(trajectory), 3, 3):
        raise InputError(f"{list(covariances.shape)}, expected one of each of {len(trajectory)}", field="covariances")
    there = np.flatnonzero(covered(trajectory.stamps, truth.stamps))
    if len(there) < 2:
        raise InputError(f"it covers {counted(len(there), 'pose')}, expected two or more", field="truth")
    stamps, given = trajectory.stamps[there], covariances[there]
    eigenvalues = np.linalg.eigvalsh(given)
    if not (np.isfinite(given).all() and (eigenvalues > -1e-12).all()):
        raise InputError("one that is not positive semi-definite", field="covariances")
    true, estimated = se2.interpolate(truth.stamps, truth.poses, stamps), trajectory.poses[there]
    errors = se2.between(se2.between(true[0], true), se2.between(estimated[0], estimated))
    ranked = eigenvalues[:, 0] > 0
    ranked[0] = False  # laid on the truth
    if not ranked.any():
        raise InputError("no covariance of rank three", field="covariances")
    errors, given = errors[ranked], given[ranked]
    return NeesResult(stamps[ranked], errors, squared_errors(errors, given), _effective(given))


def squared_errors(errors: Array, covariances: Array) -> Array:
    """e^T C^-1 e [n] of errors [n, 3] and their covariances [n, 3, 3]."""
    return np.asarray(np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]))


def _effective(covariances: Array) -> float:
    """How many independent values the NEES of poses with covariances [n, 3, 3] are worth, at least 1.

    Of two poses the later error contains the earlier one, so that they correlate by the root of the ratio of their
    variances, and their squares by that ratio. Taken by the cube root of the determinants.
    """
    variances = np.sort(np.exp(np.linalg.slogdet(covariances)[1] / DEGREES_OF_FREEDOM))
    n, before = len(variances), np.cumsum(variances) - variances
    return float(max(n * n / (n + 2 * (before / variances).sum()), 1.0))


def share_within_spread(errors: Array, deviations: Array) -> float:
    """How often errors of poses [u, 3], along and across the heading [m] and of it [rad], lie within the 95 % ellipsoid
    of the particles, given their standard deviations [u, 3]; ``InputError`` without an update.
    """
    if not len(errors) or np.shape(errors) != np.shape(deviations):
        raise InputError(f"{list(np.shape(deviations))}, expected [u, 3], as many as errors", field="deviations")
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = np.where(errors == 0, 0.0, np.square(np.asarray(errors) / deviations)).sum(axis=1)
    return float((squares < _chi2_quantile(CONFIDENCE, DEGREES_OF_FREEDOM)).mean())


def _chi2_quantile(probability: float, degrees: float) -> float:
    """The quantile of chi^2, without ``scipy.stats``, which takes 0.2 s to import."""
    from scipy.special import gammaincinv

    return float(2 * gammaincinv(degrees / 2, probability))
