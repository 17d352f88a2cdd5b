"""Base odometry, key scans and noise on steps: what SLAM integrates, and nothing of the way is lost."""

import numpy as np
import pytest
from refusals import refusal
from sim_logs import START, winding
from ucsd_robot import WHEELS

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.platform import Wheels
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, LidarStream, Recording
from moteslam.sim.logged import key_scans, with_odometry, with_odometry_noise
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.synchronise import dead_reckon, synchronise

PAPER = SyncConfig(method="nearest", low_pass_hz=10.0)
COUNT, TRACK = UCSD.wheels.metres_per_count, UCSD.wheels.effective_track
WITHOUT_WHEELS = UCSD.model_copy(update={"wheels": None})


def scans_at(odometry: list[list[float]], **streams: object) -> Recording:
    n = len(odometry)
    ranges = np.arange(n, dtype=np.float32)[:, None] + np.ones((n, 5), np.float32)
    lidar = LidarStream(np.arange(n, dtype=float), ranges, -1.0, 0.5, 0.1, 99.0, odometry=np.array(odometry, float))
    return Recording("x", UCSD, lidar=lidar, **streams)


def kept(recording: Recording, **limits: float) -> list[int]:
    lidar = key_scans(recording, **limits).lidar
    indices = lidar.stamps.astype(int)
    np.testing.assert_array_equal(lidar.ranges[:, 0], indices + 1)
    np.testing.assert_array_equal(lidar.odometry, recording.lidar.odometry[indices])
    return indices.tolist()


def steps(recording: Recording) -> np.ndarray:
    return se2.between(recording.odometry.poses[:-1], recording.odometry.poses[1:])


def arcs(count: int, left: int, right: int, wheels: Wheels = WHEELS) -> Recording:
    encoders = EncoderStream(np.arange(count) / 40, np.tile([right, left, right, left], (count, 1)))
    return with_odometry(Recording("arcs", UCSD.model_copy(update={"wheels": wheels}), encoders=encoders))


def noisy(recording: Recording, distance: float, rotation: float, seed: int = 3) -> Recording:
    return with_odometry_noise(recording, distance=distance, rotation=rotation, rng=np.random.default_rng(seed))


def test_a_scan_is_kept_once_the_odometry_has_moved_or_turned_enough() -> None:
    drive = scans_at([[x / 4, 0, 0] for x in range(14)])
    assert kept(drive) == [0, 3, 6, 9, 12]
    assert kept(drive, distance=np.inf) == [0]
    spin = scans_at([[0, 0, se2.wrap(2.5 + 0.25 * i)] for i in range(9)])  # over half a turn, too
    assert kept(spin) == [0, 2, 4, 6, 8]
    assert kept(spin, turn=4.0) == [0]
    jitter = scans_at([[0.3 * (i % 2), 0, 0.2 * (i % 2)] for i in range(50)])
    assert kept(jitter) == [0]


@pytest.mark.parametrize("late", [0.0, 5.0])
def test_counts_are_conserved(late: float) -> None:
    dense = winding()
    begun = dense.encoders.stamps >= START + late
    dense = with_odometry(
        dense.replace(encoders=EncoderStream(dense.encoders.stamps[begun], dense.encoders.counts[begun]))
    )
    thin = key_scans(dense)
    assert thin.encoders.counts.dtype == np.int64
    assert thin.encoders.stamps.tobytes() == thin.lidar.stamps.tobytes()
    counters = np.cumsum(dense.encoders.counts, axis=0).T
    read = np.stack([np.interp(thin.lidar.stamps, dense.encoders.stamps, counter) for counter in counters], axis=1)
    assert not thin.encoders.counts[0].any()
    np.testing.assert_array_equal(np.cumsum(thin.encoders.counts, axis=0), np.rint(read) - np.rint(read[0]))


@pytest.mark.parametrize(("gyro", "config"), [(False, SyncConfig()), (True, SyncConfig()), (True, PAPER)])
def test_slam_measures_the_same_at_the_kept_scans(gyro: bool, config: SyncConfig) -> None:
    dense = with_odometry(winding(), gyro=gyro)
    thin = key_scans(dense)
    expected = dead_reckon(dense).poses[np.searchsorted(dense.lidar.stamps, thin.lidar.stamps)]
    assert 90 < len(expected) < 120
    np.testing.assert_allclose(dead_reckon(thin, config).poses, expected, atol=1e-12)
    inputs = synchronise(thin, config)
    assert inputs.measured.all()
    assert not inputs.jumped.any()
    # the streams alone give the headings, exactly with the gyro and to a count without; one arc between two scans
    found = dead_reckon(thin.replace(lidar=None), config).poses
    assert np.abs(se2.wrap(found[:, 2] - expected[:, 2])).max() < (1e-9 if gyro else 1.01 * COUNT / TRACK)
    parts = [se2.between(poses[:-1], poses[1:])[:, :2] for poses in (found, expected)]
    assert np.abs(parts[1] - parts[0]).max() < 0.02


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


