"""How an error grows with the path, and how large it is where the robot comes back to a place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import evenly, match, travelled
from moteslam.eval.metrics.ate import PoseErrors
from moteslam.eval.metrics.rpe import planar_errors
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Summarised, counted

Array = NDArray[np.float64]

LENGTHS = (5.0, 10.0, 20.0, 50.0, 100.0)
"""Lengths of path over which drift is measured [m], those that the drive has."""

SAME_PLACE, LEAST_PATH = 1.0, 15.0
"""The robot is back at a place where it is less than the first from where it was [m], after more than the second of
path [m]."""

MAX_RETURNS = 2000
"""At most this many poses are looked at for returns, spread evenly over the drive."""


@dataclass(frozen=True, eq=False, repr=False)
class DriftResult(Summarised):
    """Errors of relative poses over lengths of path, divided by the length.

    Attributes:
        lengths: [n] of each part of the path that was compared [m], one of ``LENGTHS``.
        translation: [n] error of its translation per metre [m/m].
        rotation: [n] error of its rotation per metre [rad/m].
    """

    lengths: Array
    translation: Array
    rotation: Array

    def _summary(self) -> str:
        turn = np.rad2deg(self.rotation.mean())
        return f"{100 * self.translation.mean():.2f} % of the path, {turn:.3f} deg/m over {len(self.lengths)} parts"


class ReturnResult(PoseErrors):
    """Errors of relative poses between visits of the same place, at the stamps [n, 2] of both."""

    def _summary(self) -> str:
        return f"{counted(self.pairs, 'return')}, {super()._summary()}"


def drift(estimate: Trajectory, reference: Trajectory) -> DriftResult:
    """Drift per metre, as the KITTI odometry benchmark has it (Geiger, Lenz and Urtasun 2012), over lengths indoors.

    From every pose on, and over each of ``LENGTHS`` of the reference's path, the error of the relative pose divided by
    that length.

    Raises:
        InputError: no stamps in common, or a drive shorter than the shortest length.
    """
    matched = match(estimate, reference)
    path, _ = travelled(matched.reference)
    parts = []
    for length in LENGTHS:
        last = np.searchsorted(path, path + length)
        first = np.flatnonzero(last < len(path))
        if not len(first):
            break
        shift, turn = planar_errors(matched.reference, matched.estimate, first, last[first])
        parts.append((np.full(len(first), length), shift / length, turn / length))
    if not parts:
        raise InputError(f"{path[-1]:.2f} m driven, expected at least {LENGTHS[0]:g} m", field="path")
    return DriftResult(*map(np.concatenate, zip(*parts, strict=True)))


def loop_closing_error(estimate: Trajectory, reference: Trajectory) -> ReturnResult:
    """How far apart an estimate puts two visits of the same place, against how far apart they are.

    Each pose is compared with the earliest one within ``SAME_PLACE`` of it by the reference that lies more than
    ``LEAST_PATH`` of path before it.

    Raises:
        InputError: no stamps in common, or a drive that comes back to no place.
    """
    from scipy.spatial import cKDTree

    matched = match(estimate, reference)
    chosen = evenly(np.arange(len(matched)), MAX_RETURNS)
    true, path = matched.reference[chosen], travelled(matched.reference)[0][chosen]
    pairs = cKDTree(true[:, :2]).query_pairs(SAME_PLACE, output_type="ndarray")
    earliest = np.arange(len(true))
    np.minimum.at(earliest, pairs[:, 1], pairs[:, 0])
    later = np.flatnonzero(path - path[earliest] > LEAST_PATH)
    if not len(later):
        raise InputError(
            f"no place visited twice: none within {SAME_PLACE:g} m of an earlier one more than {LEAST_PATH:g} m of "
            "path before it",
            field="path",
        )
    shift, turn = planar_errors(true, matched.estimate[chosen], earliest[later], later)
    stamps = matched.stamps[chosen]
    visits = np.column_stack((stamps[earliest[later]], stamps[later]))
    return ReturnResult(visits, shift, turn)
