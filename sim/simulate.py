"""A scenario in, a recording and its truth out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from moteslam.errors import ConfigError
from moteslam.robot.noise import ClockNoise, Noise, Surroundings
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Summarised, expect_type
from moteslam.sim.actors.actors import TRUTH_RATE, Actors, Tracks
from moteslam.sim.robot.drive import Drive, drive
from moteslam.sim.robot.driver import driver_for
from moteslam.sim.robot.mishaps import Carried, Mishap
from moteslam.sim.robot.vehicle import PHYSICS_RATE, Vehicle
from moteslam.sim.scenario import Scenario
from moteslam.sim.sensors.clock import EPOCH, Outage, Stream, with_faults
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.faults import Gap, with_gaps, with_odometry_faults, with_scans_repeated, without_lost_motion
from moteslam.sim.sensors.lidar import LidarErrors, simulate_lidar, tilt_of
from moteslam.sim.sensors.rgbd import CameraFrames, schedule_frames
from moteslam.sim.sensors.wheels_and_gyro import simulate_encoders, simulate_imu
from moteslam.sim.world.floor import FloorSettings, rasterise
from moteslam.sim.world.world import World, lived_in, true_map

Progress = Callable[[str, float], None]
"""Called with what is being done (``drive``, ``lidar``) and the share of it that is done."""

Rngs = dict[str, np.random.Generator]
"""Random generators by concern."""

_CONCERNS = (
    "driver",
    "clocks",
    "lidar",
    "encoders",
    "imu",
    "actors",
    "echoes",
    "wheels",
    "faults",
    "odometry",
    "constants",
    "surroundings",
    "sway",
)
"""What random numbers are drawn for. New ones go to the end: a concern's numbers depend on its place here alone."""


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Summarised):
    """What the sensors recorded, and the truth.

    Attributes:
        recording: the sensors' streams; nothing of the truth is in it.
        truth: the robot's true poses in the world at 100 Hz, over all that the sensors recorded.
        scenario: what was simulated, with the seed that was used.
        world: its standing parts as the lidar saw them: the plan's, and what noise ``as_recorded`` adds to them.
        end: why the drive ended: ``arrived``, ``stuck`` or ``out of time``.
        base: what the robot's own base integrates: without gaps and faults of the odometry.
        tracks: where people and doors were, from the first true pose on.
        frames: the camera's, drawn when they are asked for.
    """

    recording: Recording
    truth: Trajectory
    scenario: Scenario
    world: World
    end: str
    base: Recording
    tracks: Tracks | None = None
    frames: CameraFrames | None = None

    def true_map(self, resolution: float) -> Raster:
        """The true occupancy, cells of a side [m], of what can be reached from the robot's start; see `true_map`."""
        return true_map(self.world, resolution, seen_from=self.truth.poses[:1, :2])

    def true_floor(self, resolution: float) -> Raster:
        """The true colours [H, W, 3] of the floor, a cell of a side [m] the mean of nine points in it."""
        return rasterise(self.scenario.floor or FloorSettings(), self.world.bounds, resolution, samples=3)

    def _summary(self) -> str:
        return f"{self.scenario.name!r}, seed {self.scenario.seed}, {self.end}, truth: {self.truth._summary()}"


