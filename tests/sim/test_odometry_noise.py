"""Noise of odometry: how large it is, where it goes, and that poses and counts get the same."""

from __future__ import annotations

import numpy as np
import pytest
from sim_logs import winding
from ucsd_robot import WHEELS

from moteslam.errors import ConfigError, InputError
from moteslam.robot import se2
from moteslam.robot.platform import Wheels
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, OdometryStream, Recording
from moteslam.sim.logged import key_scans, with_odometry, with_odometry_noise
from moteslam.slam.odometry.dead_reckoning import dead_reckon


def noisy(recording: Recording, distance: float, rotation: float, seed: int = 3) -> Recording:
    return with_odometry_noise(recording, distance=distance, rotation=rotation, rng=np.random.default_rng(seed))


def steps(recording: Recording) -> np.ndarray:
    assert recording.odometry is not None
    return se2.between(recording.odometry.poses[:-1], recording.odometry.poses[1:])


def arcs(count: int, left: int, right: int, wheels: Wheels | None = None) -> Recording:
    encoders = EncoderStream(np.arange(count) / 40, np.tile([right, left, right, left], (count, 1)))
    robot = UCSD if wheels is None else UCSD.model_copy(update={"wheels": wheels})
    return with_odometry(Recording("arcs", robot, encoders=encoders))


def arrays(recording: Recording) -> list[bytes]:
    assert recording.odometry is not None
    assert recording.encoders is not None
    assert recording.lidar is not None
    assert recording.lidar.odometry is not None
    found = (recording.odometry.poses, recording.encoders.counts, recording.lidar.odometry)
    return [array.tobytes() for array in found]


def test_the_noise_of_a_step_is_the_share_of_its_length_and_of_its_turn() -> None:
    drive = arcs(20_001, 300, 340)
    before, after = steps(drive), steps(noisy(drive, 0.1, 0.05))
    length = np.hypot(after[:, 0], after[:, 1]) / np.sinc(after[:, 2] / 2 / np.pi)
    true = np.hypot(before[0, 0], before[0, 1]) / np.sinc(before[0, 2] / 2 / np.pi)
    for values, expected, share in ((length, true, 0.1), (after[:, 2], before[0, 2], 0.05)):
        relative = values / expected - 1
        assert abs(relative.mean()) < 4 * share / np.sqrt(len(relative))
        assert abs(relative.std() / share - 1) < 4 / np.sqrt(2 * len(relative))
        # independent from step to step
        assert abs(np.corrcoef(relative[:-1], relative[1:])[0, 1]) < 4 / np.sqrt(len(relative))
    assert abs(np.corrcoef(length, after[:, 2])[0, 1]) < 4 / np.sqrt(len(length))


def test_the_same_share_averages_out_over_more_steps() -> None:
    ends = []
    for count, ticks in ((26, 400), (2501, 4)):  # the same 22 m
        drive = arcs(count, ticks, ticks)
        found = [noisy(drive, 0.1, 0.0, seed).odometry.poses[-1, 0] for seed in range(200)]  # type: ignore[union-attr]
        ends.append(np.std(found) / 22)
    np.testing.assert_allclose(ends, [0.1 / np.sqrt(25), 0.1 / np.sqrt(2500)], rtol=0.2)


def test_a_straight_step_stays_straight_and_one_that_stands_stands() -> None:
    straight = noisy(arcs(100, 300, 300), 0.1, 0.1)
    assert straight.odometry is not None
    assert np.ptp(straight.odometry.poses[:, 0]) > 60
    np.testing.assert_array_equal(straight.odometry.poses[:, 1:], 0.0)
    standing = noisy(arcs(100, 0, 0), 0.1, 0.1)
    assert standing.odometry is not None
    assert standing.encoders is not None
    assert not standing.odometry.poses.any()
    assert not standing.encoders.counts.any()


@pytest.mark.parametrize("thin", [False, True])
def test_counts_carry_the_same_noise_to_a_count(thin: bool) -> None:
    recording = with_odometry(winding())
    recording = key_scans(recording) if thin else recording
    result = noisy(recording, 0.1, 0.1)
    assert result.encoders is not None
    assert recording.encoders is not None
    assert UCSD.wheels is not None
    assert result.encoders.counts.dtype == np.int64
    # each reading is at most a count from the counts that steps of that length and turn have
    travel = np.diff(np.cumsum(result.encoders.counts, axis=0), axis=0) * UCSD.wheels.metres_per_count
    right, left = travel[:, ::2].mean(axis=1), travel[:, 1::2].mean(axis=1)
    length = np.hypot(*steps(result)[:, :2].T) / np.sinc(steps(result)[:, 2] / 2 / np.pi)
    turn = (right - left) / UCSD.wheels.effective_track
    before = (recording.encoders.counts[1:] * UCSD.wheels.metres_per_count).mean(axis=1)
    share = length / (np.hypot(*steps(recording)[:, :2].T) / np.sinc(steps(recording)[:, 2] / 2 / np.pi))
    assert np.abs((right + left) / 2 - before * share).max() <= 1.01 * UCSD.wheels.metres_per_count
    tolerance = 2.02 * UCSD.wheels.metres_per_count / UCSD.wheels.effective_track * (2 if thin else 1)
    assert np.abs(turn - steps(result)[:, 2]).max() < tolerance  # thinned ones are rounded to counts before, too


