"""Floors: colours of a place whatever the resolution, pictures the right way up; and floor plans as walls."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from refusals import refusal

from moteslam.errors import ConfigError, InputError
from moteslam.robot.raster import Raster, write_map_arrays
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.world.floor import FloorSettings, rasterise
from moteslam.sim.world.layout import FloorPlan, read_floor_plan, wall_segments

GREY = np.array((0.299, 0.587, 0.114))
MATERIALS = ("tiles", "carpet", "wood", "plain")


@pytest.mark.parametrize("material", MATERIALS)
def test_a_colour_depends_on_the_place_alone(material: str) -> None:
    floor = FloorSettings(material=material, stains=0.2)
    points = np.random.default_rng(0).uniform(-30, 30, (500, 2))
    together = floor.colours_at(points)
    assert (together == np.stack([floor.colours_at(point) for point in points])).all()
    crowded = np.concatenate((points, np.random.default_rng(1).uniform(-1, 1, (100_000, 2))))
    assert (floor.colours_at(crowded)[:500] == together).all()


@pytest.mark.parametrize("material", MATERIALS)
def test_a_raster_holds_the_colours_at_its_cells(material: str) -> None:
    floor = FloorSettings(material=material)
    image = rasterise(floor, (-1.03, 2.0, 0.97, 3.5), 0.05)
    assert image.values.shape == (30, 41, 3)
    assert image.origin == pytest.approx((-1.05, 2.0, 0.0))
    for row, column in ((0, 0), (29, 3), (7, 40)):
        point = image.centres([(row, column)])[0]
        assert (image.values[row, column] == floor.colours_at(point)).all()
    bit = rasterise(floor, (-0.5, 2.5, 0.0, 3.0), 0.05)
    assert (bit.values == image.values[10:20, 11:21]).all()


def test_seeds_and_materials_differ_and_colours_vary() -> None:
    seen = [rasterise(FloorSettings(seed=seed), (0, 0, 20, 20), 0.05).values for seed in (0, 1)]
    assert (seen[0] != seen[1]).any(axis=-1).mean() > 0.7
    for material, least in (("tiles", 40), ("carpet", 40), ("wood", 40), ("plain", 1)):
        colours = rasterise(FloorSettings(material=material), (0, 0, 20, 20), 0.05).values
        assert (colours @ GREY).std() > least
        assert (colours @ GREY).mean() == pytest.approx(115, abs=25)


def test_a_share_of_the_floor_is_stained() -> None:
    clean, stained = (rasterise(FloorSettings(material="plain", stains=s), (0, 0, 30, 30), 0.05) for s in (0, 0.3))
    darker = (stained.values @ GREY < 0.9 * (clean.values @ GREY)).mean()
    assert darker == pytest.approx(0.3, abs=0.06)


def test_tiles_are_square_and_lie_on_multiples_of_their_size() -> None:
    floor = FloorSettings(size=0.4, colours=((255, 0, 0), (0, 0, 255)))
    a, b = floor.colours_at([(0.02, 0.02), (0.38, 0.38)]).astype(int)
    assert np.abs(a - b).max() < 30  # one tile, but for its shading
    assert (floor.colours_at([(0.4, 0.2), (0.2, 0.798)]) == 96).all()  # joints


def picture(path: Path) -> Path:
    """4 x 2 pixels: red in the upper left corner, green in the upper right one, blue in the lower left one."""
    image = np.full((2, 4, 3), 200, np.uint8)
    image[0, 0], image[0, 3], image[1, 0] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    cv2.imwrite(str(path), image[..., ::-1])
    return path


def test_a_picture_lies_the_right_way_up(tmp_path: Path) -> None:
    floor = FloorSettings(material="image", image=str(picture(tmp_path / "p.png")), image_width=4.0)
    seen = floor.colours_at([(0.5, 1.5), (3.5, 1.5), (0.5, 0.5), (4.5, 3.5), (-3.5, -0.5)]).tolist()
    assert seen == [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 0, 0], [255, 0, 0]]


def test_a_picture_that_cannot_be_read_is_refused(
    tmp_path: Path, table: dict[str, Any], capfd: pytest.CaptureFixture[str]
) -> None:
    path = picture(tmp_path / "p.png")
    good = path.read_bytes()
    grey = cv2.imencode(".pgm", cv2.imdecode(np.frombuffer(good, np.uint8), 0))[1].tobytes()
    spoilt = good[:-20] + b"x" + good[-19:]
    for content in (None, b"", b"not a picture", good[:30], good[: len(good) // 2], spoilt, grey[: len(grey) // 2]):
        path.unlink() if content is None else path.write_bytes(content)
        with refusal(ConfigError, file="s.toml", field="floor.image"):
            parse_scenario({**table, "floor": {"material": "image", "image": str(path)}}, file="s.toml")
    assert capfd.readouterr().err == ""


REST = "[0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
YAML = (
    "image: {name}\nresolution: {cell}\norigin: [{x}, {y}, {yaw}]\nnegate: 0\n"
    "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
)


def plan_file(folder: Path, cells: np.ndarray, *, name: str = "plan.png", cell: Any = 0.1, yaw: float = 0.0) -> Path:
    """A map_server file whose solid cells [row, col] are those, row 0 the smallest y."""
    assert cv2.imwrite(str(folder / name), np.where(cells[::-1], 0, 254).astype(np.uint8))
    path = folder / "plan.yaml"
    path.write_text(YAML.format(name=name, cell=cell, x=-3.0, y=2.0, yaw=yaw))
    return path


def cave(seed: int = 0, size: tuple[int, int] = (80, 120)) -> np.ndarray:
    """Random blobs and a rim."""
    generator = np.random.default_rng(seed)
    cells = cv2.GaussianBlur(generator.random(size).astype(np.float32), (0, 0), 2.5) > 0.52
    cells[[0, -1]] = cells[:, [0, -1]] = True
    return np.asarray(cells)


@pytest.mark.parametrize("name", ["plan.png", "plan.pgm"])
def test_walls_are_the_sides_of_solid_cells_and_no_more(tmp_path: Path, name: str) -> None:
    cells = cave()
    grid = read_floor_plan(FloorPlan(file=str(plan_file(tmp_path, cells, name=name))))
    np.testing.assert_array_equal(grid.values, cells)
    padded = np.pad(cells, 1).astype(int)
    sides = np.abs(np.diff(padded, axis=0)).sum() + np.abs(np.diff(padded, axis=1)).sum()
    walls = wall_segments(grid)
    lengths = np.hypot(*(walls[:, 2:] - walls[:, :2]).T)
    assert lengths.sum() == pytest.approx(0.1 * sides)
    ahead = (walls[:, 2:] - walls[:, :2]) / lengths[:, None]
    along = walls[:, :2] + ahead * (
        np.floor(np.random.default_rng(2).random((len(walls), 1)) * lengths[:, None] * 10) / 10 + 0.05
    )
    aside = 0.05 * ahead[:, ::-1] * (-1, 1)
    left, right = (grid.values_at(along + sign * aside, outside=False) for sign in (1, -1))
    assert (left != right).all()


def test_a_turned_plan_is_solid_where_its_walls_say(tmp_path: Path) -> None:
    cells = cave(3, (30, 40))
    plain = read_floor_plan(FloorPlan(file=str(plan_file(tmp_path, cells))))
    (tmp_path / "b").mkdir()
    turned = read_floor_plan(FloorPlan(file=str(plan_file(tmp_path / "b", cells, yaw=0.5))))
    points = np.random.default_rng(0).uniform((-4, 1), (2, 6), (500, 2))
    cos, sin = np.cos(0.5), np.sin(0.5)
    moved = (points - (-3.0, 2.0)) @ np.array([(cos, sin), (-sin, cos)]) + (-3.0, 2.0)
    np.testing.assert_array_equal(turned.values_at(moved, outside=False), plain.values_at(points, outside=False))
    assert plain.values_at(points, outside=False).any()
    lengths = [np.hypot(*(wall_segments(grid)[:, 2:] - wall_segments(grid)[:, :2]).T) for grid in (plain, turned)]
    np.testing.assert_allclose(*lengths, atol=1e-9)


def test_a_plan_that_is_none_is_refused_as_the_scenarios(tmp_path: Path, table: dict[str, Any]) -> None:
    path = plan_file(tmp_path, cave(0, (50, 60)))
    cv2.imwrite(str(tmp_path / "white.png"), np.full((9, 9), 254, np.uint8))
    head = "image: {}\nresolution: {}\norigin: " + REST
    for content in (
        None, "just text", head.format("no.png", 0.1), head.format("plan.png", -1), head.format("white.png", 0.1)
    ):  # fmt: skip
        path.unlink() if content is None else path.write_text(content)
        with refusal(ConfigError, file=tmp_path / "my.toml", field="world.plan.file"):
            parse_scenario({**table, "world": {"plan": {"file": "plan.yaml"}}}, file=tmp_path / "my.toml")


def arrays_file(path: Path, name: str = "log_odds", **changes: Any) -> Path:
    """Log-odds: a wall around a room, unknown beyond it."""
    values = np.zeros((30, 40), np.float32)
    values[5:25, 5:35], values[6:24, 6:34] = 2.0, -2.0
    about: dict[str, Any] = {"values": values, "cell_size": 0.1, **changes}
    write_map_arrays(path, {name: Raster(**about)})
    return path


@pytest.mark.parametrize("name", ["map.npz", "map.yaml"])
def test_log_odds_are_a_floor_plan_whatever_the_name(tmp_path: Path, name: str) -> None:
    path = arrays_file(tmp_path / name, origin=(1.0, 2.0, 0.3))
    ring = np.zeros((30, 40), bool)
    ring[5:25, 5:35], ring[6:24, 6:34] = True, False
    found = read_floor_plan(FloorPlan(file=str(path)))
    np.testing.assert_array_equal(found.values, ring)
    assert (found.cell_size, found.origin) == (0.1, (1.0, 2.0, 0.3))
    solid = read_floor_plan(FloorPlan(file=str(path), unknown="wall"))
    assert int(solid.values.sum()) == 30 * 40 - 18 * 28


def test_arrays_that_are_no_floor_plan_are_refused(tmp_path: Path) -> None:
    for changes in ({"values": np.zeros((3, 3))}, {"cell_size": 100.0}, {"name": "points"}):
        with refusal(InputError, field="log_odds"):
            read_floor_plan(FloorPlan(file=str(arrays_file(tmp_path / "map.npz", **changes))))
