"""Interlaced lidars: logs whose scans begin at another quarter of a degree each time."""

from pathlib import Path

import numpy as np
import pytest
from converted import assert_held
from issues import messages
from robot_logs import robotlaser, write_log

from moteslam.errors import InputError
from moteslam.robot.formats import open_recording
from moteslam.robot.formats.written import write_carmen
from moteslam.robot.recording import measured, phases
from moteslam.robot.sensor_reports import lidar_report
from moteslam.slam.inputs.scans import Scans

QUARTERS = (0, 2, 1, 3)
"""At which quarter of a degree the scans of a SICK begin, in turns."""


def range_at(degrees: float) -> float:
    """What the lidar sees at a bearing: no return in one direction, an error in another [m]."""
    quarter = round(4 * degrees)
    return 81.91 if quarter == 100 else 0.0 if quarter == 201 else 1 + (quarter + 360) / 100


def line(number: int, quarter: int, *, beams: int = 180, start: float = -90.0, **changes: object) -> str:
    """A scan of a SICK that begins at a quarter of a degree after ``start``, with angles of six digits as logged."""
    bearings = start + quarter / 4 + np.arange(beams + (quarter == 0))
    options = {"stamp": 100.0 + number, "limit": 81.9, "robot": (0.1 * number, 0, 0), **changes}
    return robotlaser(
        [range_at(bearing) for bearing in bearings],
        angle_min=round(float(np.radians(bearings[0])), 6),
        step=0.017453,
        **options,
    )


def log(scans: int = 40, **changes: object) -> list[str]:
    return [line(number, QUARTERS[number % 4], **changes) for number in range(scans)]


def test_every_scan_has_its_own_bearings(tmp_path: Path) -> None:
    recording = open_recording(write_log(tmp_path / "x.log", log()))
    lidar = recording.lidar
    assert messages(recording.warnings) == ()
    assert str(lidar) == "LidarStream(40 scans of 181 beams (4 interlaced), 39.0 s)"
    assert (lidar.ranges.shape, lidar.interlace, lidar.angle_min) == ((40, 721), 4, -1.570796)
    np.testing.assert_allclose(lidar.odometry[:, 0], 0.1 * np.arange(40))
    bearings = np.linspace(-90, 90, 721)
    np.testing.assert_allclose(lidar.angles, np.radians(bearings), atol=6e-5)
    expected = np.array([range_at(bearing) for bearing in bearings], np.float32)
    expected[expected == 0], expected[expected > 80] = np.nan, np.inf
    for number, ranges in enumerate(lidar.ranges):
        seen = np.arange(721) % 4 == QUARTERS[number % 4]
        np.testing.assert_array_equal(ranges, np.where(seen, expected, np.float32(np.nan)))
    np.testing.assert_array_equal(phases(np.asarray(lidar.ranges), 4), np.resize(QUARTERS, 40))
    assert measured(np.asarray(lidar.ranges), 4).sum() == 10 * (181 + 3 * 180)


def test_what_a_scan_did_not_measure_is_no_endpoint_and_no_error(tmp_path: Path) -> None:
    recording = open_recording(write_log(tmp_path / "x.log", log()))
    lidar = recording.lidar
    scans = Scans(lidar, recording.platform.lidar)
    assert [len(scans.points(number)) for number in range(4)] == [180, 180, 179, 180]
    report = lidar_report(lidar, [])
    assert (report.beams, report.interlace) == (721, 4)
    assert report.no_return == pytest.approx(10 / 7210)
    assert report.invalid == pytest.approx(10 / 7210)


def test_a_few_scans_of_another_bearing_are_strays(tmp_path: Path) -> None:
    lines = [*(line(number, 0) for number in range(20)), line(20, 2)]
    recording = open_recording(write_log(tmp_path / "x.log", lines))
    assert recording.lidar.ranges.shape == (20, 181)
    assert messages(recording.warnings) == ("x.log: 1 ROBOTLASER1 scan of 180 beams left aside, the first is line 21",)


OTHERS = {
    "another laser, turned": [line(number, 0, start=-45.0) for number in range(10)],
    "half as many beams": [line(number, 1, beams=90) for number in range(10)],
    "another reach": [line(number, 1, limit=8.0) for number in range(10)],
    "off the grid": [line(number, 0, start=-90 + offset) for offset in (0.31, 0.77) for number in range(10)],
}


@pytest.mark.parametrize("others", OTHERS.values(), ids=OTHERS.keys())
def test_two_lasers_in_one_log_are_refused(tmp_path: Path, others: list[str]) -> None:
    lines = [*(line(number, 0) for number in range(15)), *others]
    with pytest.raises(InputError, match=r"x\.log:16: 10 ROBOTLASER1 scans of .* expected 181 beams"):
        open_recording(write_log(tmp_path / "x.log", lines))


@pytest.mark.parametrize("scans", [8, 40])
def test_what_is_written_reads_back_the_same(tmp_path: Path, scans: int) -> None:
    (tmp_path / "p.toml").write_text("[lidar]\ntime_increment = 1e-4\n")
    recording = open_recording(write_log(tmp_path / "x.log", log(scans)), platform=tmp_path / "p.toml")
    assert recording.lidar.time_increment == pytest.approx(2.5e-5)
    write_carmen(tmp_path / "y.log", recording)
    again = open_recording(tmp_path / "y.log")
    assert messages(again.warnings) == ()
    assert_held("carmen", recording, again)


def test_the_clinic(data_folder: Path) -> None:
    recording = open_recording(data_folder / "radish/fr-clinic_robotlaser.log.gz")
    lidar = recording.lidar
    assert (lidar.ranges.shape, lidar.interlace) == ((6917, 721), 4)
    np.testing.assert_array_equal(np.bincount(phases(np.asarray(lidar.ranges), 4)), [1748, 1709, 1725, 1735])
    assert messages(recording.warnings) == ()
