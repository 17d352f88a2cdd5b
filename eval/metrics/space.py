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
    cos, sin = np.cos(trajectory.poses[:, 2]), np.sin(trajectory.poses[:, 2])
    rotations = np.zeros((len(trajectory), 3, 3))
    rotations[:, 0, 0] = rotations[:, 1, 1] = cos
    rotations[:, 1, 0], rotations[:, 0, 1] = sin, -sin
    rotations[:, 2, 2] = 1.0
    return Space(np.column_stack((trajectory.poses[:, :2], np.zeros(len(trajectory)))), rotations)


def space_at(trajectory: Trajectory, stamps: Array) -> Space:
    """The poses in space interpolated at other stamps [m], held beyond the ends."""
    space = spatial(trajectory)
    where, turns = interpolated(trajectory.stamps, space.positions, quaternions_of(space.rotations), stamps)
    w, vector = turns[:, 3], turns[:, :3]
    cross = np.zeros((len(turns), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]], cross[:, [1, 2, 0], [2, 0, 1]] = vector, -vector
    rotations = np.eye(3) + 2 * (w[:, None, None] * cross + cross @ cross)
    return Space(where, rotations)


def laid(source: Array, target: Array, *, scale: bool = False) -> tuple[Array, Array, float]:
    """The rotation [3, 3], translation [3] and scale that lay points on points [n, 3] (Umeyama 1991, eq. 38 to 43)."""
    if max(np.abs(source).max(), np.abs(target).max()) > FARTHEST:  # their squares overflow
        raise InputError(f"positions beyond {FARTHEST:g} m, expected metres")
    centre, goal = source.mean(axis=0), target.mean(axis=0)
    u, size, v = np.linalg.svd((target - goal).T @ (source - centre) / len(source))
    mirror = np.array((1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(v))))
    rotation = u * mirror @ v
    variance = float(np.square(source - centre).sum(axis=1).mean())
    factor = float((size * mirror).sum()) / variance if scale and variance > 0 else 1.0
    return rotation, goal - factor * rotation @ centre, factor


def angles(rotations: Array) -> Array:
    """The angle [n] of rotation matrices [n, 3, 3]."""
    quaternions = quaternions_of(rotations)
    return np.asarray(2 * np.arctan2(np.linalg.norm(quaternions[:, :3], axis=1), np.abs(quaternions[:, 3])))


def upright(positions: Array) -> Array:
    """The rotation [3, 3], the smallest, that turns the plane of a path [n, 3] into that of x and y."""
    normal = normal_of(positions)
    axis, cos = np.array((normal[1], -normal[0], 0.0)), float(normal[2])
    if (sin := float(np.linalg.norm(axis))) < 1e-12:
        return np.eye(3)
    x, y, z = axis / sin
    cross = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
    return np.asarray(np.eye(3) + sin * cross + (1 - cos) * cross @ cross)


def planar(space: Space, turn: Array, first: Array) -> Array:
    """The poses [n, 3] in the plane that a rotation turns into x and y; headings since that of ``first``."""
    rotations = turn @ space.rotations @ (turn @ first).T
    headings = wrap(np.arctan2(rotations[:, 1, 0] - rotations[:, 0, 1], rotations[:, 0, 0] + rotations[:, 1, 1]))
    return np.column_stack(((space.positions @ turn.T)[:, :2], headings))


def in_plane(
    estimate: Trajectory, reference: Trajectory, rotation: Array, translation: Array
) -> tuple[Trajectory, Trajectory]:
    """Two trajectories with their plane of motion turned into x and y.

    Args:
        estimate, reference: of which one moves in another plane.
        rotation, translation: that lay the estimate on the reference.
    """
    on = spatial(reference)
    laid_on = Space(spatial(estimate).positions @ rotation.T + translation, rotation @ spatial(estimate).rotations)
    turn = upright(on.positions)
    found = []
    for trajectory, space in ((estimate, laid_on), (reference, on)):
        turned = Space(space.positions @ turn.T, turn @ space.rotations)
        found.append(replace(trajectory, poses=planar(space, turn, on.rotations[0]), space=turned))
    return found[0], found[1]
