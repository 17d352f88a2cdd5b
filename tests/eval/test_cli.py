"""The program as a user meets it: what each command prints, how it leaves, and that nothing is lost in converting."""

import json
import math
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from command_lines import Capsys, printed, program, refused, shown, told
from converted import WRITTEN, assert_held, name_of, to

from moteslam.eval.cli import main
from moteslam.eval.cli.recordings import _lines as inspection_lines
from moteslam.robot.formats import Cut, cut, open_recording, write_recording
from moteslam.robot.formats.written import write_carmen
from moteslam.robot.inspection import inspect_recording
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import between
from moteslam.robot.sensor_reports import ClockReport
from moteslam.robot.trajectories import WRITERS, read_trajectory, write_trajectory
from moteslam.robot.trajectories.text import read_tum, write_g2o, write_tum
from moteslam.robot.trajectory import PoseGraph, Trajectory
from moteslam.sim.logged import with_odometry

HEAVY = {"numpy", "scipy", "matplotlib", "taichi", "cv2", "pymunk", "rich"}  # Typer itself loads some of Pydantic
COMMANDS = (
    *("demo", "simulate", "replay", "evaluate", "compare", "report"),
    *("inspect", "platforms", "metrics", "scenarios"),
)


def test_help_is_instant_and_has_examples() -> None:
    code = (
        "import sys\nfrom moteslam.eval.cli.main import run\n"
        f"codes = [run([*command.split(), '--help']) for command in {('', *COMMANDS)!r}]\n"
        f"loaded = sorted({HEAVY!r} & set(sys.modules))\n"
        "loaded += [name for name in sys.modules if name.startswith(('moteslam.r', 'moteslam.s', 'moteslam.k'))]\n"
        "assert not any(codes) and not loaded, (codes, loaded)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Examples:") >= len(COMMANDS)


def test_print_config_reads_back(tmp_path: Path, capsys: Capsys) -> None:
    file, again = tmp_path / "mine.toml", tmp_path / "again.toml"
    file.write_text("particles = 7\n[map]\ncell_size = 0.1\n")
    first = ("replay", "--preset", "paper", "--config", file, "--set", "particles=8", "--print-config")
    again.write_text(printed(capsys, *first))
    values = tomllib.loads(again.read_text())
    assert (values["particles"], values["map"]["cell_size"]) == (8, 0.1)  # flag over file over preset
    found = printed(capsys, "replay", "--config", again, "--print-config", "--set", "particles=9")
    assert tomllib.loads(found) == {**values, "particles": 9}
    assert shown(capsys, *first) == values


