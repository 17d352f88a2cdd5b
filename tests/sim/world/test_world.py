"""What layouts and random buildings become: segments, solids, free space, true maps, and walls that are not flat."""

from typing import Any

import numpy as np
import pytest
import shapely
from refusals import refusal
from scipy.ndimage import label

from moteslam.errors import ConfigError
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN
from moteslam.robot.noise import Surroundings
from moteslam.robot.raster import Raster
from moteslam.sim.scenario import Scenario, load_scenario, parse_scenario
from moteslam.sim.simulate import simulate, true_drive
from moteslam.sim.world.layout import Doorway, Layout, Recess, Room, RoomDoorway, Wall
from moteslam.sim.world.pieces import Box, Pillar, Shelf
from moteslam.sim.world.random_corridors import random_corridors
from moteslam.sim.world.world import World, lived_in, true_map


def total(segments: np.ndarray) -> float:
    """The length of all the segments [m]."""
    return float(np.hypot(*(segments[:, 2:] - segments[:, :2]).T).sum())


def test_a_door_is_a_gap() -> None:
    wall = Wall(points=((0, 0), (4, 0), (4, 3)), doors=(Doorway(at=1, width=0.9), Doorway(at=5, width=1)))
    segments = wall.segments()
    assert total(segments) == pytest.approx(7 - 1.9)
    world = World(segments)
    np.testing.assert_allclose(world.distance([(1.45, 0.0), (4.0, 1.5), (3.0, 0.0)]), (0.45, 0.5, 0.0), atol=1e-12)
    at_both_ends = Wall(points=((0, 0), (4, 0)), doors=(Doorway(at=0, width=1), Doorway(at=3, width=1)))
    np.testing.assert_allclose(at_both_ends.segments(), [(1, 0, 3, 0)])
    in_the_last_side = Wall(points=((0, 0), (4, 0), (4, 3)), closed=True, doors=(Doorway(at=8, width=1),))
    assert total(in_the_last_side.segments()) == pytest.approx(12 - 1)


def test_a_recess_goes_to_the_left_and_joins_up() -> None:
    wall = Wall(points=((0, 0), (4, 0)), recesses=(Recess(at=1, width=2, depth=0.5),))
    expected = [(0, 0, 1, 0), (1, 0, 1, 0.5), (1, 0.5, 3, 0.5), (3, 0.5, 3, 0), (3, 0, 4, 0)]
    np.testing.assert_allclose(wall.segments(), expected)
    down = wall.model_copy(update={"recesses": (Recess(at=1, width=2, depth=-0.5),)}).segments()
    assert down[:, [1, 3]].min() == -0.5


@pytest.mark.parametrize("side", ["north", "east", "south", "west"])
def test_a_room_has_its_door_in_the_side_asked_for(side: str) -> None:
    room = Room(corner=(1, 2), size=(4, 3), doors=(RoomDoorway(side=side, at=1, width=0.8),))
    middle = {"north": (2.4, 5), "east": (5, 3.4), "south": (2.4, 2), "west": (1, 3.4)}
    world = World(room.segments())
    for name, point in middle.items():
        assert world.distance(point)[0] == pytest.approx(0.4 if name == side else 0.0)


def test_inside_of_solids_and_clearance() -> None:
    layout = Layout(
        boxes=(Box(centre=(0, 0), size=(2, 1), angle=np.pi / 2),), pillars=(Pillar(centre=(3, 0), radius=0.5),)
    )
    world = World.of(layout)
    points = [(0, 0), (0, 0.9), (0.9, 0), (3.4, 0), (3.6, 0), (1.5, 0)]
    np.testing.assert_array_equal(world.inside_solid(points), [True, True, False, True, False, False])
    np.testing.assert_array_equal(world.is_free(points, 0.3), [False, False, True, False, False, True])
    assert world.bounds == pytest.approx((-0.5, -1, 3.5, 1))


def test_distance_agrees_with_a_plain_loop() -> None:
    rng = np.random.default_rng(0)
    segments, points = rng.uniform(-5, 5, (17, 4)), rng.uniform(-6, 6, (23, 2))
    shares = np.linspace(0, 1, 20001)[:, None]
    expected = [min(np.hypot(*(s[:2] + shares * (s[2:] - s[:2]) - p).T).min() for s in segments) for p in points]
    np.testing.assert_allclose(World(segments).distance(points), expected, atol=1e-3)


def test_a_point_on_an_edge_belongs_to_what_is_above_or_to_the_right() -> None:
    box = World.of(Layout(boxes=(Box(centre=(1.0, 0.5), size=(2.0, 1.0)),)))
    edges = [(0.0, 0.5), (2.0, 0.5), (1.0, 0.0), (1.0, 1.0)]
    np.testing.assert_array_equal(box.inside_solid(edges), [True, False, True, False])


ROOM = World.of(
    Layout(
        rooms=(Room(corner=(0.003, 0.004), size=(6, 4)),),
        boxes=(Box(centre=(4, 2), size=(1, 1), angle=0.5),),
        walls=(Wall(points=((1.03, 1.02), (2.07, 3.1))),),
    )
)


