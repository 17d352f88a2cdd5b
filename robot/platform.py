"""A robot: body, wheels and sensors, where they are, what they measure, and what they get wrong.

A platform comes with a recording (its file, the log's own parameters, or the robot that the format is known for), or
is one of the bundled ones (`moteslam.robot.platforms`). Facts and sources: ``docs/reference/platforms.md``.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator, model_validator

from moteslam.robot.noise import Noise
from moteslam.robot.section import NotNegative, Number, Section
from moteslam.robot.specs import CameraSpec, EncoderSpec, ImuSpec, LidarSpec
from moteslam.robot.tables import merged

Length = Annotated[Number, Field(gt=0, le=100)]


class Wheels(Section):
    """The differential drive of two or four wheels.

    Attributes:
        metres_per_count: travel of a wheel for one encoder count [m].
        diameter: of a wheel [m].
        wheel_base: distance between the axles [m]; 0 for two wheels on one axle, which give their counts twice.
        track: distance between the left and right wheel centres [m].
        effective_track: the track that explains how it turns [m]; a skid-steered robot's is larger than the drawn.
    """

    metres_per_count: Annotated[Number, Field(ge=1e-7, le=10)]
    diameter: Length
    wheel_base: Annotated[Number, Field(ge=0, le=100)]
    track: Length
    effective_track: Annotated[Number, Field(ge=0.001, le=100)]


class Body(Section):
    """The robot as a mass on its wheels.

    Attributes:
        mass: [kg].
        wheel_mass: what a wheel and its motor weigh at the rim, gears included [kg].
        grip: friction of a wheel on the floor, 1 = its share of the weight.
        stiffness: contact force of a wheel for a slip of 1 m/s [N s/m], before the grip gives way.
        wheel_force: the largest force of a motor at the rim [N].
        wall_friction: of the body against what it runs into.
    """

    mass: Annotated[Number, Field(gt=0.1, le=1000)]
    wheel_mass: Annotated[Number, Field(ge=0.01, le=100)]
    grip: Annotated[Number, Field(gt=0, le=2)]
    stiffness: Annotated[Number, Field(gt=0, le=200)]
    wheel_force: Annotated[Number, Field(gt=0, le=1000)]
    wall_friction: NotNegative


class Platform(Section):
    """A robot.

    Attributes:
        name: what it is called.
        description: what it is, one sentence.
        length, width: of the body [m].
        top_speed: that it can drive [m/s]; None where that is not known.
        top_turn_rate: that it can turn with [rad/s]; None where that is not known.
        wheels: None (``false`` in TOML, which has no other word for it) where only odometry poses are known.
        body: its masses and forces; None (``false``) where they are not known.
        lidar: where it stands and what it measures.
        encoders: of the wheels; None (``false``) where they are not known.
        imu: None (``false``) where there is none.
        camera: None (``false``) where there is none.
        noise: of the sensors, as data sheets and careful measurements have it.
        as_recorded: of the sensors and their surroundings, as recordings show it; a table holds what differs from
            ``noise``. None (``false``) where that is not known.
    """

    name: str = "robot"
    description: str = ""
    length: Length = 0.5
    width: Length = 0.5
    top_speed: Annotated[Number, Field(gt=0, le=100)] | None = None
    top_turn_rate: Annotated[Number, Field(gt=0, le=100)] | None = None
    wheels: Wheels | None = None
    body: Body | None = None
    lidar: LidarSpec = LidarSpec()
    encoders: EncoderSpec | None = None
    imu: ImuSpec | None = None
    camera: CameraSpec | None = None
    noise: Noise = Noise()
    as_recorded: Noise | None = None

    @property
    def radius(self) -> float:
        """The radius of the circle about the body [m]."""
        return float(np.hypot(self.length, self.width) / 2)

    @field_validator(
        "top_speed", "top_turn_rate", "wheels", "body", "encoders", "imu", "camera", "as_recorded", mode="before"
    )
    @classmethod
    def _none_of_false(cls, value: Any) -> Any:
        return None if value is False else value

    @model_validator(mode="before")
    @classmethod
    def _over_the_data_sheet(cls, values: Any) -> Any:
        match values:
            case {"as_recorded": dict() as changes}:
                noise = values.get("noise", {})
                noise = noise.model_dump() if isinstance(noise, Noise) else noise
                return {**values, "as_recorded": merged(noise, changes) if isinstance(noise, dict) else changes}
        return values
