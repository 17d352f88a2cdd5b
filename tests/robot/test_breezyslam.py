"""BreezySLAM logs: columns and units, what is broken, and the real one."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.robot.formats import format_of, open_recording
from moteslam.robot.formats.breezyslam import BEAMS, is_breezyslam, read_breezyslam
from moteslam.robot.recording import EncoderStream, LidarStream, Recording


def reading(time: int, left: int, right: int, ranges: float = 1500) -> str:
    """A line: the range of every beam, and one more that is no range."""
    return " ".join(map(str, [time, 14554, left, right, 1.5, *[0] * 19, *[ranges] * BEAMS, 6]))


LINES = [reading(361_000_000 + 100_000 * k, 1000 + 10 * k, 5000 - 3 * k, 1000 + k) for k in range(8)]


def write(folder: Path, lines: list[str], name: str = "exp.dat") -> Path:
    path = folder / name
    data = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(data) if name.endswith(".gz") else data)
    return path


def streams(recording: Recording) -> tuple[LidarStream, EncoderStream]:
    assert recording.lidar is not None
    assert recording.encoders is not None
    return recording.lidar, recording.encoders


@pytest.mark.parametrize("name", ["exp.dat", "x.log", "exp.dat.gz"])
def test_counters_ranges_and_stamps(tmp_path: Path, name: str) -> None:
    lidar, encoders = streams(open_recording(write(tmp_path, LINES, name)))
    np.testing.assert_allclose(lidar.stamps, 361.0 + 0.1 * np.arange(8))
    np.testing.assert_array_equal(encoders.stamps, lidar.stamps)
    np.testing.assert_array_equal(encoders.counts, [[0, 0, 0, 0], *[[-3, 10, -3, 10]] * 7])
    np.testing.assert_allclose(lidar.ranges[:, 0], 1 + 0.001 * np.arange(8), rtol=1e-6)
    assert lidar.ranges.shape == (8, BEAMS)
    np.testing.assert_array_equal(lidar.ranges[:, -1], lidar.ranges[:, 0])  # not what stands before or behind
    assert np.degrees(lidar.angle_min) == pytest.approx(-119.53, abs=0.01)


def test_error_codes_and_no_return(tmp_path: Path) -> None:
    lines = [reading(0, 0, 0, value) for value in (0, 19, 20, 3999, 4000, 5600)]
    lidar, _ = streams(read_breezyslam(write(tmp_path, lines)))
    np.testing.assert_array_equal(lidar.ranges[:, 7], np.float32([np.nan, np.nan, 0.02, 3.999, np.inf, np.inf]))


def test_a_platform_lies_over_the_robot_of_these_logs(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text("[wheels]\neffective_track = 0.4\n[lidar]\nrange_max = 1.002\n")
    recording = read_breezyslam(write(tmp_path, LINES), platform=tmp_path / "p.toml")
    assert recording.platform.wheels is not None
    assert (recording.platform.wheels.effective_track, recording.platform.wheels.track) == (0.4, 0.33)
    assert np.isinf(streams(recording)[0].ranges[3, 0])


BROKEN = {
    "cut": (LINES[0][:200], r"words, expected 707 for a reading"),
    "a word": (LINES[0].replace(" 1000 ", " x ", 1), "a word that is no whole number, expected counters"),
    "a counter beyond": (LINES[0].replace("5000", str(2**60)), "counters beyond 9007199254740992"),
    "a word for a range": (LINES[0][: LINES[0].rfind(" 6")] + "a 6", "a word that is no number"),
    "a stamp that is none": (LINES[0].replace("361000000", "nan"), "NaN or infinite pose or stamp"),
}


@pytest.mark.parametrize(("line", "problem"), BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_line_is_dropped_counted_and_named(tmp_path: Path, line: str, problem: str) -> None:
    recording = read_breezyslam(write(tmp_path, [*LINES, line]))
    lidar, encoders = streams(recording)
    assert (len(lidar), len(encoders)) == (8, 8)
    (issue,) = recording.warnings
    assert issue.code == "broken-lines"
    assert str(issue).startswith("exp.dat: 1 broken line dropped, the first is line 9: ")
    with pytest.raises(InputError, match=problem):
        read_breezyslam(write(tmp_path, [line]))


def test_other_tables_of_numbers_are_not_taken_for_it(tmp_path: Path) -> None:
    for line in ("1 2 3", LINES[0] + " 7", LINES[0].replace("361000000", "361.5"), LINES[0].replace("14554", "x")):
        assert not is_breezyslam(write(tmp_path, [line] * 3))


def test_there_are_no_sequences(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="sequence: a BreezySLAM log is one sequence"):
        open_recording(write(tmp_path, LINES), sequence=2)


def test_the_real_log(data_folder: Path) -> None:
    path = data_folder / "breezyslam" / "exp2.dat"
    recording = open_recording(path)
    lidar, encoders = streams(recording)
    assert format_of(path).name.startswith("BreezySLAM")
    assert lidar.ranges.shape == (641, 682)
    assert encoders.counts[:, 1].sum() == 177_534
    assert encoders.counts[:, 0].sum() == 179_420
    assert np.isnan(lidar.ranges).mean() == pytest.approx(0.577, abs=0.001)
    assert recording.warnings == ()