def values(true: Raster, points: np.ndarray) -> np.ndarray:
    return true.values_at(points, outside=UNKNOWN)


@pytest.mark.parametrize("resolution", [0.2, 0.05, 0.013])
def test_walls_are_occupied_rooms_free_and_the_rest_unknown(resolution: float) -> None:
    true = true_map(ROOM, resolution, seen_from=[(0.5, 0.5)])
    middle = np.array(true.origin[:2]) / resolution + 0.5  # of the first cell, as of every map of this world
    np.testing.assert_allclose(middle, np.round(middle), atol=1e-9)
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
    # the wall along the y axis lies in the middle of its cells, not in those to one side of it
    np.testing.assert_allclose(centres[np.abs(centres[:, 0]) < 0.9 * resolution, 0], 0, atol=1e-9)


def test_bays_of_shelves_are_free_and_nothing_stands_in_them() -> None:
    shelf = Shelf(centre=(3, 2), size=(2.0, 0.4), bay=1.0)
    world = World.of(Layout(rooms=(Room(corner=(0, 0), size=(6, 4)),), shelves=(shelf,)))
    true = true_map(world, 0.02, seen_from=[(0.5, 0.5)])
    bay = np.array([(2.5, 2.0), (3.5, 2.0)])
    assert (values(true, bay) == FREE).all()
    assert world.inside_solid(bay).all()
    assert (values(true, world.segments[4:, :2]) == OCCUPIED).any()  # its back


@pytest.mark.parametrize("resolution", [0.0, float("nan"), 1e-5])
def test_absurd_resolutions_are_refused(resolution: float) -> None:
    with refusal(ConfigError, field="resolution"):
        true_map(ROOM, resolution, seen_from=[(0.5, 0.5)])


HALL = World.of(
    Layout(rooms=(Room(corner=(0, 0), size=(40, 30)),), boxes=(Box(centre=(8, 6), size=(1, 1), material="glass"),))
)
PATH = np.stack((np.linspace(0.4, 39.6, 400), np.full(400, 0.4)), axis=1)


def changed(seed: int = 0, **settings: float) -> World:
    return lived_in(HALL, Surroundings(**settings), np.random.default_rng(seed), path=PATH, radius=0.3)


def test_relief_strays_as_far_as_it_is_asked_and_leaves_no_gap() -> None:
    np.testing.assert_array_equal(changed().segments, HALL.segments)
    world = changed(relief=0.03, relief_length=0.2)
    points = world.segments[:, :2]
    off = HALL.distance(points)
    inner = off[off > 0]
    assert np.sqrt(np.mean(inner**2)) == pytest.approx(0.03, rel=0.1)
    _, met = np.unique(np.round(world.segments.reshape(-1, 2), 9), axis=0, return_counts=True)
    assert (met == 2).all()  # closed outlines stay closed
    assert np.hypot(*np.diff(world.segments.reshape(-1, 2, 2), axis=1)[:, 0].T).max() < 0.5


def test_clutter_is_as_dense_as_asked_and_clear_of_the_robot() -> None:
    world = changed(clutter=0.5, clutter_depth=0.3)
    things = (len(world.segments) - len(HALL.segments)) / 3
    walls = 2 * (40 + 30) + 4
    assert 0.6 * 2 * 0.5 * walls < things < 2 * 0.5 * walls  # on two sides; some stood in the way
    share = np.linspace(0, 1, 33)[:, None, None]
    drawn = world.segments[len(HALL.segments) :].reshape(-1, 2, 2)
    outline = (drawn[None, :, 0] * (1 - share) + drawn[None, :, 1] * share).reshape(-1, 2)
    assert min(np.hypot(*(outline - place).T).min() for place in PATH[::4]) > 0.3
    assert HALL.distance(outline).max() <= 0.5 + 1e-9


def test_surfaces_swallow_light_each_from_its_own_range_on_and_glass_stays_glass() -> None:
    world = changed(reach=20.0, reach_spread=0.8)
    reaches = [material.reach for material in world.palette.values() if material.reach and material.reach != 7.0]
    assert np.log(reaches).std() == pytest.approx(0.8, rel=0.15)
    assert np.median(reaches) == pytest.approx(20.0, rel=0.15)
    names = list(world.palette)
    glass = np.flatnonzero(HALL.surfaces == names.index("glass"))
    assert {names[i] for i in world.surfaces[glass]} == {"glass"}
    room = np.flatnonzero(HALL.surfaces != names.index("glass"))
    assert all(names[i].startswith("shade") for i in world.surfaces[room])


