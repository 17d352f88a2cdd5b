"""Scenarios: pictures and films of them, and what simulate records, alone and by the dozen."""

import json
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_lines import Capsys, printed, program, refused, shown
from figures import legend_of
from matplotlib.figure import Figure
from PIL import Image
from refusals import refusal

from moteslam.errors import ConfigError, OutputError
from moteslam.eval.cli.main import run
from moteslam.eval.report import film as video
from moteslam.eval.report.film import CODECS, MAX_FRAMES, Pace, check_film, write_film
from moteslam.eval.report.scenarios import draw_scenario
from moteslam.robot.formats import open_recording
from moteslam.robot.platforms import bundled_platform, bundled_platforms, load_platform
from moteslam.sim.scenario import load_scenario

SHADES = (20, 120, 240)
FRAMES = [np.full((61, 81, 3), (shade, shade, 40), np.uint8) for shade in SHADES]


@pytest.mark.parametrize("kind", [".gif", ".webp"])
def test_pictures_that_move_hold_their_frames(kind: str, tmp_path: Path) -> None:
    write_film(tmp_path / f"x{kind}", iter(FRAMES), fps=15.0)
    with Image.open(tmp_path / f"x{kind}") as film:
        assert film.n_frames == len(FRAMES)
        assert film.size == (81, 61)
        assert film.info["loop"] == 0
        for i, shade in enumerate(SHADES):
            film.seek(i)
            np.testing.assert_allclose(np.array(film.convert("RGB")).mean(axis=(0, 1)), (shade, shade, 40), atol=20)


