"""Walls that are not flat, things along them, and surfaces that swallow light."""

from typing import Any

import numpy as np
import pytest

from moteslam.robot.noise import Surroundings
from moteslam.sim.scenario import load_scenario, parse_scenario
from moteslam.sim.simulate import simulate, true_drive
from moteslam.sim.world.layout import Layout, Room
from moteslam.sim.world.pieces import Box
from moteslam.sim.world.world import World, lived_in

ROOM = World.of(
    Layout(rooms=(Room(corner=(0, 0), size=(40, 30)),), boxes=(Box(centre=(8, 6), size=(1, 1), material="glass"),))
)
PATH = np.stack((np.linspace(0.4, 39.6, 400), np.full(400, 0.4)), axis=1)


def changed(seed: int = 0, **settings: float) -> World:
    return lived_in(ROOM, Surroundings(**settings), np.random.default_rng(seed), path=PATH, radius=0.3)


def test_relief_strays_as_far_as_it_is_asked_and_leaves_no_gap() -> None:
    np.testing.assert_array_equal(changed().segments, ROOM.segments)
    world = changed(relief=0.03, relief_length=0.2)
    points = world.segments[:, :2]
    off = ROOM.distance(points)
    inner = off[off > 0]
    assert np.sqrt(np.mean(inner**2)) == pytest.approx(0.03, rel=0.1)
    _, met = np.unique(np.round(world.segments.reshape(-1, 2), 9), axis=0, return_counts=True)
    assert (met == 2).all()  # closed outlines stay closed
    assert np.hypot(*np.diff(world.segments.reshape(-1, 2, 2), axis=1)[:, 0].T).max() < 0.5


def test_clutter_is_as_dense_as_asked_and_clear_of_the_robot() -> None:
    world = changed(clutter=0.5, clutter_depth=0.3)
    things = (len(world.segments) - len(ROOM.segments)) / 3
    walls = 2 * (40 + 30) + 4
    assert 0.6 * 2 * 0.5 * walls < things < 2 * 0.5 * walls  # on two sides; some stood in the way
    share = np.linspace(0, 1, 33)[:, None, None]
    drawn = world.segments[len(ROOM.segments) :].reshape(-1, 2, 2)
    outline = (drawn[None, :, 0] * (1 - share) + drawn[None, :, 1] * share).reshape(-1, 2)
    assert min(np.hypot(*(outline - place).T).min() for place in PATH[::4]) > 0.3
    assert ROOM.distance(outline).max() <= 0.5 + 1e-9


def test_surfaces_swallow_light_each_from_its_own_range_on_and_glass_stays_glass() -> None:
    world = changed(reach=20.0, reach_spread=0.8)
    reaches = [material.reach for material in world.palette.values() if material.reach and material.reach != 7.0]
    assert np.log(reaches).std() == pytest.approx(0.8, rel=0.15)
    assert np.median(reaches) == pytest.approx(20.0, rel=0.15)
    names = list(world.palette)
    glass = np.flatnonzero(ROOM.surfaces == names.index("glass"))
    assert {names[i] for i in world.surfaces[glass]} == {"glass"}
    room = np.flatnonzero(ROOM.surfaces != names.index("glass"))
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


def test_no_thing_stands_in_a_robots_way() -> None:
    scenario = load_scenario("office", platform="lms200", noise="as_recorded")
    path = true_drive(scenario, 5).poses[::20, :2]
    world = lived_in(
        World.of(scenario.world),
        scenario.noise.surroundings,
        np.random.default_rng(0),
        path=path,
        radius=scenario.platform.radius,
    )
    planned = World.of(scenario.world).distance(path).min()
    assert world.distance(path).min() > min(planned, scenario.platform.radius) - 0.15  # relief of five sigma
