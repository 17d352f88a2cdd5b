"""The worlds for loop closing: where a known place is met again, and which places look alike."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from moteslam.kernels.raycast import build_buckets, cast_rays
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import true_drive
from moteslam.sim.world.world import World

APART = 15.0
"""A place met again after more than this much of path closes a loop [m]."""
REACH = 8.0
"""How far a look at the surroundings goes: that of a small lidar [m]."""


def look_alike(name: str) -> float:
    """The share of the places on the route from which everything within ``REACH`` looks as from another place.

    Another place is over 3 m away; alike are two views whose ranges differ by over 5 cm in at most one beam of 50.
    """
    scenario, beams = load_scenario(name), 100
    corners = scenario.route.path()
    driven = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    length = np.arange(0.0, driven[-1], 0.2)
    places = np.unique(np.stack([np.interp(length, driven, axis) for axis in corners.T], axis=-1).round(1), axis=0)
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False) + 0.01
    buckets = build_buckets(World.of(scenario.world).segments)
    ranges = cast_rays(buckets, np.repeat(places, beams, axis=0), np.tile(angles, len(places)), max_range=REACH)
    views = np.minimum(ranges, REACH).reshape(len(places), beams)
    asked = range(0, len(places), 10)
    found = 0
    for i in asked:
        alike = (np.abs(views - views[i]) > 0.05).mean(axis=1) <= 0.02
        found += bool((alike & (np.hypot(*(places - places[i]).T) > 3.0)).any())
    return found / len(asked)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "length", "first_after"),
    [("mile", (2100.0, 2200.0), (1500.0, 1550.0)), ("campus", (1500.0, 1700.0), (400.0, 480.0))],
)
def test_a_known_place_is_met_again_so_late(
    name: str, length: tuple[float, float], first_after: tuple[float, float]
) -> None:
    """After the largest round; what closes within 50 m is a room that is left where it was entered."""
    run = true_drive(load_scenario(name))
    assert run.end == "arrived"
    assert length[0] < run.truth.length < length[1]
    poses = run.poses[::200]
    driven = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    pairs = cKDTree(poses[:, :2]).query_pairs(1.0, output_type="ndarray")
    first, again = np.sort(pairs[np.abs(np.diff(driven[pairs], axis=1)[:, 0]) > 50.0], axis=1).T
    assert first_after[0] < (driven[again] - driven[first])[again == again.min()].min() < first_after[1]


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("twins", 0.5, 1.0), ("grid", 0.5, 1.0), pytest.param("campus", 0.0, 0.02, marks=pytest.mark.slow)],
)
@pytest.mark.usefixtures("taichi")
def test_how_many_places_look_like_another_one(name: str, low: float, high: float) -> None:
    assert low <= look_alike(name) <= high
