"""Checks that the sensors are on the robot, and that the lidar's sweep fits between two scans."""

from __future__ import annotations

import numpy as np

from moteslam.errors import ConfigError
from moteslam.robot.platform import Platform
from moteslam.sim.sensors.lidar import BEAMS, LIDAR_RATE

MAX_REACH = 2.0
"""Of a sensor's mount from the robot's centre [m]."""


def check_mounts(platform: Platform) -> None:
    """Refuse a lidar or camera far from the robot, and a sweep that takes longer than a scan's interval.

    Raises:
        ConfigError: the first that is wrong.
    """
    for sensor, mount in (("lidar", platform.lidar), ("camera", platform.camera)):
        if mount is not None and (away := float(np.hypot(mount.x, mount.y))) > MAX_REACH:
            axis = "x" if abs(mount.x) >= abs(mount.y) else "y"
            raise ConfigError(
                f"{away:g} m from the robot's centre, expected at most {MAX_REACH:g} m",
                field=f"platform.{sensor}.{axis}",
            )
    sweep = platform.lidar.time_increment * (BEAMS - 1)
    if sweep > 1 / LIDAR_RATE:
        raise ConfigError(
            f"{BEAMS} beams take {sweep:g} s, expected at most the {1 / LIDAR_RATE:g} s between two scans",
            field="platform.lidar.time_increment",
        )
