"""Which pose belongs to which: of two trajectories, or of a trajectory and the scans of its recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.recording import LidarStream, Recording, nearest_stamp
from moteslam.robot.se2 import Array, Poses, wrap
from moteslam.robot.trajectory import (
    FARTHEST,
    TILT,
    Space,
    Trajectory,
    interpolated,
    normal_of,
    quaternions_of,
    rotations_of,
    tilt_of,
)
from moteslam.robot.values import Issue, Summarised, counted, expect_type
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.synchronise import require_lidar, synchronise

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]

MAX_DIFFERENCE, MAX_GAP = 0.01, 1.0
"""Stamps further apart than this [s] do not belong together, as evo has it; no pose is interpolated in a longer gap."""
FEW, ALL_FIT = 0.5, 3
"""Errors are of a part where less than this share is compared; fewer poses than the second always fit each other."""
UNITS, ROUGHLY = {"mm": 0.001, "cm": 0.01, "feet": 0.3048}, 0.02
"""Units of lengths [m] that may be taken for metres, and the share by which a scale may be off one."""


@dataclass(frozen=True, eq=False, repr=False)
class Matched(Summarised):
    """Poses [n, 3] of two trajectories that belong together, at stamps [n] of one of the two [s].

    ``space`` has the same poses in space, where they must be compared there.
    """

    stamps: Array
    estimate: Poses
    reference: Poses
    oriented: bool = True
    space: tuple[Space, Space] | None = None


def match(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    max_difference: float = MAX_DIFFERENCE,
    interpolate: bool | None = None,
) -> Matched:
    """Pair the poses of two trajectories, in rising order of stamps.

    By nearest stamp, each pose of the shorter trajectory takes the pose of the longer one nearest in time, at most
    ``max_difference`` [s] away (evo's rule). Interpolated, the one is evaluated at the stamps of the other, see
    ``covered``: the reference (True), neither (False), by default the one with more poses, and neither where they have
    as many, most of them at the same stamps.
    """
    expect_type(estimate, Trajectory, "estimate", "read_trajectory(path) reads one")
    expect_type(reference, Trajectory, "reference", "read_trajectory(path) reads one")
    if not len(estimate) or not len(reference):
        raise InputError("a trajectory without poses, expected at least one in each")
    space = in_space(estimate, reference)
    dense = _denser(estimate, reference, max_difference) if interpolate is None else reference if interpolate else None
    which: list[Indices | None]  # poses of estimate and reference; None where they are interpolated
    if dense is not None:
        sparse = estimate if dense is reference else reference
        keep = np.flatnonzero(covered(sparse.stamps, dense.stamps, max_difference))
        stamps, which = sparse.stamps[keep], [keep, None] if dense is reference else [None, keep]
    else:
        shorter, longer = sorted((estimate, reference), key=len)
        pair = within(shorter.stamps, longer.stamps, max_difference)
        if np.array_equal(shorter.stamps, longer.stamps):  # poses of one stamp each have their own
            pair = (np.arange(len(shorter)),) * 2
        which = [*(pair if shorter is estimate else pair[::-1])]
        stamps = estimate.stamps[which[0]]
    if not len(stamps):
        covers = f"the estimate covers {from_to(estimate.stamps)}, the reference {from_to(reference.stamps)}"
        expected = f"expected stamps within {max_difference:g} s of each other"
        raise InputError(f"no stamps in common: {covers}, {expected}")
    there, true = (_at(one, stamps, index, space) for one, index in zip((estimate, reference), which, strict=True))
    spaces = None if there[1] is None or true[1] is None else (there[1], true[1])
    return Matched(stamps, there[0], true[0], estimate.oriented and reference.oriented, spaces)


def _denser(estimate: Trajectory, reference: Trajectory, max_difference: float) -> Trajectory | None:
    """The one with more poses where both have some, or in all; see ``match``."""
    begin = max(estimate.stamps[0], reference.stamps[0]) - max_difference
    end = min(estimate.stamps[-1], reference.stamps[-1]) + max_difference
    inside = [(one.stamps >= begin) & (one.stamps <= end) for one in (estimate, reference)]
    counts = [(int(np.count_nonzero(some)), len(some)) for some in inside]
    if counts[0] != counts[1]:
        return estimate if counts[0] > counts[1] else reference
    return None if 2 * len(within(estimate.stamps, reference.stamps, max_difference)[0]) >= counts[0][0] else reference


def _at(trajectory: Trajectory, stamps: Array, index: Indices | None, space: bool) -> tuple[Poses, Space | None]:
    """The poses of an index, or interpolated at the stamps where it is None."""
    if index is not None:
        return trajectory.poses[index], spatial(trajectory)[index] if space else None
    poses = se2.interpolate(trajectory.stamps, trajectory.poses, stamps)
    if not space:
        return poses, None
    there = spatial(trajectory)
    where, turns = interpolated(trajectory.stamps, there.positions, quaternions_of(there.rotations), stamps)
    return poses, Space(where, rotations_of(turns))


def oriented(*trajectories: Trajectory, field: str | None = None) -> tuple[Trajectory, ...]:
    """The trajectories; ``InputError`` of the field if one of them has no headings."""
    if not all(trajectory.oriented for trajectory in trajectories):
        raise InputError("a trajectory without orientation, expected headings", field=field)
    return trajectories


def within(stamps: Array, among: Array, max_difference: float) -> tuple[Indices, Indices]:
    """Indices [k] of stamps [n] and of the nearest to each among others [m, rising] within ``max_difference`` [s].

    Of two equally near the earlier is taken, and of equal stamps the last, as evo does.
    """
    nearest = nearest_stamp(among, stamps, side="right")
    near = np.flatnonzero(np.abs(among[nearest] - stamps) <= max_difference)
    return near, nearest[near]


def few_matched(matched: int, shorter: int, what: str, question: str) -> tuple[Issue, ...]:
    """The issue that few of the shorter one's stamps have a partner, if they are few."""
    if matched >= max(FEW * shorter, ALL_FIT):
        return ()
    means = "errors are those of these alone" if matched >= ALL_FIT else "so few always fit, and errors mean nothing"
    return (Issue("few-matched", f"{matched} of {shorter} {what} have a partner: {means}: {question}", matched),)


def covered(stamps: Array, reference: Array, max_difference: float = MAX_DIFFERENCE, *, gap: float = MAX_GAP) -> Flags:
    """Which stamps [...] a reference [m] can be interpolated at.

    Those that two of its stamps at most ``gap`` apart enclose, and those within ``max_difference`` of one [s].
    """
    if not len(reference):
        return np.zeros(np.shape(stamps), np.bool_)
    after = np.searchsorted(reference, stamps, side="left")
    upper, lower = reference[np.minimum(after, len(reference) - 1)], reference[np.maximum(after - 1, 0)]
    enclosed = (lower <= stamps) & (stamps <= upper) & (upper - lower <= gap)
    near = np.minimum(np.abs(upper - stamps), np.abs(stamps - lower)) <= max_difference
    return np.asarray(enclosed | near)


def from_to(stamps: Array) -> str:
    """The first and the last of stamps [n] in words: ``0.000 to 60.000 s``."""
    return f"{stamps[0]:.3f} to {stamps[-1]:.3f} s"


def placed_scans(
    recording: Recording, trajectory: Trajectory, scans: Scans | None = None
) -> tuple[LidarStream, Indices, Poses, Scans]:
    """The lidar of a recording, the indices [k] of its scans that have a pose, the poses [k, 3], and all scans, of
    ``synchronise(recording)`` where they are not given.

    Where the trajectory has a pose for every scan, in order, these are taken; else poses are interpolated at the scans'
    stamps: if it has more poses than there are scans wherever it covers them, if not at the scans within
    ``MAX_DIFFERENCE`` of a pose.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    expect_type(trajectory, Trajectory, "trajectory", "read_trajectory(path) reads one")
    lidar = require_lidar(recording)
    if not len(trajectory):
        raise InputError("a trajectory without poses, expected one for every scan", field="trajectory")
    if not np.isfinite(trajectory.poses).all():
        raise InputError("poses that are not finite, expected x, y and theta", field="trajectory")
    scans = synchronise(recording).scans if scans is None else scans
    stamps, times = lidar.stamps, trajectory.stamps
    if len(times) == len(stamps) and np.abs(times - stamps).max() <= MAX_DIFFERENCE:
        return lidar, np.arange(len(stamps)), trajectory.poses, scans  # those of one stamp keep a pose of their own
    if len(times) > len(stamps):
        index = np.flatnonzero(covered(stamps, times))
    else:
        index, _ = within(stamps, times, MAX_DIFFERENCE)
    if len(index) < 2:
        covers = f"the scans cover {from_to(stamps)}, the trajectory {from_to(times)}"
        problem = f"poses at {len(index)} of {counted(len(stamps), 'scan')}, expected at two or more: {covers}"
        raise InputError(problem, field="trajectory")
    return lidar, index, se2.interpolate(times, trajectory.poses, stamps[index]), scans


def travelled(poses: Poses) -> tuple[Array, Array]:
    """The path [m] and the turns, left or right, [rad] up to each of the poses [n, 3], both [n]."""
    x, y, turns = np.diff(poses, axis=0).T
    steps = np.stack((np.hypot(x, y), np.abs(se2.wrap(turns))))
    path, turned = np.concatenate((np.zeros((2, 1)), np.cumsum(steps, axis=1)), axis=1)
    return path, turned


def evenly(some: Indices, most: int) -> Indices:
    """Those [n], or ``most`` of them where there are more: evenly spread, the first and the last among them."""
    return some if len(some) <= most else some[np.linspace(0, len(some) - 1, most).round().astype(np.intp)]


def tree_of(points: Array) -> cKDTree:
    """The k-d tree of points [n, d]; SciPy takes long to import."""
    from scipy.spatial import cKDTree

    return cKDTree(points)


def in_space(estimate: Trajectory, reference: Trajectory) -> bool:
    """Whether two trajectories are compared in space: both are in space, or one moves in another plane than x and y."""
    spaces = [one.space for one in (estimate, reference) if one.space is not None]
    return len(spaces) == 2 or any(tilt_of(space.positions) > TILT for space in spaces)


def spatial(trajectory: Trajectory) -> Space:
    """The poses of a trajectory in space; of one in the plane upright at height 0."""
    if trajectory.space is not None:
        return trajectory.space
    x, y, heading = trajectory.poses.T
    zeros = np.zeros_like(x)
    quaternions = np.stack((zeros, zeros, np.sin(heading / 2), np.cos(heading / 2)), axis=-1)
    return Space(np.stack((x, y, zeros), axis=-1), rotations_of(quaternions))


def laid(source: Array, target: Array, *, scale: bool = False) -> tuple[Array, Array, float]:
    """The rotation [3, 3], translation [3] and scale that lay points on points [n, 3] (Umeyama 1991, eq. 38 to 43)."""
    if max(np.abs(source).max(), np.abs(target).max()) > FARTHEST:  # their squares overflow
        raise InputError(f"positions beyond {FARTHEST:g} m, expected metres")
    centre, goal = source.mean(axis=0), target.mean(axis=0)
    rotation, size = nearest_rotation((target - goal).T @ (source - centre) / len(source))
    variance = float(np.square(source - centre).sum(axis=1).mean())
    factor = size / variance if scale and variance > 0 else 1.0
    return rotation, goal - factor * rotation @ centre, factor


def nearest_rotation(matrix: Array) -> tuple[Array, float]:
    """The rotation R [d, d] for which trace(R^T M) is the largest, and that trace."""
    u, size, v = np.linalg.svd(matrix)
    mirror = np.append(np.ones(len(size) - 1), np.sign(np.linalg.det(u) * np.linalg.det(v)))
    return u * mirror @ v, float((size * mirror).sum())


def angles(rotations: Array) -> Array:
    """The angle [n] of rotation matrices [n, 3, 3]."""
    quaternions = quaternions_of(rotations)
    return np.asarray(2 * np.arctan2(np.linalg.norm(quaternions[:, :3], axis=1), np.abs(quaternions[:, 3])))


def heading_of(rotations: Array) -> Array:
    """The angle about z [...] that is nearest to rotation matrices [..., 3, 3]."""
    return wrap(np.arctan2(rotations[..., 1, 0] - rotations[..., 0, 1], rotations[..., 0, 0] + rotations[..., 1, 1]))


def upright(positions: Array) -> Array:
    """The rotation [3, 3], the smallest, that turns the plane of a path [n, 3] into that of x and y."""
    x, y, z = normal_of(positions)  # z from 0 to 1
    return np.asarray(rotations_of(np.array(((y, -x, 0.0, 1.0 + z),)))[0])


def planar(space: Space, turn: Array, first: Array) -> Array:
    """The poses [n, 3] in the plane that a rotation turns into x and y; headings since that of ``first``."""
    headings = heading_of(turn @ space.rotations @ (turn @ first).T)
    return np.column_stack(((space.positions @ turn.T)[:, :2], headings))


def in_plane(
    estimate: Trajectory, reference: Trajectory, rotation: Array, translation: Array
) -> tuple[Trajectory, Trajectory]:
    """Two trajectories, one of which moves in another plane, with that turned into x and y; a rotation [3, 3] and a
    translation [3] lay the estimate on the reference.
    """
    there, on = spatial(estimate), spatial(reference)
    turn = upright(on.positions)

    def turned(trajectory: Trajectory, space: Space) -> Trajectory:
        poses = planar(space, turn, on.rotations[0])
        return replace(trajectory, poses=poses, space=Space(space.positions @ turn.T, turn @ space.rotations))

    laid_on = Space(there.positions @ rotation.T + translation, rotation @ there.rotations)
    return turned(estimate, laid_on), turned(reference, on)


def rescaled(factor: float, left: float) -> tuple[str, float]:
    """Whose positions are to be multiplied by what, where those of the estimate by a factor are the reference's; and
    the error that this leaves [m], of one in the reference's unit.
    """
    for unit, size in UNITS.items():
        for whose, off, error in ("estimate", factor / size, left), ("reference", factor * size, size * left):
            if abs(off - 1) < ROUGHLY:
                return f"multiply the {whose}'s positions by {size:g} ({unit} as m):", error
    return f"with the estimate's positions multiplied by {factor:.4g}", left
