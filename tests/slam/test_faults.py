"""Recordings with missing, failing and jumping odometry, and with scans that see nothing: the filter finds back."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import slam_messages
from issues import counted, messages
from slam_rooms import (
    ate,
    blind,
    circled_room,
    jumping_odometry,
    recorded,
    run,
    seen_from,
    stopped_wheels,
    without_odometry,
)

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.platforms import CARMEN
from moteslam.robot.recording import LidarStream, OdometryStream, Recording
from moteslam.sim.simulate import Simulation
from moteslam.slam.estimate import Estimate
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import jumps
from moteslam.slam.inputs.step import steps
from moteslam.slam.inputs.synchronise import dead_reckon, synchronise, warnings
from moteslam.slam.tsdf.tracking import extrapolated

pytestmark = pytest.mark.usefixtures("taichi")


@pytest.fixture
def corridor() -> Simulation:
    return slam_messages.corridor()


def end_error(simulation: Simulation, estimate: Estimate) -> float:
    """How far from the true end the run ends, both seen from where it began [m]."""
    path = estimate.trajectory
    true = simulation.truth.at(path.stamps[[0, -1]]).poses
    end = se2.between(path.poses[0], path.poses[-1]) - se2.between(true[0], true[1])
    return float(np.hypot(end[0], end[1]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("break_", "bad"),
    [
        (lambda r: stopped_wheels(r, 10, 14), 0.3),
        (lambda r: jumping_odometry(r, 10, np.array([0.0, 0.0, np.radians(60)])), 0.3),
        (lambda r: jumping_odometry(r, 10, np.array([1.0, 0.0, np.radians(60)]), back=12), 0.3),
        (without_odometry, 2.0),
        (lambda r: without_odometry(blind(r, 10, 11)), 0.3),
    ],
    ids=["wheels that stop", "a turn", "a jump and back", "no odometry", "blind without odometry"],
)
def test_the_filter_recovers(corridor: Simulation, break_: Callable[[Recording], Recording], bad: float):
    recording = break_(corridor.recording)
    estimate = run(recording, seed=1)
    assert ate(estimate.dead_reckoning, corridor.truth) > bad
    assert max(ate(path, corridor.truth) for path in (estimate.trajectory, estimate.trajectory_final)) < 0.15
    assert end_error(corridor, estimate) < (0.3 if break_ is without_odometry else 0.15)
    said = [line for line in messages(estimate.warnings) if line.startswith("no odometry: constant velocity")]
    if break_ is without_odometry:
        assert f"{len(recording.lidar)} scans" in said[0]
        assert estimate.dead_reckoning.length == 0 < 5 < estimate.trajectory.length


def test_without_odometry_the_room_is_circled_and_the_robot_goes_on_where_it_sees_nothing():
    recording, true = circled_room(scans=60)
    lidar = replace(recording.lidar, odometry=None)
    dark = replace(lidar, ranges=np.where(np.arange(60)[:, None] >= 54, np.float32(np.inf), lidar.ranges))
    off = np.hypot(*(run(recording.replace(lidar=dark), seed=1).trajectory.poses - true)[:, :2].T)
    assert off[:54].max() < 0.1
    assert off[-1] < 0.15
    assert np.hypot(*(true[53] - true[-1])[:2]) > 0.4


@pytest.mark.parametrize(("scale", "told"), [(1.0, False), (1.5, True)])
def test_a_path_of_another_length_than_the_odometry_s_is_told(scale: float, told: bool):
    recording, _ = circled_room()
    longer = replace(recording.lidar, odometry=recording.lidar.odometry * (scale, scale, 1.0))
    estimate = run(recording.replace(lidar=longer))
    assert ("lengths-differ" in {issue.code for issue in estimate.warnings}) == told


def test_without_odometry_the_paper_s_filter_names_the_method_that_does_without():
    recording = circled_room(scans=5)[0]
    lone = recording.replace(lidar=replace(recording.lidar, odometry=None))
    with pytest.raises(InputError, match=r'room: neither encoders nor odometry.* method "tsdf" does without'):
        run(lone, preset="paper")
    with pytest.raises(InputError, match="neither encoders nor odometry"):
        dead_reckon(lone)


def test_steps_without_odometry_and_after_a_jump_are_not_measured(corridor: Simulation):
    recording = corridor.recording
    assert all(step.measured for step in steps(synchronise(recording)))
    lone = synchronise(without_odometry(recording))
    assert lone.path is None
    assert not any(step.measured or step.motion.any() for step in steps(lone))
    jumping = jumping_odometry(recording, 10, np.array([1.0, 0.0, 0.0]), back=15)
    jumps_there = [step for step in steps(synchronise(jumping)) if not step.measured]
    assert len(jumps_there) == 2
    assert [round(step.stamp - recording.lidar.stamps[0]) for step in jumps_there] == [10, 15]
    assert all(np.hypot(*step.motion[:2]) > 0.9 for step in jumps_there)


def test_odometry_that_never_moves_counts_as_none_once_the_scans_change(corridor: Simulation):
    lone = without_odometry(corridor.recording)
    true = corridor.truth.at(lone.lidar.stamps).poses
    driven = np.hypot(*(true - true[0])[:, :2].T)
    zeros = np.zeros((len(lone.lidar), 3))
    logged = lone.replace(lidar=replace(lone.lidar, odometry=zeros))
    stream = lone.replace(odometry=OdometryStream(lone.lidar.stamps, zeros))
    for still in (logged, stream):
        inputs = synchronise(still)
        assert inputs.measured[driven < 1e-3].all()
        assert not inputs.measured[driven > 0.2].any()
        assert counted(warnings(still, inputs)) == [("still-odometry", int((~inputs.measured).sum()))]
    moved = zeros.copy()
    moved[-1, 2] = 1e-3
    inputs = synchronise(lone.replace(lidar=replace(lone.lidar, odometry=moved)))
    assert np.flatnonzero(inputs.measured & (driven > 0.2)).tolist() == [len(zeros) - 1]


def test_who_walks_by_a_standing_robot_does_not_move_it():
    ranges = np.full((5, 100), 4.0, np.float32)
    ranges += np.random.default_rng(0).normal(0, 0.01, ranges.shape).astype(np.float32)
    ranges[1, :15] = 1.0
    ranges[2, 20:] = np.inf
    ranges[3, :25] = 1.0
    lidar, still = LidarStream(np.arange(5.0), ranges, 0.0, 0.01, 0.0, 30.0), np.zeros((5, 3))
    moving = still + (np.arange(5) >= 2)[:, None]

    def measured(ranges: np.ndarray, poses: np.ndarray) -> list[bool]:
        scans = replace(lidar, ranges=ranges, odometry=poses)
        return synchronise(Recording("c", CARMEN, lidar=scans), SyncConfig(travelling=False)).measured.tolist()

    assert measured(ranges, still) == [True, True, True, False, False]
    assert measured(ranges, moving) == [True, True, True, True, True]
    ranges[1] = np.inf
    assert measured(ranges, still) == [True, False, True, False, False]


def test_a_jump_is_faster_than_robots_are_and_than_this_one_usually_is_and_none_of_the_first_nine_steps():
    stamps = np.arange(101) * 0.1
    slow, fast = (se2.accumulate(np.tile(step, (101, 1))) for step in ([0.05, 0, 0.02], [1.5, 0, 0.6]))
    assert not jumps(stamps, slow).any()
    assert not jumps(stamps, fast).any()
    assert jumps(stamps[:1], slow[:1]).tolist() == [False]
    for at, ahead, turn in ((5, 1.0, 0.0), (9, 1.0, 0.0), (11, 1.0, 0.0), (40, 1.0, 0.0), (30, 0.0, np.radians(60))):
        path = slow.copy()
        path[at:, 0] += ahead
        path[at:, 2] = se2.wrap(path[at:, 2] + turn)
        assert np.flatnonzero(jumps(stamps, path)).tolist() == ([at] if at > 9 else [])
        assert not jumps(stamps * 0, path).any()
        assert turn or not jumps(stamps * 10, path).any()
        path[50:, 0] += 3.0  # whatever comes later
        assert jumps(stamps, path)[:50].tolist() == jumps(stamps[:50], path[:50]).tolist()
    # a robot that from some time on drives 0.6 m a step, too fast for a robot by its stamps: soon that is usual
    path = np.zeros((60, 3))
    path[:, 0] = np.cumsum(np.where(np.arange(60) < 30, 0.01, 0.6))
    found = np.flatnonzero(jumps(stamps[:60], path)).tolist()
    assert found == list(range(30, 30 + len(found)))
    assert 0 < len(found) < 5


def test_odometry_that_jumps_within_a_sweep_does_not_turn_its_beams(corridor: Simulation):
    recording = corridor.recording
    assert recording.lidar.time_increment or recording.platform.lidar.time_increment
    jumping = jumping_odometry(recording, 10, np.array([0.0, 0.0, np.radians(60)]))
    for usual, bad in zip(steps(synchronise(recording)), steps(synchronise(jumping)), strict=True):
        assert len(usual.points) == len(bad.points)
        assert not len(usual.points) or np.abs(usual.points - bad.points).max() < 0.3


def test_the_last_motion_goes_on_in_proportion_to_time():
    motion = np.array([0.1, 0.0, 0.02])
    np.testing.assert_allclose(extrapolated(motion, 0.1, 0.2), 2 * motion)
    np.testing.assert_array_equal(extrapolated(motion, 0.0, 0.2), motion)
    np.testing.assert_array_equal(extrapolated(motion, 0.1, 0.0), motion)
    np.testing.assert_allclose(extrapolated(motion, 0.1, 3600.0), 10 * motion)


def test_over_a_gap_of_eight_seconds_the_odometry_says_how_far_the_robot_drove():
    """It turns by 17 degrees on the way, yet nobody keeps a velocity for a tenth of the way and then stands."""
    random = np.random.default_rng(1)
    walls = []
    for side in (-1.2, 1.2):
        ends = np.cumsum(random.uniform(1.0, 3.0, 20)) - 5
        depths = side + np.sign(side) * random.choice((0.0, 0.3, -0.2), 20)
        walls += [((x, y), (end, y)) for x, end, y in zip((-5.0, *ends), ends, depths, strict=False)]
    true = np.column_stack((0.1 * np.arange(180), np.zeros((180, 2))))
    motions = np.tile((0.1, 0.0, 0.0), (179, 1))
    motions[70:130, 2] = 0.005
    odometry = se2.accumulate(np.vstack((np.zeros(3), motions)))
    ranges = seen_from(true, walls)
    seen = np.flatnonzero((np.arange(180) < 55) | (np.arange(180) >= 135))
    whole = recorded(np.where(ranges < 8, ranges, np.inf), odometry)
    lidar = whole.lidar
    gap = replace(lidar, stamps=lidar.stamps[seen], ranges=lidar.ranges[seen], odometry=lidar.odometry[seen])
    estimate = run(whole.replace(lidar=gap), "backend.method=none")
    assert np.hypot(*estimate.trajectory.poses[-1, :2]) == pytest.approx(17.9, abs=0.5)
