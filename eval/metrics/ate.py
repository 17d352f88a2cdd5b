"""Absolute trajectory error: how far the estimate is from the reference once both are laid on each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import MAX_DIFFERENCE, match
from moteslam.eval.metrics.statistics import Statistics
from moteslam.robot.alignment import umeyama, umeyama_scale
from moteslam.robot.se2 import IDENTITY, Poses, compose, inverse, wrap
from moteslam.robot.summary import Summarised
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.wording import counted

STANDING = 0.01
"""A reference whose positions are within this root mean square distance of their mean [m] stands still."""


@dataclass(frozen=True, eq=False, repr=False)
class AteResult(Summarised):
    """The absolute trajectory error.

    Attributes:
        stamps: [n] of the poses compared [s].
        errors: [n] distance to the reference [m].
        rotation_errors: [n] absolute difference of heading [rad].
        aligned: [n, 3] the estimate's poses, laid on the reference.
        reference: [n, 3] the poses they are compared with.
        transform: [3] what laid them there, a pose of the estimate's frame in the reference's.
        scale: that the estimate was multiplied by before; 1 unless it was asked for.
        translation: statistics of ``errors`` [m].
        rotation: statistics of ``rotation_errors`` [rad].
    """

    stamps: NDArray[np.float64]
    errors: NDArray[np.float64]
    rotation_errors: NDArray[np.float64]
    aligned: Poses
    reference: Poses
    transform: Poses
    scale: float
    translation: Statistics
    rotation: Statistics

    @property
    def rmse(self) -> float:
        """Root mean square distance [m]."""
        return self.translation.rmse

    @property
    def mean(self) -> float:
        """Mean distance [m]."""
        return self.translation.mean

    @property
    def median(self) -> float:
        """Median distance [m]."""
        return self.translation.median

    @property
    def std(self) -> float:
        """Standard deviation of the distance [m]."""
        return self.translation.std

    @property
    def max(self) -> float:
        """Largest distance [m]."""
        return self.translation.max

    @property
    def min(self) -> float:
        """Smallest distance [m]."""
        return self.translation.min

    @property
    def pairs(self) -> int:
        """How many poses were compared."""
        return self.translation.count

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into ``metrics.json``: metres, and degrees for the rotation."""
        in_degrees = Statistics.of(np.rad2deg(self.rotation_errors))
        return {
            "translation_m": self.translation.as_dict(),
            "rotation_deg": in_degrees.as_dict(),
            "transform": self.transform.tolist(),
            "scale": self.scale,
        }

    def _summary(self) -> str:
        return f"{counted(self.pairs, 'pose')}, RMSE {self.rmse:.3f} m and {np.rad2deg(self.rotation.rmse):.2f} deg"


def absolute_trajectory_error(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    align: bool = True,
    from_start: bool = False,
    scale: bool = False,
    max_difference: float = MAX_DIFFERENCE,
    interpolate: bool | None = None,
) -> AteResult:
    """The absolute trajectory error (Sturm et al. 2012), as evo computes it.

    Args:
        estimate, reference: the trajectories; equal stamps are distinct poses.
        align: lay the estimate on the reference first, by the rigid motion of least squares; a SLAM starts at its
            own origin, so that without it the error says where that origin is. Where the reference stands still
            (``STANDING``) its positions leave the rotation open: there it is the mean difference of the headings.
        from_start: lay only the first poses on each other, in place of that: what errors at the start do to the end.
        scale: with the alignment, multiply the estimate by the scale of least squares: what is left where the lidar's
            or the wheels' scale is off.
        max_difference: between stamps that belong together [s].
        interpolate: evaluate the reference at the estimate's stamps rather than take its nearest pose; None does
            so where the reference has more poses than the estimate, as a simulator's truth has.

    Raises:
        InputError: no poses, or no stamps in common; or a scale from the start alone.
    """
    if from_start and scale:
        raise InputError("given with from_start, expected one of the two", field="scale")
    matched = match(estimate, reference, max_difference=max_difference, interpolate=interpolate)
    estimated, factor = matched.estimate, 1.0
    if align and scale:
        factor = umeyama_scale(estimated[:, :2], matched.reference[:, :2])
        estimated = estimated * (factor, factor, 1.0)
    transform = IDENTITY
    if from_start:
        transform = compose(matched.reference[0], inverse(estimated[0]))
    elif align:
        transform = _laid(estimated, matched.reference)
    aligned = compose(transform, estimated)
    errors = np.hypot(*(aligned[:, :2] - matched.reference[:, :2]).T)
    rotation_errors = np.abs(wrap(aligned[:, 2] - matched.reference[:, 2]))
    return AteResult(
        stamps=matched.stamps,
        errors=errors,
        rotation_errors=rotation_errors,
        aligned=aligned,
        reference=matched.reference,
        transform=np.array(transform),
        scale=factor,
        translation=Statistics.of(errors),
        rotation=Statistics.of(rotation_errors),
    )


def _laid(estimate: Poses, reference: Poses) -> Poses:
    """The pose [3] that lays poses [n, 3] on those of a reference [n, 3]: see ``absolute_trajectory_error``."""
    goal = reference[:, :2].mean(axis=0)
    if np.square(reference[:, :2] - goal).sum(axis=1).mean() >= STANDING**2:
        return umeyama(estimate[:, :2], reference[:, :2])
    turns = reference[:, 2] - estimate[:, 2]
    turn = float(np.arctan2(np.sin(turns).mean(), np.cos(turns).mean()))
    return compose((*goal, turn), (*-estimate[:, :2].mean(axis=0), 0.0))
