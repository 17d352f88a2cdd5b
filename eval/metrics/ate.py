"""Absolute trajectory error: how far the estimate is from the reference once both are laid on each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import MAX_DIFFERENCE, Matched, match
from moteslam.eval.metrics.space import angles, laid, planar, upright
from moteslam.eval.metrics.statistics import Statistics
from moteslam.robot.se2 import IDENTITY, Poses, compose, inverse, umeyama, umeyama_scale, wrap
from moteslam.robot.trajectory import Space, Trajectory
from moteslam.robot.values import Summarised, counted

STANDING = 0.01
"""A reference whose positions are within this root mean square distance of their mean [m] stands still."""


@dataclass(frozen=True, eq=False, repr=False)
class AteResult(Summarised):
    """The absolute trajectory error.

    Attributes:
        stamps: [n] of the poses compared [s].
        errors: [n] distance to the reference [m].
        rotation_errors: [n] absolute difference of heading [rad]; None where one of the two has none.
        aligned: [n, 3] the estimate's poses, laid on the reference.
        reference: [n, 3] the poses they are compared with.
        transform: [3] what laid them there, a pose of the estimate's frame in the reference's.
        scale: that the estimate was multiplied by before; 1 unless it was asked for.
        translation: statistics of ``errors`` [m].
        rotation: statistics of ``rotation_errors`` [rad], or None.
        motion: of trajectories that are compared in space, the rotation [3, 3] and translation [3] that laid the
            estimate on the reference; poses are then those in the plane of motion. Else None.
    """

    stamps: NDArray[np.float64]
    errors: NDArray[np.float64]
    rotation_errors: NDArray[np.float64] | None
    aligned: Poses
    reference: Poses
    transform: Poses
    scale: float
    translation: Statistics
    rotation: Statistics | None
    motion: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

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
        turns = self.rotation_errors
        return {
            "translation_m": self.translation.as_dict(),
            "rotation_deg": None if turns is None else Statistics.of(np.rad2deg(turns)).as_dict(),
            "transform": self.transform.tolist(),
            "scale": self.scale,
        }

    def _summary(self) -> str:
        turn = "" if self.rotation is None else f" and {np.rad2deg(self.rotation.rmse):.2f} deg"
        return f"{counted(self.pairs, 'pose')}, RMSE {self.rmse:.3f} m{turn}"


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
    if matched.space is not None:
        return _in_space(matched, align=align, from_start=from_start, scale=scale)
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
    rotation_errors = np.abs(wrap(aligned[:, 2] - matched.reference[:, 2])) if matched.oriented else None
    return AteResult(
        stamps=matched.stamps,
        errors=errors,
        rotation_errors=rotation_errors,
        aligned=aligned,
        reference=matched.reference,
        transform=np.array(transform),
        scale=factor,
        translation=Statistics.of(errors),
        rotation=None if rotation_errors is None else Statistics.of(rotation_errors),
    )


def _in_space(matched: Matched, *, align: bool, from_start: bool, scale: bool) -> AteResult:
    """The same in space, drawn in the plane of the reference's motion."""
    assert matched.space is not None
    there, true = matched.space
    rotation, translation, factor = np.eye(3), np.zeros(3), 1.0
    if from_start:
        rotation = true.rotations[0] @ there.rotations[0].T
        translation = true.positions[0] - rotation @ there.positions[0]
    elif align and true.positions.std(axis=0).max() >= STANDING:
        rotation, translation, factor = laid(there.positions, true.positions, scale=scale)
    elif align:
        u, _, v = np.linalg.svd((true.rotations @ np.swapaxes(there.rotations, 1, 2)).sum(axis=0))
        rotation = u @ np.diag((1, 1, np.linalg.det(u @ v))) @ v
        translation = true.positions.mean(axis=0) - rotation @ there.positions.mean(axis=0)
    laid_on = Space(factor * there.positions @ rotation.T + translation, rotation @ there.rotations)
    errors = np.linalg.norm(laid_on.positions - true.positions, axis=1)
    turns = angles(np.swapaxes(true.rotations, 1, 2) @ laid_on.rotations) if matched.oriented else None
    turn = upright(true.positions)
    heading = float(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1]))
    return AteResult(
        stamps=matched.stamps,
        errors=errors,
        rotation_errors=turns,
        aligned=planar(laid_on, turn, true.rotations[0]),
        reference=planar(true, turn, true.rotations[0]),
        transform=np.array((translation[0], translation[1], heading)),
        scale=factor,
        translation=Statistics.of(errors),
        rotation=None if turns is None else Statistics.of(turns),
        motion=(rotation, translation),
    )


def _laid(estimate: Poses, reference: Poses) -> Poses:
    """The pose [3] that lays poses [n, 3] on those of a reference [n, 3]: see ``absolute_trajectory_error``."""
    goal = reference[:, :2].mean(axis=0)
    if np.square(reference[:, :2] - goal).sum(axis=1).mean() >= STANDING**2:
        return umeyama(estimate[:, :2], reference[:, :2])
    turns = reference[:, 2] - estimate[:, 2]
    turn = float(np.arctan2(np.sin(turns).mean(), np.cos(turns).mean()))
    return compose((*goal, turn), (*-estimate[:, :2].mean(axis=0), 0.0))
