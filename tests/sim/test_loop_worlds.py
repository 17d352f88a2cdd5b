"""The worlds for loop closing: how far is driven, which loops there are, and which places look alike."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from parts.runs import STEP_NOISE, wheels_case
from scipy.spatial import cKDTree

from moteslam.kernels.raycast import build_buckets, cast_rays
from moteslam.robot import se2
from moteslam.sim.robot.drive import Drive
from moteslam.sim.scenario import Scenario, load_scenario
from moteslam.sim.simulate import true_drive
from moteslam.sim.world.world import World

Array = NDArray[np.float64]

WORLDS = [pytest.param("campus", marks=pytest.mark.slow), "twins", "grid"]
STEP = 0.5
"""Between the places of a path that are compared [m]."""
APART = 15.0
"""A place seen again after more than this much of path closes a loop [m]."""
REACH = 8.0
"""How far a look at the surroundings goes: that of a small lidar [m]."""


@cache
def drive(name: str) -> Drive:
    return true_drive(load_scenario(name))


def path_of(name: str) -> tuple[Array, Array]:
    """The true path of seed 0, every ``STEP``: places [n, 2] [m] and headings [n] [rad]."""
    poses = drive(name).poses[::40]
    driven = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    x, y, heading = (np.interp(np.arange(0.0, driven[-1], STEP), driven, column) for column in poses.T)
    return np.stack((x, y), axis=-1), heading


def meetings(places: Array, driven: Array, within: float) -> NDArray[np.int64]:
    """The pairs [k, 2] of places [n, 2] at most ``within`` [m] from each other, over ``APART`` of path apart."""
    pairs = cKDTree(places).query_pairs(within, output_type="ndarray")
    return pairs[np.abs(np.diff(driven[pairs], axis=1)[:, 0]) > APART]


def views_from(places: Array, scenario: Scenario, *, beams: int) -> Array:
    """[n, beams] ranges all around from places [n, 2], at most ``REACH`` [m]."""
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False) + 0.01
    buckets = build_buckets(World.of(scenario.world).segments)
    origins = np.repeat(places, beams, axis=0)
    ranges = cast_rays(buckets, origins, np.tile(angles, len(places)), max_range=REACH)
    return np.minimum(ranges, REACH).reshape(len(places), -1)


def look_alike(name: str) -> float:
    """The share of the places on the route from which everything within ``REACH`` looks as from another place.

    Another place is over 3 m away; alike are two views whose ranges differ by over 5 cm in at most one beam of 50.
    """
    scenario = load_scenario(name)
    corners = scenario.route.path()
    driven = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    length = np.arange(0.0, driven[-1], 0.2)
    places = np.unique(np.stack([np.interp(length, driven, axis) for axis in corners.T], axis=-1).round(1), axis=0)
    views = views_from(places, scenario, beams=100)
    asked = range(0, len(places), 10)
    found = 0
    for i in asked:
        alike = (np.abs(views - views[i]) > 0.05).mean(axis=1) <= 0.02
        found += bool((alike & (np.hypot(*(places - places[i]).T) > 3.0)).any())
    return found / len(asked)


@pytest.mark.slow
def test_campus_is_driven_in_the_same_direction_here_and_in_opposite_ones_alone_there() -> None:
    places, heading = path_of("campus")
    pairs = meetings(places, STEP * np.arange(len(places)), 1.0)
    turn = np.abs(se2.wrap(np.diff(heading[pairs], axis=1)[:, 0]))
    opposite, same = (np.unique(pairs[chosen]) for chosen in (turn > np.radians(150), turn < np.radians(30)))
    assert STEP * len(np.setdiff1d(opposite, same)) > 600.0  # 300 m of corridor, there and back
    assert STEP * len(same) > 400.0


@pytest.mark.slow
def test_mile_returns_to_a_known_place_after_a_kilometre_and_a_half_and_not_before() -> None:
    run = drive("mile")
    assert run.end == "arrived"
    assert 2100.0 < run.truth.length < 2200.0
    places, _ = path_of("mile")
    first, again = meetings(places, STEP * np.arange(len(places)), 3.0).T
    assert 1500.0 < STEP * again.min() < 1550.0
    assert STEP * first.max() < STEP * again.max() < STEP * len(places)
    assert STEP * len(np.unique(again)) > 250.0


@pytest.mark.usefixtures("taichi")
def test_junctions_beside_that_of_the_first_return_to_mile_look_like_it() -> None:
    """As far as a corridor is wide and a few metres more, to all sides."""
    junctions = np.array([[20.0 * rib, 0.0] for rib in range(1, 9)])
    views = views_from(junctions, load_scenario("mile"), beams=200)
    alike = (np.abs(views - views[3]) > 0.05).mean(axis=1) <= 0.02
    assert alike[[2, 3, 4]].all()  # the fourth rib is driven down; the others are 20 m to both sides
    assert alike.sum() >= 5


@pytest.mark.slow
@pytest.mark.parametrize("name", WORLDS)
def test_key_scans_close_loops(name: str) -> None:
    case = wheels_case(name, 1, step_noise=STEP_NOISE)
    assert case.simulation.end == "arrived"
    lidar, truth = case.recording.lidar, case.reference
    assert case.recording.imu is None
    assert len(lidar) > truth.length
    places = truth.at(lidar.stamps).poses[:, :2]
    driven = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))))
    closing = np.unique(meetings(places, driven, 2.0))
    assert len(closing) > 0.5 * len(places)


@pytest.mark.slow
def test_campus_closes_its_large_loop_first_and_smaller_ones_within_it() -> None:
    run = drive("campus")
    assert run.end == "arrived"
    assert 1500.0 < run.truth.length < 1700.0
    places, _ = path_of("campus")
    first, again = meetings(places, STEP * np.arange(len(places)), 1.0).T
    lap = STEP * (again - first)
    # a room is left where it was entered: such loops are shorter than any round of corridors
    earliest = again[lap > 50].min()
    assert 400.0 < lap[(again == earliest) & (lap > 50)].min() < 480.0
    shortest = np.full(len(places), np.inf)
    np.minimum.at(shortest, again[lap > 50], lap[lap > 50])
    for low, high in ((100.0, 200.0), (200.0, 350.0)):
        assert STEP * ((shortest > low) & (shortest < high)).sum() > 20.0


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("twins", 0.5, 1.0), ("grid", 0.5, 1.0), pytest.param("campus", 0.0, 0.02, marks=pytest.mark.slow)],
)
@pytest.mark.usefixtures("taichi")
def test_how_many_places_look_like_another_one(name: str, low: float, high: float) -> None:
    assert low <= look_alike(name) <= high
