"""Whether covariances say how far poses are off: the normalised estimation error squared, anchored at the start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import covered
from moteslam.eval.statistics import CONFIDENCE
from moteslam.robot import se2
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Summarised, counted, expect_type

Array = NDArray[np.float64]

DEGREES_OF_FREEDOM = 3


@dataclass(frozen=True, eq=False, repr=False)
class NeesResult(Summarised):
    """The NEES of poses whose covariances grow from the start.

    Attributes:
        stamps: [n] [s].
        errors: [n, 3] of each pose relative to the true one, both seen from the start, in the robot's frame.
        nees: [n] e^T C^-1 e: 3 in the mean if the covariances C are right.
        effective: how many independent values the n of them are worth, since errors stay.
    """

    stamps: Array
    errors: Array
    nees: Array
    effective: float

    @property
    def mean(self) -> float:
        """Over the run."""
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

    Raises:
        InputError: of the field ``covariances``: another shape, one that is not positive semi-definite, or none of rank
            three; of ``truth``: fewer than two poses that it covers.
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
    """How often the truth lies within the 95 % ellipsoid of the particles.

    Args:
        errors: [u, 3] of the poses, along and across the heading [m] and of the heading [rad].
        deviations: [u, 3] standard deviations of the particles, likewise.

    Raises:
        InputError: no update.
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
