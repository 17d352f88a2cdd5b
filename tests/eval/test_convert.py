"""``moteslam convert``: every format of recordings and trajectories into every other; nothing of a user is lost."""

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from command_lines import printed, refused, shown, told
from converted import WRITTEN, assert_held, name_of, to, with_every_stream

from moteslam.eval.cli import main
from moteslam.robot.formats import open_recording, write_recording
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories import WRITERS, read_trajectory, write_trajectory
from moteslam.robot.trajectories.text import write_g2o
from moteslam.robot.trajectory import PoseGraph, Trajectory


@pytest.fixture(scope="session")
def drive(simulation) -> Recording:
    """A second of a drive: lidar, encoders, odometry and IMU."""
    return with_every_stream(simulation.recording)


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


def test_replay_takes_the_same_part_and_records_it(drives: dict[str, Path], tmp_path: Path, capsys) -> None:
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
