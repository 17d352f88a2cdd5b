"""People and doors: where beams see them, whom they run into, and that the robot minds them."""

from typing import Any

import numpy as np
import pytest

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.noise import Noise
from moteslam.sim.robot.drive import Drive
from moteslam.sim.scenario import Scenario, parse_scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.simulate import simulate, true_drive
from moteslam.sim.world.world import World

HALL = {"rooms": [{"corner": [0.0, 0.0], "size": [14.0, 4.0]}]}
REST = {"rest_start": 1.0, "rest_end": 1.0}


def hall(**parts: Any) -> Scenario:
    route = {"waypoints": [[1.5, 2.0], [12.0, 2.0]]}
    return parse_scenario({"world": HALL, "route": route, "drive": REST, **parts})


def watched(start: list[float], seconds: float, **parts: Any) -> Scenario:
    """A robot that stands in the hall, out of the way, and what moves there."""
    commands = {"start": start, "steps": [{"duration": seconds}]}
    return parse_scenario({"world": HALL, "drive": REST, "commands": commands, **parts})


def robot_at_the_rate_of_the_tracks(run: Drive) -> np.ndarray:
    return run.poses[::4][: len(run.tracks.people)]


def test_people_keep_clear_of_walls_robot_and_each_other() -> None:
    crowd = {"crowd": {"count": 5}, "people": [{"waypoints": [[11.0, 2.0], [1.0, 2.0]]}]}
    scenario = hall(**crowd, drive={**REST, "speed": 0.5})
    run = true_drive(scenario, 3)
    assert run.end == "arrived"
    people = run.tracks.people
    assert people.shape[1] == 6
    assert World.of(scenario.world).distance(people.reshape(-1, 2)).min() > 0.19  # radius 0.22, and bumps give way
    apart = np.linalg.norm(people[:, :, None] - people[:, None], axis=-1) + 9 * np.eye(6)
    assert apart.min() > 0.38
    robot = robot_at_the_rate_of_the_tracks(run)[:, None, :2]
    assert np.linalg.norm(people - robot, axis=-1).min() > 0.22 + 0.476 / 2 - 0.03
    assert World.of(scenario.world).is_free(run.poses[::20, :2], 0.2).all()


def test_a_blind_robot_bumps_into_who_stands_before_it() -> None:
    # a passage too narrow to step aside in: the person backs off to its end, and stands there
    passage = {"rooms": [{"corner": [0.0, 0.0], "size": [14.0, 0.9]}]}
    standing = [{"waypoints": [[5.0, 0.45]], "start": 60.0}]
    commands = {"start": [2.0, 0.45, 0.0], "steps": [{"duration": 18.0, "speed": 0.8}]}
    table = {"world": passage, "drive": REST, "commands": commands}
    free, blocked = true_drive(parse_scenario(table)), true_drive(parse_scenario({**table, "people": standing}))
    assert free.poses[-1, 0] == pytest.approx(14.0 - 0.5842 / 2, abs=0.03)
    assert blocked.poses[-1, 0] == pytest.approx(14.0 - 0.44 - 0.5842 / 2, abs=0.06)
    assert blocked.tracks.people[-1, 0, 0] == pytest.approx(14.0 - 0.22, abs=0.06)


def test_the_same_seed_the_same_people_and_no_people_the_same_drive() -> None:
    first, again, other = (true_drive(hall(crowd={"count": 3}), seed) for seed in (1, 1, 2))
    assert first.tracks.discs.tobytes() == again.tracks.discs.tobytes()
    assert first.tracks.people[0].tobytes() != other.tracks.people[0].tobytes()
    alone = true_drive(hall(), 1)
    asleep = true_drive(hall(people=[{"waypoints": [[13.0, 0.6]], "start": 500.0}]), 1)
    assert alone.poses.tobytes() == asleep.poses.tobytes()


