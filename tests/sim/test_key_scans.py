"""Key scans: where they are, and that nothing of the way between them is lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sim_logs import START, winding

from moteslam.errors import ConfigError, InputError
from moteslam.robot import se2
from moteslam.robot.formats.carmen import read_carmen
from moteslam.robot.formats.carmen_writer import write_carmen
from moteslam.robot.formats.ucsd import read_ucsd, write_ucsd
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, LidarStream, Recording
from moteslam.sim.base_odometry import with_odometry
from moteslam.sim.key_scans import key_scans
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.synchronise import synchronise, warnings
from moteslam.slam.odometry.dead_reckoning import dead_reckon

PAPER = SyncConfig(method="nearest", low_pass_hz=10.0)
COUNT_TURN = UCSD.wheels.metres_per_count / UCSD.wheels.effective_track if UCSD.wheels else 0.0
"""The turn of one count of one side's wheels [rad]."""


def scans_at(odometry: list[list[float]], **streams: object) -> Recording:
    n = len(odometry)
    ranges = np.arange(n, dtype=np.float32)[:, None] + np.ones((n, 5), np.float32)
    lidar = LidarStream(np.arange(n, dtype=float), ranges, -1.0, 0.5, 0.1, 99.0, odometry=np.array(odometry, float))
    return Recording("x", UCSD, lidar=lidar, **streams)  # type: ignore[arg-type]


def kept(recording: Recording, **limits: float) -> list[int]:
    lidar = key_scans(recording, **limits).lidar
    assert lidar is not None
    assert lidar.odometry is not None
    assert recording.lidar is not None
    assert recording.lidar.odometry is not None
    indices = lidar.stamps.astype(int)
    np.testing.assert_array_equal(lidar.ranges[:, 0], indices + 1)
    np.testing.assert_array_equal(lidar.odometry, recording.lidar.odometry[indices])
    return list(indices.tolist())


def indices_of(thin: Recording, dense: Recording) -> np.ndarray:
    assert thin.lidar is not None
    assert dense.lidar is not None
    return np.searchsorted(dense.lidar.stamps, thin.lidar.stamps)


def test_a_scan_is_kept_once_the_odometry_has_moved_the_distance() -> None:
    drive = scans_at([[x / 4, 0, 0] for x in range(14)])
    assert kept(drive) == [0, 3, 6, 9, 12]
    assert kept(drive, distance=1.0) == [0, 4, 8, 12]
    assert kept(drive, distance=np.inf) == [0]


def test_a_scan_is_kept_once_the_odometry_has_turned_also_over_half_a_turn() -> None:
    spin = scans_at([[0, 0, se2.wrap(2.5 + 0.25 * i)] for i in range(9)])
    assert kept(spin) == [0, 2, 4, 6, 8]
    assert kept(spin, turn=0.7) == [0, 3, 6]
    assert kept(spin, turn=4.0) == [0]


def test_distances_are_from_the_last_kept_scan_so_that_jitter_adds_up_to_none() -> None:
    jitter = scans_at([[0.3 * (i % 2), 0, 0.2 * (i % 2)] for i in range(50)])
    assert kept(jitter) == [0]


def test_counts_are_conserved() -> None:
    dense = with_odometry(winding())
    thin = key_scans(dense)
    assert thin.encoders is not None
    assert dense.encoders is not None
    assert thin.lidar is not None
    assert thin.encoders.counts.dtype == np.int64
    assert thin.encoders.stamps.tobytes() == thin.lidar.stamps.tobytes()
    counters = np.cumsum(dense.encoders.counts, axis=0).T
    read = np.stack([np.interp(thin.lidar.stamps, dense.encoders.stamps, counter) for counter in counters], axis=1)
    assert not thin.encoders.counts[0].any()
    np.testing.assert_array_equal(np.cumsum(thin.encoders.counts, axis=0), np.rint(read) - np.rint(read[0]))