@pytest.mark.parametrize("thin", [False, True])
def test_counts_carry_the_same_noise_to_a_count(thin: bool) -> None:
    recording = with_odometry(winding())
    recording = key_scans(recording) if thin else recording
    result = noisy(recording, 0.1, 0.1)
    # each reading is at most a count from the counts that steps of that length and turn have
    travel = np.diff(np.cumsum(result.encoders.counts, axis=0), axis=0) * COUNT
    right, left = travel[:, ::2].mean(axis=1), travel[:, 1::2].mean(axis=1)
    length = np.hypot(*steps(result)[:, :2].T) / np.sinc(steps(result)[:, 2] / 2 / np.pi)
    before = (recording.encoders.counts[1:] * COUNT).mean(axis=1)
    share = length / (np.hypot(*steps(recording)[:, :2].T) / np.sinc(steps(recording)[:, 2] / 2 / np.pi))
    assert np.abs((right + left) / 2 - before * share).max() <= 1.01 * COUNT
    tolerance = 2.02 * COUNT / TRACK * (2 if thin else 1)  # thinned ones are rounded to counts before, too
    assert np.abs((right - left) / TRACK - steps(result)[:, 2]).max() < tolerance
    if thin:
        np.testing.assert_allclose(result.lidar.odometry, result.odometry.poses, atol=1e-12)


def test_what_is_rounded_off_is_carried_on() -> None:
    result = noisy(arcs(40_001, 1, 1), 0.1, 0.0)  # one count a step: rounded each by itself, no noise would be left
    counted = np.cumsum(result.encoders.counts[1:, 0]) * COUNT
    assert (result.encoders.counts != 1).any()
    assert np.abs(counted - result.odometry.poses[1:, 0]).max() <= 0.51 * COUNT


@pytest.mark.parametrize("thin", [False, True])
def test_a_turn_that_the_gyro_measured_stays_as_it_is(thin: bool) -> None:
    recording = with_odometry(winding(), gyro=True)
    recording = key_scans(recording) if thin else recording
    result = noisy(recording, 0.1, 0.3)
    assert result.imu is recording.imu
    ends = recording.odometry.stamps[1:]
    by_gyro = (ends >= recording.imu.stamps[0]) & (ends <= recording.imu.stamps[-1])
    changed = np.abs(steps(result)[:, 2] - steps(recording)[:, 2]) > 1e-12
    assert by_gyro.any()
    assert not changed[by_gyro].any()
    assert changed[~by_gyro].sum() >= 0.5 * (~by_gyro).sum()  # of key scans the gyro covers all steps
    lengths = [np.hypot(*steps(part)[:, :2].T) for part in (recording, result)]
    assert (np.abs(lengths[1] / lengths[0] - 1) > 0.01).mean() > 0.8


def test_the_same_seed_gives_the_same_bytes_and_no_noise_changes_nothing() -> None:
    recording = key_scans(with_odometry(winding()))
    one, two, other = (noisy(recording, 0.1, 0.1, seed) for seed in (3, 3, 4))
    assert one.odometry.poses.tobytes() == two.odometry.poses.tobytes() != other.odometry.poses.tobytes()
    assert one.encoders.counts.tobytes() == two.encoders.counts.tobytes() != other.encoders.counts.tobytes()
    assert noisy(recording, 0.0, 0.0) is recording


def test_what_cannot_be_logged_is_refused() -> None:
    for field, make in (
        ("encoders", lambda: with_odometry(winding().replace(encoders=None))),
        (None, lambda: with_odometry(winding().replace(platform=WITHOUT_WHEELS))),
        ("imu", lambda: with_odometry(winding().replace(imu=None), gyro=True)),
        ("lidar", lambda: key_scans(winding().replace(lidar=None))),
    ):
        with refusal(InputError, field=field):
            make()
