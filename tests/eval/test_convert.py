"""``moteslam convert`` on recordings: every format into every other, parts of them, and nothing of a user's lost."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_lines import refused
from converted import WRITTEN, assert_held, name_of, to, with_every_stream

from moteslam.errors import ExistsError
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


def test_a_log_of_wheels_is_given_their_odometry(drives: dict[str, Path], tmp_path: Path, capsys) -> None:
    assert convert(drives["ucsd"], tmp_path / "a.log") == 0
    assert "40 odometry poses computed of the wheels and written" in capsys.readouterr().err
    back, original = open_recording(tmp_path / "a.log"), open_recording(drives["csv"])
    assert back.odometry is not None
    assert original.odometry is not None
    np.testing.assert_array_equal(back.odometry.poses, original.odometry.poses)


def test_a_truth_stays_where_it_is_and_is_named(simulated_folder: Path, tmp_path: Path, capsys) -> None:
    truth = simulated_folder / "truth.tum"
    before = truth.read_bytes()
    assert convert(simulated_folder, tmp_path / "a.bag", "--end", "1") == 0
    assert f"moteslam evaluate TRAJECTORY {truth}" in capsys.readouterr().out
    assert convert(simulated_folder, tmp_path / "b.bag", "--end", "1", "--json") == 0
    assert json.loads(capsys.readouterr().out)["truth"] == str(truth)
    assert truth.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.bag", "b.bag"]


def test_a_part_of_it(drives: dict[str, Path], drive: Recording, tmp_path: Path) -> None:
    part = ("--start", "0.2", "--end", "0.8", "--every", "3", "--streams", "lidar, odometry")
    assert convert(drives["bag"], tmp_path / "a.toml", *part) == 0
    back = open_recording(tmp_path / "a.toml")
    assert drive.lidar is not None
    assert drive.encoders is not None
    assert back.lidar is not None
    first = min(drive.lidar.stamps[0], drive.encoders.stamps[0], drive.imu.stamps[0] if drive.imu else np.inf)
    inside = (drive.lidar.stamps >= first + 0.2) & (drive.lidar.stamps <= first + 0.8)
    np.testing.assert_array_equal(back.lidar.stamps, drive.lidar.stamps[inside][::3])
    assert back.odometry is not None
    assert (back.encoders, back.imu) == (None, None)


def test_a_topic_of_a_bag(drives: dict[str, Path], tmp_path: Path, capsys) -> None:
    assert convert(drives["bag"], tmp_path / "a.toml", "--topics", "lidar=/scan") == 0
    said = refused(capsys_emptied(capsys), "convert", drives["bag"], tmp_path / "b.toml", "--topics", "lidar=/none")
    assert "/none" in said


def capsys_emptied(capsys: pytest.CaptureFixture[str]) -> pytest.CaptureFixture[str]:
    capsys.readouterr()
    return capsys


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ("a.log --start -1", "--start: -1 s, expected a finite time of at least 0"),
        ("a.log --start 5 --end 4", "--end: 4 s, expected more than start, 5 s"),
        ("a.log --start 60", "no reading from 60 to inf s, expected times within its "),
        ("a.log --every 0", "--every: 0, expected at least 1"),
        ("a.log --streams laser", "--streams: 'laser', expected some of lidar, encoders, odometry, imu, rgbd"),
        ("a.log --streams rgbd", "no rgbd, expected one of the streams it has: lidar, encoders"),
        ("a.log --streams imu", "no odometry poses, expected them for a CARMEN log"),
        ("a.log --topics lidar", "--topics: 'lidar', expected STREAM=TOPIC with a stream of lidar, odometry, "),
        ("a.log --topics lidar=/a --topics lidar=/b", "--topics: lidar twice, expected lidars to merge as "),
        ("a.log --topics lidar=/scan", "has no topics, expected none to be named"),
        ("a.log --sequence 7", "sequence"),
        ("a.xyz", "--to: 'a.xyz' has the ending of no format, expected one of .log, .log.gz, .clf, "),
        ("a.log --to nothing", "--to: 'nothing', expected one of ucsd, carmen, csv, bag, rosbag2, mcap"),
        ("a.log --to db3", "--to: 'db3' is only read, expected one of ucsd, carmen, csv, bag, rosbag2, mcap"),
        ("a.csv --to csv", "a.csv: expected a name that ends in .toml"),
    ],
)
def test_what_is_refused(
    options: str, line: str, drives: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    assert line in refused(capsys, "convert", drives["ucsd"], *options.split())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("form", ["ucsd", "csv"])
def test_an_out_that_exists_is_left_as_it_is_without_force(
    form: str, drives: dict[str, Path], tmp_path: Path, capsys
) -> None:
    out = tmp_path / name_of(form)
    assert convert(drives["csv"], out, *to(form)) == 0
    before = files_in(tmp_path)
    capsys.readouterr()
    said = refused(capsys, "convert", drives["csv"], out, *to(form), "--end", "0.5")
    assert f"{out}: exists already; name a new " in said
    assert "--force" in said
    assert files_in(tmp_path) == before
    assert convert(drives["csv"], out, *to(form), "--end", "0.5", "--force") == 0
    assert files_in(tmp_path).keys() == before.keys()
    assert files_in(tmp_path) != before
    lidar = open_recording(out).lidar
    assert lidar is not None
    assert lidar.stamps[-1] - lidar.stamps[0] < 0.5


@pytest.mark.parametrize("force", [False, True])
def test_a_csv_file_of_somebody_else_is_not_replaced(
    force: bool, drives: dict[str, Path], tmp_path: Path, capsys
) -> None:
    """``walk.toml`` is new; ``walk-imu.csv``, beside which it would lie, is a user's."""
    (tmp_path / "walk-imu.csv").write_text("mine")
    options = ["--force"] if force else []
    said = refused(capsys, "convert", drives["bag"], tmp_path / "walk.toml", *options)
    assert f"{tmp_path / 'walk-imu.csv'}: exists already; name a new file" in said
    assert files_in(tmp_path) == {"walk-imu.csv": b"mine"}


