"""A scenario in, a recording and its truth out; and both on disk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np
import tomli_w

from moteslam.errors import ConfigError
from moteslam.robot.files import write_atomically
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory, write_tum
from moteslam.sim.drive import Drive, drive
from moteslam.sim.faults import Stream, with_faults
from moteslam.sim.floor import FloorImage, FloorSettings, rasterise, write_floor
from moteslam.sim.movers import Movers
from moteslam.sim.noise import ClockNoise
from moteslam.sim.rates import PHYSICS_RATE, TRUTH_RATE
from moteslam.sim.scenario import Scenario
from moteslam.sim.sensors.encoders import simulate_encoders
from moteslam.sim.sensors.imu import simulate_imu
from moteslam.sim.sensors.lidar import simulate_lidar
from moteslam.sim.sensors.rgbd import Shots, plan_shots, write_shots
from moteslam.sim.truth import TrueMap, true_map, write_true_map
from moteslam.sim.world import World

EPOCH = 1_300_000_000.0
"""The stamp of the drive's first moment [s since 1970], so that stamps are as coarse as a real robot's."""

Progress = Callable[[str, float], None]
"""Told what is being done (``drive``, ``lidar``) and the share of it that is done."""

_CONCERNS = ("driver", "clocks", "lidar", "encoders", "imu", "others", "echoes", "wheels", "faults")
"""What random numbers are drawn for. New ones go to the end: a concern's numbers depend on its place here alone."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """What the sensors saw, and what was so.

    Attributes:
        recording: the sensors' streams; nothing of the truth is in it.
        truth: the robot's true poses in the world at 100 Hz, over all that the sensors saw.
        scenario: what was simulated, with the seed that was used.
        end: why the drive ended: ``arrived``, ``stuck`` or ``out of time``.
        movers: where people and doors were, from the first true pose on; None where there are none.
        shots: the camera's frames, drawn when they are written; None where it records none.
    """

    recording: Recording
    truth: Trajectory
    scenario: Scenario
    end: str
    movers: Movers | None = None
    shots: Shots | None = None

    @property
    def world(self) -> World:
        """The true world, what stands of it."""
        return World.of(self.scenario.world)

    def true_map(self, resolution: float) -> TrueMap:
        """The true occupancy of what stands, as far as a way leads there from the robot's.

        Args:
            resolution: a cell's side [m].

        Raises:
            ConfigError: a resolution that is not positive, or too fine.
        """
        return true_map(self.world, resolution, seen_from=self.truth.poses[:1, :2])

    def true_floor(self, resolution: float) -> FloorImage:
        """The true colours of the floor of the whole world, a cell the mean of nine points in it.

        Args:
            resolution: a cell's side [m].

        Raises:
            ConfigError: too fine, or a floor's picture that cannot be read.
        """
        return rasterise(self.scenario.floor or FloorSettings(), self.world.bounds, resolution, samples=3)


def simulate(scenario: Scenario, seed: int | None = None, *, progress: Progress | None = None) -> Simulation:
    """Drive a scenario and record what the sensors see.

    Args:
        scenario: as `load_scenario` gives it.
        seed: of all that is random, the scenario's own by default; the same seed gives the same bytes.
        progress: called now and then.

    Raises:
        ConfigError: a negative seed, or a robot that gets stuck on its route.
    """
    scenario = _seeded(scenario, seed)
    wheels, noise = scenario.platform.wheels, scenario.noise
    assert wheels is not None  # a scenario without is refused
    say = progress or (lambda _what, _share: None)
    chance = _chances(scenario.seed)
    world = World.of(scenario.world)
    driven = drive(
        scenario, world, chance["driver"], others=chance["others"], progress=lambda share: say("drive", share)
    )
    if driven.end == "stuck":
        x, y = driven.poses[-1, :2]
        raise ConfigError(
            f"the robot got stuck near ({x:.2f}, {y:.2f}) after {driven.stamps[-1]:.0f} s, "
            "expected a route it can follow: leave more room, or drive slower",
            field="route",
        )
    say("drive", 1.0)
    spans = _spans(float(driven.stamps[-1]), chance["clocks"])
    scans = simulate_lidar(
        driven,
        world,
        scenario.platform.lidar,
        noise.lidar,
        spans["lidar"],
        chance["lidar"],
        effects=chance["echoes"],
        progress=lambda share: say("lidar", share),
    )
    counts = simulate_encoders(
        driven, wheels, noise.encoders, noise.odometry_scale, spans["encoders"], chance["encoders"],
        effects=chance["wheels"],
    )  # fmt: skip
    inertial = simulate_imu(driven, noise.imu, noise.odometry_scale, spans["imu"], chance["imu"])

    faults = dict(zip(("lidar", "encoders", "imu"), chance["faults"].spawn(3), strict=True))

    def arrived(sensor: str, stream: Stream, clock: ClockNoise) -> Stream:
        outages = [outage for outage in scenario.outages if outage.sensor == sensor]
        return _at_epoch(with_faults(stream, clock, outages, faults[sensor]))

    shots = None
    if scenario.camera is not None:
        floor = scenario.floor or FloorSettings()
        shots = plan_shots(
            driven, world, floor, scenario.platform.camera, scenario.camera, scenario.seed, epoch=EPOCH
        )  # fmt: skip
    recording = Recording(
        name=scenario.name,
        platform=scenario.platform,
        lidar=arrived("lidar", scans, noise.lidar.clock),
        encoders=arrived("encoders", counts, noise.encoders.clock),
        imu=arrived("imu", inertial, noise.imu.clock),
        rgbd=None if shots is None else shots.stream,
    )
    every = PHYSICS_RATE // TRUTH_RATE
    kept = np.unique(np.append(np.arange(0, len(driven.stamps), every), len(driven.stamps) - 1))
    truth = Trajectory(EPOCH + driven.stamps[kept], driven.truth.poses[kept])
    return Simulation(recording, truth, scenario, driven.end, driven.movers, shots)


def true_drive(scenario: Scenario, seed: int | None = None) -> Drive:
    """What the robot truly does in ``simulate(scenario, seed)``, without any sensor.

    Raises:
        ConfigError: a negative seed.
    """
    scenario = _seeded(scenario, seed)
    chance = _chances(scenario.seed)
    return drive(scenario, World.of(scenario.world), chance["driver"], others=chance["others"])


def _seeded(scenario: Scenario, seed: int | None) -> Scenario:
    if seed is None:
        return scenario
    if not 0 <= seed < 2**63:
        raise ConfigError(f"{seed}, expected 0 or more", field="seed")
    return scenario.model_copy(update={"seed": seed})


def write_simulation(
    folder: str | PathLike[str],
    simulation: Simulation,
    *,
    sequence: str = "20",
    map_resolution: float | None = None,
    progress: Progress | None = None,
    tell: Callable[[str], None] | None = None,
) -> None:
    """Write a simulation as a folder in the UCSD layout, which reads back equal.

    Beside the arrays and ``platform.toml`` go ``truth.tum`` and ``scenario.toml``, and, where it is asked for,
    ``truth_map.pgm`` with its ``.yaml``. Where a camera records, its images go to ``dataRGBD/``, and with the true map
    comes ``truth_floor.png`` with its ``.yaml``.

    Args:
        folder: exists.
        simulation: what to write.
        sequence: the number in the file names.
        map_resolution: of the true map [m]; None for no such map.
        progress: told the share of the images (``images``) that is written.
        tell: told, before the first image is written, how large all will be.

    Raises:
        ConfigError: a resolution that is not positive, or too fine.
        OutputError: the folder is missing or read-only, or the disk is full.
    """
    from moteslam.robot.formats.ucsd import write_ucsd

    write_ucsd(folder, simulation.recording, sequence=sequence)
    if simulation.shots is not None:
        say = progress or (lambda _what, _share: None)
        write_shots(Path(folder), simulation.shots, sequence, tell=tell, progress=lambda share: say("images", share))
    write_tum(Path(folder) / "truth.tum", simulation.truth)
    write_atomically(Path(folder) / "scenario.toml", tomli_w.dumps(simulation.scenario.model_dump(exclude_none=True)))
    if map_resolution is not None:
        write_true_map(Path(folder) / "truth_map.pgm", simulation.true_map(map_resolution))
        if simulation.shots is not None:
            write_floor(Path(folder) / "truth_floor.png", simulation.true_floor(map_resolution))


def _spans(duration: float, rng: np.random.Generator) -> dict[str, tuple[float, float]]:
    """When each sensor's first and last reading is taken [s].

    As measured on the real robot: the IMU starts 0.3 to 0.5 s after the encoders, which end 1.4 to 1.6 s after it.
    """
    start = 0.1 + rng.uniform(0.0, 0.025)
    end = duration - 0.1
    return {
        "encoders": (start, end),
        "imu": (start + rng.uniform(0.3, 0.5), end - rng.uniform(1.4, 1.6)),
        "lidar": (start + rng.uniform(0.05, 0.25), end - rng.uniform(0.2, 1.0)),
    }


def _chances(seed: int) -> dict[str, np.random.Generator]:
    """A stream of random numbers a concern: a change to one sensor's noise leaves the others as they were."""
    children = np.random.SeedSequence(seed).spawn(len(_CONCERNS))
    return {concern: np.random.default_rng(child) for concern, child in zip(_CONCERNS, children, strict=True)}


def _at_epoch(stream: Stream) -> Stream:
    """The stream with its stamps in Unix seconds."""
    return replace(stream, stamps=EPOCH + stream.stamps)
