"""Which pose of one trajectory belongs to which of another: by the nearest stamp, or by interpolation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.space import in_space, space_at, spatial
from moteslam.robot import se2
from moteslam.robot.recording import nearest_stamp
from moteslam.robot.se2 import Poses
from moteslam.robot.trajectory import Space, Trajectory
from moteslam.robot.values import Summarised, expect_type

MAX_DIFFERENCE = 0.01
"""Stamps further apart than this [s] do not belong together, as evo has it."""

MAX_GAP = 1.0
"""Nothing is interpolated where its poses are further apart than this [s]."""


@dataclass(frozen=True, eq=False, repr=False)
class Matched(Summarised):
    """Poses of two trajectories that belong together.

    Attributes:
        stamps: [n] of the estimate, or of the reference where the estimate is interpolated [s].
        estimate, reference: [n, 3] poses.
        oriented: whether both have headings.
        space: the same poses in space, where they must be compared there; else None.
    """

    stamps: NDArray[np.float64]
    estimate: Poses
    reference: Poses
    oriented: bool = True
    space: tuple[Space, Space] | None = None

    def __len__(self) -> int:
        return len(self.stamps)


def match(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    max_difference: float = MAX_DIFFERENCE,
    interpolate: bool | None = None,
) -> Matched:
    """Pair the poses of two trajectories.

    By nearest stamp, each pose of the shorter trajectory takes the pose of the longer one nearest in time, at most
    ``max_difference`` away (evo's rule, so that the scores agree). Interpolated, the one is evaluated at the stamps of
    the other, wherever two of its poses at most ``MAX_GAP`` apart enclose the stamp or one lies within
    ``max_difference``: a simulator's truth is dense, and snapping to its poses would cost a few millimetres.

    Args:
        estimate, reference: in rising order of stamps.
        max_difference: between stamps that belong together [s].
        interpolate: the reference (True) or nothing (False); None interpolates the one that has more poses where both
            are, and nothing where they have the same stamps or as many.

    Raises:
        InputError: a trajectory is empty, or not one pose has a partner.
    """
    expect_type(estimate, Trajectory, "estimate", "read_trajectory(path) reads one")
    expect_type(reference, Trajectory, "reference", "read_trajectory(path) reads one")
    if not len(estimate) or not len(reference):
        raise InputError("a trajectory without poses, expected at least one in each")
    space = in_space(estimate, reference)
    dense = _denser(estimate, reference, max_difference) if interpolate is None else reference if interpolate else None
    if dense is not None:
        sparse = estimate if dense is reference else reference
        keep = covered(sparse.stamps, dense.stamps, max_difference)
        stamps = sparse.stamps[keep]
        pair = [_at(sparse, stamps, keep, space), _at(dense, stamps, None, space)]
        there, true = pair if dense is reference else reversed(pair)
    else:
        if len(reference) < len(estimate):
            in_reference, in_estimate = within(reference.stamps, estimate.stamps, max_difference)
        else:
            in_estimate, in_reference = within(estimate.stamps, reference.stamps, max_difference)
        stamps = estimate.stamps[in_estimate]
        there, true = _at(estimate, stamps, in_estimate, space), _at(reference, stamps, in_reference, space)
    if not len(stamps):
        raise InputError(
            f"no stamps in common: the estimate covers {from_to(estimate.stamps)}, the reference "
            f"{from_to(reference.stamps)}, expected stamps within {max_difference:g} s of each other"
        )
    spaces = None if there[1] is None or true[1] is None else (there[1], true[1])
    return Matched(stamps, there[0], true[0], estimate.oriented and reference.oriented, spaces)


def _denser(estimate: Trajectory, reference: Trajectory, max_difference: float) -> Trajectory | None:
    """The one with more poses where both are, or in all; None where they are as many, most of them at the same time."""
    begin = max(estimate.stamps[0], reference.stamps[0]) - max_difference
    end = min(estimate.stamps[-1], reference.stamps[-1]) + max_difference
    counts = [
        (int(np.count_nonzero((one.stamps >= begin) & (one.stamps <= end))), len(one)) for one in (estimate, reference)
    ]
    if counts[0] != counts[1]:
        return estimate if counts[0] > counts[1] else reference
    return None if 2 * len(within(estimate.stamps, reference.stamps, max_difference)[0]) >= counts[0][0] else reference


def _at(
    trajectory: Trajectory, stamps: NDArray[np.float64], index: NDArray[Any] | None, space: bool
) -> tuple[Poses, Space | None]:
    """Some of the poses of a trajectory, or those at other stamps where no index is given; in space, too, if wanted."""
    if index is not None:
        return trajectory.poses[index], spatial(trajectory)[index] if space else None
    poses = se2.interpolate(trajectory.stamps, trajectory.poses, stamps)
    return poses, space_at(trajectory, stamps) if space else None


def within(
    wanted: NDArray[np.float64], among: NDArray[np.float64], max_difference: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """For each stamp [n] the nearest among others [m, rising], where one lies within ``max_difference`` [s].

    Of two equally near the earlier is taken, and of equal stamps the last, as evo does.

    Returns:
        indices into ``wanted`` and into ``among``, both [k].
    """
    nearest = nearest_stamp(among, wanted, side="right")
    found = np.flatnonzero(np.abs(among[nearest] - wanted) <= max_difference)
    return found, nearest[found]


def covered(stamps: NDArray[np.float64], reference: NDArray[np.float64], max_difference: float) -> NDArray[np.bool_]:
    """Which stamps [n] a reference [m] can be interpolated at.

    Those that two of its stamps at most ``MAX_GAP`` apart enclose, and those within ``max_difference`` of one [s].
    """
    after = np.searchsorted(reference, stamps, side="left")
    last = len(reference) - 1
    upper, lower = reference[np.minimum(after, last)], reference[np.maximum(after - 1, 0)]
    enclosed = (lower <= stamps) & (stamps <= upper) & (upper - lower <= MAX_GAP)
    near = np.minimum(np.abs(upper - stamps), np.abs(stamps - lower)) <= max_difference
    return np.asarray(enclosed | near)


def from_to(stamps: NDArray[np.float64]) -> str:
    """The first and the last of stamps [n], at least one, in words: ``0.000 to 60.000 s``."""
    return f"{stamps[0]:.3f} to {stamps[-1]:.3f} s"
