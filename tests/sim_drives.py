"""A drive too simple to need physics, and a small scenario, for tests of the simulator."""

from typing import Any

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


def room_table() -> dict[str, Any]:
    """A room of 10 m by 8 m with a route across it, as TOML gives it."""
    return {
        "world": {"rooms": [{"corner": [0.0, 0.0], "size": [10.0, 8.0]}]},
        "route": {"waypoints": [[2.0, 2.0], [7.0, 2.0], [7.0, 6.0]]},
        "drive": {"rest_start": 1.0, "rest_end": 2.0},
    }
