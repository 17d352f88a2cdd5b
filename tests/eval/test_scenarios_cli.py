"""Scenarios on the command line: listed, drawn, filmed, simulated by the dozen."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from command_lines import refused

from moteslam.errors import OutputError
from moteslam.eval.cli.main import run
from moteslam.eval.report import film as video
from moteslam.eval.report.film import Pace, film, write_film
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate


def test_an_mp4_that_no_browser_would_play_is_refused_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "CODECS", dict.fromkeys(("none",), "H.264, VP9, AV1"))
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
    from moteslam.slam.online import OnlineSlam
    from moteslam.slam.settings import resolve_config

    simulation = simulate(load_scenario(scenario_file).model_copy(update={"duration": 14.0}))
    session = OnlineSlam.over(simulation.recording, resolve_config("paper", ["particles=5"]))
    assert simulation.recording.lidar is not None
    pace = Pace(1.0, 4.0)
    shown = [frame for _, frames in film(simulation, session, pace) for frame in frames]
    assert len(shown) == len(pace.moments(simulation.recording.lidar.stamps)) >= 4
    (height, width, _), *others = {frame.shape for frame in shown}
    assert not others
    assert width <= 1000
    assert height <= 660
    assert (shown[0] != shown[-1]).any()
    white = [(frame > 250).all(axis=2).mean() for frame in shown]
    assert white[-1] > white[0] - 0.05


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
def test_the_workers_of_a_batch_that_is_killed_end_with_it(tmp_path: Path) -> None:
    arguments = ("simulate", "campus", "--out", "many", "--batch", "50", "--jobs", "2")
    with subprocess.Popen([sys.executable, "-m", "moteslam", *arguments], cwd=tmp_path) as batch:
        children = Path(f"/proc/{batch.pid}/task/{batch.pid}/children")
        until(lambda: len(children.read_text().split()) == 2)
        both = [Path(f"/proc/{child}/cmdline") for child in children.read_text().split()]
        time.sleep(3)  # they simulate
        batch.kill()
        until(lambda: not any(worker.exists() and worker.read_bytes() for worker in both))  # empty of one that ended
    assert not list(tmp_path.rglob("truth.tum"))


def until(done: Callable[[], bool]) -> None:
    """Wait, for two minutes at most."""
    deadline = time.monotonic() + 120
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.05)
