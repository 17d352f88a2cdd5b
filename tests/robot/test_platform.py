"""Platforms and their TOML."""

from pathlib import Path

import numpy as np
import pytest
import tomli_w
from refusals import refusal
from ucsd_robot import CAMERA

from moteslam.errors import ConfigError
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.platforms import (
    CARMEN,
    UCSD,
    bundled_platforms,
    load_platform,
    platform_table,
    read_platform,
    write_platform,
)


def test_the_ucsd_robot_is_that_of_the_drawing() -> None:
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
    ("text", "field"),
    [
        (None, None),
        ("name = ", None),
        ('base = "nobody"', "base"),
        ("[lidar]\nbeams = 361\nangle_increment = 0.0349", "lidar"),
        ("[lidar]\nangle_increment = 0", "lidar"),
        ("[lidar]\nrange_min = 2\nrange_max = 1", "lidar"),
        ("nmae = 'x'", "nmae"),
        ("[lidar]\nx = 'far'", "lidar.x"),
        ("[wheels]\ntrack = 0", "wheels.metres_per_count"),
    ],
)
def test_bad_platforms_are_told_with_their_key(tmp_path: Path, text: str | None, field: str | None) -> None:
    path = tmp_path / "platform.toml"
    if text is not None:
        path.write_text(text)
    with refusal(ConfigError, file=path, field=field):
        read_platform(path)


def test_a_file_overrides_a_base_key_by_key_and_one_that_was_written_overrides_all(tmp_path: Path) -> None:
    path = tmp_path / "platform.toml"
    path.write_text('name = "heavy"\n[wheels]\ntrack = 0.4\n')
    read = read_platform(path, base=UCSD)
    assert read == UCSD.model_copy(update={"name": "heavy", "wheels": UCSD.wheels.model_copy(update={"track": 0.4})})
    for platform in (CARMEN, UCSD, Platform(name="ä [bold]\"'\n", lidar=LidarSpec(x=0.1 + 0.2))):
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


@pytest.mark.parametrize("key", ["width", "imu", "wheels", "lidar", "lidar.x", "lidar.beams", "lidar.range_max"])
def test_a_whole_robot_that_is_not_is_refused_with_the_keys_that_are_missing(key: str, tmp_path: Path) -> None:
    values = platform_table(UCSD)
    table, _, name = key.rpartition(".")
    del (values[table] if table else values)[name]
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(values))
    with pytest.raises(ConfigError, match=f": {key} missing"):
        load_platform(path)


def test_an_unknown_name_is_refused_with_those_there_are() -> None:
    with refusal(ConfigError, "lms200", field="nobody"):
        load_platform("nobody")


def test_figures_as_recorded_lie_over_those_of_the_data_sheet() -> None:
    noise = {"lidar": {"range_noise": 0.01, "dropout": 0.2}}
    platform = Platform.model_validate({"noise": noise, "as_recorded": {"lidar": {"dropout": 0.5}}})
    assert platform.as_recorded.lidar.range_noise == 0.01
    assert platform.as_recorded.lidar.dropout == 0.5
    assert platform.noise.lidar.dropout == 0.2
