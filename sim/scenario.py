"""A scenario: a world, who moves in it, what the robot does, and how noisy its sensors are, as one TOML file."""

import math
import re
import tomllib
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import Field, model_validator

from moteslam.errors import ConfigError, InputError
from moteslam.files import file_within
from moteslam.robot.noise import Noise
from moteslam.robot.platform import CameraSettings, Platform
from moteslam.robot.platforms import BASE, UCSD, load_platform, platform_table, whole_platform
from moteslam.robot.se2 import Array
from moteslam.robot.values import Number, Section, Table, Truth, Whole, assigned, merged, read_toml, validated
from moteslam.sim.actors.actors import MAX_DOORS, Door, check_doors, check_people
from moteslam.sim.actors.people import CLEARANCE, MAX_PEOPLE, Crowd, Person
from moteslam.sim.robot.driver import MAX_DURATION, Commands, Limits, Route, Task, Wander, check_duration, check_task
from moteslam.sim.robot.mishaps import Carried, StuckWheels, check_mishaps
from moteslam.sim.robot.vehicle import check_body, check_wheels
from moteslam.sim.sensors.clock import Outage
from moteslam.sim.sensors.faults import Cart, Gap, OdometryJump, RepeatedScans, StaleOdometry, Tilt
from moteslam.sim.sensors.lidar import check_sensors
from moteslam.sim.sensors.rgbd import check_camera
from moteslam.sim.world.floor import FloorSettings, read_picture
from moteslam.sim.world.layout import Layout
from moteslam.sim.world.random_corridors import NAME as RANDOM_CORRIDORS
from moteslam.sim.world.random_corridors import random_corridors
from moteslam.sim.world.visit import Visit, visited
from moteslam.sim.world.world import World, check_world

SCENARIOS = Path(__file__).parent / "scenarios"
MAX_SEED = 2**63 - 1
_RANDOM = re.compile(rf"{RANDOM_CORRIDORS}(?:-(\d{{1,40}}))?")
_TASKS = ("route", "wander", "commands")

Fault = Annotated[
    Cart | Tilt | RepeatedScans | StuckWheels | Gap | StaleOdometry | OdometryJump | Carried,
    Field(discriminator="kind"),
]
"""What goes wrong in a run, a table for each kind."""
_KINDS = tuple(fault.model_fields["kind"].default for fault in get_args(get_args(Fault)[0]))


