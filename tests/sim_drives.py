"""Drives too simple to need physics, for tests of the sensors."""

from __future__ import annotations

import numpy as np
from ucsd_robot import WHEELS

from moteslam.sim.robot.drive import Drive


def steady(seconds: float, *, speed: float = 0.0, turn_rate: float = 0.0) -> Drive:
    """A robot whose wheels do not slip, at one speed [m/s] or turning on the spot [rad/s]."""
    assert not (speed and turn_rate)
    stamps = np.arange(round(seconds * 400) + 1) / 400
    zeros, side = np.zeros_like(stamps), turn_rate * WHEELS.effective_track / 2
    return Drive(
        stamps,
        poses=np.stack((speed * stamps, zeros, turn_rate * stamps), axis=1),
        velocities=np.stack((zeros + speed, zeros, zeros + turn_rate), axis=1),
        wheel_travel=stamps[:, None] * np.array((speed + side, speed - side, speed + side, speed - side)),
        end="arrived",
    )
