"""How an error grows with the path, and how large it is where the robot comes back to a place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import MAX_DIFFERENCE, match
from moteslam.eval.metrics.scan_poses import evenly, travelled
from moteslam.eval.metrics.statistics import Statistics
from moteslam.robot.se2 import between
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

    def by_length(self) -> dict[float, tuple[float, float]]:
        """Mean errors per metre of translation [m/m] and rotation [rad/m], by the length of path [m]."""
        return {
            length: (float(self.translation[some].mean()), float(self.rotation[some].mean()))
            for length in LENGTHS
            if (some := self.lengths == length).any()
        }

    def as_dict(self) -> dict[str, Any]:
        """The same as plain values, fit for JSON: shares of the path, and degrees a metre."""
        groups = self.by_length().items()
        return {
            "translation_m_per_m": float(self.translation.mean()),
            "rotation_deg_per_m": float(np.rad2deg(self.rotation.mean())),
            "lengths": [
                {"length_m": length, "translation_m_per_m": shift, "rotation_deg_per_m": float(np.rad2deg(turn))}
                for length, (shift, turn) in groups
            ],
        }

    def _summary(self) -> str:
        turn = np.rad2deg(self.rotation.mean())
        return f"{100 * self.translation.mean():.2f} % of the path, {turn:.3f} deg/m over {len(self.lengths)} parts"


def drift(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    max_difference: float = MAX_DIFFERENCE,
    interpolate: bool | None = None,
) -> DriftResult:
    """Drift per metre, as the KITTI odometry benchmark has it (Geiger, Lenz and Urtasun 2012), over lengths indoors.

    From every pose on, and over each of ``LENGTHS`` of the reference's path, the error of the relative pose divided by
    that length.

    Args:
        estimate, reference: the trajectories.
        max_difference, interpolate: as in ``absolute_trajectory_error``.

    Raises:
        InputError: no stamps in common, or a drive shorter than the shortest length.
    """
    matched = match(estimate, reference, max_difference=max_difference, interpolate=interpolate)
    path, _ = travelled(matched.reference)
    lengths, shifts, turns = [], [], []
    for length in LENGTHS:
        last = np.searchsorted(path, path + length)
        first = np.flatnonzero(last < len(path))
        if not len(first):
            break
        last = last[first]
        errors = between(
            between(matched.reference[first], matched.reference[last]),
            between(matched.estimate[first], matched.estimate[last]),
        )
        lengths.append(np.full(len(first), length))
        shifts.append(np.hypot(errors[:, 0], errors[:, 1]) / length)
        turns.append(np.abs(errors[:, 2]) / length)
    if not lengths:
        raise InputError(f"{path[-1]:.2f} m driven, expected at least {LENGTHS[0]:g} m", field="path")
    return DriftResult(np.concatenate(lengths), np.concatenate(shifts), np.concatenate(turns))


@dataclass(frozen=True, eq=False, repr=False)
class ReturnResult(Summarised):
    """Errors of relative poses between visits of the same place.

    Attributes:
        stamps: [n, 2] of the earlier and the later visit [s].
        errors: [n] of the translation [m].
        rotation_errors: [n] of the rotation [rad].
        translation: statistics of ``errors`` [m].
        rotation: statistics of ``rotation_errors`` [rad].
    """

    stamps: Array
    errors: Array
    rotation_errors: Array
    translation: Statistics
    rotation: Statistics

    def as_dict(self) -> dict[str, Any]:
        """The statistics as plain values, fit for JSON: metres and degrees."""
        in_degrees = Statistics.of(np.rad2deg(self.rotation_errors))
        return {"translation_m": self.translation.as_dict(), "rotation_deg": in_degrees.as_dict()}

    def _summary(self) -> str:
        return f"{counted(len(self.errors), 'return')}, RMSE {self.translation.rmse:.3f} m"


def loop_closing_error(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    max_difference: float = MAX_DIFFERENCE,
    interpolate: bool | None = None,
) -> ReturnResult:
    """How far apart an estimate puts two visits of the same place, against how far apart they are.

    Each pose is compared with the earliest one within ``SAME_PLACE`` of it by the reference that lies more than
    ``LEAST_PATH`` of path before it. A wall seen on both visits is drawn twice, that far apart.

    Args:
        estimate, reference: the trajectories.
        max_difference, interpolate: as in ``absolute_trajectory_error``.

    Raises:
        InputError: no stamps in common, or a drive that comes back to no place.
    """
    from scipy.spatial import cKDTree

    matched = match(estimate, reference, max_difference=max_difference, interpolate=interpolate)
    chosen = evenly(np.arange(len(matched)), MAX_RETURNS)
    true, estimated, path = matched.reference[chosen], matched.estimate[chosen], travelled(matched.reference)[0][chosen]
    # of each pose the earliest one that is near it
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
    earlier = earliest[later]
    errors = between(between(true[earlier], true[later]), between(estimated[earlier], estimated[later]))
    translation, rotation = np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])
    stamps = matched.stamps[chosen]
    return ReturnResult(
        np.column_stack((stamps[earlier], stamps[later])),
        translation,
        rotation,
        Statistics.of(translation),
        Statistics.of(rotation),
    )
