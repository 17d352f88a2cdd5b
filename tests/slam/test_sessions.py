"""Sessions of one building: bound in one frame or kept apart, and the map in which newer scans win."""

from dataclasses import replace

import numpy as np
import pytest
import slam_rooms
from refusals import refusal
from slam_rooms import ate, endpoints, run

from moteslam.errors import ConfigError
from moteslam.eval.cli.simulate import scenario_of
from moteslam.robot import se2
from moteslam.robot.formats import Cut, cut
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.sim.simulate import Simulation, simulate
from moteslam.slam import sessions
from moteslam.slam.backend.building import Building, Session
from moteslam.slam.backend.graph.pose_graph import Edges, MeasuredChain
from moteslam.slam.config import resolve_config
from moteslam.slam.estimate import Estimate
from moteslam.slam.known_map.search import Found, Place, find_path
from moteslam.slam.mapping.config import MapConfig
from moteslam.slam.sessions import go_on, joined

ROOM = [((-4, -3), (4, -3)), ((4, -3), (4, 3)), ((4, 3), (-4, 3)), ((-4, 3), (-4, -3)), ((-4, -1), (-3, -1))]
NO_LOOPS = Edges(*np.zeros((2, 0), np.intp), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, bool))


def box(x: float, y: float) -> list:
    """The walls of a box of 0.8 m around a place."""
    corners = [(x - 0.4, y - 0.4), (x + 0.4, y - 0.4), (x + 0.4, y + 0.4), (x - 0.4, y + 0.4)]
    return list(zip(corners, corners[1:] + corners[:1], strict=True))


def seen(walls: list, *, begins: float, scans: int = 12, across: float = 2.0) -> Building:
    """A session of scans along the middle of the room, from -2 m to ``across``."""
    path = np.column_stack((np.linspace(-2, across, scans), np.zeros((scans, 2))))
    points = [endpoints(pose, walls) for pose in path]
    steps, covariance = np.diff(path, axis=0), np.repeat(1e-4 * np.eye(3)[None], scans - 1, axis=0)
    chain = MeasuredChain(steps, covariance, steps, covariance, np.zeros(scans - 1, bool))
    counts, drawn = np.array([len(each) for each in points], np.int32), np.ones(scans, bool)
    arrays = (np.arange(scans), chain, np.concatenate(points), counts, np.zeros(2), drawn)
    return Building((Session(begins + np.arange(scans), path, *arrays),), NO_LOOPS)


def occupied(drawn: Raster, walls: list) -> float:
    """The share of points on walls that lie on occupied cells or beside one."""
    ends = np.array(walls, float)
    along = (ends[:, :1] + np.linspace(0, 1, 41)[None, :, None] * (ends[:, 1:] - ends[:, :1])).reshape(-1, 2)
    shifts = 0.05 * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
    return float(
        np.mean((drawn.values_at((along[:, None] + shifts).reshape(-1, 2), outside=0) > 0).reshape(-1, 5).any(1))
    )


def test_a_box_that_was_moved_stands_at_its_new_place_alone() -> None:
    before, after = seen(ROOM + box(0, 1.5), begins=0.0), seen(ROOM + box(1, -1.5), begins=100.0, scans=8)
    face = [((-0.4, 1.1), (0.4, 1.1))], [((0.6, -1.1), (1.4, -1.1))]
    for building in (before.plus(after), after.plus(before)):  # by time, in whatever order they came
        drawn = building.draw(MapConfig())
        assert occupied(drawn, face[0]) < 0.1
        assert occupied(drawn, face[1]) > 0.9
        assert occupied(drawn, ROOM[:4]) > 0.75  # some of it behind boxes and the robot
    assert occupied(before.plus(after).draw(MapConfig(memory=0.0)), face[0]) > 0.9


def test_what_a_later_session_did_not_see_stays() -> None:
    before = seen(ROOM + box(0, 1.5), begins=0.0)
    (session,) = seen(ROOM, begins=100.0).sessions
    near = np.hypot(*session.points.T) < 1.0
    blind = replace(session, points=session.points[near], counts=np.zeros_like(session.counts))
    drawn = before.plus(Building((blind,), NO_LOOPS)).draw(MapConfig())
    assert occupied(drawn, [((-0.4, 1.1), (0.4, 1.1))]) > 0.9


@pytest.mark.parametrize(
    ("begins", "order"),
    [
        ((0, 100, 200), [0, 1, 2]),
        ((200, 0, 100), [1, 2, 0]),
        ((0, 0, 0), [0, 1, 2]),  # of clocks that nothing relates
        ((100, 0, 5), [1, 2, 0]),
    ],
)
def test_sessions_are_in_the_order_of_their_stamps_where_these_tell(begins: tuple[int, ...], order: list[int]) -> None:
    one, *others = [seen(ROOM, begins=begin, scans=12) for begin in begins]
    building = one
    for other in others:
        building = building.plus(other)
    assert building.by_age == order