@pytest.mark.slow
def test_simulate_then_replay_then_evaluate(scenario_file: Path, tmp_path: Path, capsys) -> None:
    done = program("simulate", scenario_file, "--out", "robot", "--seed", 3, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["seed"] == 3

    done = program("replay", "robot", "--out", "result", "--set", "particles=5", "--json", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    summary = json.loads(done.stdout)
    names = {file.name for file in (tmp_path / "result").iterdir()}
    assert names == {
        *("trajectory.tum", "trajectory_final.tum", "dead_reckoning.tum", "truth.tum"),
        *("map.png", "map.pgm", "map.yaml", "map.npz", "metrics.json", "config.toml", "run.json"),
        *("trajectories.png", "over_time.png", "dead_reckoning.png", "particles.png", "error.png"),
        *("effective_particles.png", "particles.npz", "loops.csv", "graph.g2o", "sessions.npz", "diagnostics.csv"),
        ".moteslam",
    }
    assert summary["scans"] == len(read_tum(tmp_path / "result/trajectory.tum"))
    about = json.loads((tmp_path / "result/run.json").read_text())
    assert about["seed"] == 0
    assert about["versions"]["taichi"]
    assert about["hardware"]["cores"] >= 1

    done = program("evaluate", "result/trajectory.tum", "result/truth.tum", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    ate = json.loads(done.stdout)["ate"]
    assert ate["translation_m"]["rmse"] == summary["metrics"]["online.ate"]["value"]
    assert ate["rotation_deg"]["mean"] == pytest.approx(summary["metrics"]["online.heading"]["mean"])
    assert 0 < ate["translation_m"]["rmse"] < 0.1

    said = refused(capsys, "replay", tmp_path / "result", "--out", tmp_path / "more")
    assert "is the result folder of a run, expected a recording" in said
    assert "exists already" in refused(capsys, "replay", tmp_path / "robot", "--out", tmp_path / "result")
    done = program("replay", "robot", "--out", "result", "--force", "--no-figures", "--preset", "paper", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "ATE RMSE" in done.stdout
    assert not (tmp_path / "result/error.png").exists()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["result", "robot"]


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
def test_a_log_is_scored_by_the_reference_and_the_relations_beside_it(
    simulation, tmp_path: Path, capsys: Capsys
) -> None:
    write_carmen(tmp_path / "a.log", with_odometry(simulation.recording, gyro=True))
    write_tum(tmp_path / "a.reference.tum", simulation.truth)
    first, last = simulation.recording.lidar.stamps[[10, -10]]
    x, y, theta = between(*simulation.truth.at(np.array((first, last))).poses)
    lines = (f"{first:.6f} {end:.6f} {x} {y} 0 0 0 {theta}\n" for end in (last, last + 900))
    (tmp_path / "a.relations").write_text("".join(lines))
    out = printed(capsys, "replay", tmp_path / "a.log", "--out", tmp_path / "out", "--no-figures")
    assert " m in " in out  # the reference's
    assert "laid on the reference, rigidly" in out
    assert "SLAM (final) against 1 of 2 relations: off by " in out
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())["metrics"]
    assert metrics["final.relations"]["value"] < 0.05
    assert (metrics["final.relations"]["used"], metrics["final.relations"]["total"]) == (1, 2)


@pytest.mark.parametrize(
    ("sequence", "distance", "end", "heading"),
    [("20", 95.9, (-2.1, -1.9), 2.4), ("21", 91.8, (-2.53, -1.84), -53.0)],
)
def test_dead_reckoning_of_the_real_encoders(
    sequence: str, distance: float, end: tuple[float, float], heading: float, data_folder: Path, tmp_path: Path, capsys
) -> None:
    replay = ("replay", data_folder / "ucsd", "--sequence", sequence, "--dead-reckoning")
    found = shown(capsys, *replay, "--out", tmp_path / "out")
    assert found["distance_m"] == pytest.approx(distance, abs=0.1)
    assert found["end"]["heading_deg"] == pytest.approx(heading, abs=0.5)
    assert (found["end"]["x_m"], found["end"]["y_m"]) == pytest.approx(end, abs=0.1)
    assert len(read_tum(tmp_path / "out" / "dead_reckoning.tum")) == found["poses"]
    assert (tmp_path / "out" / "dead_reckoning.png").exists()


def test_a_stated_duration_that_is_too_short_is_named(tmp_path: Path, capsys: Capsys) -> None:
    slow = ("--platform", "turtlebot3", "--set", "duration=60")
    said = refused(capsys, "simulate", "corridor", *slow, "--out", tmp_path / "x")
    words = "corridor: duration: 259.091 s", "duration=60", "101 m take ", "to stop earlier use --duration 60"
    assert all(each in said for each in words)


def test_dead_reckoning_is_scored_by_the_truth_beside_it(
    simulated_folder: Path, tmp_path: Path, capsys: Capsys
) -> None:
    replay = ("replay", simulated_folder, "--dead-reckoning")
    assert re.search(r"^ATE \S+ cm, by the truth beside the recording$", printed(capsys, *replay), re.M)
    printed(capsys, *replay, "--out", tmp_path / "out")
    scored = shown(capsys, "evaluate", tmp_path / "out/dead_reckoning.tum", simulated_folder / "truth.tum")
    assert shown(capsys, *replay)["ate_m"] == pytest.approx(scored["ate"]["translation_m"]["rmse"])


def test_inspect(simulated_folder: Path, tmp_path: Path, capsys: Capsys) -> None:
    found = {}
    for line in printed(capsys, "inspect", simulated_folder).splitlines():
        name, *cells = [cell.strip() for cell in line.split("  ") if cell.strip()]
        found[name] = cells
    assert found["sensors"] == ["measured", "platform"]
    assert found["lidar beams"] == ["1081", "1081"]
    assert found["first beam"] == ["-135 deg", "-135 deg"]
    assert found["turns"] == ["counterclockwise", "counterclockwise"]
    assert found["range resolution"] == ["1 mm", "1 mm"]
    assert found["encoder rate"] == ["40.0 Hz", "40 Hz"]
    assert found["gyro at rest, noise"][1] == "0.00400 rad/s"
    lidar = shown(capsys, "inspect", simulated_folder, "--plot", tmp_path / "a.PNG")["lidar"]
    assert (tmp_path / "a.PNG").read_bytes().startswith(b"\x89PNG")
    assert lidar["resolution"] == pytest.approx(0.001)
    assert lidar["noise_at_rest"]["deviation"] == pytest.approx(0.009, abs=0.002)


def test_a_clock_is_before_or_after_another(simulation) -> None:
    found = inspect_recording(simulation.recording)
    for offset, words in ((-0.15, "150 ms before"), (0.15, "150 ms after"), (-0.05, "within 0.1 s of")):
        clock = ClockReport("encoders", "imu", offset, 0.9, 0.01)
        lines = inspection_lines(replace(found, clocks=(clock,)), simulation.recording.platform, None)
        assert f"clock: turns by the encoders {words} those by the imu, correlation 0.90" in lines


@pytest.fixture(scope="session")
def drive(simulation) -> Recording:
    """A second of a drive: lidar, encoders, odometry and IMU."""
    odometry = with_odometry(simulation.recording, gyro=True).odometry
    return cut(simulation.recording.replace(odometry=odometry), Cut(end=1.0))


@pytest.fixture(scope="session")
def drives(drive: Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same in every format."""
    folder = tmp_path_factory.mktemp("drives")
    paths = {form: folder / form / name_of(form) for form in WRITTEN}
    for form, path in paths.items():
        write_recording(path, drive, to=form)
    return paths


def files_in(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def convert(*arguments: object) -> int:
    return main.run(["convert", *map(str, arguments)])


@pytest.mark.parametrize(("source", "target"), [*zip(WRITTEN, WRITTEN, strict=True), *pairwise((*WRITTEN, WRITTEN[0]))])
def test_every_format_becomes_itself_and_the_next(
    source: str, target: str, drives: dict[str, Path], tmp_path: Path
) -> None:
    out = tmp_path / name_of(target)
    assert convert(drives[source], out, *to(target)) == 0
    assert_held(target, open_recording(drives[source]), open_recording(out))


def test_what_is_lost_is_printed_and_in_the_json(drives: dict[str, Path], tmp_path: Path, capsys) -> None:
    assert told(capsys, "convert", drives["csv"], tmp_path / "a.log", "--every", "10").count(" not written, ") == 2
    assert convert(drives["csv"], tmp_path / "b.log", "--json") == 0
    out, err = capsys.readouterr()
    said = json.loads(out)
    assert err == ""
    assert (said["format"], said["out"], said["truth"]) == ("carmen", str(tmp_path / "b.log"), None)
    assert {issue["code"] for issue in said["warnings"]} == {"not-written"}
    assert said["readings"]["encoders"] == 40


def test_a_truth_stays_where_it_is_and_is_named(simulated_folder: Path, tmp_path: Path, capsys) -> None:
    truth = simulated_folder / "truth.tum"
    before = truth.read_bytes()
    said = printed(capsys, "convert", simulated_folder, tmp_path / "a.bag", "--end", "1")
    assert f"moteslam evaluate TRAJECTORY {truth}" in said
    assert shown(capsys, "convert", simulated_folder, tmp_path / "b.bag", "--end", "1")["truth"] == str(truth)
    assert truth.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.bag", "b.bag"]


@pytest.mark.parametrize("form", ["ucsd", "csv"])
def test_the_input_is_never_replaced_and_others_with_force_alone(form: str, drives: dict[str, Path], capsys) -> None:
    before = files_in(drives[form].parent)
    assert "--force" in refused(capsys, "convert", drives["bag"], drives[form], *to(form))
    assert "the input" in refused(capsys, "convert", drives[form], drives[form], *to(form), "--force")
    assert files_in(drives[form].parent) == before


def test_replay_takes_the_same_part_and_records_it(drives: dict[str, Path], tmp_path: Path) -> None:
    part = ["--start", "0.1", "--end", "0.9", "--every", "2", "--streams", "lidar,odometry"]
    options = ["--topics", "lidar=/scan", "--no-figures", "--set", "particles=5", "--out", str(tmp_path / "result")]
    assert main.run(["replay", str(drives["bag"]), *part, *options]) == 0
    about = json.loads((tmp_path / "result" / "run.json").read_text())
    assert (about["start"], about["end"], about["every"]) == (0.1, 0.9, 2)
    assert (about["streams"], about["topics"]) == ("lidar,odometry", ["lidar=/scan"])
    rows = (tmp_path / "result" / "trajectory.tum").read_text().splitlines()
    assert 10 < len([row for row in rows if not row.startswith("#")]) < 20


ENDINGS = {name: ending for name, (ending, _) in WRITERS.items()}
STAMPS = 1_300_000_000 + np.arange(40) / 8
PATH = Trajectory(STAMPS, np.column_stack((np.cos(STAMPS), np.sin(STAMPS), np.linspace(-3, 3, 40))))


@pytest.fixture
def trajectories(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, ending in ENDINGS.items():
        write_trajectory(f"{name}{ending}", PATH)


@pytest.mark.usefixtures("trajectories")
def test_a_format_that_is_named_and_json(capsys) -> None:
    said = shown(capsys, "convert", "tum.tum", "path.txt", "--to", "euroc")
    assert said == {"out": "path.txt", "format": "euroc", "poses": 40, "distance_m": PATH.length, "warnings": []}
    assert Path("path.txt").read_text().startswith("#timestamp [ns]")


@pytest.mark.usefixtures("trajectories")
def test_the_poses_are_in_the_plane() -> None:
    """Of a trajectory in space x, y and the heading are kept, as by every command."""
    Path("space.tum").write_text("0 1 2 3 0 0 1 0\n1 4 5 6 0 0 0 1\n")
    assert convert("space.tum", "flat.g2o") == 0
    np.testing.assert_allclose(read_trajectory("flat.g2o").poses, [[1, 2, math.pi], [4, 5, 0]])


@pytest.mark.usefixtures("trajectories")
def test_edges_that_are_lost_are_printed(capsys) -> None:
    graph = PoseGraph(
        ids=np.arange(3),
        poses=PATH.poses[:3],
        first=np.array([0, 1]),
        second=np.array([1, 2]),
        relative=np.ones((2, 3)),
        information=np.tile(np.eye(3), (2, 1, 1)),
        stamps=PATH.stamps[:3],
        fixed=np.array([0]),
    )
    write_g2o("graph.g2o", graph)
    told_of = "moteslam: warning: graph.g2o: 2 edges not written, no part of a trajectory\n"
    assert told(capsys, "convert", "graph.g2o", "a.tum") == told_of
    [issue] = shown(capsys, "convert", "graph.g2o", "b.g2o")["warnings"]
    assert (issue["code"], issue["count"]) == ("not-written", 2)