class Scenario(Section):
    """A world and a run in it."""

    # the file's name without ``.toml``, unless the file says otherwise
    name: Annotated[str, Field(min_length=1, max_length=200)] = "scenario"
    description: str = ""  # what it is, one sentence
    why: str = ""  # it is hard, likewise
    expect_divergence: Truth = False  # whether an estimate that is lost is no surprise here
    seed: Annotated[Whole, Field(ge=0, lt=2**63)] = 0  # of all that is random, unless ``simulate`` is given another
    # of the run at most [s]; longer in proportion for a robot that is slower than ``drive.speed``
    duration: Annotated[Number, Field(gt=0, le=MAX_DURATION)] = 600.0
    world: Layout
    visit: Visit | None = None  # what is changed in the world; as it is written if None
    people: Annotated[tuple[Person, ...], Field(max_length=MAX_PEOPLE)] = ()
    crowd: Crowd | None = None
    doors: Annotated[tuple[Door, ...], Field(max_length=MAX_DOORS)] = ()
    route: Route | None = None  # what the robot does, as the next two; exactly one of them
    wander: Wander | None = None
    commands: Commands | None = None
    drive: Limits = Limits()  # the limits it drives within, at most the robot's own
    # the robot: a bundled one's name, a ``.toml`` file beside the scenario's, or a table of all its keys or of a
    # ``base`` and what differs from it
    platform: Platform = UCSD
    noise_class: Literal["datasheet", "as_recorded"] = "datasheet"  # whose figures of the robot ``noise`` begins with
    noise: Noise = UCSD.noise
    outages: Annotated[tuple[Outage, ...], Field(max_length=100)] = ()  # when a sensor is dead
    faults: Annotated[tuple[Fault, ...], Field(max_length=100)] = ()  # what else goes wrong
    floor: FloorSettings | None = None  # what it looks like; tiles if None
    camera: CameraSettings | None = None  # of the robot, which a file changes in single values; no images if None

    @model_validator(mode="before")
    @classmethod
    def _over_its_robot(cls, values: Any) -> Any:
        """A table with the robot's own figures below what it changes of them.

        ``platform`` becomes a whole robot; ``noise`` and ``camera`` lie, key by key, over the robot's; a speed that it
        cannot drive becomes its top speed, and the run may take longer by as much.
        """
        if not isinstance(values, dict):
            return values
        platform = chosen_platform(values.get("platform"))
        values = {**values, "platform": platform}
        noise = values.get("noise")
        if noise is None or isinstance(noise, dict):
            figures = _class_noise(platform, values.get("noise_class", "datasheet"))
            values["noise"] = merged(figures.model_dump(), noise or {})
        if isinstance(camera := values.get("camera"), dict):
            sensor = check_camera(platform.camera).sensor
            values["camera"] = camera if sensor is None else merged(sensor.model_dump(), camera)
        return _within_reach(values, platform)

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        """Refuse parts that contradict each other; each of them alone is checked where it is defined."""
        given = [task for task in _TASKS if getattr(self, task) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "nothing to do"
            raise ConfigError(
                f"{found}, expected exactly one of route, wander and commands", field=given[-1] if given else "route"
            )
        platform, start = self.platform, self.start[:2]
        check_duration(self.task, self.drive, self.duration)
        check_wheels(platform)
        check_sensors(platform)
        check_body(platform)
        if self.camera is not None:
            check_camera(platform.camera)
        if self.floor is not None and self.floor.image is not None:
            read_picture(self.floor.image)
        try:
            world = World.of(self.standing)
        except InputError as error:
            raise ConfigError(str(error), field="world.plan.file") from error
        check_world(world)
        for i, fault in enumerate(self.faults):
            if isinstance(fault, Tilt) and fault.height is None and (z := platform.lidar.z) <= 0:
                problem = f"missing, expected it where the robot's lidar is at z = {z:g} m"
                raise ConfigError(problem, field=f"faults.{i}.height")
        check_people(self.people, world, start, platform.radius)
        check_doors(self.doors, world, start, platform.radius)
        check_task(self.task, world, platform)
        check_mishaps(self.faults, self.task, world, platform)
        return self

    def __repr__(self) -> str:
        return f"Scenario({self.name!r}, platform={self.platform.name!r}, duration={self.duration:g} s)"

    def with_(self, **changes: Any) -> Self:
        """A checked copy with some values changed, those of tables one by one: ``with_(drive={"speed": 0.3})``.

        Another ``platform`` or ``noise_class`` brings its own noise. A ``duration`` that is too short for what the
        robot does ends it early.
        """
        table = scenario_table(self)
        if {"platform", "noise_class"} & changes.keys():
            del table["noise"]
        table = _with_files_beside(merged(table, changes), None)
        try:
            return validated(type(self), table, kinds=_KINDS)
        except ConfigError as error:
            duration = table["duration"]
            if error.field != "duration" or type(duration) not in (int, float) or not 0 < duration < MAX_DURATION:
                raise
        whole = validated(type(self), {**table, "duration": MAX_DURATION}, kinds=_KINDS)
        return whole.model_copy(update={"duration": float(duration)})

    @property
    def standing(self) -> Layout:
        """What stands in the world at its visit."""
        if self.visit is None:
            return self.world
        route = self.route.corners if self.route else np.tile(self.start[:2], (2, 1))
        others = [(np.array(person.waypoints), CLEARANCE) for person in self.people]
        others += [(np.array((door.hinge, door.end)), math.dist(door.hinge, door.end)) for door in self.doors]
        return visited(self.world, self.visit, route, others)

    @property
    def task(self) -> Task:
        task = self.route or self.wander or self.commands
        assert task is not None  # a scenario without is refused
        return task

    @property
    def start(self) -> Array:
        """The pose [3] that the robot starts at: x [m], y [m], theta [rad]."""
        return self.task.start_pose


def with_camera(scenario: Scenario) -> Scenario:
    """The scenario with a camera that records and a floor to see, if it lacks them."""
    sensor = scenario.camera or check_camera(scenario.platform.camera).sensor
    if sensor is None:
        raise ConfigError("not known, expected the camera's figures", field="platform.camera.sensor")
    return scenario.model_copy(update={"camera": sensor, "floor": scenario.floor or FloorSettings()})


def scenario_table(scenario: Scenario) -> Table:
    """A scenario as TOML holds it, with every key that has a value; it reads back equal."""
    return {**scenario.model_dump(exclude_none=True), "platform": platform_table(scenario.platform)}


def bundled_scenarios() -> dict[str, str]:
    """The names of the scenarios that come with the package, each with the sentence that says why it is hard."""
    found = {}
    for file in sorted(SCENARIOS.glob("*.toml")):
        found[file.stem] = str(tomllib.loads(file.read_text(encoding="utf-8")).get("why", ""))
    return found


def load_scenario(
    name_or_path: str | PathLike[str],
    *,
    platform: Platform | str | PathLike[str] | None = None,
    noise: str | None = None,
    settings: Sequence[str] = (),
) -> Scenario:
    """Read a scenario: the name of a bundled one, or the path of a TOML file (anything with ``.toml`` or a ``/``).

    ``random-corridors-7`` is the random building of seed 7 (`random_corridors`). In place of the scenario's own are a
    ``platform`` (a bundled robot's name, a ``platform.toml`` of a whole robot, or the robot itself), the class of
    ``noise`` (``datasheet`` or ``as_recorded``), and ``settings``, ``key=value`` with dotted keys, ``drive.speed=0.5``.
    These may name files anywhere, from the current folder; the scenario's own floor plan, picture and robot lie in its
    folder or below.

    A `ConfigError` says what is wrong with it, by file and key.
    """
    path = Path(name_or_path)
    text = str(name_or_path)
    if random := _RANDOM.fullmatch(text):
        if (seed := int(random[1] or 0)) > MAX_SEED:
            raise ConfigError(f"no such building, expected a number up to {MAX_SEED}", file=text)
        table = _changed(random_corridors(seed), platform, noise, settings)
        return parse_scenario(table, file=f"{RANDOM_CORRIDORS}-{seed}")
    if path.suffix != ".toml" and path.name == text:
        path = SCENARIOS / f"{text}.toml"
        if text not in bundled_scenarios():
            expected = f"{', '.join(bundled_scenarios())}, {RANDOM_CORRIDORS}, or a .toml file"
            raise ConfigError(f"no scenario of this name, expected one of {expected}", file=text)
    table = {"name": path.stem, **read_toml(path, "a scenario's .toml file")}
    changed = _changed(_with_files_beside(table, path, within=True), platform, noise, settings)
    return validated(Scenario, _with_files_beside(changed, path), file=name_or_path, kinds=_KINDS)


def _changed(
    table: Table, platform: Platform | str | PathLike[str] | None, noise: str | None, settings: Sequence[str]
) -> Table:
    """The table with another robot, another class of noise, and single values changed."""
    if platform is not None:
        table = {**table, "platform": platform if isinstance(platform, Platform) else load_platform(platform)}
    if noise is not None:
        table = {**table, "noise_class": noise}
    changes = _with_files_beside(assigned(settings), Path("settings"))  # of the folder where they are given
    robot = changes.get("platform")
    if isinstance(robot, dict) and BASE not in robot:  # single values of the robot, whichever it is
        table = {**table, "platform": platform_table(chosen_platform(table.get("platform")))}
    return merged(table, changes)


def parse_scenario(table: dict[str, Any], *, file: str | PathLike[str] | None = None) -> Scenario:
    """A scenario from a table as TOML gives it; ``file`` is named in errors, and files in the table lie beside it."""
    beside = None if file is None else Path(file)
    return validated(Scenario, _with_files_beside(table, beside), file=file, kinds=_KINDS)


def _with_files_beside(table: Table, file: Path | None, *, within: bool = False) -> Table:
    """The table with absolute paths of its floor plan, floor picture and platform; relative ones lie beside its file.

    ``within`` refuses files that lie neither beside it nor below: who writes a scenario says nothing of other folders.
    """
    folder = Path.cwd() if file is None else file.absolute().parent

    def beside(name: str, field: str) -> str:
        if within and file is not None:
            return str(file_within(folder, name, file=file, field=field))
        return str(folder / name)

    match table:
        case {"world": {"plan": {"file": str(name)} as plan} as world} if name and "\0" not in name:
            table = {**table, "world": {**world, "plan": {**plan, "file": beside(name, "world.plan.file")}}}
    match table:
        case {"floor": {"image": str(name)} as floor} if file is not None and "\0" not in name:
            table = {**table, "floor": {**floor, "image": beside(name, "floor.image")}}
    match table:
        case {"platform": str(name)} if name.endswith(".toml") and "\0" not in name:
            table = {**table, "platform": beside(name, "platform")}
    return table


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
    noise = platform.noise if name == "datasheet" else platform.as_recorded
    if name not in ("datasheet", "as_recorded") or noise is None:
        problem = f"{name!r}, expected datasheet or, of a robot with [as_recorded], as_recorded"
        raise ConfigError(problem, field="noise_class")
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
