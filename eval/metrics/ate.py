"""Absolute trajectory error: how far the estimate is from the reference once it is laid on it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from moteslam.errors import InputError
from moteslam.eval.metrics import association
from moteslam.eval.metrics.association import MAX_DIFFERENCE, Matched, match
from moteslam.eval.statistics import Statistics
from moteslam.robot.se2 import IDENTITY, Array, Poses, compose, inverse, umeyama, wrap
from moteslam.robot.trajectory import Space, Trajectory
from moteslam.robot.values import Summarised, counted

STANDING = 0.01
"""A reference whose positions are within this root mean square distance of their mean [m] stands still."""


@dataclass(frozen=True, eq=False, repr=False)
class PoseErrors(Summarised):
    """Errors of poses at stamps [n] [s], or of pairs of poses at stamps [n, 2]: of the position [n] [m], and of the
    rotation [n] [rad], from 0; None where one of the two trajectories has none.
    """

    stamps: Array
    errors: Array
    rotation_errors: Array | None
    _what: ClassVar[str] = "pose"

    @cached_property
    def translation(self) -> Statistics:
        return Statistics.of(self.errors)

    @cached_property
    def rotation(self) -> Statistics | None:
        return None if self.rotation_errors is None else Statistics.of(self.rotation_errors)

    @cached_property
    def rotation_deg(self) -> Statistics | None:
        return None if self.rotation_errors is None else Statistics.of(np.rad2deg(self.rotation_errors))

    @property
    def rmse(self) -> float:
        """Root mean square error of the position [m]."""
        return self.translation.rmse

    @property
    def pairs(self) -> int:
        return len(self.errors)

    def as_dict(self) -> dict[str, Any]:
        turns = None if self.rotation_deg is None else self.rotation_deg.as_dict()
        return {"translation_m": self.translation.as_dict(), "rotation_deg": turns}

    def _summary(self) -> str:
        turn = "" if self.rotation is None else f" and {np.rad2deg(self.rotation.rmse):.2f} deg"
        return f"{counted(self.pairs, self._what)}, RMSE {self.rmse:.3f} m{turn}"


@dataclass(frozen=True, eq=False, repr=False)
class AteResult(PoseErrors):
    """The absolute trajectory error: distances to the reference, and differences of heading.

    Attributes:
        aligned, reference: [n, 3] the estimate's poses, laid on the reference, and those they are compared with.
        transform: [3] what laid them there, a pose of the estimate's frame in the reference's.
        scale: that the estimate was multiplied by before; 1 unless it was asked for.
        motion: in space, the rotation [3, 3] and translation [3] that laid the estimate on the reference; poses are
            then those in the plane of motion.
        space: in space, the poses that ``aligned`` and ``reference`` are in that plane.
    """

    aligned: Poses
    reference: Poses
    transform: Poses
    scale: float
    motion: tuple[Array, Array] | None = None
    space: tuple[Space, Space] | None = None

    def as_dict(self) -> dict[str, Any]:
        return {**super().as_dict(), "transform": self.transform.tolist(), "scale": self.scale}


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
        estimate, reference, max_difference, interpolate: see ``match``.
        align: lay the estimate on the reference first, by the rigid motion of least squares. Where the reference
            stands still (``STANDING``) its positions leave the rotation open: there it is the mean difference of the
            headings.
        from_start: lay only the first poses on each other, in place of that.
        scale: with the alignment, multiply the estimate by the scale of least squares.
    """
    if from_start and scale:
        raise InputError("given with from_start, expected one of the two", field="scale")
    matched = match(estimate, reference, max_difference=max_difference, interpolate=interpolate)
    compare = _in_plane if matched.space is None else _in_space
    return compare(matched, align=align, from_start=from_start, scale=scale)


def _in_plane(matched: Matched, *, align: bool, from_start: bool, scale: bool) -> AteResult:
    estimated, reference = matched.estimate, matched.reference
    factor = _scale(estimated[:, :2], reference[:, :2]) if align and scale else 1.0
    estimated = estimated * (factor, factor, 1.0)
    transform = IDENTITY
    if from_start:
        transform = compose(reference[0], inverse(estimated[0]))
    elif align:
        goal = reference[:, :2].mean(axis=0)
        if np.square(reference[:, :2] - goal).sum(axis=1).mean() >= STANDING**2:
            transform = umeyama(estimated[:, :2], reference[:, :2])
        else:
            turns = reference[:, 2] - estimated[:, 2]
            turn = float(np.arctan2(np.sin(turns).mean(), np.cos(turns).mean()))
            transform = compose((*goal, turn), (*-estimated[:, :2].mean(axis=0), 0.0))
    aligned = compose(transform, estimated)
    errors = np.hypot(*(aligned[:, :2] - reference[:, :2]).T)
    turned = np.abs(wrap(aligned[:, 2] - reference[:, 2])) if matched.oriented else None
    return AteResult(matched.stamps, errors, turned, aligned, reference, np.array(transform), factor)


def _in_space(matched: Matched, *, align: bool, from_start: bool, scale: bool) -> AteResult:
    assert matched.space is not None
    there, true = matched.space
    rotation, translation, factor = np.eye(3), np.zeros(3), 1.0
    if from_start:
        rotation = true.rotations[0] @ there.rotations[0].T
        translation = true.positions[0] - rotation @ there.positions[0]
    elif align and true.positions.std(axis=0).max() >= STANDING:
        rotation, translation, factor = association.laid(there.positions, true.positions, scale=scale)
    elif align:
        rotation, _ = association.nearest_rotation((true.rotations @ np.swapaxes(there.rotations, 1, 2)).sum(axis=0))
        translation = true.positions.mean(axis=0) - rotation @ there.positions.mean(axis=0)
    laid_on = Space(factor * there.positions @ rotation.T + translation, rotation @ there.rotations)
    errors = np.linalg.norm(laid_on.positions - true.positions, axis=1)
    turns = association.angles(np.swapaxes(true.rotations, 1, 2) @ laid_on.rotations) if matched.oriented else None
    turn = association.upright(true.positions)
    aligned, reference = (association.planar(space, turn, true.rotations[0]) for space in (laid_on, true))
    transform = np.array((translation[0], translation[1], float(association.heading_of(rotation))))
    laying = rotation, translation
    return AteResult(matched.stamps, errors, turns, aligned, reference, transform, factor, laying, (laid_on, true))


def _scale(source: Array, target: Array) -> float:
    """The factor that lays points [n, 2] on others with the least squared distance (Umeyama 1991); 1 for a point."""
    a, b = ((one - one.mean(axis=0)) @ (1, 1j) for one in (source, target))
    size = float(np.vdot(a, a).real)
    return float(abs(np.vdot(a, b))) / size if size > 0 else 1.0
