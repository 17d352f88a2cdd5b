"""Files that a scenario names: in its folder or below; and with a simulation on disk they are in its folder."""

import shutil
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from moteslam.errors import ConfigError
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN, write_map, write_picture
from moteslam.robot.raster import Raster
from moteslam.sim.output import write_simulation
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate

ROUTE = "[route]\nwaypoints = [[0.0, 0.0], [1.0, 0.0]]\n"
WALL = "[[world.walls]]\npoints = [[-5.0, 3.0], [5.0, 3.0]]\n"
PLAN = ROUTE + "[world.plan]\nfile = '{0}'\n"
PICTURE = ROUTE + "[floor]\nmaterial = 'image'\nimage = '{0}'\n" + WALL
ROBOT = "platform = '{0}'\n" + ROUTE + WALL
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
def scenario(tmp_path: Path) -> Path:
    """Where a scenario is to be; files lie beside it, below, and in a folder beside its own."""
    for folder in ("mine", "mine/below", "other"):
        write_files(tmp_path / folder)
    return tmp_path / "mine" / "s.toml"


@pytest.mark.parametrize("field", KINDS)
@pytest.mark.parametrize("way", ["{0}", "below/{0}", "below/../{0}", "../mine/{0}", "{1}/mine/{0}"])
def test_files_beside_and_below_are_read(field: str, way: str, scenario: Path, tmp_path: Path) -> None:
    text, name = KINDS[field]
    scenario.write_text(text.format(way.format(name, tmp_path)))
    assert load_scenario(scenario).name == "s"


@pytest.mark.parametrize("field", KINDS)
@pytest.mark.parametrize("way", ["../other/{0}", "below/../../other/{0}", "{1}/other/{0}", "link/{0}", "link-{0}"])
def test_files_elsewhere_are_refused(field: str, way: str, scenario: Path, tmp_path: Path) -> None:
    text, name = KINDS[field]
    (tmp_path / "mine" / "link").symlink_to(tmp_path / "other")
    (tmp_path / "mine" / f"link-{name}").symlink_to(tmp_path / "other" / name)
    given = way.format(name, tmp_path)
    scenario.write_text(text.format(given))
    with pytest.raises(ConfigError) as caught:
        load_scenario(scenario)
    assert (str(caught.value.file), caught.value.field) == (str(scenario), field)


def test_who_asks_for_a_simulation_may_name_files_anywhere(scenario: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    scenario.write_text(PLAN.format("map.yaml"))
    loaded = load_scenario(scenario, platform=other / "robot.toml", settings=[f"world.plan.file={other / 'map.yaml'}"])
    assert loaded.world.plan.file == str(other / "map.yaml")


def test_a_simulation_on_disk_can_be_simulated_again_wherever_it_is_moved(scenario: Path, tmp_path: Path) -> None:
    scenario.write_text(
        "duration = 30.0\n" + PLAN.format("below/map.yaml") + "[floor]\nmaterial = 'image'\nimage = 'floor.png'\n"
    )
    first = simulate(load_scenario(scenario), 1)
    write_simulation(tmp_path / "made", first)
    shutil.move(tmp_path / "made", tmp_path / "moved")
    shutil.rmtree(scenario.parent)
    again = load_scenario(tmp_path / "moved" / "scenario.toml")
    assert again.floor.image == str(tmp_path / "moved" / "floor.png")
    second = simulate(again, 1)
    np.testing.assert_array_equal(first.recording.lidar.ranges, second.recording.lidar.ranges)
