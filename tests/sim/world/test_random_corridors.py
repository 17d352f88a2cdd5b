"""Random buildings: connected, drivable, all different, and no ray through a wall of theirs."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import shapely
from scipy.ndimage import label

from moteslam.robot.formats.map_server import FREE, OCCUPIED
from moteslam.sim.scenario import Scenario, load_scenario, parse_scenario
from moteslam.sim.simulate import true_drive
from moteslam.sim.world.layout import Layout
from moteslam.sim.world.random_corridors import random_corridors
from moteslam.sim.world.true_map import true_map
from moteslam.sim.world.world import World


def building(seed: int) -> Scenario:
    return parse_scenario(random_corridors(seed))


@pytest.mark.parametrize("seed", [0, 1013, 1018, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (3, 11))])
def test_drivable(seed: int) -> None:
    """In 1013 and 1018 furniture stood where the robot swings out to turn back."""
    scenario = building(seed)
    world = World.of(scenario.world)
    run = true_drive(scenario)
    assert run.end == "arrived"
    assert world.is_free(run.poses[::10, :2], scenario.platform.width / 2).all()
    assert 80 < run.truth.length < 130


@pytest.mark.parametrize("seed", range(2))
def test_connected(seed: int) -> None:
    scenario = building(seed)
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
    for seed in range(50):
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
    assert 12.0 < area / count < 15.0  # square metres for each


def crosses(a: tuple[Fraction, ...], b: tuple[Fraction, ...], wall: list[Fraction]) -> bool:
    """Whether the open segment a-b properly crosses a wall, by the signs of exact areas."""

    def side(p: Any, q: Any, r: Any) -> int:
        area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        return (area > 0) - (area < 0)

    c, d = wall[:2], wall[2:]
    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


@pytest.mark.usefixtures("taichi")
def test_no_ray_goes_through_a_wall() -> None:
    from moteslam.kernels.raycast import build_buckets, cast_rays

    scenario = building(9)
    world = World.of(scenario.world)
    generator = np.random.default_rng(0)
    run = true_drive(scenario)
    origins = run.poses[generator.integers(0, len(run.poses), 40), :2]
    angles = generator.uniform(-np.pi, np.pi, 40)
    ranges = cast_rays(build_buckets(world.segments), origins, angles, max_range=30.0).astype(np.float64)
    assert np.isfinite(ranges).mean() > 0.95
    reach = np.where(np.isfinite(ranges), ranges, 30.0) - 2e-3  # float32, and walls met aslant
    ends = origins + reach[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    walls = [[Fraction(value) for value in wall] for wall in world.segments.tolist()]
    for origin, end in zip(origins.tolist(), ends.tolist(), strict=True):
        a, b = tuple(map(Fraction, origin)), tuple(map(Fraction, end))
        assert not any(crosses(a, b, wall) for wall in walls)
    # and the test can fail: a ray one centimetre longer than it saw is through something
    far = origins + (ranges + 0.01)[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    through = [
        any(crosses(tuple(map(Fraction, a)), tuple(map(Fraction, b)), wall) for wall in walls)
        for a, b, seen in zip(origins.tolist(), far.tolist(), np.isfinite(ranges), strict=True)
        if seen
    ]
    assert np.mean(through) > 0.9
