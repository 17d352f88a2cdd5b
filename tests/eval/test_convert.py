"""``moteslam convert`` on recordings: every format into every other, parts of them, and nothing of a user's lost."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_lines import refused
from converted import WRITTEN, assert_held, name_of, to, with_every_stream

from moteslam.eval.cli import main
from moteslam.robot.formats import open_recording, write_recording
from moteslam.robot.recording import Recording


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


@pytest.mark.parametrize("target", WRITTEN)
@pytest.mark.parametrize("source", WRITTEN)
def test_every_format_becomes_every_other(source: str, target: str, drives: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / name_of(target)
    assert convert(drives[source], out, *to(target)) == 0
    assert_held(target, open_recording(drives[source]), open_recording(out))


def test_what_is_lost_is_printed_and_in_the_json(drives: dict[str, Path], tmp_path: Path, capsys) -> None:
    assert convert(drives["csv"], tmp_path / "a.log", "--every", "10") == 0
    out, err = capsys.readouterr()
    assert err.count("\n") == 2
    assert "room: 40 encoder readings not written, no place in a CARMEN log" in err
    assert "IMU readings not written, no place in a CARMEN log" in err
    assert f"wrote {tmp_path / 'a.log'}, carmen\n" in out
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
    assert convert(simulated_folder, tmp_path / "a.bag", "--end", "1") == 0
    assert f"moteslam evaluate TRAJECTORY {truth}" in capsys.readouterr().out
    assert convert(simulated_folder, tmp_path / "b.bag", "--end", "1", "--json") == 0
    assert json.loads(capsys.readouterr().out)["truth"] == str(truth)
    assert truth.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.bag", "b.bag"]


def test_a_topic_of_a_bag(drives: dict[str, Path], tmp_path: Path, capsys) -> None:
    assert convert(drives["bag"], tmp_path / "a.toml", "--topics", "lidar=/scan") == 0
    assert "/none" in refused(capsys, "convert", drives["bag"], tmp_path / "b.toml", "--topics", "lidar=/none")


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
