"""Differential drive: the increment of a pose from what the wheels (and the gyro) did.

An increment is a pose in the frame of the pose before it. Both functions take a travelled distance and a turn,
never a velocity: an interval between jittered stamps is not a thing to divide by (``docs/theory/paper.md``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from moteslam.robot.se2 import Poses


def euler_increment(distance: ArrayLike, turn: ArrayLike) -> Poses:
    """Equation III.1 of the paper: drive straight along the old heading, then turn.

    Args:
        distance: v * tau [m], shape [...].
        turn: omega * tau [rad], shape [...].

    Returns:
        increments [..., 3].
    """
    distance, turn = np.asarray(distance, np.float64), np.asarray(turn, np.float64)
    return np.stack(np.broadcast_arrays(distance, np.zeros_like(distance), turn), axis=-1)


def arc_increment(distance: ArrayLike, turn: ArrayLike) -> Poses:
    """The exact arc of constant v and omega (Probabilistic Robotics, table 5.3), straight as the turn goes to 0.

    Args:
        distance: length of the arc [m], shape [...].
        turn: its angle [rad], shape [...].

    Returns:
        increments [..., 3].
    """
    distance, turn = np.asarray(distance, np.float64), np.asarray(turn, np.float64)
    # chord = d sinc(turn / 2), at half the turn: exact, and smooth through zero
    chord = distance * np.sinc(turn / (2 * np.pi))
    return np.stack(np.broadcast_arrays(chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn), axis=-1)


def wheel_motion(left: ArrayLike, right: ArrayLike, track: float) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the centre [m] and turn [rad] from the travel of the left and right wheels [m].

    Args:
        left, right: travel of each side's wheels [m], shape [...].
        track: effective distance between them [m]; on a skid-steered robot larger than the drawn one.
    """
    left, right = np.asarray(left, np.float64), np.asarray(right, np.float64)
    return (left + right) / 2, (right - left) / track
