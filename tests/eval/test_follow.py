"""``moteslam follow`` as a user meets it: a log that another program writes meanwhile."""

from __future__ import annotations

import gzip
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from growing_files import repacked
from slam_rooms import circled_room

from moteslam.errors import InputError
from moteslam.eval.cli.main import run as run_program
from moteslam.eval.live import without_late_scans
from moteslam.robot.formats import write_recording
from moteslam.robot.recording import OdometryStream, Recording
from moteslam.robot.trajectories.tum import read_tum

SCANS = 12
OPTIONS = ("--particles", "2", "--seed", "5", "--no-figures")


@pytest.fixture(scope="module")
def recording() -> Recording:
    """A few scans, and the odometry at and after each."""
    room = circled_room(scans=SCANS)[0]
    assert room.lidar is not None
    assert room.lidar.odometry is not None
    stamps = np.append(room.lidar.stamps, room.lidar.stamps[-1] + 0.05)
    poses = np.vstack((room.lidar.odometry, room.lidar.odometry[-1:]))
    return room.replace(lidar=replace(room.lidar, odometry=None), odometry=OdometryStream(stamps, poses))


@pytest.fixture(scope="module")
def contents(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of the recording as a log and as an MCAP file, by ending."""
    folder = tmp_path_factory.mktemp("finished")
    write_recording(folder / "a.log", recording)
    write_recording(folder / "a.mcap", recording)
    return {"log": (folder / "a.log").read_bytes(), "mcap": repacked((folder / "a.mcap").read_bytes(), 3)}


@contextmanager
def following(path: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """``moteslam follow`` in a process of its own."""
    process = subprocess.Popen(
        [sys.executable, "-m", "moteslam", "follow", str(path), *OPTIONS, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "COLUMNS": "100"},
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def write_slowly(path: Path, content: bytes, parts: int = 40) -> None:
    """Write in pieces of one size, wherever they end."""
    size = len(content) // parts + 1
    with path.open("wb") as file:
        for first in range(0, len(content), size):
            file.write(content[first : first + size])
            file.flush()
            time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["log", "mcap"])
def test_the_result_is_that_of_replay(tmp_path: Path, contents: dict[str, bytes], ending: str, program) -> None:
    path = tmp_path / f"robot.{ending}"
    with following(path, "--idle", "3", "--json", "--out", str(tmp_path / "followed")) as process:
        time.sleep(0.5)  # the file is not there yet
        write_slowly(path, contents[ending])
        out, problems = process.communicate(timeout=120)
    assert process.returncode == 0, problems
    done = program("replay", path, *OPTIONS, "--out", tmp_path / "replayed", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for name in ("trajectory.tum", "trajectory_final.tum", "map.pgm"):
        assert (tmp_path / "followed" / name).read_bytes() == (tmp_path / "replayed" / name).read_bytes()
    scans = [json.loads(line) for line in out.splitlines()]
    assert [scan["stamp"] for scan in scans] == pytest.approx(np.arange(SCANS) * 0.1)
    assert all(scan["latency_ms"] > 0 for scan in scans)
    assert scans[-1].keys() == {"stamp", "x_m", "y_m", "heading_deg", "state", "latency_ms"}
    about = json.loads((tmp_path / "followed" / "run.json").read_text())
    assert about["latency_seconds"]["longest"] == pytest.approx(max(scan["latency_ms"] for scan in scans) / 1000)


@pytest.mark.slow
@pytest.mark.usefixtures("signals_are_heard")
@pytest.mark.skipif(os.name == "nt", reason="no SIGINT to another process")
def test_an_interrupt_ends_it_with_the_result(tmp_path: Path, contents: dict[str, bytes]) -> None:
    path = tmp_path / "robot.log"
    path.write_bytes(contents["log"])
    with following(path, "--idle", "1000", "--out", str(tmp_path / "followed")) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(SCANS - 1)]
        process.send_signal(signal.SIGINT)
        out, problems = process.communicate(timeout=120)
    assert process.returncode == 0, problems
    assert lines[0].split()[:2] == ["stamp", "[s]"]
    assert f"{SCANS} scans, latency " in out
    assert len(read_tum(tmp_path / "followed" / "trajectory.tum")) == SCANS


@pytest.mark.slow
def test_a_file_whose_first_chunk_is_written_slowly_is_waited_for(tmp_path: Path, contents: dict[str, bytes]) -> None:
    path, content = tmp_path / "robot.mcap", contents["mcap"]
    path.write_bytes(content[:200])
    with following(path, "--idle", "2") as process:
        assert process.stdout is not None
        process.stdout.readline()  # it has begun
        with path.open("ab") as file:
            for end in range(400, 1800, 200):  # within the first chunk, over longer than --idle
                time.sleep(0.6)
                file.write(content[end - 200 : end])
                file.flush()
            file.write(content[1600:])
        out, problems = process.communicate(timeout=120)
    assert process.returncode == 0, problems
    assert f"{SCANS} scans, latency " in out


@pytest.mark.slow
def test_without_a_folder_the_poses_alone_are_printed(tmp_path: Path, contents: dict[str, bytes]) -> None:
    path = tmp_path / "robot.log"
    path.write_bytes(contents["log"])
    with following(path, "--idle", "0.2") as process:
        out, problems = process.communicate(timeout=120)
    assert process.returncode == 0, problems
    head, *scans, summary = out.splitlines()
    assert head.endswith("latency [ms]")
    assert len(scans) == SCANS
    assert summary.startswith(f"{SCANS} scans, latency ")
    assert [file.name for file in tmp_path.iterdir()] == ["robot.log"]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "robot.log: No such file or directory, expected a recording"),
        (b"", "robot.log: is empty, expected a recording"),
        (b"# a head alone\n", "robot.log: not a recording known here, expected a "),
        (
            gzip.compress(b"ODOM 1 2 3 0 0 0 1 host 1\n"),
            "robot.log: packed by gzip, which cannot be read while it is written; expected a plain CARMEN log",
        ),
        (b"#ROSBAG V2.0\n", "robot.log: ROS 1 bag, expected what can be read while it is written: CARMEN log"),
        (b"ODOM 1 2 3 0 0 0 1 host 1\n", "robot: lidar: no lidar scans, expected at least one"),
    ],
    ids=["none", "empty", "head", "gzip", "bag", "no scans"],
)
def test_what_cannot_be_followed_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None, problem: str, taichi: None
) -> None:
    path = tmp_path / "robot.log"
    if content is not None:
        path.write_bytes(content)
    assert run_program(["follow", str(path), "--idle", "0.1", "--json", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert problem in said.err
    assert said.err.count("\n") == 1
    assert "Traceback" not in said.err
    assert not (tmp_path / "out").exists()


def test_a_folder_of_arrays_is_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], simulated_folder: Path
) -> None:
    assert run_program(["follow", str(simulated_folder), "--idle", "1000"]) == 2
    assert "expected what can be read while it is written: CARMEN log" in capsys.readouterr().err


def test_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_program(["follow", "--help"]) == 0
    said = capsys.readouterr().out
    assert "moteslam follow robot.log --json | my-navigation" in said
    assert "--idle" in said


def test_scans_that_come_late_are_left_out(recording: Recording) -> None:
    lidar = recording.lidar
    assert lidar is not None
    taken = np.array([0.0, 0.2, 0.2, 0.5])
    stamps = np.array([0.0, 0.1, 0.2, 0.2, 0.2, 0.4, 0.5, 0.5, 0.6, 0.7, 0.8, 0.9])
    grown, late = without_late_scans(recording.replace(lidar=replace(lidar, stamps=stamps)), taken)
    assert grown.lidar is not None
    assert late == 3
    np.testing.assert_array_equal(grown.lidar.stamps, [0.0, 0.2, 0.2, 0.5, 0.5, 0.6, 0.7, 0.8, 0.9])
    np.testing.assert_array_equal(grown.lidar.ranges, np.asarray(lidar.ranges)[[0, 2, 3, 6, 7, 8, 9, 10, 11]])


def test_scans_that_are_no_longer_there_are_refused(recording: Recording) -> None:
    with pytest.raises(InputError, match=r"room: lidar: the stamps of 2 scans changed after they were taken in"):
        without_late_scans(recording, np.array([0.0, 0.15]))