@pytest.mark.parametrize("form", ["ucsd", "csv"])
def test_the_input_is_never_replaced(form: str, drives: dict[str, Path], capsys) -> None:
    before = files_in(drives[form].parent)
    said = refused(capsys, "convert", drives[form], drives[form], *to(form), "--force")
    assert "the input" in said
    assert files_in(drives[form].parent) == before


def test_a_folder_around_the_input_and_one_of_others_are_not_replaced(
    drives: dict[str, Path], tmp_path: Path, capsys
) -> None:
    folder = tmp_path / "mine"
    assert convert(drives["bag"], folder / "a.bag") == 0
    before = files_in(tmp_path)
    capsys.readouterr()
    said = refused(capsys, "convert", folder / "a.bag", folder, "--to", "ucsd", "--force")
    assert "holds the input, which would be deleted" in said
    said = refused(capsys, "convert", drives["bag"], folder, "--to", "ucsd", "--force")
    assert "holds a.bag, which moteslam did not write" in said
    said = refused(capsys, "convert", drives["bag"], folder, "--to", "carmen", "--force")
    assert "is a folder, expected a file" in said
    assert files_in(tmp_path) == before


BREAKS = {
    "ucsd": "moteslam.robot.formats.ucsd._compact",
    "csv": "moteslam.robot.formats.written.platform_table",
    "mcap": "moteslam.robot.formats.bags.write.write_events",
}
"""What is called in the midst of writing; of a UCSD folder and CSV files after some of them are there."""


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("form", BREAKS)
def test_a_write_that_fails_midway_leaves_nothing(
    form: str, existing: bool, drives: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    out = tmp_path / "new" / name_of(form)
    if existing:
        assert convert(drives["csv"], out, *to(form)) == 0
        capsys.readouterr()
    before = files_in(tmp_path)

    def fail(*_arguments: object, **_options: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(BREAKS[form], fail)
    said = refused(capsys, "convert", drives["csv"], out, *to(form), *["--force"] * existing)
    assert "No space left on device" in said
    assert str(out) in said
    assert files_in(tmp_path) == before
    assert (tmp_path / "new").exists() == existing


def test_replay_takes_the_same_part_and_records_it(drives: dict[str, Path], tmp_path: Path, capsys) -> None:
    part = ["--start", "0.1", "--end", "0.9", "--every", "2", "--streams", "lidar,odometry"]
    options = ["--topics", "lidar=/scan", "--no-figures", "--set", "particles=5", "--out", str(tmp_path / "result")]
    assert main.run(["replay", str(drives["bag"]), *part, *options]) == 0
    about = json.loads((tmp_path / "result" / "run.json").read_text())
    assert (about["start"], about["end"], about["every"]) == (0.1, 0.9, 2)
    assert (about["streams"], about["topics"]) == ("lidar,odometry", ["lidar=/scan"])
    rows = (tmp_path / "result" / "trajectory.tum").read_text().splitlines()
    assert 10 < len([row for row in rows if not row.startswith("#")]) < 20
    capsys.readouterr()
    said = refused(capsys, "replay", drives["bag"], "--out", tmp_path / "other", "--every", "0")
    assert "--every: 0, expected at least 1" in said
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("form", ["ucsd", "rosbag2"])
def test_from_python_a_folder_with_something_in_it_is_not(form: str, drive: Recording, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    write_recording(tmp_path / "empty", drive, to=form)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("mine")
    for folder in ("mine", "empty"):
        before = files_in(tmp_path)
        with pytest.raises(ExistsError, match=r"exists already"):
            write_recording(tmp_path / folder, drive, to=form)
        assert files_in(tmp_path) == before
