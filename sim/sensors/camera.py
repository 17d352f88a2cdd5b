"""What a simulated RGB-D camera is like: its rate, noise and limits; ``[camera]`` in a scenario."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.platform import CameraMount
from moteslam.robot.section import NotNegative, Number, Positive, Section, Share, Whole
from moteslam.sim.sensors.clock import ClockNoise

MAX_HEIGHT = 10.0
"""Of the camera above the floor [m]."""


class CameraSettings(Section):
    """The Kinect of the UCSD robot.

    Attributes:
        rate: frames a second of either camera, when none is lost [Hz] (data sheet and measured: 30).
        gap: probability that the frames after one are lost (measured: 0.14 to 0.16 of all intervals).
        gap_frames: how many are lost then (measured: intervals of 0.2 s, so 5).
        disparity_noise: standard deviation of a raw disparity before rounding (Khoshelham and Elberink 2012: 1.4 mm
            at 1 m, growing with the square of the depth, which is half a step of this sensor).
        nearest, farthest: depths that it can measure [m] (the sensor's mode; its data sheet promises 0.8 to 4.0).
        dropout: probability that a pixel has no depth.
        grazing: floor met at a smaller slope than this sends nothing back [m/m]: 0.05 is 7.2 m away for this mount.
        colour_noise: standard deviation of a colour level.
        clock: of the frames (measured: intervals of 33.2 ms, 1 % of them below 32 or above 35).
    """

    rate: Annotated[Number, Field(gt=0, le=120)] = 30.0
    gap: Share = 0.15
    gap_frames: Annotated[Whole, Field(ge=0, le=1000)] = 5
    disparity_noise: NotNegative = 0.5
    nearest: Positive = 0.4
    farthest: Positive = 8.0
    dropout: Share = 0.02
    grazing: NotNegative = 0.05
    colour_noise: Annotated[Number, Field(ge=0, le=100)] = 2.0
    clock: ClockNoise = ClockNoise(jitter=0.0003, late=0.005, late_delay=0.01, burst_interval=0.027, rate_error=2e-4)

    @model_validator(mode="after")
    def _can_measure_something(self) -> CameraSettings:
        if self.nearest >= self.farthest:
            raise ValueError(f"nearest of {self.nearest:g} m, expected less than farthest, {self.farthest:g} m")
        return self


def check_camera(mount: CameraMount | None) -> CameraMount:
    """The mount of a camera that can record.

    Raises:
        ConfigError: the platform has no camera, or not above the floor.
    """
    if mount is None:
        raise ConfigError("none, expected a camera to simulate", field="platform.camera")
    if not 0 < mount.z <= MAX_HEIGHT:
        raise ConfigError(f"{mount.z:g} m, expected above 0, up to {MAX_HEIGHT:g}", field="platform.camera.z")
    return mount
