"""Two trajectories in space: whether they must be compared there, laid on each other, and in their plane of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.se2 import wrap
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

Array = NDArray[np.float64]


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


def space_at(trajectory: Trajectory, stamps: Array) -> Space:
    """The poses in space interpolated at other stamps [m], held beyond the ends."""
    space = spatial(trajectory)
    where, turns = interpolated(trajectory.stamps, space.positions, quaternions_of(space.rotations), stamps)
    return Space(where, rotations_of(turns))


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
    """The rotation R [3, 3] for which trace(R^T M) is the largest, and that trace."""
    u, size, v = np.linalg.svd(matrix)
    mirror = np.array((1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(v))))
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
    """Two trajectories with their plane of motion turned into x and y.

    Args:
        estimate, reference: of which one moves in another plane.
        rotation, translation: that lay the estimate on the reference.
    """
    there, on = spatial(estimate), spatial(reference)
    turn = upright(on.positions)

    def turned(trajectory: Trajectory, space: Space) -> Trajectory:
        poses = planar(space, turn, on.rotations[0])
        return replace(trajectory, poses=poses, space=Space(space.positions @ turn.T, turn @ space.rotations))

    laid_on = Space(there.positions @ rotation.T + translation, rotation @ there.rotations)
    return turned(estimate, laid_on), turned(reference, on)
