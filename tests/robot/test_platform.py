"""Platforms and their TOML."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moteslam.errors import ConfigError
from moteslam.robot.platform import CARMEN, UCSD, CameraMount, LidarMount, Platform, read_platform, write_platform


@pytest.mark.parametrize("platform", [UCSD, CARMEN, Platform(name="ä [bold]\"'\n", lidar=LidarMount(x=0.1 + 0.2))])
def test_toml_reads_back_equal(tmp_path: Path, platform: Platform) -> None:
    write_platform(tmp_path / "platform.toml", platform)
    assert read_platform(tmp_path / "platform.toml") == platform


def test_the_ucsd_robot_is_that_of_the_drawing() -> None:
    assert UCSD.wheels is not None
    assert UCSD.lidar.x == pytest.approx(0.1367, abs=5e-5)
    assert UCSD.wheels.metres_per_count == pytest.approx(np.pi * UCSD.wheels.diameter / 360, rel=0.01)
    assert UCSD.camera == CameraMount(x=0.18, y=0.005, z=0.36, roll=0, pitch=0.36, yaw=0.021)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nmae = 'x'", "nmae: unknown key, expected one of name, length, width"),
        ("[lidar]\nx = 'far'", r"lidar\.x"),
        ("[lidar]\nx = nan", r"lidar\.x: nan, expected a finite number"),
        ("[wheels]\ntrack = 0", r"wheels\.track: 0, expected above 0"),
        ("length = -1", "length: -1, expected above 0"),
        ("wheels = 3", "wheels: 3, expected a table"),
        ("[wheels]\ntrak = 1", r"wheels\.trak: unknown key, expected one of metres_per_count"),
        ("name = ", "not TOML"),
        ("", None),
    ],
)
def test_bad_platforms_are_told_with_their_key(tmp_path: Path, text: str, message: str | None) -> None:
    path = tmp_path / "platform.toml"
    path.write_text(text)
    if message is None:
        assert read_platform(path) == Platform()
        return
    with pytest.raises(ConfigError, match=message) as caught:
        read_platform(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_file_overrides_a_base_key_by_key_and_one_that_was_written_overrides_all(tmp_path: Path) -> None:
    path = tmp_path / "platform.toml"
    path.write_text('name = "heavy"\n[wheels]\ntrack = 0.4\n')
    read = read_platform(path, base=UCSD)
    assert UCSD.wheels is not None
    assert read == UCSD.model_copy(update={"name": "heavy", "wheels": UCSD.wheels.model_copy(update={"track": 0.4})})
    for platform in (CARMEN, UCSD):
        write_platform(path, platform)
        for base in (CARMEN, UCSD):
            assert read_platform(path, base=base) == platform
    path.write_text("wheels = true")
    with pytest.raises(ConfigError, match="wheels: "):
        read_platform(path, base=UCSD)


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"No such file or directory, expected a platform\.toml"):
        read_platform(tmp_path / "platform.toml")
