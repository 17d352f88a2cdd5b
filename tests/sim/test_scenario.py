"""Scenario files: what is read, what is refused, which files they may name, and what the bundled ones promise."""

import copy
import re
import shutil
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from refusals import refusal

from moteslam.errors import ConfigError
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN, write_map, write_picture
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import UCSD
from moteslam.robot.raster import Raster
from moteslam.robot.values import Section
from moteslam.sim.output import write_simulation
from moteslam.sim.scenario import bundled_scenarios, load_scenario, parse_scenario, scenario_table
from moteslam.sim.simulate import simulate, true_drive
from moteslam.sim.world.world import MAX_SEGMENTS


def changed(table: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """The table with one dotted key set, or taken away where the value is None."""
    table = copy.deepcopy(table)
    if key.startswith("platform."):
        table["platform"] = {"base": "ucsd"}
    *path, last = key.split(".")
    inner = table
    for part in path:
        inner = inner.setdefault(part, {})
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    return table


BOX_ON_START = [{"centre": [2.0, 2.0], "size": [2.0, 2.0]}]
TOO_MANY = [{"centre": [5.0, 5.0], "radius": 0.1, "sides": 256}] * (MAX_SEGMENTS // 256 + 1)
DOOR: dict[str, Any] = {"hinge": [5.0, 6.5], "end": [6.0, 6.5]}
ON_START = {"hinge": [2.1, 1.5], "end": [2.1, 2.5]}
PERSON = {"waypoints": [[5.0, 4.0]]}
NICHE = {"at": 1.0, "width": 1.0, "depth": 0.0}
WALL = {"points": [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]]}


@pytest.mark.parametrize(
    ("key", "value", "field"),
    [
        ("route.waypoints", [[2.0, 2.0], [5.0, float("nan")]], "route.waypoints.1.1"),
        ("world", {}, "world"),
        ("world.pillars", TOO_MANY, "world"),
        ("world.boxes", BOX_ON_START, "route.waypoints.0"),
        ("world.boxes", [{"centre": [8.0, 7.0], "size": [1.0, 1.0], "material": "velvet"}], "world"),
        ("world.boxes", [{"centre": [8.0, 7.0], "size": [1.0, 1.0], "angle": 45.0}], "world.boxes.0.angle"),
        ("noise.lidar.range_noise", 30.0, "noise.lidar.range_noise"),
        ("world.walls", [{**WALL, "recesses": [NICHE]}], "world.walls.0.recesses.0"),
        ("world.walls", [{**WALL, "doors": [{"at": 7.5, "width": 1.0}]}], "world.walls.0"),
        ("world.walls", [{**WALL, "doors": [{"at": 3.5, "width": 1.0}]}], "world.walls.0"),
        ("world.walls", [{**WALL, "doors": [{"at": 0.5, "width": 1.0}, {"at": 1.2, "width": 1.0}]}], "world.walls.0"),
        ("route.waypoints", [[0.2, 2.0], [7.0, 2.0]], "route.waypoints.0"),
        ("route.waypoints", [[2.0, 2.0], [9.9, 2.0]], "route.waypoints.1"),
        ("route.waypoints", [[2.0, 2.0], [12.0, 2.0]], "route.waypoints.0"),
        ("route.waypoints", [[2.0, 2.0], [2.0, 2.0]], "route"),
        ("route.laps", 2.0, "route"),
        ("route", None, "route"),
        ("wander", {"start": [2.0, 2.0], "distance": 9.0}, "wander"),
        ("duration", 6.0, "duration"),
        ("platform", {"wheels": {"track": 0.3}}, "platform.wheels.metres_per_count"),
        ("platform", {"base": "nobody"}, "platform.base"),
        ("platform.lidar.time_increment", 1e-4, "platform.lidar.time_increment"),
        ("platform.body.mass", 0.2, "platform.body.stiffness"),
        ("platform.lidar.beams", False, "platform.lidar"),
        ("platform.encoders", False, "platform.encoders"),
        ("platform.wheels.effective_track", 0.2, "platform.wheels.effective_track"),
        ("platform.width", 0.1, "platform.width"),
        ("platform.camera.z", 0.0, "platform.camera.z"),
        ("platform.camera", False, "platform.camera"),
        ("platform.lidar.x", 5.0, "platform.lidar.x"),
        ("camera", {"nearest": 9.0}, "camera"),
        ("doors", [{**DOOR, "kind": "slide", "opening": 1.0}], "doors.0"),
        ("doors", [DOOR, ON_START], "doors.1"),
        ("doors", [{"hinge": [1.0, 1.0], "end": [1.0, 1.0]}], "doors.0"),
        ("doors", [{**DOOR, "material": "cheese"}], "doors.0.material"),
        ("people", [PERSON, PERSON], "people.1.waypoints.0"),
        ("people", [{"waypoints": [[2.1, 2.0]]}], "people.0.waypoints.0"),
        ("crowd", {"count": 2, "speed": [1.4, 0.8]}, "crowd"),
        ("noise.imu.gyro_correlation", [0.9, 0.1], "noise.imu"),
        ("noise.imu.clock.begins", [0.5, 0.3], "noise.imu.clock"),
        ("outages", [{"sensor": "sonar", "start": 1.0, "duration": 1.0}], "outages.0.sensor"),
        ("floor", {"material": "image"}, "floor"),
    ],
)
def test_refused(table: dict[str, Any], key: str, value: Any, field: str) -> None:
    with refusal(ConfigError, file="my.toml", field=field):
        parse_scenario(changed({**table, "camera": {}}, key, value), file="my.toml")


@pytest.mark.parametrize("start", [[2.0, 2.0, 0.5], [2.0]])
def test_a_point_is_x_and_y(table: dict[str, Any], start: list[float]) -> None:
    with refusal(ConfigError, f"{len(start)} numbers, expected x, y", field="wander.start"):
        parse_scenario(changed(changed(table, "route", None), "wander", {"start": start, "distance": 9.0}))


@pytest.mark.parametrize("name", ["nowhere", "full.txt", "", "broken.toml", "huge.toml"])
def test_unreadable_files_are_refused(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    contents = {
        "full.txt": b"", "broken.toml": b"world = [", "huge.toml": b"#" * 5_000_000
    }  # fmt: skip
    if name in contents:
        (tmp_path / name).write_bytes(contents[name])
    with refusal(ConfigError, file=name):
        load_scenario(name)


@pytest.mark.parametrize("name", [name for name in bundled_scenarios() if name not in ("campus", "mile")])
def test_a_scenario_reads_back_as_it_was_written(name: str, tmp_path: Any) -> None:
    scenario = load_scenario(name)
    path = tmp_path / "other.toml"
    path.write_text(tomli_w.dumps(scenario_table(scenario)), encoding="utf-8")
    assert load_scenario(path) == scenario


def test_laps_of_a_closed_route_end_part_of_the_way_round(table: dict[str, Any]) -> None:
    square = {"waypoints": [[2.0, 2.0], [6.0, 2.0], [6.0, 6.0], [2.0, 6.0]], "closed": True}
    route = parse_scenario(changed(table, "route", {**square, "laps": 1.5})).route
    path = route.path()
    assert np.hypot(*np.diff(path, axis=0).T).sum() == pytest.approx(24.0)
    np.testing.assert_allclose(path[-1], (6.0, 6.0))
    half = parse_scenario(changed(table, "route", {**square, "laps": 0.5})).route
    np.testing.assert_allclose(half.path()[-1], (6.0, 6.0))


def sections(of: type[Section] = Section) -> Iterator[type[Section]]:
    """Every table of a file."""
    for part in of.__subclasses__():
        yield part
        yield from sections(part)


def test_every_key_stands_in_the_documentation() -> None:
    pages = Path(__file__).parents[2] / "docs" / "reference"
    text = (pages / "scenarios.md").read_text(encoding="utf-8")
    text += (pages.parents[1] / "robot" / "noise.py").read_text(encoding="utf-8").replace(":", " ")
    keys = {(part.__module__, part.__name__, key) for part in sections() for key in part.model_fields}
    of_scenarios = [key for key in keys if key[0].startswith(("moteslam.sim.", "moteslam.robot.noise"))]
    assert len(of_scenarios) > 150
    for _, part, key in of_scenarios:
        assert re.search(rf"[`\.\[{{, ]{key}[`\.\]}}, ]", text), f"{part}.{key}"


def test_the_example_of_the_documentation_runs(tmp_path: Any) -> None:
    text = (Path(__file__).parents[2] / "docs" / "reference" / "scenarios.md").read_text(encoding="utf-8")
    example = re.search(r"```toml\n(.*?)```", text, re.DOTALL)
    (tmp_path / "example.toml").write_text(example[1], encoding="utf-8")
    scenario = load_scenario(tmp_path / "example.toml")
    assert true_drive(scenario, 0).end == "arrived"


def test_noise_as_recorded_is_the_robots_with_single_values_over_it(table: dict[str, Any]) -> None:
    scenario = parse_scenario({**table, "noise_class": "as_recorded", "noise": {"lidar": {"range_bias": 0.5}}})
    recorded = UCSD.as_recorded
    assert recorded.surroundings != UCSD.noise.surroundings
    assert scenario.noise.lidar == recorded.lidar.model_copy(update={"range_bias": 0.5})
    assert scenario.noise.surroundings == recorded.surroundings


ROUTE = "[route]\nwaypoints = [[0.0, 0.0], [1.0, 0.0]]\n"
BESIDE = "[[world.walls]]\npoints = [[-5.0, 3.0], [5.0, 3.0]]\n"
PLAN = ROUTE + "[world.plan]\nfile = '{0}'\n"
PICTURE = ROUTE + "[floor]\nmaterial = 'image'\nimage = '{0}'\n" + BESIDE
ROBOT = "platform = '{0}'\n" + ROUTE + BESIDE
KINDS = {
    "world.plan.file": (PLAN, "map.yaml"),
    "floor.image": (PICTURE, "floor.png"),
    "platform": (ROBOT, "robot.toml"),
}


def write_files(folder: Path) -> None:
    """A floor plan, a picture of a floor and a robot."""
    folder.mkdir(parents=True, exist_ok=True)
    cells = np.full((80, 120), FREE, np.int8)
    cells[[0, -1]], cells[:, [0, -1]], cells[60:70, 10:14] = OCCUPIED, OCCUPIED, UNKNOWN
    write_map(folder / "map.pgm", Raster(cells, 0.05, (-2.0, -2.0, 0.0)))
    colours = np.random.default_rng(1).integers(1, 255, (8, 8, 3)).astype(np.uint8)
    write_picture(folder / "floor.png", Raster(colours, 0.5, (0.0, 0.0, 0.0)))
    robot = resources.files("moteslam.robot.platforms").joinpath("ucsd.toml").read_text("utf-8")
    (folder / "robot.toml").write_text(robot)


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """Where a scenario is to be; files lie beside it, below, and in a folder beside its own."""
    for folder in ("mine", "mine/below", "other"):
        write_files(tmp_path / folder)
    return tmp_path / "mine" / "s.toml"


@pytest.mark.parametrize("field", KINDS)
@pytest.mark.parametrize("way", ["below/{0}", "below/../{0}", "{1}/mine/{0}"])
def test_files_beside_and_below_are_read(field: str, way: str, mine: Path, tmp_path: Path) -> None:
    text, name = KINDS[field]
    mine.write_text(text.format(way.format(name, tmp_path)))
    assert load_scenario(mine).name == "s"


@pytest.mark.parametrize("field", KINDS)
@pytest.mark.parametrize("way", ["below/../../other/{0}", "{1}/other/{0}", "link-{0}"])
def test_files_elsewhere_are_refused(field: str, way: str, mine: Path, tmp_path: Path) -> None:
    text, name = KINDS[field]
    (tmp_path / "mine" / "link").symlink_to(tmp_path / "other")
    (tmp_path / "mine" / f"link-{name}").symlink_to(tmp_path / "other" / name)
    given = way.format(name, tmp_path)
    mine.write_text(text.format(given))
    with refusal(ConfigError, file=mine, field=field):
        load_scenario(mine)


def test_a_simulation_on_disk_can_be_simulated_again_wherever_it_is_moved(mine: Path, tmp_path: Path) -> None:
    mine.write_text(
        "duration = 30.0\n" + PLAN.format("below/map.yaml") + "[floor]\nmaterial = 'image'\nimage = 'floor.png'\n"
    )
    first = simulate(load_scenario(mine), 1)
    write_simulation(tmp_path / "made", first)
    shutil.move(tmp_path / "made", tmp_path / "moved")
    shutil.rmtree(mine.parent)
    again = load_scenario(tmp_path / "moved" / "scenario.toml")
    assert again.floor.image == str(tmp_path / "moved" / "floor.png")
    second = simulate(again, 1)
    np.testing.assert_array_equal(first.recording.lidar.ranges, second.recording.lidar.ranges)


def test_a_changed_copy_is_checked_and_brings_the_robots_own_noise() -> None:
    scenario = load_scenario("corridor")
    assert scenario.with_() == scenario
    assert scenario.with_(platform="turtlebot3") == load_scenario("corridor", platform="turtlebot3")
    assert scenario.with_(noise_class="as_recorded") == load_scenario("corridor", noise="as_recorded")
    short = scenario.with_(duration=20.0, drive={"speed": 0.3})  # ends before the way does
    assert (short.duration, short.drive.speed) == (20.0, 0.3)
    assert short.with_() == short
    assert len(repr(scenario)) < 200


@pytest.mark.parametrize("change", [{"durations": 3.0}, {"duration": -1.0}, {"people": 5}])
def test_a_changed_copy_with_a_wrong_key_or_value_is_refused(change: dict) -> None:
    with refusal(ConfigError, field=next(iter(change))) as caught:
        load_scenario("corridor").with_(**change)
    assert ("expected one of duration, " in caught.value.problem) == ("durations" in change)


@pytest.mark.parametrize("changes", [{"duration": 10.0}, {"duration": 7.0, "drive": {"rest_end": 1.0}}])
def test_a_drive_that_ends_before_the_robot_has_moved_is_refused(changes: dict) -> None:
    with refusal(ConfigError, "expected more than", field="duration"):
        simulate(load_scenario("corridor").with_(**changes))


def test_what_never_changes_says_so_in_a_line() -> None:
    with refusal(ConfigError, field="duration"):
        load_scenario("corridor").duration = 3.0
    with refusal(ConfigError, field="length"):
        Platform(length=-1.0)
