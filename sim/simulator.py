"""The simulated robot in your hands: it is told how to drive, and reports what its sensors saw since."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.robot import se2
from moteslam.robot.noise import Surroundings
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, Recording, RgbdStream
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import expect_type, shortened
from moteslam.sim.actors.actors import TRUTH_RATE
from moteslam.sim.robot.drive import CONTROL_STEPS
from moteslam.sim.robot.mishaps import Carried
from moteslam.sim.robot.vehicle import PHYSICS_RATE
from moteslam.sim.scenario import Scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.faults import with_gaps, with_odometry_faults
from moteslam.sim.simulate import Sensors, on_its_way, random_generators, run_of, seeded
from moteslam.sim.world.world import World

LATEST = 5.0  # Readings are made from so much of the drive [s]: no driver delivers them later


@dataclass(frozen=True, eq=False)
class Readings:
    """What has arrived since the step before: streams of a recording, often without a reading."""

    stamp: float  # of the moment, by the clock of the stamps [s]
    lidar: LidarStream
    encoders: EncoderStream
    imu: ImuStream | None  # None of a robot without one
    rgbd: RgbdStream | None = None  # None of a scenario without a camera; images are drawn when they are asked for


class Simulator:
    """The robot of a scenario in its building, among its people and doors, without its route.

    Wheels, contact, sensors, noise and faults are those of ``simulate``, which is a loop over the same physics; the
    same seed and commands give the same bytes. What noise adds to the walls is what it adds there, where the scenario's
    own driver does not run into it; here the robot may.

    ``seed``: of all that is random, the scenario's own by default.

    Attributes:
        interval: of a step [s].
        world: the building.

    Raises ``ConfigError``: the robot is to be carried along a route, which it does not have here.
    """

    interval = CONTROL_STEPS / PHYSICS_RATE

    def __init__(self, scenario: Scenario, seed: int | None = None) -> None:
        expect_type(scenario, Scenario, "scenario", "load_scenario(name) reads one")
        self.scenario = scenario = seeded(scenario, seed)
        for i, fault in enumerate(scenario.faults):
            if isinstance(fault, Carried) and fault.to is None:
                text = "missing, expected where the robot is set down: in a closed loop it has no route"
                raise ConfigError(text, field=f"faults.{i}.to")
        self._plan = self.world = World.of(scenario.standing)
        if scenario.noise.surroundings != Surroundings():
            _, self.world = on_its_way(scenario, self._plan)
        self.reset()

    def reset(self) -> Readings:
        """Put the robot back to where it starts; nothing has arrived by then."""
        rngs = random_generators(self.scenario.seed)
        self._run = run_of(self.scenario, self._plan, rngs, self.world)
        self._sensors = Sensors(self.scenario, self.scenario.duration, rngs)
        self._counted, self._given = EncoderStream(np.empty(0), np.empty((0, 4), np.int64)), 0
        return self._readings()

    def step(self, speed: float, turn_rate: float) -> Readings:
        """Ask the motors for a speed [m/s] and a turn rate [rad/s] for an ``interval``.

        They follow as fast as the scenario's ``drive`` lets them accelerate, up to its speed and turn rate.

        Raises:
            InputError: no finite numbers.
            ConfigError: the scenario's duration is over.
        """
        for field, asked in (("speed", speed), ("turn_rate", turn_rate)):
            if not (isinstance(asked, Real) and math.isfinite(asked)):
                raise InputError(f"{shortened(asked)}, expected a finite number", field=field)
        if self.done:
            raise ConfigError(f"{self.scenario.duration:g} s are over, expected a longer one", field="duration")
        limits = self.scenario.drive
        speed = min(max(speed, -limits.speed), limits.speed)
        self._run.ask(speed, min(max(turn_rate, -limits.turn_rate), limits.turn_rate), limits, self.interval)
        for _ in range(CONTROL_STEPS):
            self._run.step()
        return self._readings()

    def recording(self, readings: Sequence[Readings]) -> Recording:
        """All that was read since the reset, in order, as one recording without images: to be written, or run."""
        name, platform = self.scenario.name, self.scenario.platform
        joined = {of: _joined([getattr(each, of) for each in readings]) for of in ("lidar", "encoders", "imu")}
        return Recording(name, platform, **joined)

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
        base, frames = self._sensors.read(driven, Scene(self.world, driven.tracks), self.seconds)
        faults, old, new = self.scenario.faults, self._counted, base.encoders
        assert new is not None
        if faults:  # what is held back of the counts comes with a later reading
            self._counted = EncoderStream(np.append(old.stamps, new.stamps), np.vstack((old.counts, new.counts)))
            base = with_odometry_faults(with_gaps(base.replace(encoders=self._counted), faults), faults)
            assert base.encoders is not None
            new = base.encoders.take(np.arange(self._given, len(base.encoders)))
            self._given = len(base.encoders)
        assert base.lidar is not None
        drawn = None if frames is None else frames.drawn
        return Readings(EPOCH + self.seconds, base.lidar, new, base.imu, drawn)


def _joined(parts: Sequence[Any]) -> Any:
    """One stream of several, one after the other; None of none."""
    if not parts or parts[0] is None:
        return None
    arrays = [name for name, value in vars(parts[0]).items() if isinstance(value, np.ndarray)]
    return replace(parts[0], **{name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays})
