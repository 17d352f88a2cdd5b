"""Gaps of the log, stale odometry and jumps: what is not measured, and what is known of it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from slam_rooms import ate, recorded, run, seen_from

from moteslam.robot import se2
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, LidarStream, Recording
from moteslam.sim.scenario import load_scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.simulate import simulate
from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.inputs.step import steps
from moteslam.slam.inputs.synchronise import Inputs, synchronise

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
    assert lidar is not None
    assert lidar.odometry is not None
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
    assert step.open is not None
    assert 0.5 < step.open.place < 0.44 * 8
    assert (step.open.arc < 0.1 * step.motion[0]) == kept  # counters say that it did not turn in the end
    assert step.open.heading < 0.2 if kept else step.open.heading > 1.0
    rest = [other.measured for other in steps(inputs) if other is not step][1:]
    assert sum(rest) >= len(rest) - 2


@pytest.mark.usefixtures("taichi")
def test_a_turn_that_counters_alone_leap_by_is_a_jump_though_a_gyro_knows_better():
    fault = 'faults=[{kind="odometry_jump", start=40, theta=0.3}]'
    simulation = simulate(load_scenario("loop", platform="ucsd", settings=[fault]), 200)
    inputs = synchronise(simulation.recording)
    assert np.abs(inputs.stamps[inputs.jumped] - EPOCH - 40).max() < 0.5
    assert "wheels-spin" not in codes(inputs)


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize("counters", ["kept", "lost"])
def test_after_a_gap_into_a_new_place_the_robot_is_lost_until_it_is_found(counters: str):
    fault = f'faults=[{{kind="gap", start=54.4, duration=10, counters="{counters}"}}]'
    simulation = simulate(load_scenario("loop", platform="ucsd", settings=[fault]), 200)
    estimate = run(simulation.recording)
    assert ate(estimate.trajectory_final, simulation.truth) < 0.005
    since = estimate.trajectory.stamps - EPOCH
    state = estimate.diagnostics["state"]
    assert (state[(since > 64.5) & (since < 75)] == LocalisationState.LOST).all()
    assert state[-1] == LocalisationState.SURE
    assert {"gap", "lost"} <= {issue.code for issue in estimate.warnings}
