"""Roll and pitch while driving: a body that leans in bends, dips when it brakes, and shakes with its speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.noise import DriveNoise
from moteslam.sim.robot.drive import Drive

SETTLES = 0.1
"""Time in which the body follows an acceleration, and over which it shakes alike [s]."""


def tilt_of(drive: Drive, noise: DriveNoise, rng: np.random.Generator) -> NDArray[np.float64]:
    """Roll (to the right positive) and pitch (down positive) [n, 2] at the drive's stamps [rad].

    Args:
        drive: what the robot truly did.
        noise: ``sway`` and ``shake``.
        rng: drawn from.
    """
    from scipy.signal import lfilter

    step = float(drive.stamps[1] - drive.stamps[0])
    keep = np.exp(-step / SETTLES)
    theta, (vx, vy) = drive.poses[:, 2], drive.velocities[:, :2].T
    ax, ay = (np.gradient(component, step) for component in (vx, vy))
    forward, left = np.cos(theta) * ax + np.sin(theta) * ay, np.cos(theta) * ay - np.sin(theta) * ax
    leans = noise.sway * np.stack((left, -forward), axis=1)
    leans = lfilter([1.0 - keep], [1.0, -keep], leans, axis=0)
    white = np.sqrt(1 - keep**2) * rng.standard_normal((len(theta), 2))
    shaken = noise.shake * np.hypot(vx, vy)[:, None] * lfilter([1.0], [1.0, -keep], white, axis=0)
    return np.asarray(leans + shaken, np.float64)