@pytest.mark.usefixtures("taichi")
def test_beams_see_people_where_they_are_at_the_beams_moment() -> None:
    walking = {"speed": 1.4, "pause": 0.0}
    people = [{"waypoints": [[x, 0.8], [x, 3.2]], "legs": legs, **walking} for x, legs in ((5.0, True), (8.0, False))]
    scenario = watched([2.0, 2.0, 0.0], 4.0, people=people, noise=Noise().model_dump())
    simulation = simulate(scenario)
    lidar, tracks = simulation.recording.lidar, simulation.tracks
    assert tracks.discs.shape[1] == 2 + 1
    mount = se2.compose(np.array((2.0, 2.0, 0.0)), scenario.platform.lidar.pose)
    angles = lidar.angles
    ends = mount[:2] + lidar.ranges[..., None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    on_wall = World.of(scenario.world).distance(ends.reshape(-1, 2)).reshape(lidar.ranges.shape) < 2e-3
    scan, beam = np.nonzero(~on_wall)
    assert len(scan) > 500
    at = (lidar.stamps[scan] - EPOCH + beam * lidar.time_increment) * tracks.rate
    i = np.floor(at).astype(int)
    share = (at - i)[:, None, None]
    discs = tracks.discs[i] * (1 - share) + tracks.discs[i + 1] * share
    off = np.linalg.norm(ends[scan, beam][:, None] - discs[..., :2], axis=-1) - discs[..., 2]
    assert np.abs(off).min(axis=1).max() < 1e-3
    late = tracks.discs[np.minimum(i + 10, len(tracks.discs) - 1)]  # 0.1 s later they are elsewhere
    off = np.linalg.norm(ends[scan, beam][:, None] - late[..., :2], axis=-1) - late[..., 2]
    assert np.abs(off).min(axis=1).max() > 0.05
    assert len(set(np.abs(off).argmin(axis=1).tolist())) == 3


DOOR = {"hinge": [7.0, 0.0], "end": [7.0, 4.0], "kind": "slide"}


def test_an_automatic_door_lets_the_robot_through_and_shuts_behind_it() -> None:
    run = true_drive(hall(doors=[{**DOOR, "shut_for": 1000.0}]))
    assert run.end == "arrived"
    low = run.tracks.lines[:, 0, 3]  # the upper end: 4 shut, 0 open
    robot = robot_at_the_rate_of_the_tracks(run)[:, 0]
    assert low[0] == 4.0
    assert (low[np.abs(robot - 7.0) < 0.4] < 0.3).all()
    assert low[-1] > 3.9


def test_before_a_door_that_is_shut_the_robot_waits() -> None:
    closed = {**DOOR, "automatic": False, "shut_for": 20.0, "open_for": 100.0}
    run = true_drive(hall(doors=[closed]))
    assert run.end == "arrived"
    there = run.stamps[np.searchsorted(run.poses[:, 0], 7.0)]
    assert 20.0 < there < 26.0
    still = (run.stamps > 12) & (run.stamps < 20)
    assert np.ptp(run.poses[still, 0]) < 0.02
    assert 5.9 < run.poses[still, 0].max() < 6.6


def test_a_swinging_leaf_stops_for_who_stands_in_its_way() -> None:
    # the leaf would sweep through the person, who stands 0.4 m from it
    times = {"automatic": False, "shut_for": 0.5, "open_for": 99.0}
    door = {"hinge": [7.0, 0.2], "end": [7.0, 1.2], "opening": 1.5, **times}
    person = {"waypoints": [[6.5, 0.9]], "start": 60.0}
    run = true_drive(watched([2.0, 3.0, 0.0], 4.0, doors=[door], people=[person]))
    share = np.linspace(0, 1, 50)[:, None]
    leaf = run.tracks.lines[:, 0, None, :2] * (1 - share) + run.tracks.lines[:, 0, None, 2:] * share
    away = np.linalg.norm(leaf - run.tracks.people[:, :1], axis=-1).min(axis=1)
    assert away.min() > 0.22 + 0.05
    assert away.min() < 0.22 + 0.3  # it came near, and the person stepped aside
    assert np.hypot(*(run.tracks.lines[-1, 0, 2:] - (7.0, 1.2))) > 0.3


def test_a_crowd_without_room_is_refused() -> None:
    with pytest.raises(ConfigError, match="room for"):
        true_drive(hall(crowd={"count": 60}))


def test_who_meets_head_on_passes_on_the_right_and_strides() -> None:
    people = [{"waypoints": [[3.0, 2.0], [11.0, 2.0]]}, {"waypoints": [[11.0, 2.0], [3.0, 2.0]]}]
    run = true_drive(watched([13.0, 3.4, 0.0], 6.0, people=people))
    first, second = run.tracks.people[:, 0], run.tracks.people[:, 1]
    meeting = int(np.abs(first[:, 0] - second[:, 0]).argmin())
    assert first[meeting, 1] < 2.0 < second[meeting, 1]  # who walks along x has y to the left
    # a leg swings to and fro once in two steps of 0.7 m
    ahead = run.tracks.discs[:, 0, 0] - first[:, 0]
    walked = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(first, axis=0).T))))
    alone = (walked > 0.5) & (walked < 3.3)
    assert (np.diff(np.sign(ahead[alone])) != 0).sum() == 4
    assert np.abs(ahead[alone]).max() == pytest.approx(0.18, abs=0.01)