@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize(
    ("others", "places"),
    [([ROOM], 2), ([ROOM + box(2, -1.5)], 1), ([], 1)],
    ids=["two alike", "two that differ", "one"],
)
def test_a_path_lies_at_the_one_place_that_does_not_contradict_it(others: list, places: int) -> None:
    there = np.array((0.5, 0.2, 0.3))
    path = np.asarray([(0.4 * np.cos(k / 2), 0.4 * np.sin(k / 2), k / 2) for k in range(40)])
    stood = np.array([(20.0 * k, 0.0, 0.0) for k in range(1 + len(others))])
    scans = [endpoints(pose, ROOM) for pose in se2.compose(there, path)]
    rooms = [np.add(room, (x, 0.0)).tolist() for (x, _, _), room in zip(stood, (ROOM, *others), strict=True)]
    building = slam_rooms.drawn(*rooms, low=(-5.0, -4.0), high=(5.0 + stood[-1, 0], 4.0))
    found, decided, number = find_path(building, stood, path, scans, np.zeros(2))
    assert decided == (places == 1)
    if places > 1:
        assert number > 1
    else:
        np.testing.assert_allclose(found.track[0], se2.compose(there, path[0]), atol=0.06)


@pytest.fixture(scope="module")
def drive() -> Simulation:
    return simulate(scenario_of("office", 300, duration=70.0), 300)


@pytest.fixture(scope="module")
def parts(drive: Simulation, taichi: None) -> list[Estimate]:
    return [run(cut(drive.recording, Cut(*span))) for span in ((0.0, 45.0), (25.0, 70.0))]


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 1])
def test_two_recordings_give_the_same_building_in_any_order(
    drive: Simulation, parts: list[Estimate], first: int
) -> None:
    old, new = parts[first], parts[1 - first]
    found = go_on(new, old.building)
    building = found.building
    assert [one.stamps[0] for one in building.sessions] == [each.trajectory.stamps[0] for each in (old, new)]
    assert building.between.sum() >= 2
    np.testing.assert_array_equal(found.trajectory_final.poses, building.sessions[1].path)
    together = [
        replace(each.trajectory_final, poses=one.path) for each, one in zip((old, new), building.sessions, strict=True)
    ]
    stamps, poses = (np.concatenate([getattr(one, name) for one in together]) for name in ("stamps", "poses"))
    order = np.argsort(stamps, kind="stable")
    assert ate(type(together[0])(stamps[order], poses[order]), drive.truth) < 0.01
    # the frame is that of the sessions before
    assert np.abs(building.sessions[0].path - old.trajectory_final.poses)[:, :2].max() < 0.05
    assert not [issue for issue in found.warnings if issue.code == "session-apart"]


@pytest.mark.slow
def test_a_recording_of_another_building_stays_apart(parts: list[Estimate]) -> None:
    elsewhere = run(simulate(scenario_of("lab", 301, duration=40.0), 301).recording)
    found = go_on(elsewhere, parts[0].building)
    assert [issue.code for issue in found.warnings if issue not in elsewhere.warnings] == ["session-apart"]
    assert found.building is elsewhere.building
    assert found.map is elsewhere.map


@pytest.mark.slow
def test_a_recording_is_not_bound_to_itself(parts: list[Estimate]) -> None:
    building = parts[0].building
    found = go_on(parts[0], building)
    assert [issue.code for issue in found.warnings if issue not in parts[0].warnings] == ["session-apart"]
    assert "session 1" in found.warnings[-1].message
    assert found.building is building


@pytest.mark.parametrize(("off", "decided", "bound"), [(0.1, "01", 1), (0.1, "10", 1), (0.1, "00", 0), (5.0, "11", 0)])
@pytest.mark.usefixtures("taichi")
def test_sessions_lie_in_each_others_maps_at_one_place(
    monkeypatch: pytest.MonkeyPatch, off: float, decided: str, bound: int
) -> None:
    """What is found either way; one place is off from the other, and decided or not."""
    building, new = seen(ROOM + box(0, 1.5), begins=0.0), seen(ROOM + box(0, -1.5), begins=100.0)
    ways = iter(((0.0, decided[0] == "1"), (off, decided[1] == "1")))

    def find(_occupancy: Raster, _stood: Array, path: Array, *_: object) -> Found:
        shift, is_decided = next(ways)
        return Found(Place(3, 500.0, 0.0, np.add(path, (shift, 0.0, 0.0))), is_decided, 1)

    monkeypatch.setattr(sessions, "find_path", find)
    monkeypatch.setattr(sessions, "bind", lambda *_: building)
    assert (joined(building, new, resolve_config()) is building) == bool(bound)


@pytest.mark.usefixtures("taichi")
def test_other_scans_with_the_same_stamps_are_another_recording() -> None:
    building, other = (seen(ROOM + box(0, y), begins=0.0) for y in (1.5, -1.5))
    for new, same in ((building, True), (other, False)):
        why = joined(building, new, resolve_config())
        assert isinstance(why, str)
        assert ("session 1" in why) == same


@pytest.mark.slow
def test_sessions_need_a_graph(parts: list[Estimate]) -> None:
    building = parts[0].building
    graph_less = replace(parts[1], config=resolve_config(settings=["backend.method=none"]))
    with refusal(ConfigError, field="backend.method"):
        go_on(graph_less, building)
