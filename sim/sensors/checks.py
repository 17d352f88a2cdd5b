"""Checks that the sensors are known and on the robot, and that the lidar's sweep fits between two scans."""

from __future__ import annotations

import numpy as np

from moteslam.errors import ConfigError
from moteslam.robot.platform import CameraSpec, Platform

MAX_REACH = 2.0
"""Of a sensor's mount from the robot's centre [m]."""
MAX_HEIGHT = 10.0
"""Of the camera above the floor [m]."""


def check_sensors(platform: Platform) -> None:
    """Refuse sensors that are not known or far from the robot, and a sweep that takes longer than a scan's interval.

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
    if platform.encoders is None:
        raise ConfigError("none, expected wheels with encoders", field="platform.encoders")
    scan = platform.lidar.scan
    sweep = platform.lidar.time_increment * (scan.beams - 1)
    if sweep > 1 / scan.rate:
        raise ConfigError(
            f"{scan.beams} beams take {sweep:g} s, expected at most the {1 / scan.rate:g} s between two scans",
            field="platform.lidar.time_increment",
        )


def check_camera(camera: CameraSpec | None) -> CameraSpec:
    """A camera that can record.

    Raises:
        ConfigError: the platform has no camera, or not above the floor.
    """
    if camera is None:
        raise ConfigError("none, expected a camera to simulate", field="platform.camera")
    if not 0 < camera.z <= MAX_HEIGHT:
        raise ConfigError(f"{camera.z:g} m, expected above 0, up to {MAX_HEIGHT:g}", field="platform.camera.z")
    return camera
