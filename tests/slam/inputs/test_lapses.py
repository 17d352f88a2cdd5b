"""Gaps of the log, stale odometry, jumps, and what travels with the robot: what is not measured, and what is known."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from slam_rooms import ANGLES, ate, recorded, run, seen_from

from moteslam.robot import se2
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, LidarStream, OdometryStream, Recording
from moteslam.sim.scenario import load_scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.simulate import simulate
from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.step import steps
from moteslam.slam.inputs.synchronise import Inputs, about_jumps, synchronise
from moteslam.slam.registration import localisation, search

SCANS = 100
CORNERS = [(-3, -2), (12, -2), (12, 2), (4, 2), (4, 1), (3, 1), (3, 2), (-3, 2), (-3, -2)]
GOING = np.minimum(0.004 * np.arange(SCANS), 0.1)
"""Of the robot in each step [m]: it starts slowly, ten scans a second."""


def driven(going: np.ndarray = GOING) -> Recording:
    """A robot that drives straight on and logs its odometry with each scan."""
    true = np.column_stack((np.cumsum(going), np.zeros((SCANS, 2))))
    ranges = seen_from(true, list(pairwise(CORNERS)))
    return recorded(ranges + np.random.default_rng(0).normal(0, 0.003, ranges.shape), true)


def codes(inputs: Inputs) -> list[str]:
    return [issue.code for issue in inputs.issues]


def wheels(*, kept: bool, first: int = 200, last: int = 520) -> Recording:
    """Scans and counters of a robot that goes straight on at 0.44 m/s, without readings for 8 s."""
    stamps = 0.025 * np.arange(800)
    counts = np.full((800, 4), 5, np.int64)
    if kept:
        counts[last] = 5 * (last - first + 1)
    there = (np.arange(800) < first) | (np.arange(800) >= last)
    scans = stamps[there][2::4]
    ranges = np.random.default_rng(0).uniform(1, 2, (len(scans), 8)).astype(np.float32)
    lidar = LidarStream(scans, ranges, -1.0, 0.3, 0.1, 30.0)
    return Recording("gap", UCSD, lidar=lidar, encoders=EncoderStream(stamps[there], counts[there]))


def test_odometry_without_lapses_is_all_measured():
    inputs = synchronise(driven())
    assert inputs.measured[1:].all()
    assert not inputs.issues
    assert all(step.open is None for step in steps(inputs))


def test_odometry_that_stops_dead_while_the_robot_drives_is_stale_whatever_comes_later():
    recording = driven()
    lidar = recording.lidar
    stale = lidar.odometry.copy()
    stale[40:70] = stale[40]
    whole = synchronise(recording.replace(lidar=replace(lidar, odometry=stale)))
    assert not whole.measured[44:70].any()
    assert whole.measured[1:40].all()
    assert whole.measured[75:].all()
    assert "stale-odometry" in codes(whole)
    first = replace(lidar, stamps=lidar.stamps[:60], ranges=lidar.ranges[:60], odometry=stale[:60])
    part = synchronise(recording.replace(lidar=first))
    np.testing.assert_array_equal(part.measured[:59], whole.measured[:59])
    np.testing.assert_allclose(se2.between(part.odometry, whole.odometry[:60]), 0, atol=1e-12)


@pytest.mark.parametrize("moving", ["drives", "turns", "stands"])
def test_odometry_that_is_missing_while_scans_go_on_measures_nothing_unless_the_robot_stood(moving: str):
    slows = np.clip(np.abs(np.arange(SCANS) - 55) / 20 - 1, 0.0, 1.0)
    recording = driven(GOING if moving == "drives" else GOING * slows)
    lidar = recording.lidar
    poses, kept = lidar.odometry.copy(), np.delete(np.arange(SCANS), np.arange(40, 70))
    if moving == "turns":
        poses[40:, 2] += np.minimum(0.05 * np.arange(SCANS - 40), 1.5)
    odometry = OdometryStream(lidar.stamps[kept], poses[kept])
    inputs = synchronise(recording.replace(lidar=replace(lidar, odometry=None), odometry=odometry))
    assert ("no-odometry" in codes(inputs)) == (moving != "stands")
    np.testing.assert_array_equal(inputs.measured[40:71], moving == "stands")
    assert inputs.measured[1:40].all()
    assert inputs.measured[71:].all()


@pytest.mark.parametrize("held", [True, False])
def test_a_pose_from_before_a_gap_is_named(held: bool):
    recording = driven()
    there = np.r_[0:50, 80:SCANS]
    lidar, poses = recording.lidar, recording.lidar.odometry[there].copy()
    if held:
        poses[50] = poses[49]
    cut = replace(lidar, stamps=lidar.stamps[there], ranges=np.asarray(lidar.ranges[there]), odometry=poses)
    (issue, *_) = synchronise(recording.replace(lidar=cut)).issues
    assert issue.code == "gap"
    assert ("carries an odometry pose from before" in issue.message) == held


@pytest.mark.parametrize("at", [0.0, 3.0])
def test_odometry_that_begins_anew_after_a_gap_is_of_another_run(at: float):
    recording = driven(np.full(SCANS, 0.1))
    stamps, poses = recording.lidar.stamps.copy(), recording.lidar.odometry.copy()
    poses[50:] += (at, 0.0, 0.0) - poses[50]
    stamps[50:] += 3600.0
    inputs = synchronise(recording.replace(lidar=replace(recording.lidar, stamps=stamps, odometry=poses)))
    assert any("begins anew" in issue.message for issue in inputs.issues) == (at == 0)
    assert inputs.measured[50] == (at != 0)
    assert at != 0 or (inputs.open[50].place > 10 and inputs.open[50].heading > 1)


@pytest.mark.parametrize("full", [4.0, None])
def test_a_counter_that_is_full_is_named_as_the_cause_of_jumps(full: float | None):
    recording = driven()
    poses = recording.lidar.odometry.copy()
    poses[40:, 0] -= full or 3.0
    poses[80:, 0] -= full or 8.0
    inputs = synchronise(recording.replace(lidar=replace(recording.lidar, odometry=poses)))
    (issue,) = about_jumps(inputs.stamps, inputs.odometry, inputs.jumped)
    assert issue.count == 2
    assert ("a counter that is full" in issue.message) == (full is not None)


def test_a_robot_that_stops_is_not_stale():
    """It brakes at 2.5 m/s^2 and stands for 3 s."""
    going = GOING.copy()
    going[40:75] = np.concatenate((0.1 - 0.025 * np.arange(1, 5), np.zeros(31)))
    inputs = synchronise(driven(going))
    assert (~inputs.measured[1:]).sum() < 10  # until the scans show that it stands
    assert inputs.measured[75:].all()
    assert "stale-odometry" not in codes(inputs)


@pytest.mark.parametrize("kept", [True, False])
def test_over_a_gap_the_motion_is_not_measured_but_known_within_bounds(kept: bool):
    inputs = synchronise(wheels(kept=kept))
    over = [step for step in steps(inputs) if step.open is not None]
    assert len(over) == 1
    assert codes(inputs) == ["gap"]
    (step,) = over
    assert not step.measured
    assert step.dt > 8
    ahead = 1.0 if kept else np.sin(2) / 2  # counted, or at the speed of before, with any turn of up to 2 rad
    assert step.motion[0] == pytest.approx(0.44 * 8 * ahead, rel=0.05)
    assert 0.5 < step.open.place < 0.44 * 8
    assert (step.open.arc < 0.1 * step.motion[0]) == kept  # counters say that it did not turn in the end
    assert step.open.heading < 0.2 if kept else step.open.heading > 1.0
    rest = [other.measured for other in steps(inputs) if other is not step][1:]
    assert sum(rest) >= len(rest) - 2


@pytest.mark.parametrize("rest", [0, 40])
def test_who_turned_on_the_spot_before_a_gap_that_was_not_counted_may_have_driven_on(rest: int):
    """As fast as it usually drives; one that had come to rest stands."""
    recording = wheels(kept=False)
    counts = np.array(recording.encoders.counts)
    counts[150 : 200 - rest] = 5 * np.array((1, -1, 1, -1))
    counts[200 - rest : 200] = 0
    encoders = EncoderStream(recording.encoders.stamps, counts)
    inputs = synchronise(recording.replace(encoders=encoders))
    over = [step for step in steps(inputs) if step.open is not None and step.dt > 8]
    assert len(over) == 1
    assert (codes(inputs) == ["gap"]) == (not rest)
    assert (over[0].open.place > 0.5) == (not rest)


@pytest.mark.usefixtures("taichi")
def test_floor_that_other_beams_see_does_not_make_wheels_spin():
    settings = ['faults=[{kind="tilt", pitch=0.087, height=0.2}]']
    scenario = load_scenario("office", platform="turtlebot3", settings=settings)
    simulation = simulate(scenario.model_copy(update={"duration": 110.0}), seed=0)
    assert codes(synchronise(simulation.recording)) == ["travels-along"]


@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize(("pitch", "roll"), [(0.05, 0.07), (-0.05, -0.05), (0.035, 0.0)])
def test_floor_that_a_tilted_lidar_sees_is_left_out_from_a_quarter_of_a_metre_on(pitch: float, roll: float):
    def driven(*settings: str) -> Recording:
        scenario = load_scenario("lab", platform="rplidar_a1", settings=list(settings))
        return simulate(scenario.model_copy(update={"duration": 25.0}), seed=390).recording

    sound, tilted = driven(), driven(f'faults=[{{kind="tilt", pitch={pitch}, roll={roll}}}]')
    assert not codes(synchronise(sound))
    inputs = synchronise(tilted)
    assert codes(inputs) == ["travels-along"]
    seen, walls = tilted.lidar.ranges, np.where(np.isfinite(sound.lidar.ranges), sound.lidar.ranges, np.inf)
    floor = np.isfinite(seen) & (seen < walls - 0.15)
    later = np.flatnonzero(tilted.lidar.stamps - EPOCH > 8.5)  # it sets off after 6 s
    kept = np.array([len(inputs.scans.points(int(scan))) for scan in later])
    missing = np.isfinite(seen[later]).sum(axis=1) - kept
    assert np.abs(missing - floor[later].sum(axis=1)).sum() < 0.2 * floor[later].sum()


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
def test_a_turn_that_counters_alone_leap_by_is_a_jump_though_a_gyro_knows_better():
    fault = 'faults=[{kind="odometry_jump", start=40, theta=0.3}]'
    simulation = simulate(load_scenario("loop", platform="ucsd", settings=[fault]), 200)
    inputs = synchronise(simulation.recording)
    assert np.abs(inputs.stamps[inputs.jumped] - EPOCH - 40).max() < 0.5
    assert "wheels-spin" not in codes(inputs)


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize(("start", "duration", "seed"), [*((54.4, 10, k) for k in (200, 203, 218)), (40.0, 3, 242)])
def test_after_a_gap_into_a_new_place_the_robot_is_lost_until_it_is_found(start: float, duration: float, seed: int):
    """The loop looks the same from the other side: without the place where it was found the graph may turn it round."""
    fault = f'faults=[{{kind="gap", start={start}, duration={duration}, counters="lost"}}]'
    simulation = simulate(load_scenario("loop", platform="lms200", settings=[fault]), seed)
    estimate = run(simulation.recording)
    assert ate(estimate.trajectory_final, simulation.truth) < 0.01  # 3 cm at the end of the path before the gap
    since = estimate.trajectory.stamps - EPOCH - start - duration
    state = estimate.diagnostics["state"]
    assert (state[(since > 0.1) & (since < 10)] == LocalisationState.LOST).all()
    assert state[-1] == LocalisationState.SURE
    assert {"gap", "lost"} <= {issue.code for issue in estimate.warnings}


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
def test_after_a_lapse_of_an_hour_the_robot_is_searched_for_where_the_map_is(monkeypatch: pytest.MonkeyPatch):
    widest = 0.0

    def candidates(*args: Any) -> np.ndarray:
        nonlocal widest
        widest = max(widest, *args[4].half[:2])
        assert widest < 100.0  # else it takes gigabytes
        return search.candidates(*args)

    monkeypatch.setattr(localisation, "candidates", candidates)
    recording = recorded(corridor(along_it()), along_it())
    stamps = recording.lidar.stamps + np.where(np.arange(TAKEN) < 40, 0.0, 3600.0)
    estimate = run(recording.replace(lidar=replace(recording.lidar, stamps=stamps)))
    assert widest > 10.0
    assert "gap" in {issue.code for issue in estimate.warnings}


TAKEN = 80
DOORWAYS = [2.0, 4.5, 5.5, 8.0]


def corridor(truth: np.ndarray, doorways: list[float] = DOORWAYS) -> np.ndarray:
    """Ranges [n, beams] in a corridor 2 m wide with doorways 0.8 m wide and 0.4 m deep on its left, and two ends."""
    corners = [(-2.0, 1.0)]
    for x in doorways:
        corners += [(x, 1.0), (x, 1.4), (x + 0.8, 1.4), (x + 0.8, 1.0)]
    corners += [(12.0, 1.0), (12.0, -1.0), (-2.0, -1.0), (-2.0, 1.0)]
    noise = np.random.default_rng(0).normal(0, 0.005, (len(truth), len(ANGLES)))
    return seen_from(truth, list(pairwise(corners))) + noise


def along_it(metres: np.ndarray | None = None) -> np.ndarray:
    """Poses [TAKEN, 3] along the corridor, with a little turning; 0.06 m a scan, or as given."""
    x = 0.06 * np.arange(TAKEN) if metres is None else metres
    return np.column_stack((x, 0.05 * np.sin(x), 0.1 * np.cos(3 * x)))


def test_a_corridor_has_nothing_that_travels():
    recording = recorded(corridor(along_it()), along_it())
    inputs = synchronise(recording)
    assert not inputs.issues
    assert len(inputs.scans.points(TAKEN - 1)) == len(ANGLES)


@pytest.mark.parametrize("what", ["load", "floor"])
def test_what_travels_is_left_out_once_it_is_known(what: str):
    ahead = np.abs(ANGLES) < (0.35 if what == "load" else 1.2)
    with np.errstate(divide="ignore"):
        held = np.where(ahead, (0.9 if what == "load" else 2.5) / np.cos(ANGLES), np.inf)
    walls = corridor(along_it())
    noise = np.random.default_rng(1).normal(0, 0.005, walls.shape)
    inputs = synchronise(recorded(np.minimum(walls, held + noise), along_it()))
    assert codes(inputs) == ["travels-along"]
    ends, begins, counts = inputs.scans.block(0, TAKEN)
    for scan in range(30, TAKEN):
        points = inputs.scans.points(scan)
        np.testing.assert_array_equal(ends[begins[scan] : begins[scan] + counts[scan]], points)
        cut = walls[scan] > held + 0.3  # the walls behind it
        assert len(points) == pytest.approx((~cut).sum(), abs=12)
        near = np.abs(points[:, 0] - held[len(ANGLES) // 2])
        assert (near > 0.08).all() or what == "load"


def test_beams_that_are_stuck_travel():
    true = along_it()
    true[40:, 2] += 0.7 * np.sin(np.arange(TAKEN - 40) / 6)
    ranges = corridor(true)
    ranges[20:, :60] = ranges[20, :60]
    inputs = synchronise(recorded(ranges, true))
    assert codes(inputs) == ["travels-along"]
    assert len(inputs.scans.points(TAKEN - 1)) == pytest.approx(len(ANGLES) - 60, abs=12)
    assert not synchronise(recorded(corridor(true), true)).issues


def test_ranges_in_decimetres_stay_the_same_by_chance():
    true = along_it()
    true[:, 2] += 1.5 * np.sin(np.arange(TAKEN) / 8)
    assert not synchronise(recorded(corridor(true).round(1), true)).issues


def test_what_travels_is_known_by_what_came_before_alone():
    held = np.where(np.abs(ANGLES) < 0.35, 0.9 / np.cos(ANGLES), np.inf)
    ranges = np.minimum(corridor(along_it()), held)
    whole = synchronise(recorded(ranges, along_it()))
    part = synchronise(recorded(ranges[:40], along_it()[:40]))
    for scan in range(40):
        np.testing.assert_array_equal(whole.scans.points(scan), part.scans.points(scan))
    np.testing.assert_array_equal(whole.odometry[:40], part.odometry)


@pytest.mark.parametrize("doorways", [DOORWAYS, [0.5]])
def test_wheels_that_spin_move_nothing(doorways: list[float]):
    """The robot stands from 2.4 m on for 20 scans while its odometry goes on."""
    true = along_it(0.06 * np.concatenate((np.arange(40), np.full(20, 39), np.arange(40, 60))))
    odometry = np.array(true[:1])
    steps = se2.between(true[:-1], true[1:])
    steps[39:59] = (0.06, 0.0, 0.0)
    odometry = se2.accumulate(np.vstack((np.zeros(3), steps)))
    inputs = synchronise(recorded(corridor(true, doorways), odometry))
    assert codes(inputs) == ["wheels-spin"]
    travelled = se2.between(inputs.odometry[0], inputs.odometry[-1])
    expected = se2.between(true[0], true[-1])
    assert np.hypot(*(travelled - expected)[:2]) < 0.3  # without: 1.2
    assert not synchronise(recorded(corridor(true, doorways), true)).issues


@pytest.mark.parametrize("noise", [0.0002, 0.005])
def test_a_bare_corridor_looks_the_same_and_is_new(noise: float):
    walls = [((-99, -1), (99, -1)), ((-99, 1), (99, 1))]
    ranges = seen_from(np.zeros((TAKEN, 3)), walls)
    ranges += np.random.default_rng(0).normal(0, noise, ranges.shape)
    along = np.column_stack((0.06 * np.arange(TAKEN), np.zeros((TAKEN, 2))))
    assert not synchronise(recorded(np.where(ranges < 6, ranges, np.inf), along)).issues


def test_a_scan_that_the_driver_gives_again_is_left_out_while_the_robot_moves():
    ranges = corridor(along_it())
    ranges[40:50] = ranges[39]
    inputs = synchronise(recorded(ranges, along_it()))
    assert codes(inputs) == ["scans-repeat"]
    assert inputs.issues[0].count == 10
    assert [len(inputs.scans.points(scan)) for scan in (39, 40, 49, 50)] == [len(ANGLES), 0, 0, len(ANGLES)]
    still = np.repeat(along_it()[39:40], TAKEN, axis=0)
    assert not synchronise(recorded(np.repeat(ranges[39:40], TAKEN, axis=0), still)).issues


def test_scans_far_apart_and_the_papers_filter_are_left_alone():
    held = np.where(np.abs(ANGLES) < 0.35, 0.9 / np.cos(ANGLES), np.inf)
    recording = recorded(np.minimum(corridor(along_it()), held), along_it())
    assert not synchronise(recording, SyncConfig(travelling=False)).issues
    lidar = recording.lidar
    some = slice(None, None, 13)
    sparse = replace(lidar, stamps=lidar.stamps[some], ranges=lidar.ranges[some], odometry=lidar.odometry[some])
    assert not synchronise(replace(recording, lidar=sparse)).issues
