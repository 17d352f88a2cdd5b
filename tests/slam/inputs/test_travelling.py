"""What travels with the robot: seen in scans of a corridor with doorways, against odometry that is right."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from slam_rooms import ANGLES, recorded, seen_from

from moteslam.robot import se2
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.synchronise import Inputs, synchronise

SCANS = 80
DOORWAYS = [2.0, 4.5, 5.5, 8.0]


def corridor(truth: np.ndarray) -> np.ndarray:
    """Ranges [n, beams] in a corridor 2 m wide with doorways 0.8 m wide and 0.4 m deep on its left, and two ends."""
    corners = [(-2.0, 1.0)]
    for x in DOORWAYS:
        corners += [(x, 1.0), (x, 1.4), (x + 0.8, 1.4), (x + 0.8, 1.0)]
    corners += [(12.0, 1.0), (12.0, -1.0), (-2.0, -1.0), (-2.0, 1.0)]
    noise = np.random.default_rng(0).normal(0, 0.005, (len(truth), len(ANGLES)))
    return seen_from(truth, list(pairwise(corners))) + noise


def driven(metres: np.ndarray | None = None) -> np.ndarray:
    """Poses [SCANS, 3] along the corridor, with a little turning; 0.06 m a scan, or as given."""
    x = 0.06 * np.arange(SCANS) if metres is None else metres
    return np.column_stack((x, 0.05 * np.sin(x), 0.1 * np.cos(3 * x)))


def codes(inputs: Inputs) -> list[str]:
    return [issue.code for issue in inputs.issues]


def test_a_corridor_has_nothing_that_travels():
    recording = recorded(corridor(driven()), driven())
    inputs = synchronise(recording)
    assert not inputs.issues
    assert len(inputs.scans.points(SCANS - 1)) == len(ANGLES)


@pytest.mark.parametrize("what", ["load", "floor"])
def test_what_travels_is_left_out_once_it_is_known(what: str):
    ahead = np.abs(ANGLES) < (0.35 if what == "load" else 1.2)
    with np.errstate(divide="ignore"):
        held = np.where(ahead, (0.9 if what == "load" else 2.5) / np.cos(ANGLES), np.inf)
    walls = corridor(driven())
    noise = np.random.default_rng(1).normal(0, 0.005, walls.shape)
    inputs = synchronise(recorded(np.minimum(walls, held + noise), driven()))
    assert codes(inputs) == ["travels-along"]
    block = inputs.scans.block(0, SCANS)
    for scan in range(30, SCANS):
        points = inputs.scans.points(scan)
        np.testing.assert_array_equal(block.of(scan), points)
        cut = walls[scan] > held + 0.3  # the walls behind it
        assert len(points) == pytest.approx((~cut).sum(), abs=12)
        near = np.abs(points[:, 0] - held[len(ANGLES) // 2])
        assert (near > 0.08).all() or what == "load"


def test_it_is_causal():
    held = np.where(np.abs(ANGLES) < 0.35, 0.9 / np.cos(ANGLES), np.inf)
    ranges = np.minimum(corridor(driven()), held)
    whole = synchronise(recorded(ranges, driven()))
    part = synchronise(recorded(ranges[:40], driven()[:40]))
    for scan in range(40):
        np.testing.assert_array_equal(whole.scans.points(scan), part.scans.points(scan))
    np.testing.assert_array_equal(whole.odometry[:40], part.odometry)


def test_wheels_that_spin_move_nothing():
    """The robot stands from 2.4 m on for 20 scans while its odometry goes on."""
    true = driven(0.06 * np.concatenate((np.arange(40), np.full(20, 39), np.arange(40, 60))))
    odometry = np.array(true[:1])
    steps = se2.between(true[:-1], true[1:])
    steps[39:59] = (0.06, 0.0, 0.0)
    odometry = se2.accumulate(np.vstack((np.zeros(3), steps)))
    inputs = synchronise(recorded(corridor(true), odometry))
    assert codes(inputs) == ["wheels-spin"]
    travelled = se2.between(inputs.odometry[0], inputs.odometry[-1])
    expected = se2.between(true[0], true[-1])
    assert np.hypot(*(travelled - expected)[:2]) < 0.3  # without: 1.2
    assert not synchronise(recorded(corridor(true), true)).issues


def test_a_scan_that_the_driver_gives_again_is_left_out_while_the_robot_moves():
    ranges = corridor(driven())
    ranges[40:50] = ranges[39]
    inputs = synchronise(recorded(ranges, driven()))
    assert codes(inputs) == ["scans-repeat"]
    assert inputs.issues[0].count == 10
    assert [len(inputs.scans.points(scan)) for scan in (39, 40, 49, 50)] == [len(ANGLES), 0, 0, len(ANGLES)]
    still = np.repeat(driven()[39:40], SCANS, axis=0)
    assert not synchronise(recorded(np.repeat(ranges[39:40], SCANS, axis=0), still)).issues


def test_scans_far_apart_and_the_papers_filter_are_left_alone():
    held = np.where(np.abs(ANGLES) < 0.35, 0.9 / np.cos(ANGLES), np.inf)
    recording = recorded(np.minimum(corridor(driven()), held), driven())
    assert not synchronise(recording, SyncConfig(travelling=False)).issues
    lidar = recording.lidar
    assert lidar is not None
    assert lidar.odometry is not None
    some = slice(None, None, 13)
    sparse = replace(lidar, stamps=lidar.stamps[some], ranges=lidar.ranges[some], odometry=lidar.odometry[some])
    assert not synchronise(replace(recording, lidar=sparse)).issues