@pytest.mark.usefixtures("taichi")
def test_the_lidar_sees_it_and_the_robot_drives_as_before(table: dict[str, Any]) -> None:
    table["platform"] = "lms200"
    plain = simulate(parse_scenario(table), 3)
    table["noise"] = {"surroundings": {"relief": 0.03, "clutter": 1.0, "reach": 5.0}}
    seen = simulate(parse_scenario(table), 3)
    assert seen.truth.poses.tobytes() == plain.truth.poses.tobytes()
    assert np.isinf(seen.recording.lidar.ranges).mean() > 0.1 > np.isinf(plain.recording.lidar.ranges).mean()
    assert len(seen.world.segments) > 10 * len(plain.world.segments)
    seen_map, plain_map = (simulation.true_map(0.1).values for simulation in (seen, plain))
    assert (seen_map == plain_map.max()).sum() != (plain_map == plain_map.max()).sum()


def building(seed: int) -> Scenario:
    return parse_scenario(random_corridors(seed))


def test_drivable() -> None:
    """In this one furniture stood where the robot swings out to turn back."""
    scenario = building(1018)
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


@pytest.mark.slow
def test_furniture_stands_in_free_space_clear_of_walls_route_and_other_furniture() -> None:
    count, area = 0, 0.0
    for seed in range(15):
        scenario = building(seed)
        walls = shapely.multilinestrings([wall.points for wall in scenario.world.walls])
        route = shapely.LineString(scenario.route.waypoints)
        faces = shapely.polygonize(shapely.get_parts(shapely.node(walls)))
        (free,) = [face for face in shapely.get_parts(faces) if face.intersects(route)]
        world = scenario.world
        furniture = (*world.boxes, *world.pillars, *world.tables, *world.chairs)
        pieces = [shapely.Polygon(piece.polygon()) for piece in furniture]
        assert shapely.covers(free.buffer(1e-6), pieces).all(), seed
        assert min(shapely.distance(pieces, route)) > 0.64, seed
        assert shapely.union_all(pieces).area == pytest.approx(sum(shapely.area(pieces))), seed
        count, area = count + len(pieces), area + free.area
    assert 12.0 < area / count < 15.5  # square metres for each


FURNITURE = ("boxes", "tables", "chairs", "shelves")


def visit_of(name: str, *keys: str) -> Scenario:
    return load_scenario(name, settings=[f"visit={{{', '.join(keys)}}}"])


@pytest.mark.parametrize(("name", "moved"), [("office", 4), ("lab", 7), ("random-corridors-5", 4)])
def test_a_visit_finds_a_share_of_the_furniture_elsewhere_and_the_robot_its_way_clear(name: str, moved: int) -> None:
    scenario = visit_of(name, "seed=2", "moved=0.3")
    before, after = scenario.world, scenario.standing
    pairs = [pair for kind in FURNITURE for pair in zip(getattr(before, kind), getattr(after, kind), strict=True)]
    away = np.array([np.hypot(*(np.array(a.centre) - b.centre)) for a, b in pairs])
    assert (away > 0).sum() == moved
    assert ((away[away > 0] >= 0.499) & (away[away > 0] <= 3.001)).all()
    solid = [shapely.Polygon(b.polygon()) for a, b in pairs if a != b]
    walls = shapely.MultiLineString(
        World.of(after.model_copy(update=dict.fromkeys(FURNITURE, ()))).segments.reshape(-1, 2, 2).tolist()
    )
    assert not any(piece.intersects(walls) for piece in solid)
    route = shapely.LineString(scenario.route.corners)
    assert min(piece.distance(route) for piece in solid) > 0.6
    assert visit_of(name, "seed=2", "moved=0.3").standing == after
    assert visit_of(name, "seed=3", "moved=0.3").standing != after
    assert visit_of(name, "moved=0.0", "shut=0.0").standing == before


@pytest.mark.slow
def test_two_visits_have_truths_of_their_own_in_one_building() -> None:
    """Relief and clutter are those of the building; a room behind a shut door is unknown to its visit's truth."""
    maps = {}
    for seed, settings in ((1, ("moved=0.0", "shut=0.0")), (2, ("seed=2", "moved=0.1", "shut=1.0"))):
        more = [f"visit={{{', '.join(settings)}}}"]
        scenario = load_scenario("office", platform="turtlebot3", noise="as_recorded", settings=more)
        maps[seed] = simulate(scenario.model_copy(update={"duration": 11.0}), seed)
    first, second = (maps[seed].true_map(0.05) for seed in (1, 2))
    assert (second.values == FREE).sum() < 0.9 * (first.values == FREE).sum()
    assert ((first.values == OCCUPIED) & (second.values == FREE)).sum() > 20
    lines = [{tuple(line) for line in maps[seed].world.segments.round(9).tolist()} for seed in (1, 2)]
    assert len(lines[0] & lines[1]) > 0.9 * len(lines[0])


def test_where_there_is_no_route_the_start_stays_clear() -> None:
    for seed in range(4):
        table = load_scenario("office").model_dump(exclude={"route"}, exclude_none=True)
        scenario = parse_scenario(
            {**table, "wander": {"start": [8.0, -3.0], "distance": 20}, "visit": {"seed": seed, "moved": 1.0}}
        )
        assert World.of(scenario.standing).distance((8.0, -3.0))[0] > 0.6
