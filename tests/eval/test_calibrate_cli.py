"""What `inspect` and `replay` say of a lidar that is not as stated, and what `replay --calibrate` makes of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sim_logs import winding

from moteslam.eval.cli import main
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.robot.formats import write_recording
from moteslam.robot.formats.written import write_carmen
from moteslam.robot.trajectories.text import read_tum, write_tum
from moteslam.sim.logged import with_odometry
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate
from moteslam.slam.odometry.dead_reckoning import dead_reckon


@pytest.fixture(scope="module")
def reversed_beams(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of a drive whose scans have their beams the other way round."""
    folder = tmp_path_factory.mktemp("logs")
    simulation = simulate(load_scenario("office", platform="lms200"), 200)
    recording = simulation.recording
    lidar = recording.lidar
    assert lidar is not None
    poses = dead_reckon(recording).poses
    ranges = np.ascontiguousarray(lidar.ranges[:, ::-1])
    write_carmen(folder / "drive.log", recording.replace(lidar=replace(lidar, ranges=ranges, odometry=poses)))
    write_tum(folder / "drive.tum", simulation.truth)
    return folder / "drive.log"


def test_inspect_prints_estimates_and_what_is_certain(reversed_beams: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["inspect", str(reversed_beams)]) == 0
    out = capsys.readouterr().out
    assert "angles between beams, over the stated" in out
    assert "nothing measured" not in out
    assert "problem: scans and odometry turn in opposite directions" in out
    assert main.run(["inspect", str(reversed_beams), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert "mirrored" in [problem["code"] for problem in shown["problems"]]
    assert {"name", "value", "deviation", "stated", "certain"} == shown["calibration"][0].keys()


def test_inspect_says_where_nothing_could_be_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recording(tmp_path / "short.mcap", winding(seconds=1.0).replace(encoders=None, imu=None))
    assert main.run(["inspect", str(tmp_path / "short.mcap")]) == 0
    assert "by scans and odometry: nothing measured" in capsys.readouterr().out


@pytest.mark.slow
def test_replay_says_where_nothing_could_be_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    straight = load_scenario("corridor", platform="lms200", settings=["route.waypoints=[[3.5, 0.0], [12.0, 0.0]]"])
    write_recording(tmp_path / "straight.mcap", with_odometry(simulate(straight, 0).recording))
    for command in (["inspect"], ["replay", "--no-figures", "--out", str(tmp_path / "out")]):
        for more in ([], ["--calibrate", "lidar", "--force"]) if len(command) > 1 else ([],):
            assert main.run([*command, str(tmp_path / "straight.mcap"), "--json", *more]) == 0
            shown = json.loads(capsys.readouterr().out)
            told = [issue["code"] for issue in shown.get("problems", shown.get("warnings"))]
            assert told.count("not-calibrated") == 1


@pytest.mark.slow
def test_inspect_says_all_that_replay_says_of_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = with_odometry(winding(seconds=12.0)).replace(encoders=None, imu=None)
    odometry = recording.odometry
    poses = odometry.poses.copy()
    frozen = (odometry.stamps > odometry.stamps[0] + 4) & (odometry.stamps < odometry.stamps[0] + 7)
    poses[frozen] = poses[frozen][0]
    bag = tmp_path / "drive.mcap"
    write_recording(bag, recording.replace(odometry=replace(odometry, poses=poses)))
    assert main.run(["inspect", str(bag), "--json"]) == 0
    told = {problem["code"] for problem in json.loads(capsys.readouterr().out)["problems"]}
    assert main.run(["replay", str(bag), "--out", str(tmp_path / "out"), "--no-figures", "--json"]) == 0
    warnings = {warning["code"] for warning in json.loads(capsys.readouterr().out)["warnings"]}
    assert "stale-odometry" in warnings
    assert warnings <= told


def test_scans_that_do_not_fit_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = with_odometry(winding(seconds=12.0))
    lidar = recording.lidar
    far = replace(lidar, ranges=lidar.ranges[:] * np.float32(30), range_max=lidar.range_max * 30)
    write_recording(tmp_path / "drive.mcap", recording.replace(lidar=far))
    assert main.run(["inspect", str(tmp_path / "drive.mcap")]) == 0
    out = capsys.readouterr().out
    assert "pairs of scans fit each other" in out
    assert "replay --calibrate" not in out


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "expected"), [(1.0, {"travels-along"}), (1.06, {"lidar-angles"})])
def test_what_travels_along_is_known_only_where_the_angles_are_right(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], scale: float, expected: set[str]
) -> None:
    recording = with_odometry(simulate(load_scenario("office", platform="lms200"), 200).recording)
    lidar = recording.lidar
    keep = np.arange(400)
    ranges = np.array(lidar.ranges[keep])
    ranges[:, 80:90] = 0.5  # a load
    step = lidar.angle_increment / scale
    lidar = replace(lidar, stamps=lidar.stamps[keep], ranges=ranges, angle_increment=step, odometry=None)
    write_recording(tmp_path / "drive.mcap", recording.replace(lidar=lidar, encoders=None, imu=None))
    asked = {"lidar-angles", "travels-along"}
    assert main.run(["inspect", str(tmp_path / "drive.mcap"), "--deep", "--json"]) == 0
    told = {problem["code"] for problem in json.loads(capsys.readouterr().out)["problems"]}
    assert told & asked == expected
    out = str(tmp_path / "out")
    assert main.run(["replay", str(tmp_path / "drive.mcap"), "--out", out, "--no-figures", "--json"]) == 0
    told = {warning["code"] for warning in json.loads(capsys.readouterr().out)["warnings"]}
    assert told & asked == expected


@pytest.mark.slow
def test_replay_warns_and_mends(reversed_beams: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, options in (("as_is", []), ("mended", ["--calibrate", "lidar"])):
        out = str(tmp_path / name)
        assert main.run(["replay", str(reversed_beams), "--out", out, "--no-figures", "--json", *options]) == 0
        warnings = json.loads(capsys.readouterr().out)["warnings"]
        (mirrored,) = [issue["message"] for issue in warnings if issue["code"] == "mirrored"]
        assert mirrored.endswith("; mended by the lidar") == bool(options)
    truth = read_tum(reversed_beams.with_suffix(".tum"))
    as_is, mended = (
        absolute_trajectory_error(read_tum(tmp_path / name / "trajectory_final.tum"), truth).rmse
        for name in ("as_is", "mended")
    )
    assert mended < 0.1 < as_is
