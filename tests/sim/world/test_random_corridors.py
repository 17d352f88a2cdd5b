"""Random buildings: connected, drivable, all different, and no ray through a wall of theirs."""

import numpy as np
import pytest
import shapely
from scipy.ndimage import label

from moteslam.robot.formats.map_server import FREE, OCCUPIED
from moteslam.sim.scenario import Scenario, load_scenario, parse_scenario
from moteslam.sim.simulate import true_drive
from moteslam.sim.world.layout import Layout
from moteslam.sim.world.random_corridors import random_corridors
from moteslam.sim.world.world import World, true_map


def building(seed: int) -> Scenario:
    return parse_scenario(random_corridors(seed))


@pytest.mark.parametrize("seed", [1013, 1018])
def test_drivable(seed: int) -> None:
    """In these furniture stood where the robot swings out to turn back."""
    scenario = building(seed)
    world = World.of(scenario.world)
    run = true_drive(scenario)
    assert run.end == "arrived"
    assert world.is_free(run.poses[::10, :2], scenario.platform.width / 2).all()
    assert 80 < run.truth.length < 130


def test_connected() -> None:
    scenario = building(0)
    true = true_map(World.of(scenario.world), 0.1, seen_from=scenario.start[:2])
    inside = true.values != OCCUPIED
    regions, count = label(inside)
    free = np.unique(regions[true.values == FREE])
    assert len(free) == 1
    # what is neither free nor wall is outside, or solid between the corridors
    assert (true.values == FREE).sum() * 0.01 > 80.0
    assert count >= 2


def test_the_same_seed_the_same_building_another_seed_another() -> None:
    assert building(5) == building(5) == load_scenario("random-corridors-5")
    found = {tuple(map(tuple, World.of(building(seed).world).segments.tolist())) for seed in range(4)}
    assert len(found) == 4
    assert load_scenario("random-corridors") == building(0)


def outlines(layout: Layout) -> list[shapely.Polygon]:
    """What each piece of furniture takes on the floor."""
    pieces = (*layout.boxes, *layout.pillars, *layout.tables, *layout.chairs)
    return [shapely.Polygon(piece.polygon()) for piece in pieces]


@pytest.mark.slow
def test_furniture_stands_in_free_space_clear_of_walls_route_and_other_furniture() -> None:
    count, area = 0, 0.0
    for seed in range(15):
        scenario = building(seed)
        walls = shapely.multilinestrings([wall.points for wall in scenario.world.walls])
        route = shapely.LineString(scenario.route.waypoints)
        faces = shapely.polygonize(shapely.get_parts(shapely.node(walls)))
        (free,) = [face for face in shapely.get_parts(faces) if face.intersects(route)]
        pieces = outlines(scenario.world)
        assert shapely.covers(free.buffer(1e-6), pieces).all(), seed
        assert min(shapely.distance(pieces, route)) > 0.64, seed
        assert shapely.union_all(pieces).area == pytest.approx(sum(shapely.area(pieces))), seed
        count, area = count + len(pieces), area + free.area
    assert 12.0 < area / count < 15.5  # square metres for each
