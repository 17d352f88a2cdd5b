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
from command_lines import printed, refused, shown
from figures import legend_of
from matplotlib.figure import Figure
from PIL import Image

from moteslam.errors import ConfigError, OutputError
from moteslam.eval.cli.main import run
from moteslam.eval.report import film as video
from moteslam.eval.report.film import CODECS, MAX_FRAMES, Pace, check_film, film, write_film
from moteslam.eval.report.scenarios import draw_scenario
from moteslam.robot.formats import open_recording
from moteslam.robot.platforms import bundled_platform, bundled_platforms, load_platform
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories.text import read_tum
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate


def test_free_space_is_white_and_the_rest_grey(tmp_path: Path, drawn: list[Figure]) -> None:
    scenario = load_scenario("loop")
    draw_scenario(tmp_path / "x.png", scenario)
    (axes,) = drawn[0].axes
    (picture,) = axes.images
    left, right, bottom, top = picture.get_extent()
    rest = ~np.ma.getmaskarray(picture.get_array())

    def grey_at(x: float, y: float) -> bool:
        rows, columns = rest.shape
        return bool(rest[int((y - bottom) / (top - bottom) * rows), int((x - left) / (right - left) * columns)])

    assert not grey_at(*scenario.start[:2])
    assert not grey_at(11.0, 17.0)  # a room behind an open door, at the top
    assert grey_at(11.0, 7.0)  # inside the loop


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


def test_an_mp4_is_one_that_browsers_play(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
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


def test_a_film_of_another_kind_is_refused(tmp_path: Path) -> None:
    for name in ("x.avi", "x", "x.png"):
        with pytest.raises(OutputError, match=r"x.*: expected a name"):
            write_film(tmp_path / name, FRAMES)


def test_moments_are_even_and_the_last_is_the_end() -> None:
    stamps = 100.0 + np.arange(101) / 10
    moments = Pace(fps=5.0, speed=2.0).moments(stamps)
    np.testing.assert_array_equal(np.diff(moments[:-1]), np.full(24, 4))
    assert (moments[0], moments[-1]) == (0, 100)
    slow = Pace(fps=50.0, speed=1.0).moments(stamps)
    assert set(np.bincount(slow)[:-1]) <= {4, 5, 6}  # stamps are no exact tenths
    np.testing.assert_array_equal(Pace(15.0, 1.0).moments(stamps[:1]), [0])


def test_a_speed_is_chosen_for_a_short_film() -> None:
    assert [Pace.of(duration).speed for duration in (3.0, 15.0, 16.0, 75.0, 100.0, 600.0)] == [1, 1, 2, 5, 10, 50]
    assert str(Pace.of(75.0)) == "5 × real time, 15 frames/s"
    with pytest.raises(ConfigError, match=f"at most {MAX_FRAMES} frames") as caught:
        Pace.of(600.0, speed=1.0)
    assert caught.value.field == "speed"


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
    pace = Pace(1.0, 4.0)
    shown = list(film(simulation, session, pace))
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
    assert np.isnan(changed.lidar.ranges).mean() == pytest.approx(0.5, abs=0.02)
    based = ("--set", "platform.base=turtlebot3", "--set", "platform.lidar.rate=4.0")
    assert simulated(scenario_file, tmp_path / "based", *based).platform.lidar == filed.platform.lidar


def test_a_drive_is_ended_after_so_many_seconds(scenario_file: Path, tmp_path: Path) -> None:
    short = simulated(scenario_file, tmp_path / "short", "--duration", 4.0)
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
    assert recording.lidar.odometry is not None
    assert recording.lidar.ranges.shape[1] == 181
    capsys.readouterr()
    replay = ("replay", str(out / "room.log.gz"), "--platform", str(out / "platform.toml"), "--out")
    said = shown(capsys, *replay, tmp_path / "result", "--dead-reckoning")
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
    assert shown(capsys, "platforms", file) == tomllib.loads(file.read_text())


def test_platforms_lists_all(capsys) -> None:
    assert [line.split()[0] for line in printed(capsys, "platforms").splitlines()[1:]] == sorted(bundled_platforms())
    assert shown(capsys, "platforms")["urg04lx"]["beams"] == 682
