"""A drive too simple to need physics, and a small scenario, for tests of the simulator."""

from dataclasses import replace
from typing import Any

import numpy as np
from ucsd_robot import WHEELS

from moteslam.sim.actors.actors import Tracks
from moteslam.sim.robot.drive import Drive


def moving(
    start: tuple[float, float, float],
    velocity: tuple[float, float, float],
    seconds: float,
    tracks: Tracks | None = None,
) -> Drive:
    """A robot that moves evenly, x and y and heading alike."""
    stamps = np.arange(round(seconds * 400) + 1) / 400
    poses, speeds = np.asarray(start) + stamps[:, None] * np.asarray(velocity), np.tile(velocity, (len(stamps), 1))
    return Drive(stamps, poses, speeds.astype(float), np.zeros((len(stamps), 4)), "arrived", tracks)


def steady(seconds: float, *, speed: float = 0.0, turn_rate: float = 0.0) -> Drive:
    """A robot whose wheels do not slip, at one speed [m/s] or turning on the spot [rad/s]."""
    assert not (speed and turn_rate)
    drive, side = moving((0.0, 0.0, 0.0), (speed, 0.0, turn_rate), seconds), turn_rate * WHEELS.effective_track / 2
    travel = drive.stamps[:, None] * np.array((speed + side, speed - side, speed + side, speed - side))
    return replace(drive, wheel_travel=travel)


def room_table() -> dict[str, Any]:
    """A room of 10 m by 8 m with a route across it, as TOML gives it."""
    return {
        "world": {"rooms": [{"corner": [0.0, 0.0], "size": [10.0, 8.0]}]},
        "route": {"waypoints": [[2.0, 2.0], [7.0, 2.0], [7.0, 6.0]]},
        "drive": {"rest_start": 1.0, "rest_end": 2.0},
    }
