"""What ``moteslam simulate`` is asked for is what is recorded; what it cannot do it says in one line."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_lines import printed, refused

from moteslam.eval.cli.main import run
from moteslam.robot.formats import open_recording
from moteslam.robot.platforms import bundled_platform, bundled_platforms, load_platform
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories.text import read_tum

CLASSIC = ("--platform", "lms200", "--format", "carmen")


def simulated(scenario: Path, out: Path, *options: object) -> Recording:
    """Simulate a scenario with options, and read the recording."""
    assert run(["simulate", str(scenario), "--out", str(out), *map(str, options)]) == 0
    logs = list(out.glob("*.log.gz"))
    return open_recording(*logs) if logs else open_recording(out)


def test_a_platform_is_named_filed_or_changed(scenario_file: Path, tmp_path: Path) -> None:
    named = simulated(scenario_file, tmp_path / "named", "--platform", "turtlebot3")
    assert named.platform == bundled_platform("turtlebot3")
    (tmp_path / "mine.toml").write_text('base = "turtlebot3"\n[lidar]\nrate = 4.0\n')
    filed = simulated(scenario_file, tmp_path / "filed", "--platform", tmp_path / "mine.toml")
    assert filed.platform == load_platform(tmp_path / "mine.toml")
    changes = ("--set", "platform.lidar.rate=4.0", "--set", "noise.lidar.dropout=0.5")
    changed = simulated(scenario_file, tmp_path / "changed", "--platform", "turtlebot3", *changes)
    assert changed.platform.lidar == filed.platform.lidar
    assert changed.lidar is not None
    assert np.isnan(changed.lidar.ranges).mean() == pytest.approx(0.5, abs=0.02)
    based = ("--set", "platform.base=turtlebot3", "--set", "platform.lidar.rate=4.0")
    assert simulated(scenario_file, tmp_path / "based", *based).platform.lidar == filed.platform.lidar


def test_a_drive_is_ended_after_so_many_seconds(scenario_file: Path, tmp_path: Path) -> None:
    short = simulated(scenario_file, tmp_path / "short", "--duration", 4.0)
    assert short.encoders is not None
    assert 3.0 < np.ptp(short.encoders.stamps) < 4.0


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
    file = tmp_path / "mine.toml"
    file.write_text(printed(capsys, "platforms", name))
    assert load_platform(file) == bundled_platform(name)
    assert json.loads(printed(capsys, "platforms", file, "--json")) == tomllib.loads(file.read_text())


def test_platforms_lists_all(capsys) -> None:
    assert [line.split()[0] for line in printed(capsys, "platforms").splitlines()[1:]] == sorted(bundled_platforms())
    assert json.loads(printed(capsys, "platforms", "--json"))["urg04lx"]["beams"] == 682