def test_what_is_rounded_off_is_carried_on() -> None:
    drive = arcs(40_001, 1, 1)  # one count a step: rounded each by itself, no noise of 10 % would be left
    result = noisy(drive, 0.1, 0.0)
    assert result.encoders is not None
    assert result.odometry is not None
    assert UCSD.wheels is not None
    counted = np.cumsum(result.encoders.counts[1:, 0]) * UCSD.wheels.metres_per_count
    assert (result.encoders.counts != 1).any()
    assert np.abs(counted - result.odometry.poses[1:, 0]).max() <= 0.51 * UCSD.wheels.metres_per_count


def test_poses_are_those_of_the_counts_where_these_are_fine() -> None:
    result = noisy(arcs(100, 400_000, 1_000_000, WHEELS.model_copy(update={"metres_per_count": 1e-6})), 0.1, 0.2)
    assert result.odometry is not None
    assert np.ptp(steps(result)[:, 2]) > 0.5
    integrated = dead_reckon(result.replace(odometry=None)).poses
    np.testing.assert_allclose(se2.between(result.odometry.poses, integrated), 0.0, atol=1e-4)


def test_dense_poses_are_those_that_slam_integrates_from_the_counts() -> None:
    result = noisy(with_odometry(winding()), 0.1, 0.1)
    integrated = dead_reckon(result.replace(lidar=None, odometry=None)).poses
    assert result.odometry is not None
    apart = se2.between(result.odometry.poses, integrated)
    assert np.abs(apart[:, 2]).max() < 0.004  # a count of every wheel
    assert np.hypot(*apart[:, :2].T).max() < 0.02
    before = with_odometry(winding()).odometry
    assert before is not None
    assert np.hypot(*(result.odometry.poses - before.poses)[:, :2].T).max() > 0.2


@pytest.mark.parametrize("thin", [False, True])
def test_a_turn_that_the_gyro_measured_stays_as_it_is(thin: bool) -> None:
    recording = with_odometry(winding(), gyro=True)
    recording = key_scans(recording) if thin else recording
    result = noisy(recording, 0.1, 0.3)
    assert recording.imu is not None
    assert recording.odometry is not None
    assert result.imu is recording.imu
    ends = recording.odometry.stamps[1:]
    by_gyro = (ends >= recording.imu.stamps[0]) & (ends <= recording.imu.stamps[-1])
    changed = np.abs(steps(result)[:, 2] - steps(recording)[:, 2]) > 1e-12
    assert by_gyro.any()
    assert not changed[by_gyro].any()
    assert changed[~by_gyro].sum() >= 0.5 * (~by_gyro).sum()  # of key scans the gyro covers all steps
    lengths = [np.hypot(*steps(part)[:, :2].T) for part in (recording, result)]
    assert (np.abs(lengths[1] / lengths[0] - 1) > 0.01).mean() > 0.8


def test_the_poses_at_the_scans_are_those_of_the_odometry() -> None:
    result = noisy(key_scans(with_odometry(winding())), 0.1, 0.1)
    assert result.lidar is not None
    assert result.lidar.odometry is not None
    assert result.odometry is not None
    np.testing.assert_allclose(result.lidar.odometry, result.odometry.poses, atol=1e-12)


def test_the_same_seed_gives_the_same_bytes() -> None:
    dense = with_odometry(winding())
    for recording in (dense, key_scans(dense)):
        one, two, other = noisy(recording, 0.1, 0.1), noisy(recording, 0.1, 0.1), noisy(recording, 0.1, 0.1, seed=4)
        assert arrays(one) == arrays(two)
        assert all(a != b for a, b in zip(arrays(one), arrays(other), strict=True))


def test_no_noise_changes_nothing() -> None:
    recording = key_scans(with_odometry(winding()))
    assert noisy(recording, 0.0, 0.0) is recording


def test_odometry_alone_gets_noise_too() -> None:
    poses = np.stack((np.arange(50.0), np.zeros(50), np.zeros(50)), axis=1)
    result = noisy(Recording("x", UCSD, odometry=OdometryStream(np.arange(50.0), poses)), 0.1, 0.1)
    assert result.encoders is None
    assert 0.05 < steps(result)[:, 0].std() < 0.15


@pytest.mark.parametrize(
    ("shares", "line"),
    [
        ({"distance": -0.1, "rotation": 0.0}, r"^distance: -0\.1, expected a share of 0 or more$"),
        ({"distance": 0.1, "rotation": np.nan}, r"^rotation: nan, expected a share of 0 or more$"),
        ({"distance": np.inf, "rotation": 0.1}, r"^distance: inf, expected a share of 0 or more$"),
    ],
)
def test_shares_that_are_none_are_refused(shares: dict[str, float], line: str) -> None:
    with pytest.raises(ConfigError, match=line):
        noisy(with_odometry(winding()), **shares)


def test_recordings_that_lack_something_are_refused() -> None:
    dense = with_odometry(winding())
    assert dense.encoders is not None
    apart = EncoderStream(dense.encoders.stamps + 1, dense.encoders.counts)
    for recording, line in (
        (winding(), r"^winding: odometry: no odometry, expected at least one pose$"),
        (dense.replace(encoders=apart), r"^winding: stamps: encoders and odometry at other stamps, expected the same$"),
        (dense.replace(platform=UCSD.model_copy(update={"wheels": None})), r"^winding: encoders without wheels"),
    ):
        with pytest.raises(InputError, match=line):
            noisy(recording, 0.1, 0.1)