def test_counts_between_scans_at_readings_are_summed_exactly() -> None:
    counts = np.arange(28).reshape(7, 4)
    recording = scans_at([[float(i // 3), 0, 0] for i in range(7)], encoders=EncoderStream(np.arange(7.0), counts))
    encoders = key_scans(recording).encoders
    assert encoders is not None
    np.testing.assert_array_equal(encoders.counts, [[0] * 4, counts[1:4].sum(axis=0), counts[4:7].sum(axis=0)])


@pytest.mark.parametrize("gyro", [False, True])
@pytest.mark.parametrize("config", [SyncConfig(), PAPER])
def test_slam_measures_the_same_poses_at_the_kept_scans(gyro: bool, config: SyncConfig) -> None:
    dense = with_odometry(winding(), gyro=gyro)
    thin = key_scans(dense)
    expected = dead_reckon(dense).poses[indices_of(thin, dense)]
    assert 90 < len(expected) < 120
    np.testing.assert_allclose(dead_reckon(thin, config).poses, expected, atol=1e-12)
    inputs = synchronise(thin, config)
    assert inputs.measured.all()
    assert not inputs.jumped.any()


@pytest.mark.parametrize("config", [SyncConfig(), PAPER])
def test_integrated_streams_give_the_same_headings_with_the_gyro_and_to_a_count_without(config: SyncConfig) -> None:
    for gyro, apart in ((True, 1e-9), (False, 1.01 * COUNT_TURN)):
        dense = with_odometry(winding(), gyro=gyro)
        thin = key_scans(dense)
        expected = dead_reckon(dense).poses[indices_of(thin, dense)]
        found = dead_reckon(thin.replace(lidar=None), config).poses
        assert np.abs(se2.wrap(found[:, 2] - expected[:, 2])).max() < apart
        steps = [se2.between(poses[:-1], poses[1:])[:, :2] for poses in (found, expected)]
        assert np.abs(steps[1] - steps[0]).max() < 0.02  # one arc for the path between two key scans


def test_integrated_counts_of_one_arc_give_its_positions() -> None:
    stamps = np.arange(0, 20, 0.025)
    encoders = EncoderStream(stamps, np.tile([18, 14, 18, 14], (len(stamps), 1)))
    lidar = LidarStream(stamps, np.ones((len(stamps), 3), np.float32), -1.0, 1.0, 0.1, 30.0)
    dense = with_odometry(Recording("arc", UCSD, lidar=lidar, encoders=encoders))
    thin = key_scans(dense)
    found = dead_reckon(thin.replace(lidar=None)).poses
    np.testing.assert_allclose(found, dead_reckon(dense).poses[indices_of(thin, dense)], atol=1e-9)


def test_thinning_again_changes_nothing() -> None:
    for gyro in (False, True):
        once = key_scans(with_odometry(winding(), gyro=gyro))
        again = key_scans(once)
        assert once.lidar is not None
        assert again.lidar is not None
        np.testing.assert_array_equal(again.lidar.stamps, once.lidar.stamps)
        assert dead_reckon(again).poses.tobytes() == dead_reckon(once).poses.tobytes()
        headings = [dead_reckon(part.replace(lidar=None)).poses for part in (once, again)]
        assert again.encoders is not None
        assert once.encoders is not None
        np.testing.assert_array_equal(again.encoders.counts, once.encoders.counts)
        np.testing.assert_allclose(headings[0], headings[1], atol=1e-9)


def test_one_kept_scan_has_no_rates() -> None:
    thin = key_scans(with_odometry(winding(), gyro=True), distance=1e6, turn=7.0)
    assert thin.imu is not None
    assert (len(thin.imu), len(thin.lidar or ())) == (0, 1)
    np.testing.assert_allclose(dead_reckon(thin).poses, [[0, 0, 0]], atol=1e-15)


@pytest.mark.parametrize("gyro", [False, True])
def test_a_ucsd_folder_reads_back_the_same(tmp_path: Path, gyro: bool) -> None:
    thin = key_scans(with_odometry(winding(), gyro=gyro))
    write_ucsd(tmp_path, thin, sequence=20)
    again = read_ucsd(tmp_path)
    assert again.warnings == ()
    for name in ("lidar", "encoders", "imu"):
        written, read = getattr(thin, name), getattr(again, name)
        assert (written is None) == (read is None)
        for field in () if written is None else ("stamps", "ranges", "counts", "angular_velocity"):
            if hasattr(written, field):
                assert getattr(written, field).tobytes() == getattr(read, field).tobytes()
    expected = [] if gyro else ["no-gyro"]
    assert [issue.code for issue in warnings(again, synchronise(again))] == expected


def test_a_long_interval_is_beyond_int16_and_reads_back_the_same(tmp_path: Path) -> None:
    thin = key_scans(with_odometry(winding()), distance=5.0, turn=7.0)
    longer = thin.replace(encoders=EncoderStream(thin.lidar.stamps, thin.encoders.counts * 20))  # type: ignore[union-attr]
    write_ucsd(tmp_path, longer, sequence=20)
    again = read_ucsd(tmp_path)
    assert again.encoders is not None
    assert longer.encoders is not None
    assert again.encoders.counts.max() > 2**15
    np.testing.assert_array_equal(again.encoders.counts, longer.encoders.counts)


@pytest.mark.parametrize("gyro", [False, True])
def test_a_carmen_log_reads_back_the_same(tmp_path: Path, gyro: bool) -> None:
    thin = key_scans(with_odometry(winding(), gyro=gyro))
    write_carmen(tmp_path / "key.log.gz", thin)
    again = read_carmen(tmp_path / "key.log.gz")
    assert again.warnings == ()
    for part in (thin, again):
        assert part.lidar is not None
        assert part.lidar.odometry is not None
        assert part.odometry is not None
    for field in ("stamps", "ranges", "odometry"):
        assert getattr(thin.lidar, field).tobytes() == getattr(again.lidar, field).tobytes()
    for field in ("stamps", "poses"):
        assert getattr(thin.odometry, field).tobytes() == getattr(again.odometry, field).tobytes()
    assert dead_reckon(again).poses.tobytes() == dead_reckon(thin).poses.tobytes()
    assert warnings(again, synchronise(again)) == ()


def test_encoders_that_start_late_lose_nothing_that_was_counted() -> None:
    dense = with_odometry(winding())
    assert dense.encoders is not None
    late = dense.encoders.stamps > START + 5
    encoders = EncoderStream(dense.encoders.stamps[late], dense.encoders.counts[late])
    thin = key_scans(with_odometry(dense.replace(encoders=encoders)))
    assert thin.encoders is not None
    assert thin.encoders.stamps[1] > START + 5  # nothing has moved before
    counters = np.cumsum(encoders.counts, axis=0)
    last = [np.interp(thin.encoders.stamps[-1], encoders.stamps, counter) for counter in counters.T]
    np.testing.assert_array_equal(thin.encoders.counts.sum(axis=0), np.rint(last) - counters[0])


@pytest.mark.parametrize(
    ("limits", "line"),
    [
        ({"distance": 0.0}, r"^distance: 0 m, expected more than 0$"),
        ({"distance": np.nan}, r"^distance: nan m, expected more than 0$"),
        ({"turn": -0.5}, r"^turn: -0\.5 rad, expected more than 0$"),
    ],
)
def test_limits_that_are_not_positive_are_refused(limits: dict[str, float], line: str) -> None:
    with pytest.raises(ConfigError, match=line):
        key_scans(scans_at([[0, 0, 0]]), **limits)


def test_scans_and_poses_are_needed() -> None:
    with pytest.raises(InputError, match=r"^winding: odometry: no odometry poses, expected one at every scan$"):
        key_scans(winding())
    with pytest.raises(InputError, match=r"^winding: lidar: no lidar scans, expected at least one$"):
        key_scans(winding().replace(lidar=None))
