"""Wean Hall logs: entries and units, what is broken, and the real ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from robot_logs import flaser, write_log

from moteslam.errors import InputError
from moteslam.robot.formats import format_of, open_recording
from moteslam.robot.formats.wean import is_wean, read_wean
from moteslam.robot.recording import Recording


def scan(stamp: float, x: float, ranges: Sequence[float] | None = None, ahead: float = 25.0) -> str:
    """An L line of a robot that looks along x."""
    values = [100.0 + k for k in range(180)] if ranges is None else ranges
    return " ".join(map(str, ["L", x, 200, 0, x + ahead, 200, 0, *values, stamp]))


LINES = ["O 0 200 0 0.5", *[scan(1.0 + k, 10.0 * k) for k in range(8)], "O 80 200 -0.5 9.5"]


def test_centimetres_are_metres(tmp_path: Path) -> None:
    recording = open_recording(write_log(tmp_path / "x.log", LINES, packed=True))
    assert recording.lidar is not None
    assert recording.odometry is not None
    np.testing.assert_allclose(recording.odometry.poses, [[0, 2, 0], [0.8, 2, -0.5]])
    np.testing.assert_allclose(recording.lidar.odometry, [[0.1 * k, 2, 0] for k in range(8)])
    np.testing.assert_array_equal(recording.lidar.stamps, np.arange(1.0, 9.0))
    np.testing.assert_allclose(recording.lidar.ranges[0], 1 + 0.01 * np.arange(180), rtol=1e-6)
    assert recording.lidar.angle_min == -np.pi / 2
    assert recording.platform.lidar.pose == (0.25, 0, 0)


def test_the_mount_is_that_of_the_logged_poses(tmp_path: Path) -> None:
    lines = [scan(float(k), 10.0 * k, ahead=31.5) for k in range(5)]
    assert read_wean(write_log(tmp_path / "x.log", lines)).platform.lidar.pose == (0.315, 0, 0)
    moved = [scan(float(k), 10.0 * k, ahead=31.5 + k) for k in range(5)]
    assert read_wean(write_log(tmp_path / "y.log", moved)).platform.lidar.pose == (0.25, 0, 0)


def test_no_return_is_a_spike_of_long_ranges(tmp_path: Path) -> None:
    lines = [scan(float(k), 0.0, [*range(100, 270), *[818.3] * 10]) for k in range(8)]
    lidar = read_wean(write_log(tmp_path / "x.log", lines)).lidar
    assert lidar is not None
    assert lidar.range_max == pytest.approx(8.183)
    assert np.isinf(lidar.ranges[:, 170:]).all()


BROKEN = {
    "cut": (LINES[1][:300], r"words, expected 188 for a scan of 180 ranges"),
    "short odometry": ("O 1 2 3", "4 words, expected 5 for odometry"),
    "a word": (LINES[1].replace("150.0", "x"), "a word that is no number"),
    "a pose that is NaN": ("O nan 2 3 4", "NaN or infinite pose or stamp"),
    "a pose off the globe": ("O 2e9 2 3 4", "pose beyond 10000000 m or rad"),
    "a stamp in microseconds": ("O 1 2 3 1e12", "expected seconds below 1e11"),
}


@pytest.mark.parametrize(("line", "problem"), BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_line_is_dropped_counted_and_named(tmp_path: Path, line: str, problem: str) -> None:
    recording = read_wean(write_log(tmp_path / "x.log", [*LINES, line]))
    (issue,) = recording.warnings
    assert str(issue).startswith("x.log: 1 broken line dropped, the first is line 11: ")
    with pytest.raises(InputError, match=problem):
        read_wean(write_log(tmp_path / "x.log", [line]))


@pytest.mark.parametrize("line", ["O 1 2 3", "L 1 2", "O 1 2 3 x", flaser([1.0] * 180), "Odometry 1 2 3"])
def test_other_lines_are_not_taken_for_it(tmp_path: Path, line: str) -> None:
    assert not is_wean(write_log(tmp_path / "x.log", [line] * 3))
    assert not is_wean(write_log(tmp_path / "x.log", [LINES[0], line]))


def test_there_are_no_sequences(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="sequence: a Wean Hall log is one sequence"):
        open_recording(write_log(tmp_path / "x.log", LINES), sequence=2)


@pytest.mark.parametrize(("name", "scans", "poses"), [("robotdata1.log", 713, 1505), ("robotdata3.log", 1241, 1735)])
def test_the_real_logs(data_folder: Path, name: str, scans: int, poses: int) -> None:
    path = data_folder / "wean" / name
    recording: Recording = open_recording(path)
    assert format_of(path).name.startswith("Wean Hall")
    assert recording.lidar is not None
    assert recording.odometry is not None
    assert recording.lidar.ranges.shape == (scans, 180)
    assert len(recording.odometry) == poses
    assert recording.platform.lidar.pose == (0.25, 0, 0)
    assert recording.warnings == ()
