"""Scenarios on the command line: listed, drawn, filmed, simulated by the dozen."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_lines import refused

from moteslam.errors import OutputError
from moteslam.eval.cli.main import run
from moteslam.eval.report import video
from moteslam.eval.report.animation import Film
from moteslam.eval.report.pace import Pace
from moteslam.eval.report.scenarios import draw_scenario
from moteslam.eval.report.video import write_film
from moteslam.robot.formats.ucsd import read_ucsd
from moteslam.robot.trajectories.text import read_tum
from moteslam.sim.scenario import bundled_scenarios, load_scenario
from moteslam.sim.simulate import simulate


def test_each_is_listed_with_why_it_is_hard(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["scenarios"]) == 0
    out = capsys.readouterr().out
    for name, why in bundled_scenarios().items():
        assert name in out
        assert why in out
    assert "random-corridors" in out


@pytest.mark.parametrize("name", ["lab", "doors", "random-corridors"])
def test_show_draws_a_picture(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["scenarios", "show", name, "--out", str(tmp_path / "x.png")]) == 0
    assert name in capsys.readouterr().out
    picture = cv2.imread(str(tmp_path / "x.png"))
    assert picture is not None
    assert min(picture.shape[:2]) > 300
    dark = (picture < 100).all(axis=2).mean()
    assert 0.001 < dark < 0.3


def test_walls_are_drawn_to_scale(tmp_path: Path) -> None:
    draw_scenario(tmp_path / "x.png", load_scenario("hall"))
    picture = cv2.imread(str(tmp_path / "x.png"))
    assert picture is not None
    dark = (picture < 100).all(axis=2)
    rows = np.flatnonzero(dark.mean(axis=1) > 0.5)  # the hall's two long walls, and the axis below them
    below = rows[rows > rows[0] + 5][0]
    assert dark[rows[0]].sum() / (below - rows[0]) == pytest.approx(110 / 6, rel=0.1)


def test_show_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "there.png").touch()
    assert "exists already" in refused(capsys, "scenarios", "show", "lab", "--out", tmp_path / "there.png")
    assert "expected one to write" in refused(capsys, "scenarios", "show", "lab", "--out", tmp_path / "x.jpg")
    assert "no scenario of this name" in refused(capsys, "scenarios", "show", "lap", "--out", tmp_path / "x.png")
    (tmp_path / "file").touch()
    for what, name in (("show", "x.png"), ("animate", "x.gif")):
        line = refused(capsys, "scenarios", what, "hall", "--out", tmp_path / "file" / "no" / name)
        assert "cannot be made" in line
    assert "expected one to write" in refused(capsys, "scenarios", "animate", "lab", "--out", tmp_path / "x.avi")


@pytest.mark.parametrize(
    ("option", "value", "line"),
    [
        ("--fps", "0", "--fps: 0, expected 1 to 50 frames a second"),
        ("--fps", "51", "--fps: 51, expected 1 to 50 frames a second"),
        ("--fps", "nan", "--fps: nan, expected 1 to 50 frames a second"),
        ("--speed", "-1", "--speed: -1, expected 0.1 to 10000 times real time"),
        ("--speed", "inf", "--speed: inf, expected 0.1 to 10000 times real time"),
        ("--speed", "fast", "a number"),
    ],
)
def test_a_pace_that_cannot_be_is_refused(
    option: str, value: str, line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert line in refused(capsys, "scenarios", "animate", "hall", "--out", tmp_path / "x.gif", option, value)
    assert not list(tmp_path.iterdir())


def test_an_mp4_that_no_browser_would_play_is_refused_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "video_codec", lambda: None)
    line = refused(capsys, "scenarios", "animate", "hall", "--out", tmp_path / "x.mp4")
    assert "no encoder that browsers play (H.264, VP9, AV1), expected .webp or .gif" in line
    with pytest.raises(OutputError, match=r"expected \.webp or \.gif"):
        write_film(tmp_path / "x.mp4", iter([]))


@pytest.mark.usefixtures("taichi")
def test_folders_above_a_picture_or_film_are_made(scenario_file: Path, tmp_path: Path) -> None:
    picture, film = tmp_path / "a" / "b" / "x.png", tmp_path / "c" / "d" / "x.gif"
    assert run(["scenarios", "show", str(scenario_file), "--out", str(picture)]) == 0
    film_it = ["--duration", "12", "--speed", "12", "--fps", "1", "--preset", "paper", "--set", "particles=5"]
    assert run(["scenarios", "animate", str(scenario_file), "--out", str(film), *film_it]) == 0
    assert picture.stat().st_size > 0
    assert film.stat().st_size > 0


@pytest.mark.usefixtures("taichi")
def test_a_film_shows_the_run(scenario_file: Path) -> None:
    from moteslam.slam.run import SlamSession
    from moteslam.slam.settings import resolve_config

    simulation = simulate(load_scenario(scenario_file).model_copy(update={"duration": 14.0}))
    session = SlamSession(simulation.recording, resolve_config("paper", ["particles=5"]))
    assert simulation.recording.lidar is not None
    pace = Pace(1.0, 4.0)
    shown = [frame for _, frames in Film(simulation, session, pace).play() for frame in frames]
    assert len(shown) == len(pace.moments(simulation.recording.lidar.stamps)) >= 4
    (height, width, _), *others = {frame.shape for frame in shown}
    assert not others
    assert width <= 1000
    assert height <= 660
    assert (shown[0] != shown[-1]).any()
    white = [(frame > 250).all(axis=2).mean() for frame in shown]
    assert white[-1] > white[0] - 0.05


def test_absurd_cells_of_the_true_map_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "simulate", "hall", "--true-map", "1e-9", "--out", tmp_path / "x")
    assert "--true-map" in line
    assert not (tmp_path / "x").exists()


@pytest.mark.slow
def test_a_batch_is_what_its_parts_are(program, scenario_file: Path, tmp_path: Path) -> None:
    arguments = ("--batch", 2, "--seed", 5, "--jobs", 2, "--true-map", 0.1, "--json")
    done = program("simulate", scenario_file, "--out", "many", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["simulations"]
    assert [one["seed"] for one in found] == [5, 6]
    alone = program("simulate", scenario_file, "--out", "one", "--seed", 6, cwd=tmp_path)
    assert alone.returncode == 0, alone.stderr
    first, second = read_ucsd(tmp_path / "many" / "room-6"), read_ucsd(tmp_path / "one")
    assert first.lidar is not None
    assert second.lidar is not None
    assert first.lidar.ranges.tobytes() == second.lidar.ranges.tobytes()
    truths = [read_tum(tmp_path / "many" / name / "truth.tum").poses for name in ("room-5", "room-6")]
    assert truths[0].tobytes() != truths[1].tobytes()
    assert (tmp_path / "many" / "room-5" / "truth_map.yaml").exists()


@pytest.mark.slow
def test_a_batch_that_fails_leaves_nothing(program, scenario_file: Path, tmp_path: Path) -> None:
    crowded = tmp_path / "crowded.toml"
    crowded.write_text(scenario_file.read_text() + "\n[crowd]\ncount = 60\n")
    done = program("simulate", crowded, "--out", "many", "--batch", 2, cwd=tmp_path)
    assert done.returncode == 2
    assert "crowd.count" in done.stderr
    assert "seed 0" in done.stderr or "seed 1" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "many").exists()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="children of a process as Linux lists them")
@pytest.mark.parametrize("killed", ["parent", "worker"])
def test_a_batch_of_which_a_process_is_killed_ends(killed: str, tmp_path: Path) -> None:
    """Its workers end with it, in the middle of their work; a worker that is killed ends it with a line."""
    arguments = ("simulate", "campus", "--out", "many", "--batch", "50", "--jobs", "2")
    command = [sys.executable, "-m", "moteslam", *arguments]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as batch:
        until(lambda: len(workers(batch.pid)) == 2 and min(map(seconds, workers(batch.pid))) > 2)
        both = workers(batch.pid)
        if killed == "parent":
            batch.kill()
        else:
            os.kill(both[0], signal.SIGKILL)
            _, said = batch.communicate(timeout=120)
            assert batch.returncode == 2
            assert "its process was killed" in said
            assert len(said.splitlines()) == 1
            assert not list(tmp_path.iterdir())
        until(lambda: all(seconds(worker) == 0 for worker in both))
        assert not list(tmp_path.rglob("truth.tum"))


def until(done: Callable[[], bool]) -> None:
    """Wait, for two minutes at most."""
    deadline = time.monotonic() + 120
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def workers(parent: int) -> list[int]:
    """The processes that a batch simulates in."""
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return [int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


def seconds(process: int) -> float:
    """What it has computed [s of a processor]; 0 once it has ended, whether or not anybody has waited for it."""
    try:
        state, *fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return 0.0 if state == "Z" else (int(fields[10]) + int(fields[11])) / os.sysconf("SC_CLK_TCK")
