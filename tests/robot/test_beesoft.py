"""Script logs and rec logs: messages and units, dates, what is broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from issues import messages
from robot_logs import write_log

from moteslam.errors import InputError
from moteslam.robot.formats import format_of, open_recording
from moteslam.robot.formats.beesoft import is_beesoft, read_beesoft

SCRIPT = ["@OPEN 12-03-99 14:04:59.5", ""]
for second in range(6):
    SCRIPT += [f"@SENS 12-03-99 14:05:{second:02d}.250000", f"#ROBOT {100 * second}.0 50.0 60.0", ""]
    SCRIPT += [f"@SENS 12-03-99 14:05:{second:02d}.500000", f"#LASER 3 0: 100 200 {300 + second}", ""]
REC = []
for second in range(6):
    REC += [f"POS 921247500  {250000 + second}: {100 * second}.0 50.0 30.0 0.0 0.0"]
    REC += [f"LASER-RANGE 9212475{second:02d}  500000 0 3 180.0: 100.0 200.0 {300 + second}.0"]


def test_a_script_log(tmp_path: Path) -> None:
    recording = open_recording(write_log(tmp_path / "x.script", SCRIPT, packed=True))
    assert recording.lidar is not None
    assert recording.odometry is not None
    np.testing.assert_allclose(np.diff(recording.odometry.stamps), 1.0)
    np.testing.assert_allclose(recording.lidar.stamps - recording.odometry.stamps, 0.25)
    np.testing.assert_allclose(recording.odometry.poses[2], [2.0, 0.5, np.pi / 6])
    np.testing.assert_allclose(recording.lidar.ranges[5], [1, 2, 3.05], rtol=1e-6)
    np.testing.assert_allclose(recording.lidar.angles, np.radians([-90, 0, 90]))
    assert recording.lidar.odometry is None
    assert recording.warnings == ()


def test_a_rec_log_says_the_same(tmp_path: Path) -> None:
    recording = open_recording(write_log(tmp_path / "x.rec", REC))
    assert recording.lidar is not None
    assert recording.odometry is not None
    np.testing.assert_allclose(recording.odometry.poses[2], [2.0, 0.5, np.pi / 6])
    np.testing.assert_allclose(recording.odometry.stamps, 921247500.25 + 1e-6 * np.arange(6))
    np.testing.assert_allclose(recording.lidar.stamps, 921247500.5 + np.arange(6))
    np.testing.assert_allclose(recording.lidar.ranges[5], [1, 2, 3.05], rtol=1e-6)
    assert format_of(tmp_path / "x.rec").name.startswith("script or rec log")


@pytest.mark.parametrize("beams", [180, 181, 360, 361])
def test_beams_are_those_of_a_classic_laser(tmp_path: Path, beams: int) -> None:
    line = f"LASER-RANGE 1 0 0 {beams} 180.0: {' '.join(['100'] * beams)}"
    lidar = read_beesoft(write_log(tmp_path / "x.rec", [line])).lidar
    assert lidar is not None
    assert lidar.angle_min == -np.pi / 2
    assert lidar.angle_increment == pytest.approx(np.radians(1.0 if beams < 200 else 0.5))


@pytest.mark.parametrize("year", ["99", "1999"])
def test_dates_of_two_and_of_four_digits(tmp_path: Path, year: str) -> None:
    lines = [line.replace("-99 ", f"-{year} ") for line in SCRIPT]
    odometry = read_beesoft(write_log(tmp_path / "x.script", lines)).odometry
    assert odometry is not None
    assert odometry.stamps[0] == 921247500.25  # 12 March 1999, 14:05


@pytest.mark.parametrize("year", ["3", "03", "103", "2003"])
def test_years_after_2000(tmp_path: Path, year: str) -> None:
    lines = [line.replace("12-03-99", f"31-02-{year}") for line in SCRIPT]  # the month from 0: March
    odometry = read_beesoft(write_log(tmp_path / "x.script", lines)).odometry
    assert odometry is not None
    assert odometry.stamps[0] == 1046700300.25


def test_another_laser_is_left_aside(tmp_path: Path) -> None:
    rear = ["LASER-RANGE 921247500 0 1 3 180.0: 1 2 3", "LASER-RANGE 921247500 0 2 3 180.0: 1 2 3"]
    recording = read_beesoft(write_log(tmp_path / "x.rec", [*REC, *rear]))
    assert messages(recording.warnings) == ("x.rec: 2 scans of another laser than the front one left aside",)
    both = [line.replace("#LASER 3 0:", "#LASER 3 2:") + (" 7 7" if "#LASER" in line else "") for line in SCRIPT]
    recording = read_beesoft(write_log(tmp_path / "x.script", both))
    assert recording.lidar is not None
    np.testing.assert_allclose(recording.lidar.ranges[5], [1, 2, 3.05], rtol=1e-6)
    assert messages(recording.warnings) == ("x.script: 6 scans of another laser than the front one left aside",)


BROKEN = {
    "a cut scan": ("LASER-RANGE 1 2 0 3 180.0: 1 2", "8 words, expected 9 for 3 ranges"),
    "other beams": ("LASER-RANGE 1 2 0 2 180.0: 1 2", "2 ranges over 180 degrees, expected"),
    "no view": ("LASER-RANGE 1 2 0 3 0.0: 1 2 3", "field of view 0, expected degrees above 0"),
    "a cut pose": ("POS 1 2: 3 4", "5 words, expected 6 or 8 for a pose"),
    "a pose that is NaN": ("POS 1 2: nan 4 5", "NaN or infinite pose or stamp"),
    "a pose off the globe": ("POS 1 2: 1e12 4 5", "pose beyond 10000000 m or rad"),
    "a stamp beyond": ("POS 1e12 2: 1 4 5", "expected seconds below 1e11"),
    "no time": ("#ROBOT 1 2 3", "a message without a time, expected an @SENS line before it"),
    "no date": ("@SENS 12-03 14:05:00", "no date and time, expected day-month-year hour:minute:second"),
    "no second": ("@SENS 12-03-99 14:05:nan", "NaN or infinite pose or stamp"),
    "an hour beyond": ("@SENS 12-03-99 34:05:00", "no date and time"),
    "a short script scan": ("#LASER 3", "2 words, expected"),
}


@pytest.mark.parametrize(("line", "problem"), BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_line_is_dropped_counted_and_named(tmp_path: Path, line: str, problem: str) -> None:
    recording = read_beesoft(write_log(tmp_path / "x.rec", [*REC, line]))
    (message,) = messages(recording.warnings)
    assert message.startswith("x.rec: 1 broken line dropped, the first is line 13: ")
    assert problem in message


def test_a_log_without_readings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"x\.script: no pose and no scan, expected a script log or a rec log"):
        open_recording(write_log(tmp_path / "x.script", SCRIPT[:1]))


@pytest.mark.parametrize("line", ["POS 1 2 3", "LASER-RANGE 1 2", "#ROBOT 1 2 3", "# @SENS", "POS x y: 1 2 3"])
def test_other_lines_are_not_taken_for_it(tmp_path: Path, line: str) -> None:
    assert not is_beesoft(write_log(tmp_path / "x.log", [line] * 3))


def test_there_are_no_sequences(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="sequence: a script or rec log is one sequence"):
        open_recording(write_log(tmp_path / "x.rec", REC), sequence=2)
