"""Which pose of one trajectory belongs to which of another: by the nearest stamp, or by interpolation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.se2 import Poses
from moteslam.robot.stamps import nearest_stamp
from moteslam.robot.summary import Summarised
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.wording import expect_type

MAX_DIFFERENCE = 0.01
"""Stamps further apart than this [s] do not belong together, as evo has it."""

MAX_GAP = 1.0
"""A reference is not interpolated where its poses are further apart than this [s]."""


@dataclass(frozen=True, eq=False, repr=False)
class Matched(Summarised):
    """Poses of two trajectories that belong together.

    Attributes:
        stamps: [n] of the estimate [s].
        estimate, reference: [n, 3] poses.
    """

    stamps: NDArray[np.float64]
    estimate: Poses
    reference: Poses

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
    ``max_difference`` away (evo's rule, so that the scores agree). Interpolated, the reference is evaluated at the
    stamps of the estimate, wherever two of its poses at most ``MAX_GAP`` apart enclose the stamp or one lies within
    ``max_difference``: a simulator's truth is dense, and snapping to its poses would cost a few millimetres.

    Args:
        estimate, reference: in rising order of stamps.
        max_difference: between stamps that belong together [s].
        interpolate: True or False; None interpolates a reference that has more poses than the estimate.

    Raises:
        InputError: a trajectory is empty, or not one pose has a partner.
    """
    expect_type(estimate, Trajectory, "estimate", "read_trajectory(path) reads one")
    expect_type(reference, Trajectory, "reference", "read_trajectory(path) reads one")
    if not len(estimate) or not len(reference):
        raise InputError("a trajectory without poses, expected at least one in each")
    if interpolate is None:
        interpolate = len(reference) > len(estimate)
    if interpolate:
        keep = covered(estimate.stamps, reference.stamps, max_difference)
        stamps = estimate.stamps[keep]
        matched = Matched(stamps, estimate.poses[keep], se2.interpolate(reference.stamps, reference.poses, stamps))
    else:
        if len(reference) < len(estimate):
            in_reference, in_estimate = within(reference.stamps, estimate.stamps, max_difference)
        else:
            in_estimate, in_reference = within(estimate.stamps, reference.stamps, max_difference)
        matched = Matched(estimate.stamps[in_estimate], estimate.poses[in_estimate], reference.poses[in_reference])
    if not len(matched):
        raise InputError(
            f"no stamps in common: the estimate covers {from_to(estimate.stamps)}, the reference "
            f"{from_to(reference.stamps)}, expected stamps within {max_difference:g} s of each other"
        )
    return matched


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
