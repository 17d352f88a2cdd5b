"""The absolute error against measured positions, which have no heading: what cameras and total stations measure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import MAX_DIFFERENCE, covered, from_to
from moteslam.eval.metrics.statistics import Statistics
from moteslam.robot.se2 import IDENTITY, Poses, compose, umeyama, umeyama_scale
from moteslam.robot.se2 import interpolate as interpolated
from moteslam.robot.trajectory import Positions, Trajectory
from moteslam.robot.values import Summarised, counted, expect_type


@dataclass(frozen=True, eq=False, repr=False)
class PositionResult(Summarised):
    """How far a point of the estimate is from its measured positions.

    Attributes:
        stamps: [n] of the positions compared [s].
        errors: [n] distance to them [m].
        aligned: [n, 2] the estimate's point, laid on them [m].
        reference: [n, 2] the positions [m].
        transform: [3] what laid it there, a pose of the estimate's frame in the reference's.
        scale: that the estimate was multiplied by before; 1 unless it was asked for.
        translation: statistics of ``errors`` [m].
    """

    stamps: NDArray[np.float64]
    errors: NDArray[np.float64]
    aligned: NDArray[np.float64]
    reference: NDArray[np.float64]
    transform: Poses
    scale: float
    translation: Statistics

    @property
    def rmse(self) -> float:
        """Root mean square distance [m]."""
        return self.translation.rmse

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into JSON."""
        return {
            "translation_m": self.translation.as_dict(),
            "transform": self.transform.tolist(),
            "scale": self.scale,
        }

    def _summary(self) -> str:
        return f"{counted(len(self.stamps), 'position')}, RMSE {self.rmse:.3f} m"


def position_error(
    estimate: Trajectory,
    positions: Positions,
    *,
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0),
    align: bool = True,
    scale: bool = False,
    max_difference: float = MAX_DIFFERENCE,
) -> PositionResult:
    """The absolute trajectory error (Sturm et al. 2012) of a point of the robot, without a heading.

    The estimate is interpolated at the stamps of the positions: what was measured stays as it is.

    Args:
        estimate: poses of the robot.
        positions: measured, of a point that stands on it.
        mount: pose of that point in the robot's frame, as a lidar's [m, rad].
        align: lay the estimate on the positions first, by the rigid motion of least squares.
        scale: with that, multiply it by the scale of least squares.
        max_difference: a position before or after the estimate by no more than this belongs to its end [s].

    Raises:
        InputError: no poses or positions, or none of them between two poses at most a second apart.
    """
    expect_type(estimate, Trajectory, "estimate", "read_tum(path) reads one")
    expect_type(positions, Positions, "positions", "read_positions(path) reads some")
    if not len(estimate) or not len(positions):
        raise InputError("no poses or no positions, expected at least one of each")
    keep = covered(positions.stamps, estimate.stamps, max_difference)
    if not keep.any():
        raise InputError(
            f"no stamps in common: the estimate covers {from_to(estimate.stamps)}, the positions "
            f"{from_to(positions.stamps)}, expected positions between its poses"
        )
    stamps, reference = positions.stamps[keep], positions.points[keep]
    points = compose(interpolated(estimate.stamps, estimate.poses, stamps), mount)
    factor = umeyama_scale(points[:, :2], reference) if align and scale else 1.0
    points = points * (factor, factor, 1.0)
    transform = umeyama(points[:, :2], reference) if align else IDENTITY
    aligned = compose(transform, points)[:, :2]
    errors = np.hypot(*(aligned - reference).T)
    return PositionResult(
        stamps=stamps,
        errors=errors,
        aligned=aligned,
        reference=reference,
        transform=np.array(transform),
        scale=factor,
        translation=Statistics.of(errors),
    )
