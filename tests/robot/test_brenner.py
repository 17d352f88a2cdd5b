"""Folders of the LEGO robot: lines and units, sequences, what is broken, and the real one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robot_logs import write_log

from moteslam.errors import InputError
from moteslam.robot.formats import format_of, open_recording
from moteslam.robot.formats.brenner import lego_sequences, read_lego
from moteslam.robot.recording import EncoderStream, LidarStream, Recording


def motors(stamp: int, left: int, right: int) -> str:
    return f"M {stamp} {left} {left} 3000 0 {right} {right} 3000 0 0 0 6000 0"


MOTORS = [motors(200 + 250 * k, 20_000 + 100 * k, 16_000 + 90 * k) for k in range(8)]
SCANS = [f"S {300 + 240 * k} 4 1000 {1500 + k} 15 5000" for k in range(8)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "arena"
    path.mkdir()
    write_log(path / "robot4_motors.txt", MOTORS)
    write_log(path / "robot4_scan.txt", SCANS)
    write_log(path / "robot4_reference.txt", ["P 378 1850 1897"])
    write_log(path / "landmarks.txt", ["L C 221 1472 40"])
    return path


def streams(recording: Recording) -> tuple[LidarStream, EncoderStream]:
    assert recording.lidar is not None
    assert recording.encoders is not None
    return recording.lidar, recording.encoders


def test_ticks_ranges_and_stamps(folder: Path) -> None:
    recording = open_recording(folder)
    lidar, encoders = streams(recording)
    np.testing.assert_allclose(encoders.stamps, 0.2 + 0.25 * np.arange(8))
    np.testing.assert_allclose(lidar.stamps, 0.3 + 0.24 * np.arange(8))
    np.testing.assert_array_equal(encoders.counts, [[0] * 4, *[[90, 100, 90, 100]] * 7])
    np.testing.assert_array_equal(lidar.ranges[1], np.float32([1.0, 1.501, np.nan, np.inf]))
    assert lidar.angles[0] + recording.platform.lidar.yaw == pytest.approx(-330 * 0.006135923 - 0.0698, abs=1e-4)
    assert recording.name == "robot4"
    assert recording.warnings == ()


def test_files_of_one_word_are_of_the_folder(tmp_path: Path) -> None:
    write_log(tmp_path / "motors.txt", MOTORS)
    write_log(tmp_path / "scan.txt.gz", SCANS, packed=True)
    lidar, encoders = streams(read_lego(tmp_path))
    assert (len(lidar), len(encoders)) == (8, 8)
    assert read_lego(tmp_path).name == tmp_path.name


def test_several_runs_are_chosen_by_name(folder: Path) -> None:
    write_log(folder / "robot5_scan.txt", SCANS[:3])
    with pytest.raises(InputError, match="sequence: several sequences, expected one of robot4, robot5"):
        open_recording(folder)
    with pytest.raises(InputError, match="sequence: no sequence robot6, expected one of robot4, robot5"):
        open_recording(folder, sequence="robot6")
    recording = open_recording(folder, sequence="robot5")
    assert recording.lidar is not None
    assert len(recording.lidar) == 3
    assert recording.encoders is None


BROKEN = {
    "cut motors": ("M 1 2 3", "robot4_motors.txt", "4 words, expected 14 for motors"),
    "a word": (MOTORS[0].replace("20000", "x"), "robot4_motors.txt", "a word that is no whole number, expected ticks"),
    "ticks beyond": (motors(1, 2**40, 0), "robot4_motors.txt", "ticks beyond 2147483648"),
    "a cut scan": ("S 1 4 1 2", "robot4_scan.txt", "5 words, expected 7 for 4 ranges"),
    "other beams": ("S 1 2 1 2", "robot4_scan.txt", "2 ranges, expected 4 as in the scans before it"),
    "a stamp that is none": ("S inf 4 1 2 3 4", "robot4_scan.txt", "NaN or infinite pose or stamp"),
}


@pytest.mark.parametrize(("line", "name", "problem"), BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_line_is_dropped_counted_and_named(folder: Path, line: str, name: str, problem: str) -> None:
    write_log(folder / name, [*(MOTORS if "motors" in name else SCANS), line])
    lidar, encoders = streams(read_lego(folder))
    assert (len(lidar), len(encoders)) == (8, 8)
    (issue,) = read_lego(folder).warnings
    assert str(issue).startswith(f"{name}: 1 broken line dropped, the first is line 9: {problem}")


def test_much_broken_is_refused(folder: Path) -> None:
    write_log(folder / "robot4_motors.txt", [*MOTORS[:4], *["M 1"] * 4])
    with pytest.raises(InputError, match=r"robot4_motors\.txt:5: .*first of 4 broken lines, 4 whole"):
        read_lego(folder)


@pytest.mark.parametrize("lines", [["M 1 2 3"], ["S 1 4 1 2"], ["P 1 2 3"], ["MOTOR 1"], ["S x 1 2"], []])
def test_other_folders_are_not_taken_for_it(tmp_path: Path, lines: list[str]) -> None:
    write_log(tmp_path / "robot4_motors.txt", lines)
    assert lego_sequences(tmp_path) == {}
    with pytest.raises(InputError, match="not a recording known here"):
        open_recording(tmp_path)
    with pytest.raises(InputError, match="holds no file that begins with M or S lines"):
        read_lego(tmp_path)


def test_the_real_folder(data_folder: Path) -> None:
    path = data_folder / "brenner"
    lidar, encoders = streams(open_recording(path))
    assert format_of(path).name.startswith("LEGO robot")
    assert lidar.ranges.shape == (278, 660)
    assert encoders.counts.sum(axis=0).tolist() == [27_953, 22_094, 27_953, 22_094]
