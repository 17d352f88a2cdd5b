"""The true map: every wall in it, nothing free that is not, at any resolution."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moteslam.errors import ConfigError
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN, write_map
from moteslam.robot.raster import Raster
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import true_drive
from moteslam.sim.world.floor_plan import FloorPlan, read_floor_plan
from moteslam.sim.world.layout import Layout, Room, Wall
from moteslam.sim.world.pieces import Box, Shelf
from moteslam.sim.world.true_map import true_map
from moteslam.sim.world.world import World

ROOM = World.of(
    Layout(
        rooms=(Room(corner=(0.003, 0.004), size=(6, 4)),),
        boxes=(Box(centre=(4, 2), size=(1, 1), angle=0.5),),
        walls=(Wall(points=((1.03, 1.02), (2.07, 3.1))),),
    )
)


def values(true: Raster, points: np.ndarray) -> np.ndarray:
    first = np.round(np.array(true.origin[:2]) / true.cell_size)
    at = (np.floor(points / true.cell_size) - first).astype(int)
    return true.values[at[:, 1], at[:, 0]]


@pytest.mark.parametrize("resolution", [0.2, 0.05, 0.013])
def test_walls_are_occupied_rooms_free_and_the_rest_unknown(resolution: float) -> None:
    true = true_map(ROOM, resolution, seen_from=[(0.5, 0.5)])
    share = np.random.default_rng(0).random((4000, 1))
    segments = ROOM.segments[np.random.default_rng(1).integers(0, len(ROOM.segments), 4000)]
    on_walls = segments[:, :2] + share * (segments[:, 2:] - segments[:, :2])
    assert (values(true, on_walls) == OCCUPIED).mean() > 0.999  # one that runs along a side of cells has two
    places = np.random.default_rng(2).uniform((-0.4, -0.4), (6.4, 4.4), (4000, 2))
    away = ROOM.distance(places) > 1.5 * resolution
    inside = (places > 0).all(1) & (places < (6, 4)).all(1)
    solid = ROOM.inside_solid(places)
    assert (values(true, places[away & inside & ~solid]) == FREE).all()
    assert (values(true, places[away & ~inside]) == UNKNOWN).all()
    assert (values(true, places[solid & away]) == OCCUPIED).all()
    # no more than the cells that walls cross
    centres = true.centres(np.argwhere(true.values == OCCUPIED))
    near = (ROOM.distance(centres) <= resolution * np.sqrt(0.5) + 1e-9) | ROOM.inside_solid(centres)
    assert near.all()


def test_bays_of_shelves_are_free_and_nothing_stands_in_them() -> None:
    world = World.of(
        Layout(rooms=(Room(corner=(0, 0), size=(6, 4)),), shelves=(Shelf(centre=(3, 2), size=(2.0, 0.4), bay=1.0),))
    )
    true = true_map(world, 0.02, seen_from=[(0.5, 0.5)])
    bay = np.array([(2.5, 2.0), (3.5, 2.0)])
    assert (values(true, bay) == FREE).all()
    assert world.inside_solid(bay).all()
    back = world.segments[4:, :2]
    assert (values(true, back + 1e-3) == OCCUPIED).any()


def test_maps_of_one_world_lie_on_one_another() -> None:
    fine, coarse = (true_map(ROOM, size, seen_from=[(0.5, 0.5)]) for size in (0.05, 0.1))
    for true in (fine, coarse):
        np.testing.assert_allclose(np.array(true.origin[:2]) / true.cell_size % 1, 0, atol=1e-9)
    any_wall = coarse.values == OCCUPIED
    rows, cols = np.nonzero(fine.values == OCCUPIED)
    shift = np.round((np.array(fine.origin) - coarse.origin)[:2] / 0.05).astype(int)
    assert any_wall[(rows + shift[1]) // 2, (cols + shift[0]) // 2].all()


def test_it_reads_back_as_a_floor_plan(tmp_path: Path) -> None:
    true = true_map(ROOM, 0.05, seen_from=[(0.5, 0.5)])
    write_map(tmp_path / "map.pgm", true)
    grid = read_floor_plan(FloorPlan(file=str(tmp_path / "map.yaml")))
    np.testing.assert_array_equal(grid.values, true.values == OCCUPIED)
    assert grid.origin == true.origin
    with_unknown = read_floor_plan(FloorPlan(file=str(tmp_path / "map.yaml"), unknown="wall"))
    np.testing.assert_array_equal(with_unknown.values, true.values != FREE)


def test_the_robot_drives_in_free_cells() -> None:
    scenario = load_scenario("office")
    run = true_drive(scenario)
    true = true_map(World.of(scenario.world), 0.05, seen_from=scenario.start[:2])
    assert (values(true, run.poses[:, :2]) == FREE).all()


@pytest.mark.parametrize("resolution", [0.0, float("nan"), 1e-5])
def test_absurd_resolutions_are_refused(resolution: float) -> None:
    with pytest.raises(ConfigError) as caught:
        true_map(ROOM, resolution, seen_from=[(0.5, 0.5)])
    assert caught.value.field == "resolution"
