"""DP-SLAM logs: entries, what is broken, and the real one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from issues import messages
from robot_logs import write_log

from moteslam.errors import InputError
from moteslam.robot.formats import format_of, open_recording
from moteslam.robot.formats.dpslam import is_dpslam, read_dpslam

PAIRS = [[f"Odometry {k} 0.5 0.25 ", f"Laser 3 1.0 2.0 {3.0 + k} "] for k in range(8)]
LINES = [line for pair in PAIRS for line in pair]
NO_STAMPS = "x.log: scans without stamps; one second a scan is assumed"


def test_a_pose_and_a_scan_a_second(tmp_path: Path) -> None:
    recording = open_recording(write_log(tmp_path / "x.log", LINES))
    assert recording.lidar is not None
    np.testing.assert_array_equal(recording.lidar.stamps, np.arange(8.0))
    np.testing.assert_array_equal(recording.lidar.odometry, [[k, 0.5, 0.25] for k in range(8)])
    np.testing.assert_array_equal(recording.lidar.ranges[:, 2], np.arange(3.0, 11.0, dtype=np.float32))
    assert recording.odometry is None
    assert messages(recording.warnings) == (NO_STAMPS,)
    assert recording.warnings[0].code == "no-stamps"


BROKEN = {
    "cut": ("Laser 3 1.0 2.0", "4 words, expected 5 for 3 ranges"),
    "short odometry": ("Odometry 1 2", "3 words, expected 4 for odometry"),
    "no odometry": ("Laser 3 1 2 3", "a Laser line without odometry, expected an Odometry line before it"),
    "no number of beams": ("Laser x 1 2", "no number of ranges at word 2"),
    "no beams": ("Laser 0", "0 ranges, expected at least 1"),
    "a pose that is NaN": ("Odometry 1 nan 2", "NaN or infinite pose or stamp"),
}


@pytest.mark.parametrize(("line", "problem"), BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_line_is_dropped_counted_and_named(tmp_path: Path, line: str, problem: str) -> None:
    recording = read_dpslam(write_log(tmp_path / "x.log", [*LINES, line]))
    assert messages(recording.warnings)[0].startswith("x.log: 1 broken line dropped, the first is line 17: ")
    with pytest.raises(InputError, match=problem):
        read_dpslam(write_log(tmp_path / "x.log", [line]))


def test_a_scan_with_other_beams_or_after_broken_odometry_is_dropped(tmp_path: Path) -> None:
    more = ["Odometry 9 0 0", "Laser 2 1 1", "Odometry 9 0", "Laser 3 1 1 1"]
    recording = read_dpslam(write_log(tmp_path / "x.log", [*LINES, *more]))
    assert recording.lidar is not None
    assert len(recording.lidar) == 8
    assert "3 broken lines dropped, the first is line 18: 2 ranges, expected 3 as" in messages(recording.warnings)[0]


@pytest.mark.parametrize("line", ["Odometry 1 2", "Laser 3 1 2", "Laser 3 1 2 x", "ODOM 1 2 3", "Laser"])
def test_other_lines_are_not_taken_for_it(tmp_path: Path, line: str) -> None:
    assert not is_dpslam(write_log(tmp_path / "x.log", [line] * 3))


def test_there_are_no_sequences(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="sequence: a DP-SLAM log is one sequence"):
        open_recording(write_log(tmp_path / "x.log", LINES), sequence=2)


def test_the_real_log(data_folder: Path) -> None:
    path = data_folder / "dpslam" / "loop5.log"
    recording = open_recording(path)
    assert format_of(path).name.startswith("DP-SLAM")
    assert recording.lidar is not None
    assert recording.lidar.ranges.shape == (551, 181)
    assert recording.lidar.range_max == pytest.approx(8.183)
    assert np.isinf(recording.lidar.ranges).mean() == pytest.approx(0.0674, abs=0.0001)