def test_an_mp4_is_one_that_browsers_play(tmp_path: Path, capfd: Capsys) -> None:
    try:
        check_film("x.mp4")
    except OutputError:
        pytest.skip("no encoder in this build of OpenCV")
    write_film(tmp_path / "x.mp4", FRAMES, fps=12.5)
    film = cv2.VideoCapture(str(tmp_path / "x.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == 12.5
    found = []
    while (read := film.read())[0]:
        found.append(read[1].mean(axis=(0, 1)))
        assert read[1].shape == (60, 80, 3)  # even
    np.testing.assert_allclose(found, [(40, shade, shade) for shade in SHADES], atol=20)
    content = (tmp_path / "x.mp4").read_bytes()
    assert content[4:8] == b"ftyp"
    assert any(codec.encode() in content for codec in CODECS)
    assert b"mp4v" not in content
    assert capfd.readouterr() == ("", "")


def test_a_speed_is_chosen_for_a_short_film() -> None:
    assert [Pace.of(duration).speed for duration in (3.0, 15.0, 16.0, 75.0, 100.0, 600.0)] == [1, 1, 2, 5, 10, 50]
    assert str(Pace.of(75.0)) == "5 × real time, 15 frames/s"
    with refusal(ConfigError, f"at most {MAX_FRAMES} frames", field="speed"):
        Pace.of(600.0, speed=1.0)


@pytest.mark.usefixtures("taichi")
def test_folders_above_a_picture_or_film_are_made(scenario_file: Path, tmp_path: Path) -> None:
    picture, film = tmp_path / "a" / "b" / "x.png", tmp_path / "c" / "d" / "x.gif"
    assert run(["scenarios", "show", str(scenario_file), "--out", str(picture)]) == 0
    film_it = ["--duration", "12", "--speed", "12", "--fps", "1", "--preset", "paper", "--set", "particles=5"]
    assert run(["scenarios", "animate", str(scenario_file), "--out", str(film), *film_it]) == 0
    assert picture.stat().st_size > 0
    assert film.stat().st_size > 0


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


CLASSIC = ("--platform", "lms200", "--format", "carmen")


@pytest.mark.slow
def test_a_batch_with_options_is_what_its_parts_are(scenario_file: Path, tmp_path: Path, capsys: Capsys) -> None:
    options = (*CLASSIC, "--log-every", 0.3, "--odometry-noise", 0.1, 0.1, "--set", "noise.lidar.dropout=0.1")
    batch = ("--batch", 2, "--seed", 5, "--jobs", 2, "--true-map", 0.1, "--json")
    done = program("simulate", scenario_file, "--out", "many", *options, *batch, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [one["seed"] for one in json.loads(done.stdout)["simulations"]] == [5, 6]
    printed(capsys, "simulate", scenario_file, "--out", tmp_path / "one", *options, "--seed", 6)
    log = tmp_path / "many" / "room-6" / "room.log.gz"
    assert log.read_bytes() == (tmp_path / "one" / "room.log.gz").read_bytes()
    assert (tmp_path / "many" / "room-5" / "room.log.gz").read_bytes() != log.read_bytes()
    assert log.with_name("truth_map.yaml").exists()
    assert np.isnan(open_recording(log).lidar.ranges).mean() == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize("name", bundled_platforms())
def test_what_platforms_prints_is_the_robot(name: str, tmp_path: Path, capsys) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(printed(capsys, "platforms", name))
    assert load_platform(file) == bundled_platform(name)
    assert shown(capsys, "platforms", file) == tomllib.loads(file.read_text())


def test_a_route_beyond_the_walls_is_in_the_picture(tmp_path: Path, drawn: list[Figure]) -> None:
    file = tmp_path / "open.toml"
    file.write_text("route.waypoints = [[1, 1], [8, 9]]\nworld.walls = [{ points = [[0, 0], [5, 0]] }]")
    draw_scenario(tmp_path / "a.png", load_scenario(file))
    (axes,) = drawn[0].axes
    assert axes.get_xlim()[1] > 8
    assert axes.get_ylim()[1] > 9


def test_the_legend_names_what_is_there(tmp_path: Path, drawn: list[Figure]) -> None:
    draw_scenario(tmp_path / "a.png", load_scenario("lab"))
    draw_scenario(tmp_path / "b.png", load_scenario("people"))
    draw_scenario(tmp_path / "c.png", load_scenario("doors"))
    lab, people, doors = map(legend_of, drawn)
    assert lab == [
        *("free space", "shelf (3)", "table (7)", "chair (8)", "box (6)", "wall", "black", "shiny"),
        *("start", "route, 80 m", "goal"),
    ]
    assert people[-2:] == ["person, there and back", "person, strolls about"]
    assert doors[-2:] == ["door, shut", "door, as it opens"]


def test_a_film_of_another_kind_is_refused(tmp_path: Path) -> None:
    for name in ("x.avi", "x", "x.png"):
        with pytest.raises(OutputError, match=r"x.*: expected a name"):
            write_film(tmp_path / name, FRAMES)


def test_an_mp4_that_no_browser_would_play_is_refused_before_the_run(
    tmp_path: Path, capsys: Capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "CODECS", dict.fromkeys(("none",), "H.264, VP9, AV1"))
    line = refused(capsys, "scenarios", "animate", "hall", "--out", tmp_path / "x.mp4")
    assert "no encoder that browsers play (H.264, VP9, AV1), expected .webp or .gif" in line
    with pytest.raises(OutputError, match=r"expected \.webp or \.gif"):
        write_film(tmp_path / "x.mp4", iter([]))


def test_a_random_building_of_the_demo_is_that_of_its_seed(taichi, tmp_path: Path, capsys) -> None:
    options = ("--duration", "12", "--set", "particles=2", "--no-figures", "--out", str(tmp_path / "out"))
    assert run(["demo", "--scenario", "random-corridors", "--seed", "3", *options]) == 0
    assert capsys.readouterr().out.startswith("random-corridors-3: ")


def test_platforms_lists_all(capsys) -> None:
    assert [line.split()[0] for line in printed(capsys, "platforms").splitlines()[1:]] == sorted(bundled_platforms())
    assert shown(capsys, "platforms")["urg04lx"]["beams"] == 682
