"""Rotations in space and the heading that is left of them in the plane, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2

Array = NDArray[np.float64]

NO_ROTATION = 0.05
"""Entries of R R^T off those of the identity by more than this make a matrix no rotation, however it was rounded."""


def quaternion_of_yaw(yaw: Array) -> tuple[list[float], list[float]]:
    """The z and the w of the quaternions of headings [n] [rad]; x and y are 0."""
    return np.sin(yaw / 2).tolist(), np.cos(yaw / 2).tolist()


def yaw_of_rotation(rotation: Array) -> Array:
    """The rotation [...] about z [rad] of rotation matrices [..., 3, 3]."""
    return se2.wrap(np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]))


def rotation_of_yaw(yaw: Array) -> Array:
    """The rotation matrices [n, 3, 3] of headings [n] [rad]."""
    rotation = np.zeros((len(yaw), 3, 3))
    rotation[:, 0, 0] = rotation[:, 1, 1] = np.cos(yaw)
    rotation[:, 1, 0] = np.sin(yaw)
    rotation[:, 0, 1] = -rotation[:, 1, 0]
    rotation[:, 2, 2] = 1.0
    return rotation


def check_quaternion(quaternion: list[float], path: Path, line: int) -> None:
    """Refuse four numbers that are no rotation.

    Raises:
        InputError: all of them are 0; file and line are named.
    """
    if not any(quaternion):
        raise InputError("quaternion of length 0, expected a unit quaternion", file=path, line=line)


def is_rotation(rotation: Array) -> NDArray[np.bool_]:
    """Which matrices [n, 3, 3] are rotations, as far as rounded digits can be, and no reflections."""
    off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
    return np.asarray((off < NO_ROTATION) & (np.linalg.det(rotation) > 0))
