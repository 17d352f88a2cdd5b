"""The robot of a scenario: which one it is, and what follows from that for noise, camera and speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from moteslam.errors import ConfigError
from moteslam.robot.noise import Noise
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import UCSD, load_platform, whole_platform
from moteslam.robot.tables import Table, merged
from moteslam.sim.robot.limits import MAX_DURATION, Limits

NOISE_CLASSES = ("datasheet", "as_recorded")
"""Whose figures the noise begins with: `Platform.noise` or `Platform.as_recorded`."""


def with_its_robot(values: Table) -> Table:
    """A scenario's table with the robot's own figures below what the table changes of them.

    ``platform`` becomes a whole robot; ``noise`` and ``camera`` lie, key by key, over the robot's; a speed that it
    cannot drive becomes its top speed, and the run may take longer by as much.
    """
    platform = chosen_platform(values.get("platform"))
    values = {**values, "platform": platform}
    noise = values.get("noise")
    if noise is None or isinstance(noise, dict):
        figures = _class_noise(platform, values.get("noise_class", NOISE_CLASSES[0]))
        values["noise"] = merged(figures.model_dump(), noise or {})
    if isinstance(camera := values.get("camera"), dict):
        if platform.camera is None:
            raise ConfigError("none, expected a camera to simulate", field="platform.camera")
        sensor = platform.camera.sensor
        values["camera"] = camera if sensor is None else merged(sensor.model_dump(), camera)
    return _within_reach(values, platform)


def chosen_platform(value: Any) -> Platform:
    """The whole robot that a scenario's ``platform`` is: a name, a path, a table, or the robot itself."""
    if value is None:
        return UCSD
    if isinstance(value, Platform):
        return value
    try:
        if isinstance(value, str | Path):
            return load_platform(value)
        if isinstance(value, dict):
            return whole_platform(value)
    except ConfigError as error:
        if error.file is not None:
            raise
        within = isinstance(value, dict) and error.field
        raise ConfigError(error.problem, field=f"platform.{error.field}" if within else "platform") from error
    raise ConfigError(f"{value!r}, expected a robot's name, a .toml file, or a table", field="platform")


def _class_noise(platform: Platform, name: object) -> Noise:
    if name not in NOISE_CLASSES:
        raise ConfigError(f"{name!r}, expected {' or '.join(NOISE_CLASSES)}", field="noise_class")
    noise = platform.noise if name == NOISE_CLASSES[0] else platform.as_recorded
    if noise is None:
        raise ConfigError(f"{name}, expected a robot with [{name}]; {platform.name} has none", field="noise_class")
    return noise


def _within_reach(values: Table, platform: Platform) -> Table:
    """The table with ``drive`` within the robot's top speeds, and ``duration`` longer by the ratio of the speeds."""
    drive = values.get("drive", {})
    drive = drive.model_dump() if isinstance(drive, Limits) else drive
    if not isinstance(drive, dict):
        return values
    for key, top in (("speed", platform.top_speed), ("turn_rate", platform.top_turn_rate)):
        wanted = drive.get(key, getattr(Limits(), key))
        if top is None or not isinstance(wanted, int | float) or wanted <= top:
            continue
        drive = {**drive, key: top}
        duration = values.get("duration", 600.0)
        if key == "speed" and isinstance(duration, int | float):
            values = {**values, "duration": max(duration, min(duration * wanted / top, MAX_DURATION))}
    return {**values, "drive": drive}