def simulate(scenario: Scenario, seed: int | None = None, *, progress: Progress | None = None) -> Simulation:
    """Drive a scenario and record what the sensors see.

    Args:
        seed: of all that is random, the scenario's own by default; the same seed gives the same bytes.
        progress: called now and then.

    Raises:
        ConfigError: a negative seed, or a robot that gets stuck on its route.
    """
    expect_type(scenario, Scenario, "scenario", "load_scenario(name) reads one")
    scenario = _seeded(scenario, seed)
    report = progress or (lambda _what, _share: None)
    rngs = random_generators(scenario.seed)
    world = World.of(scenario.standing)
    driven = _drive(scenario, world, rngs, progress=lambda share: report("drive", share))
    if driven.end == "stuck":
        x, y = driven.poses[-1, :2]
        raise ConfigError(
            f"the robot got stuck near ({x:.2f}, {y:.2f}) after {driven.stamps[-1]:.0f} s, "
            "expected a route it can follow: leave more room, or drive slower",
            field="route",
        )
    report("drive", 1.0)
    _check_starts(scenario, driven)
    if scenario.noise.surroundings != Surroundings():
        path, radius = driven.poses[:: PHYSICS_RATE // 20, :2], scenario.platform.radius
        rng = rngs["surroundings"]
        if scenario.visit is not None:
            rng = random_generators(scenario.visit.building)["surroundings"]
        world = lived_in(world, scenario.noise.surroundings, rng, path=path, radius=radius)
    scene, faults, frames = Scene(world, driven.tracks), scenario.faults, None
    base = without_lost_motion(with_scans_repeated(_record(scenario, driven, scene, rngs, report), faults), faults)
    recording = with_odometry_faults(with_gaps(base, faults), faults)
    if scenario.camera is not None:
        floor, mount = scenario.floor or FloorSettings(), scenario.platform.camera
        frames = schedule_frames(driven, scene, floor, mount, scenario.camera, scenario.seed)
        for gap in faults:
            if isinstance(gap, Gap):
                frames = frames.without(gap)
        recording = recording.replace(rgbd=frames.stream)
    every = PHYSICS_RATE // TRUTH_RATE
    kept = np.unique(np.append(np.arange(0, len(driven.stamps), every), len(driven.stamps) - 1))
    truth = Trajectory(EPOCH + driven.stamps[kept], driven.truth.poses[kept])
    return Simulation(recording, truth, scenario, world, driven.end, base, driven.tracks, frames)


def _drive(
    scenario: Scenario, world: World, rngs: Rngs, *, progress: Callable[[float], None] = lambda _: None
) -> Drive:
    """Let the robot do a scenario's task, among its people and doors, without any sensor."""
    vehicle = Vehicle(scenario.platform, scenario.start, world, scenario.noise.drive)
    actors = None
    if scenario.has_actors:
        actors = Actors(
            scenario.people,
            scenario.crowd,
            scenario.doors,
            world=world,
            space=vehicle.space,
            start=scenario.start[:2],
            duration=scenario.duration,
            rng=rngs["actors"],
        )
    driver = driver_for(scenario.task, scenario.drive, world, rngs["driver"])
    limits, duration = scenario.drive, scenario.duration
    return drive(vehicle, driver, limits, duration, actors=actors, faults=scenario.faults, progress=progress)


def true_drive(scenario: Scenario, seed: int | None = None) -> Drive:
    """What the robot truly does in ``simulate(scenario, seed)``."""
    scenario = _seeded(scenario, seed)
    return _drive(scenario, World.of(scenario.standing), random_generators(scenario.seed))


def _record(scenario: Scenario, driven: Drive, scene: Scene, rngs: Rngs, report: Progress) -> Recording:
    """What lidar, encoders and IMU record of a drive, faults included."""
    platform, noise = scenario.platform, scenario.noise
    spans, scale = _spans(float(driven.stamps[-1]), noise, rngs["clocks"]), noise.odometry_scale
    scans = simulate_lidar(
        driven,
        scene,
        platform.lidar,
        noise.lidar,
        spans["lidar"],
        rngs["lidar"],
        errors=LidarErrors.drawn(noise.lidar, rngs["constants"]),
        tilt=tilt_of(driven, noise.drive, rngs["sway"]) if noise.drive.sway or noise.drive.shake else None,
        faults=scenario.faults,
        effects=rngs["echoes"],
        progress=lambda share: report("lidar", share),
    )
    counts = simulate_encoders(
        driven, platform, noise.encoders, scale, spans["encoders"], rngs["encoders"], effects=rngs["wheels"]
    )
    inertial = None
    if platform.imu is not None:
        inertial = simulate_imu(driven, platform.imu, noise.imu, scale, spans["imu"], rngs["imu"])
    faults = dict(zip(("lidar", "encoders", "imu"), rngs["faults"].spawn(3), strict=True))

    def arrived(sensor: str, stream: Stream, clock: ClockNoise) -> Stream:
        outages: list[Outage | Carried] = [outage for outage in scenario.outages if outage.sensor == sensor]
        if sensor == "lidar":
            outages += [one for one in scenario.faults if isinstance(one, Carried) and one.lidar == "off"]
        if clock.offset_error:
            off = clock.offset + clock.offset_error * rngs["constants"].standard_normal()
            clock = clock.model_copy(update={"offset": off})
        stream = with_faults(stream, clock, outages, faults[sensor])
        return replace(stream, stamps=EPOCH + stream.stamps)

    return Recording(
        name=scenario.name,
        platform=platform,
        lidar=arrived("lidar", scans, noise.lidar.clock),
        encoders=arrived("encoders", counts, noise.encoders.clock),
        imu=None if inertial is None else arrived("imu", inertial, noise.imu.clock),
    )


def _check_starts(scenario: Scenario, driven: Drive) -> None:
    """Refuse a fault that begins after the drive, or a mishap after the robot's arrival.

    A drive that runs out of time may have lost some.
    """
    if driven.end != "arrived":
        return
    end = float(driven.stamps[-1])
    for i, fault in enumerate(scenario.faults):
        last, what = end, "the end of the drive"
        if isinstance(fault, Mishap):
            last, what = end - scenario.drive.rest_end, "the robot's arrival"
        if fault.start >= last:
            raise ConfigError(f"{fault.start:g} s, expected before {what}, {last:.1f} s", field=f"faults.{i}.start")


def _seeded(scenario: Scenario, seed: int | None) -> Scenario:
    if seed is None:
        return scenario
    if not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise ConfigError(f"{seed!r}, expected a whole number from 0 to 2^63 - 1", field="seed")
    return scenario.model_copy(update={"seed": seed})


def _spans(duration: float, noise: Noise, rng: np.random.Generator) -> dict[str, tuple[float, float]]:
    """When each sensor's first and last reading is taken [s]: those of IMU and lidar within those of the encoders."""
    start = 0.1 + rng.uniform(0.0, 0.025)
    end = duration - 0.1
    spans = {"encoders": (start, end)}
    for sensor, clock in (("imu", noise.imu.clock), ("lidar", noise.lidar.clock)):
        spans[sensor] = (start + rng.uniform(*clock.begins), end - rng.uniform(*clock.ends))
    return spans


def random_generators(seed: int) -> Rngs:
    """A random generator a concern: a change to one sensor's noise leaves the others as they were."""
    children = np.random.SeedSequence(seed).spawn(len(_CONCERNS))
    return {concern: np.random.default_rng(child) for concern, child in zip(_CONCERNS, children, strict=True)}
