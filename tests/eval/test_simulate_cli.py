"""What ``moteslam simulate`` is asked for is what is recorded; what it cannot do it says in one line."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_lines import refused

from moteslam.eval.cli.main import run
from moteslam.robot.formats import open_recording
from moteslam.robot.platforms import bundled_platform, bundled_platforms, load_platform
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories.text import read_tum
from moteslam.slam.odometry.dead_reckoning import dead_reckon

CLASSIC = ("--platform", "lms200", "--format", "carmen")


def simulated(scenario: Path, out: Path, *options: object) -> Recording:
    """Simulate a scenario with options, and read the recording."""
    assert run(["simulate", str(scenario), "--out", str(out), *map(str, options)]) == 0
    logs = list(out.glob("*.log.gz"))
    return open_recording(*logs) if logs else open_recording(out)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ("--platform nobody", "--platform: nobody: no robot of this name, expected one of lms200, rplidar_a1, "),
        ("--platform part.toml", "part.toml: length, width, "),
        ("--noise loud", "--noise: 'loud', expected datasheet or as_recorded"),
        ("--platform plain.toml --noise as_recorded", "--noise: as_recorded, expected a robot with [as_recorded]"),
        ("--set noise.lidar.dropout=2", "--set noise.lidar.dropout: "),
        ("--set noise.lidar.dropout", "--set: expected key=value, found 'noise.lidar.dropout'"),
        ("--set platform=nobody", "--set platform: no robot of this name, expected one of lms200, "),
        ("--set platform.lidar.range_max=50", "--set platform.lidar: no_return of 31 m, expected at least range_max"),
        ("--set platform.lidar.rate=100", "room.toml: platform.lidar.time_increment: 1081 beams take 0.01875 s"),
        ("--log-every nan", "--log-every: nan, expected a finite number above 0"),
        ("--log-turn -1", "--log-turn: -1, expected a finite number above 0"),
        ("--odometry-noise 0.1 2", "--odometry-noise: 0.1 2, expected 0 to 1"),
        ("--format rosbag", "Invalid value for '--format': 'rosbag' is not one of 'ucsd', 'carmen'."),
        ("--format carmen", "--format: 1081 beams over 270 degrees from -135, expected for a CARMEN log 180 or "),
        ("--platform turtlebot3 --camera", "room.toml: platform.camera: none, expected a camera to simulate"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    options: str, line: str, scenario_file: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("room.toml").write_text(scenario_file.read_text())
    Path("part.toml").write_text("[lidar]\nrange_max = 3.0\n")
    Path("plain.toml").write_text('base = "ucsd"\nname = "mine"\nas_recorded = false\n')
    before = sorted(tmp_path.iterdir())
    found = refused(capsys, "simulate", "room.toml", "--out", "new/and/x", *options.split())
    assert found.startswith(f"moteslam: {line}")
    assert sorted(tmp_path.iterdir()) == before


def test_a_platform_is_named_filed_or_changed(scenario_file: Path, tmp_path: Path) -> None:
    burger = bundled_platform("turtlebot3")
    assert simulated(scenario_file, tmp_path / "named", "--platform", "turtlebot3").platform == burger
    file = tmp_path / "mine.toml"
    file.write_text('base = "turtlebot3"\n[lidar]\nrate = 4.0\n')
    filed = simulated(scenario_file, tmp_path / "filed", "--platform", file)
    assert filed.platform == load_platform(file)
    assert filed.platform.lidar.rate == 4.0
    changes = ("--set", "platform.lidar.rate=4.0", "--set", "noise.lidar.dropout=0.5")
    changed = simulated(scenario_file, tmp_path / "changed", "--platform", "turtlebot3", *changes)
    assert changed.platform.lidar == filed.platform.lidar
    assert changed.lidar is not None
    assert filed.lidar is not None
    assert np.isnan(changed.lidar.ranges).mean() == pytest.approx(0.5, abs=0.02)
    assert np.isnan(filed.lidar.ranges).mean() == pytest.approx(0.01, abs=0.005)
    based = ("--set", "platform.base=turtlebot3", "--set", "platform.lidar.rate=4.0")
    assert simulated(scenario_file, tmp_path / "based", *based).platform.lidar == filed.platform.lidar


def test_a_file_beside_the_scenario_is_its_robot(scenario_file: Path, tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "room.toml").write_text('platform = "burger.toml"\n' + scenario_file.read_text())
    (tmp_path / "sub" / "burger.toml").write_text('base = "turtlebot3"\n')
    monkeypatch.chdir(tmp_path)
    assert simulated(Path("sub/room.toml"), tmp_path / "out").platform.lidar.beams == 360


def test_a_carmen_log_is_replayed_and_scored_by_the_truth_beside_it(
    scenario_file: Path, tmp_path: Path, capsys
) -> None:
    out = tmp_path / "log"
    recording = simulated(scenario_file, out, *CLASSIC)
    assert sorted(path.name for path in out.iterdir()) == [
        *(".moteslam", "platform.toml", "room.log.gz", "scenario.toml", "truth.tum"),
    ]
    assert load_platform(out / "platform.toml") == bundled_platform("lms200")
    assert recording.lidar is not None
    assert recording.lidar.odometry is not None
    assert recording.lidar.ranges.shape[1] == 181
    capsys.readouterr()
    replay = ("replay", str(out / "room.log.gz"), "--platform", str(out / "platform.toml"), "--out")
    assert run([*replay, str(tmp_path / "result"), "--dead-reckoning", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    length = read_tum(out / "truth.tum").length
    assert said["distance_m"] == pytest.approx(length, rel=0.02)
    assert f"as {out / 'room.log.gz'}" in refused(capsys, "inspect", out)


def test_streams_and_log_of_the_same_simulation_agree(scenario_file: Path, tmp_path: Path) -> None:
    keys = ("--platform", "lms200", "--log-every", 0.3, "--odometry-noise", 0.1, 0.1, "--seed", 2)
    arrays = simulated(scenario_file, tmp_path / "arrays", *keys)
    log = simulated(scenario_file, tmp_path / "log", *keys, "--format", "carmen")
    assert arrays.lidar is not None
    assert log.lidar is not None
    np.testing.assert_array_equal(arrays.lidar.ranges, log.lidar.ranges)
    assert log.lidar.odometry is not None
    counted = dead_reckon(arrays).poses
    np.testing.assert_allclose(counted[:, 2], log.lidar.odometry[:, 2], atol=2e-4)
    # between two key scans counts are taken for one arc, poses are where the wheels went
    np.testing.assert_allclose(counted[:, :2], log.lidar.odometry[:, :2], atol=0.03)


@pytest.mark.slow
def test_a_batch_with_options_is_what_its_parts_are(program, scenario_file: Path, tmp_path: Path) -> None:
    options = (*CLASSIC, "--log-every", 0.3, "--odometry-noise", 0.1, 0.1, "--set", "noise.lidar.dropout=0.1")
    batch = ("--batch", 2, "--seed", 5, "--jobs", 2, "--true-map", 0.1, "--json")
    done = program("simulate", scenario_file, "--out", "many", *options, *batch, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [one["seed"] for one in json.loads(done.stdout)["simulations"]] == [5, 6]
    alone = simulated(scenario_file, tmp_path / "one", *options, "--seed", 6)
    log = tmp_path / "many" / "room-6" / "room.log.gz"
    assert log.read_bytes() == (tmp_path / "one" / "room.log.gz").read_bytes()
    assert (tmp_path / "many" / "room-5" / "room.log.gz").read_bytes() != log.read_bytes()
    assert log.with_name("truth_map.yaml").exists()
    assert alone.lidar is not None
    assert np.isnan(alone.lidar.ranges).mean() == pytest.approx(0.1, abs=0.03)


def test_a_random_building_of_the_demo_is_that_of_its_seed(taichi, tmp_path: Path, capsys) -> None:
    options = ("--duration", "12", "--set", "particles=2", "--no-figures", "--out", str(tmp_path / "out"))
    assert run(["demo", "--scenario", "random-corridors", "--seed", "3", *options]) == 0
    assert capsys.readouterr().out.startswith("random-corridors-3: ")


@pytest.mark.parametrize("name", bundled_platforms())
def test_what_platforms_prints_is_the_robot(name: str, tmp_path: Path, capsys) -> None:
    assert run(["platforms", name]) == 0
    file = tmp_path / "mine.toml"
    file.write_text(capsys.readouterr().out)
    assert load_platform(file) == bundled_platform(name)
    assert run(["platforms", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == tomllib.loads(file.read_text())


def test_platforms_lists_all(capsys) -> None:
    assert run(["platforms"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == sorted(bundled_platforms())
    assert run(["platforms", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["urg04lx"]["beams"] == 682
    assert "absent.toml: No such file" in refused(capsys, "platforms", "absent.toml")
    assert "nobody: no robot of this name" in refused(capsys, "platforms", "nobody")
