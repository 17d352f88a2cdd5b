"""Parameters of the motion noise and of the calibration of odometry."""

from __future__ import annotations

from moteslam.robot.tables import NotNegative, Positive, Section, Truth


class MotionNoise(Section):
    """Standard deviations of the Gaussian noise that prediction adds to the control (epsilon in II.6, III.3).

    The paper's noise is constant in (v, omega): the first two. The others grow with the motion itself, so that logs
    whose stamps carry no time (equal ones, one a second) spread too (alpha 1 to 4 of Probabilistic Robotics, 5.3).
    """

    velocity: NotNegative = 0.0
    """Noise on the velocity [m/s]."""
    yaw_rate: NotNegative = 0.0
    """Noise on the yaw rate [rad/s]."""
    translation_from_translation: NotNegative = 0.0
    """Noise along the path, as a share of the distance [m/m] (alpha 3)."""
    translation_from_rotation: NotNegative = 0.0
    """Noise of the position for a turn [m/rad] (alpha 4)."""
    rotation_from_translation: NotNegative = 0.0
    """Noise of the heading for a distance [rad/m] (alpha 2)."""
    rotation_from_rotation: NotNegative = 0.0
    """Noise of the heading, as a share of the turn [rad/rad] (alpha 1)."""


class CalibrationConfig(Section):
    """Calibration of the odometry while driving: four gains, each a small Kalman filter."""

    enabled: Truth = True
    """Estimate the odometry's systematic errors and correct them."""
    scale: Positive = 0.05
    """Prior standard deviation of the scale error of distances and of turns [m/m], [rad/rad]."""
    curvature: Positive = 0.02
    """Prior standard deviation of the curvature of a path that is straight by the odometry [rad/m]."""
    lidar_offset: Positive = 0.1
    """Prior standard deviation of how far the lidar is ahead of where the recording says, seen from the axle [m]."""
    change: NotNegative = 0.001
    """Standard deviation by which these gains change over a metre [1/sqrt(m)]."""
    translation: Positive = 0.005
    """Standard deviation of the odometry's random error of one motion, at rest [m]."""
    translation_from_translation: NotNegative = 0.03
    """Added to that for every metre [m/m]."""
    rotation: Positive = 0.01
    """Standard deviation of the random error of its heading, at rest [rad]."""
    rotation_from_rotation: NotNegative = 0.1
    """Added to that for every radian [rad/rad]."""
    gate: Positive = 3.0
    """Validation gate: an innovation of more standard deviations is left out; wheels slipped."""
