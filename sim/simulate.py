"""A scenario in, a recording and its truth out."""

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
from moteslam.sim.robot.drive import Drive, Run, drive
from moteslam.sim.robot.driver import check_moves, driver_for
from moteslam.sim.robot.mishaps import Carried, Mishap
from moteslam.sim.robot.vehicle import PHYSICS_RATE, Vehicle
from moteslam.sim.scenario import Scenario
from moteslam.sim.sensors.clock import EPOCH, Outage, Stream, arrived, with_faults
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.faults import Gap, Repeating, with_gaps, with_odometry_faults, without_lost_motion
from moteslam.sim.sensors.lidar import Lidar, LidarErrors, tilt_of
from moteslam.sim.sensors.rgbd import Camera, CameraFrames
from moteslam.sim.sensors.wheels_and_gyro import Encoders, Imu
from moteslam.sim.world.floor import FloorSettings, rasterise
from moteslam.sim.world.world import World, lived_in, true_map

Progress = Callable[[str, float], None]
"""Called with what is being done (``drive``, ``lidar``) and the share of it that is done."""

Rngs = dict[str, np.random.Generator]  # Random generators by concern

_CONCERNS = "driver clocks lidar encoders imu actors echoes wheels faults odometry constants surroundings sway"
"""What random numbers are drawn for. New ones go to the end: a concern's numbers depend on its place here alone."""


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Summarised):
    """What the sensors recorded, and the truth."""

    recording: Recording  # the sensors' streams; nothing of the truth is in it
    truth: Trajectory  # the robot's true poses in the world at 100 Hz, over all that the sensors recorded
    scenario: Scenario  # what was simulated, with the seed that was used
    world: World  # its standing parts as the lidar saw them: the plan's, and what noise ``as_recorded`` adds to them
    end: str  # why the drive ended: ``arrived``, ``stuck`` or ``out of time``
    base: Recording  # what the robot's own base integrates: without gaps and faults of the odometry
    tracks: Tracks | None = None  # where people and doors were, from the first true pose on
    frames: CameraFrames | None = None  # the camera's, drawn when they are asked for

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

    Raises ``ConfigError``: a negative seed, a duration of rests alone, or a robot that gets stuck on its route.
    """
    expect_type(scenario, Scenario, "scenario", "load_scenario(name) reads one")
    scenario = seeded(scenario, seed)
    report = progress or (lambda _what, _share: None)
    driven, world = on_its_way(scenario, World.of(scenario.standing), lambda share: report("drive", share))
    report("drive", 1.0)
    _check_starts(scenario, driven)
    sensors = Sensors(scenario, float(driven.stamps[-1]), random_generators(scenario.seed))
    base, frames = sensors.read(driven, Scene(world, driven.tracks), progress=lambda share: report("lidar", share))
    recording = with_odometry_faults(with_gaps(base, scenario.faults), scenario.faults)
    if frames is not None:
        recording = recording.replace(rgbd=frames.stream)
    every = PHYSICS_RATE // TRUTH_RATE
    kept = np.unique(np.append(np.arange(0, len(driven.stamps), every), len(driven.stamps) - 1))
    truth = Trajectory(EPOCH + driven.stamps[kept], driven.truth.poses[kept])
    return Simulation(recording, truth, scenario, world, driven.end, base, driven.tracks, frames)


def on_its_way(
    scenario: Scenario, world: World, progress: Callable[[float], None] = lambda _: None
) -> tuple[Drive, World]:
    """The drive of a scenario's own driver, and the world as the sensors see it, with what stands beside its way."""
    driven = true_drive(scenario, world=world, progress=progress)
    if driven.end == "stuck":
        x, y = driven.poses[-1, :2]
        raise ConfigError(
            f"the robot got stuck near ({x:.2f}, {y:.2f}) after {driven.stamps[-1]:.0f} s, "
            "expected a route it can follow: leave more room, or drive slower",
            field="route",
        )
    if scenario.noise.surroundings != Surroundings():
        path, radius = driven.poses[:: PHYSICS_RATE // 20, :2], scenario.platform.radius
        seed = scenario.seed if scenario.visit is None else scenario.visit.building
        rng = random_generators(seed)["surroundings"]
        world = lived_in(world, scenario.noise.surroundings, rng, path=path, radius=radius)
    return driven, world


def true_drive(
    scenario: Scenario,
    seed: int | None = None,
    *,
    world: World | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Drive:
    """What the robot truly does in ``simulate(scenario, seed)``, in a world that may be given, without any sensor."""
    scenario = seeded(scenario, seed)
    check_moves(scenario.drive, scenario.duration)
    rngs, world = random_generators(scenario.seed), world or World.of(scenario.standing)
    driver = driver_for(scenario.task, scenario.drive, world, rngs["driver"])
    return drive(run_of(scenario, world, rngs), driver, scenario.drive, scenario.duration, progress=progress)


def run_of(scenario: Scenario, world: World, rngs: Rngs, met: World | None = None) -> Run:
    """The robot at its start among the people and doors of a scenario; what it runs into may be more (``met``)."""
    vehicle = Vehicle(scenario.platform, scenario.start, met or world, scenario.noise.drive)
    actors = None
    moving = scenario.people, scenario.crowd, scenario.doors
    if any(moving):
        start, space = scenario.start[:2], vehicle.space
        rng, duration = rngs["actors"], scenario.duration
        actors = Actors(*moving, world=world, space=space, start=start, duration=duration, rng=rng)
    return Run(vehicle, actors, scenario.faults)


class Sensors:
    """Lidar, encoders, IMU and camera of a robot, faults included; what is random of their clocks is drawn beforehand.

    ``seconds``: what they record lies within so many of the drive's start.
    """

    def __init__(self, scenario: Scenario, seconds: float, rngs: Rngs) -> None:
        self._scenario, platform = scenario, scenario.platform
        noise, constants = scenario.noise, rngs["constants"]
        spans, scale = _spans(seconds, noise, rngs["clocks"]), noise.odometry_scale
        self._lidar = Lidar(
            platform.lidar,
            noise.lidar,
            spans["lidar"],
            rngs["lidar"],
            errors=LidarErrors.drawn(noise.lidar, constants),
            faults=scenario.faults,
            effects=rngs["echoes"],
        )
        self._encoders = Encoders(
            platform, noise.encoders, scale, spans["encoders"], rngs["encoders"], effects=rngs["wheels"]
        )
        self._imu = None
        if platform.imu is not None:
            self._imu = Imu(platform.imu, noise.imu, scale, spans["imu"], rngs["imu"])
        self._repeating, self._camera = Repeating(scenario.faults), None
        if scenario.camera is not None:
            floor = scenario.floor or FloorSettings()
            self._camera = Camera(platform.camera, scenario.camera, floor, seconds, scenario.seed)
        self._shaken = None
        if noise.drive.sway or noise.drive.shake:
            self._shaken = rngs["sway"].standard_normal((round(seconds * PHYSICS_RATE) + 1, 2))
        clocks = noise.lidar.clock, noise.encoders.clock, noise.imu.clock
        self._clocks: dict[str, tuple[ClockNoise, list[Outage | Carried], np.random.Generator]] = {}
        for sensor, clock, rng in zip(("lidar", "encoders", "imu"), clocks, rngs["faults"].spawn(3), strict=True):
            lost: list[Outage | Carried] = [one for one in scenario.outages if one.sensor == sensor]
            if sensor == "lidar":
                lost += [one for one in scenario.faults if isinstance(one, Carried) and one.lidar == "off"]
            if clock.offset_error and (sensor != "imu" or self._imu is not None):
                error = clock.offset_error * constants.standard_normal()
                clock = clock.model_copy(update={"offset": clock.offset + error})
            self._clocks[sensor] = clock, lost, rng

    def read(
        self, driven: Drive, scene: Scene, until: float = np.inf, *, progress: Callable[[float], None] = lambda _: None
    ) -> tuple[Recording, CameraFrames | None]:
        """What has arrived since this was asked last, until a time [s], as the base gets it; and the camera's."""
        scenario, lidar, encoders, imu, tilt = self._scenario, self._lidar, self._encoders, self._imu, None
        spec, faults = scenario.platform.lidar, scenario.faults
        scans = arrived(lidar.times + spec.time_increment * (spec.scan.beams - 1), lidar.stamps, until)
        if self._shaken is not None and len(driven.stamps) > 1:
            first = round(float(driven.stamps[0]) * PHYSICS_RATE)
            tilt = tilt_of(driven, scenario.noise.drive, self._shaken[first : first + len(driven.stamps)])
        seen = lidar.read(driven, scene, scans, tilt=tilt, progress=progress)
        counts = encoders.read(driven, arrived(encoders.times, encoders.stamps, until))
        whole = Recording(
            scenario.name,
            scenario.platform,
            lidar=self._repeating.sent(self._stamped("lidar", seen)),
            encoders=self._stamped("encoders", counts),
        )
        if imu is not None:
            inertial = imu.read(driven, arrived(imu.times, imu.stamps, until))
            whole = whole.replace(imu=self._stamped("imu", inertial))
        frames = None if self._camera is None else self._camera.read(driven, scene, until)
        for fault in faults:
            if frames is not None and isinstance(fault, Gap):
                frames = frames.without(fault)
        return without_lost_motion(whole, faults), frames

    def _stamped(self, sensor: str, stream: Stream) -> Stream:
        stream = with_faults(stream, *self._clocks[sensor])
        return replace(stream, stamps=EPOCH + stream.stamps)


def _check_starts(scenario: Scenario, driven: Drive) -> None:
    """Refuse an outage or a fault that begins after the drive, or a mishap after the robot's arrival.

    A drive that runs out of time may have lost some.
    """
    if driven.end != "arrived":
        return
    end = float(driven.stamps[-1])
    for key in ("outages", "faults"):
        for i, fault in enumerate(getattr(scenario, key)):
            last, what = end, "the end of the drive"
            if isinstance(fault, Mishap):
                last, what = end - scenario.drive.rest_end, "the robot's arrival"
            if fault.start >= last:
                raise ConfigError(f"{fault.start:g} s, expected before {what}, {last:.1f} s", field=f"{key}.{i}.start")


def seeded(scenario: Scenario, seed: int | None) -> Scenario:
    """The scenario with another seed, unless that is None."""
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
    concerns = _CONCERNS.split()
    children = np.random.SeedSequence(seed).spawn(len(concerns))
    return {concern: np.random.default_rng(child) for concern, child in zip(concerns, children, strict=True)}
