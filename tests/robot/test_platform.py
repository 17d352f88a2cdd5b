"""Platforms and their TOML."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tomli_w
from ucsd_robot import CAMERA

from moteslam.errors import ConfigError
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import (
    CARMEN,
    UCSD,
    bundled_platforms,
    load_platform,
    platform_table,
    read_platform,
    write_platform,
)
from moteslam.robot.specs import LidarSpec


@pytest.mark.parametrize("platform", [UCSD, CARMEN, Platform(name="ä [bold]\"'\n", lidar=LidarSpec(x=0.1 + 0.2))])
def test_toml_reads_back_equal(tmp_path: Path, platform: Platform) -> None:
    write_platform(tmp_path / "platform.toml", platform)
    assert read_platform(tmp_path / "platform.toml") == platform


def test_the_ucsd_robot_is_that_of_the_drawing() -> None:
    assert UCSD.wheels is not None
    assert UCSD.lidar.x == pytest.approx(0.1367, abs=5e-5)
    assert UCSD.wheels.metres_per_count == pytest.approx(np.pi * UCSD.wheels.diameter / 360, rel=0.01)
    assert CAMERA.model_dump(exclude={"sensor"}) == {
        "x": 0.18,
        "y": 0.005,
        "z": 0.36,
        "roll": 0.0,
        "pitch": 0.36,
        "yaw": 0.021,
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('base = "nobody"', "base: 'nobody', expected one of lms200"),
        ("base = 3", "base: 3, expected one of lms200"),
        ("[lidar]\nbeams = 361\nangle_increment = 0.0349", r"lidar: 361 beams 0\.0349 rad apart are 2\.00 turns"),
        ("[lidar]\nangle_increment = 0", "lidar: angle_increment of 0, expected an angle between beams"),
        ("[lidar]\nrange_min = 2\nrange_max = 1", "lidar: range_min of 2 m, expected less than 1 m"),
        ("nmae = 'x'", "nmae: unknown key, expected one of base, name, description, length, width"),
        ("[lidar]\nx = 'far'", r"lidar\.x"),
        ("[lidar]\nx = nan", r"lidar\.x: nan, expected a finite number"),
        ("[wheels]\ntrack = 0", "wheels: metres_per_count, diameter"),
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


@pytest.mark.parametrize("name", bundled_platforms())
def test_a_bundled_robot_is_whole_and_reads_back(name: str, tmp_path: Path) -> None:
    platform = load_platform(name)
    assert platform.name == name
    assert platform.description
    write_platform(tmp_path / "platform.toml", platform)
    assert load_platform(tmp_path / "platform.toml") == platform
    lidar = platform.lidar
    assert (lidar.scan.beams - 1) * lidar.time_increment < 1 / lidar.scan.rate


NAMES = ", ".join(f'"{name}"' for name in sorted(bundled_platforms()))


@pytest.mark.parametrize(
    ("key", "table"),
    [("width", ""), ("imu", ""), ("camera", ""), ("body", ""), ("encoders", ""), ("wheels", ""), ("lidar", "")]
    + [(key, "lidar") for key in ("x", "yaw", "time_increment", "beams", "rate", "range_max")],
)
def test_a_whole_robot_that_is_not_is_refused_with_the_keys_that_are_missing(
    key: str, table: str, tmp_path: Path
) -> None:
    values = platform_table(UCSD)
    del (values[table] if table else values)[key]
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(values))
    missing = f"{table}.{key}" if table else key
    with pytest.raises(ConfigError) as caught:
        load_platform(path)
    assert str(caught.value) == f"{path}: {missing} missing, expected a whole robot, or base = one of {NAMES}"


def test_a_file_may_change_a_bundled_robot_if_it_names_it(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('base = "turtlebot3"\n[lidar]\nrange_max = 8.0\nno_return = []\n[noise.lidar]\ndropout = 0.1\n')
    mine, theirs = load_platform(path), load_platform("turtlebot3")
    assert mine.lidar == theirs.lidar.model_copy(update={"range_max": 8.0, "no_return": ()})
    assert mine.noise.lidar == theirs.noise.lidar.model_copy(update={"dropout": 0.1})
    assert mine.wheels == theirs.wheels
    assert mine.name == "mine"


def test_an_unknown_name_is_refused_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match=r"nobody: no robot of this name, expected one of lms200, .*"):
        load_platform("nobody")


def test_figures_as_recorded_lie_over_those_of_the_data_sheet() -> None:
    noise = {"lidar": {"range_noise": 0.01, "dropout": 0.2}}
    platform = Platform.model_validate({"noise": noise, "as_recorded": {"lidar": {"dropout": 0.5}}})
    assert platform.as_recorded is not None
    assert platform.as_recorded.lidar.range_noise == 0.01
    assert platform.as_recorded.lidar.dropout == 0.5
    assert platform.noise.lidar.dropout == 0.2


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"No such file or directory, expected a platform\.toml"):
        read_platform(tmp_path / "platform.toml")
