"""The map that scans draw under a trajectory: noise, walls drawn twice, and what neither is."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.metrics.map_quality import MapConsistency, map_consistency
from moteslam.robot.platform import Platform
from moteslam.robot.recording import LidarStream, OdometryStream, Recording
from moteslam.robot.trajectory import Trajectory

WIDE, TALL = 12.0, 8.0
ANGLES = np.deg2rad(np.arange(-180.0, 180.0, 1.5))


def twice_around(noise: float = 0.003) -> tuple[Recording, Trajectory]:
    """Two laps of 28 m within an empty room, a scan each 0.2 m."""
    corners = np.array([[2.0, 2.0], [10.0, 2.0], [10.0, 6.0], [2.0, 6.0], [2.0, 2.0]])
    sides = [np.linspace(a, b, 40, endpoint=False) for a, b in pairwise(corners)]
    lap = np.vstack(sides)
    headings = np.repeat((0.0, np.pi / 2, np.pi, -np.pi / 2), 40)
    poses = np.tile(np.column_stack((lap, headings)), (2, 1))
    rng = np.random.default_rng(3)
    ranges = []
    for x, y, heading in poses:
        c, s = np.cos(ANGLES + heading), np.sin(ANGLES + heading)
        with np.errstate(divide="ignore"):
            across = np.minimum(np.where(c > 0, (WIDE - x) / c, -x / c), np.where(s > 0, (TALL - y) / s, -y / s))
        ranges.append(across + rng.normal(0, noise, len(ANGLES)))
    stamps = 0.2 * np.arange(len(poses))
    lidar = LidarStream(stamps, np.array(ranges, np.float32), ANGLES[0], ANGLES[1] - ANGLES[0], 0.1, 30.0)
    odometry = OdometryStream(stamps, poses)
    return Recording("room", Platform(), lidar=lidar, odometry=odometry), Trajectory(stamps, poses)


@cache
def scored(shift: float = 0.0, noise: float = 0.003) -> MapConsistency:
    """The second lap is drawn that far aside [m]."""
    recording, truth = twice_around(noise)
    poses = truth.poses.copy()
    poses[len(poses) // 2 :, :2] += shift * np.array([0.8, 0.6])
    return map_consistency(recording, Trajectory(truth.stamps, poses))


@pytest.mark.slow
def test_walls_drawn_once_are_as_thick_as_the_noise() -> None:
    score = scored()
    assert score.thickness == pytest.approx(0.003, rel=0.3)
    assert score.twice == 0.0
    assert score.far is not None
    assert score.far < 0.02
    assert score.near < 0.03
    assert scored(noise=0.01).thickness == pytest.approx(0.01, rel=0.3)
    assert scored(noise=0.01).cells_per_metre > score.cells_per_metre


@pytest.mark.slow
def test_a_wall_drawn_twice_is_noticed() -> None:
    """In all but what the scans of one lap say."""
    shifts = (0.0, 0.05, 0.15, 0.3)
    scores = [scored(shift) for shift in shifts]
    assert (np.diff([score.cells for score in scores]) > 0).all()
    assert (np.array([score.cells_per_metre for score in scores[1:]]) > 1.3 * scores[0].cells_per_metre).all()
    assert (np.diff([score.far or 0.0 for score in scores]) > 0).all()
    assert [score.near for score in scores] == pytest.approx([scores[0].near] * 4, rel=0.2)
    twice = [score.twice for score in scores]
    assert twice[0] == twice[1] == 0.0
    assert twice[2] is not None
    assert twice[3] is not None
    assert 0.05 < twice[2] < twice[3]
    # the length of the walls is that of what was seen
    assert [score.walls for score in scores] == pytest.approx([scores[0].walls] * 4, rel=0.25)


def test_the_other_side_of_a_wall_is_not_the_same_wall_drawn_twice() -> None:
    """Every other lap is driven beyond a wall of 20 cm: seen from both sides, drawn once each."""
    recording, truth = twice_around()
    poses = truth.poses.copy()
    poses[len(poses) // 2 :, 1] += TALL + 0.2
    score = map_consistency(recording, Trajectory(truth.stamps, poses))
    assert score.twice is None or score.twice < 0.05


def test_a_drive_that_comes_back_nowhere_has_no_far_distance() -> None:
    recording, truth = twice_around()
    assert recording.lidar is not None
    few = 30
    lidar = LidarStream(
        recording.lidar.stamps[:few], recording.lidar.ranges[:few], ANGLES[0], ANGLES[1] - ANGLES[0], 0.1, 30.0
    )
    score = map_consistency(
        Recording("wall", Platform(), lidar=lidar), Trajectory(truth.stamps[:few], truth.poses[:few])
    )
    assert score.far is None
    assert score.twice is None


def test_what_cannot_be_had_says_why() -> None:
    recording, truth = twice_around()
    assert recording.lidar is not None
    empty = replace(recording.lidar, ranges=np.full_like(recording.lidar.ranges, np.inf))
    with pytest.raises(InputError, match="lidar: scans without an endpoint"):
        map_consistency(Recording("empty", Platform(), lidar=empty), truth)
    with pytest.raises(InputError, match="trajectory: poses at 0 of 320 scans"):
        map_consistency(recording, Trajectory(truth.stamps + 1e6, truth.poses))
    with pytest.raises(InputError, match="trajectory: poses that are not finite"):
        map_consistency(recording, Trajectory(truth.stamps, truth.poses * np.nan))
