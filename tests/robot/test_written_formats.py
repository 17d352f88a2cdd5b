"""Formats that are written: what comes back, and an issue for what a format cannot hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from converted import BAGS, WRITTEN, assert_held, made, name_of

from moteslam.robot.formats import FORMATS, open_recording, write_recording
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording, RgbdStream
from moteslam.robot.wheel_odometry import wheel_path

STAMPS = np.arange(4.0)
FULL = Recording(
    name="full",
    platform=UCSD,
    lidar=LidarStream(
        STAMPS, np.full((4, 3), 2.5, np.float32), -1.0, 0.5, 0.1, 30.0, UCSD.lidar.time_increment, np.ones((4, 3))
    ),
    encoders=EncoderStream(STAMPS, np.ones((4, 4), np.int64)),
    odometry=OdometryStream(STAMPS, np.ones((4, 3))),
    imu=ImuStream(STAMPS, np.zeros((4, 3)), np.zeros((4, 3))),
    rgbd=RgbdStream(STAMPS, STAMPS, (None,) * 4, (None,) * 4),
)


def contents(path: Path) -> list[bytes]:
    return [file.read_bytes() for file in (sorted(path.rglob("*.*")) if path.is_dir() else [path])]


@pytest.mark.parametrize(("form", "name"), [*((form, name_of(form, "x")) for form in WRITTEN), ("carmen", "x.log")])
@pytest.mark.parametrize("clockwise", [False, True])
def test_what_is_written_reads_back_and_is_the_same_bytes_again(
    tmp_path: Path, form: str, name: str, clockwise: bool
) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    recording = made(form, clockwise=clockwise)
    assert write_recording(tmp_path / "a" / name, recording, to=form) == ()
    assert (contents(tmp_path / "a" / name)[0][:2] == b"\x1f\x8b") == name.endswith(".gz")
    back = open_recording(tmp_path / "a" / name)
    assert back.warnings == ()
    assert (back.name, back.platform) == (recording.name, recording.platform)
    assert_held(form, recording, back)
    if back.imu is not None:
        mine, its = (one.imu.linear_acceleration_g for one in (recording, back))
        np.testing.assert_allclose(its, mine, rtol=4e-16 if form in BAGS else 0)
    write_recording(tmp_path / "b" / name, recording if form in BAGS else back, to=form)
    assert contents(tmp_path / "b" / name) == contents(tmp_path / "a" / name) != []


@pytest.mark.parametrize(
    ("name", "file", "lost"),
    [
        ("carmen", "x.log", ["4 encoder readings", "4 IMU readings", "8 images"]),
        ("ucsd", "new/folder", ["4 odometry poses", "4 odometry poses of scans", "8 images"]),
        ("csv", "x.toml", ["8 images"]),
    ],
)
def test_what_a_format_cannot_hold_is_an_issue(tmp_path: Path, name: str, file: str, lost: list[str]) -> None:
    write = FORMATS[name].write
    issues = write(tmp_path / file, FULL)
    assert {issue.code for issue in issues} == {"not-written"}
    assert [str(issue).partition(" not written, no place in ")[0] for issue in issues] == [f"full: {e}" for e in lost]
    back = open_recording(tmp_path / file)
    np.testing.assert_array_equal(back.lidar.ranges, FULL.lidar.ranges if FULL.lidar else 0)
    assert (back.platform.lidar.z, back.lidar.time_increment) == (UCSD.lidar.z, UCSD.lidar.time_increment)


def test_a_carmen_log_of_wheels_gets_the_poses_that_they_measure(tmp_path: Path) -> None:
    write = FORMATS["carmen"].write
    wheels = FULL.replace(odometry=None, rgbd=None, lidar=replace(FULL.lidar, odometry=None))
    first, *rest = write(tmp_path / "x.log", wheels)
    assert (first.code, first.count) == ("computed-odometry", 4)
    assert first.message == "full: 4 odometry poses computed of the wheels and written"
    assert len(rest) == 2
    back = open_recording(tmp_path / "x.log")
    np.testing.assert_array_equal(back.odometry.poses, wheel_path(wheels))
