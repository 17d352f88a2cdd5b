"""What a layout becomes: segments, solids, free space."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.sim.world.layout import Doorway, Layout, Recess, Room, RoomDoorway, Wall
from moteslam.sim.world.pieces import Box, Pillar
from moteslam.sim.world.world import World


def total(segments: np.ndarray) -> float:
    """The length of all the segments [m]."""
    return float(np.hypot(*(segments[:, 2:] - segments[:, :2]).T).sum())


def test_a_door_is_a_gap() -> None:
    wall = Wall(points=((0, 0), (4, 0), (4, 3)), doors=(Doorway(at=1, width=0.9), Doorway(at=5, width=1)))
    segments = wall.segments()
    assert total(segments) == pytest.approx(7 - 1.9)
    world = World(segments)
    np.testing.assert_allclose(world.distance([(1.45, 0.0), (4.0, 1.5), (3.0, 0.0)]), (0.45, 0.5, 0.0), atol=1e-12)


def test_a_wall_with_a_door_from_its_beginning_and_one_to_its_end() -> None:
    wall = Wall(points=((0, 0), (4, 0)), doors=(Doorway(at=0, width=1), Doorway(at=3, width=1)))
    np.testing.assert_allclose(wall.segments(), [(1, 0, 3, 0)])


def test_a_recess_goes_to_the_left_and_joins_up() -> None:
    wall = Wall(points=((0, 0), (4, 0)), recesses=(Recess(at=1, width=2, depth=0.5),))
    expected = [(0, 0, 1, 0), (1, 0, 1, 0.5), (1, 0.5, 3, 0.5), (3, 0.5, 3, 0), (3, 0, 4, 0)]
    np.testing.assert_allclose(wall.segments(), expected)
    down = wall.model_copy(update={"recesses": (Recess(at=1, width=2, depth=-0.5),)}).segments()
    assert down[:, [1, 3]].min() == -0.5


def test_a_closed_wall_comes_back_to_its_first_point() -> None:
    wall = Wall(points=((0, 0), (4, 0), (4, 3)), closed=True, doors=(Doorway(at=8, width=1),))
    assert total(wall.segments()) == pytest.approx(12 - 1)


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
