"""The simulated robot in your hands: it is told how to drive, and reports what its sensors saw since."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.noise import Surroundings
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import expect_type
from moteslam.sim.actors.actors import TRUTH_RATE
from moteslam.sim.robot.drive import CONTROL_STEPS
from moteslam.sim.robot.vehicle import PHYSICS_RATE
from moteslam.sim.scenario import Scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.faults import Cart, Tilt
from moteslam.sim.simulate import Sensors, random_generators, run_of, seeded
from moteslam.sim.world.world import World

LATEST = 5.0
"""Readings are made from so much of the drive [s]: no driver delivers them later."""


@dataclass(frozen=True, eq=False)
class Readings:
    """What has arrived since the step before: streams of a recording, often without a reading.

    Attributes:
        stamp: of the moment, by the clock of the stamps [s].
        lidar, encoders, imu: the readings; no ``imu`` of a robot without one.
    """

    stamp: float
    lidar: LidarStream
    encoders: EncoderStream
    imu: ImuStream | None


class Simulator:
    """The robot of a scenario in its building, among its people and doors, without its route.

    Wheels, contact, sensors and noise are those of ``simulate``, which is a loop over the same physics; the same seed
    and commands give the same bytes.

    Args:
        seed: of all that is random, the scenario's own by default.

    Attributes:
        interval: of a step [s].
        world: the building.

    Raises:
        ConfigError: the scenario has what needs a route or the complete drive: a camera, faults other than ``cart`` and
            ``tilt``, or the noise of things beside the path and of a body that leans.
    """

    interval = CONTROL_STEPS / PHYSICS_RATE

    def __init__(self, scenario: Scenario, seed: int | None = None) -> None:
        expect_type(scenario, Scenario, "scenario", "load_scenario(name) reads one")
        self.scenario = scenario = seeded(scenario, seed)
        noise = scenario.noise
        for field, there in (
            ("faults", [fault for fault in scenario.faults if not isinstance(fault, Cart | Tilt)]),
            ("camera", scenario.camera),
            ("noise.surroundings", noise.surroundings != Surroundings()),
            ("noise.drive", noise.drive.sway or noise.drive.shake),
        ):
            if there:
                raise ConfigError("there is, expected none in a closed loop", field=field)
        self.world = World.of(scenario.standing)
        self.reset()

    def reset(self) -> Readings:
        """Put the robot back to where it starts; nothing has arrived by then."""
        rngs = random_generators(self.scenario.seed)
        self._run, self._scene = run_of(self.scenario, self.world, rngs), Scene(self.world)
        self._sensors = Sensors(self.scenario, self.scenario.duration, rngs)
        return self._readings()

    def step(self, speed: float, turn_rate: float) -> Readings:
        """Ask the motors for a speed [m/s] and a turn rate [rad/s] for an ``interval``.

        They follow as fast as the scenario's ``drive`` lets them accelerate, up to its speed and turn rate.

        Raises:
            ConfigError: no finite numbers, or the scenario's duration is over.
        """
        if not (math.isfinite(speed) and math.isfinite(turn_rate)):
            raise ConfigError(f"{speed}, {turn_rate}, expected finite numbers", field="speed")
        if self.done:
            raise ConfigError(f"{self.scenario.duration:g} s are over, expected a longer one", field="duration")
        limits = self.scenario.drive
        speed = min(max(speed, -limits.speed), limits.speed)
        self._run.ask(speed, min(max(turn_rate, -limits.turn_rate), limits.turn_rate), limits, self.interval)
        for _ in range(CONTROL_STEPS):
            self._run.step()
        return self._readings()

    @property
    def seconds(self) -> float:
        """How long it has driven [s]."""
        return self._run.steps / PHYSICS_RATE

    @property
    def done(self) -> bool:
        """Whether the scenario's duration is over."""
        return self._run.steps + CONTROL_STEPS > round(self.scenario.duration * PHYSICS_RATE)

    @property
    def pose(self) -> NDArray[np.float64]:
        """The true pose [3] now."""
        x, y, theta = self._run.state[:3]
        return np.array((x, y, se2.wrap(theta)))

    @property
    def truth(self) -> Trajectory:
        """The true poses so far, at 100 Hz."""
        driven, every = self._run.driven().truth, PHYSICS_RATE // TRUTH_RATE
        return Trajectory(EPOCH + driven.stamps[::every], driven.poses[::every])

    def _readings(self) -> Readings:
        driven = self._run.driven(seconds=LATEST)
        return Readings(
            EPOCH + self.seconds, *self._sensors.read(driven, self._scene.moved(driven.tracks), self.seconds)
        )
