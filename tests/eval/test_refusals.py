"""Whatever is wrong: one line on stderr that names it, exit code 2, no traceback, nothing left behind."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_lines import printed, refused
from made_sweeps import swept

from moteslam.eval.cli import interrupt, main

TUM = "".join(f"{t} {t} 0 0 0 0 0 1\n" for t in range(10))
FAR_WALL = "[[world.walls]]\npoints = [[-90.0, -90.0], [-90.0, 90.0]]\n"
TRACKS = "EST... [REF]"

LINES = {
    "": [
        ("bogus", "No such command 'bogus'"),
        ("demo --set particles=0", "--set particles: "),
        ("replay", "PATH"),
        ("replay x --preset none", "--preset none: "),
        ("replay robot --every 0 --out x", "--every: 0, expected at least 1"),
    ],
    "simulate ": [
        ("random-corridors --out x --batch 2 --seed 9223372036854775807", "--seed: 9223372036854775807"),
        ("random-corridors-9223372036854775808 --out x", "no such building, expected a number up to"),
        ("wide.toml --true-map 0.001 --out x", "moteslam: --true-map: "),
        ("corridor --out robot", "robot: exists already; name a new folder, or replace it with --force\n"),
    ],
    "simulate room.toml --out new/and/x ": [
        ("--platform nobody", "--platform nobody: no robot of this name, expected one of lms200, rplidar_a1, "),
        ("--log-every nan", "--log-every: nan, expected a finite number above 0"),
        ("--odometry-noise 0.1 2", "--odometry-noise: 0.1 2, expected 0 to 1"),
    ],
    "scenarios ": [
        ("show lab --out there.png", "there.png: exists already"),
        ("show lab --out x.jpg", "x.jpg: expected a name"),
        ("animate lab --out x.gif --fps 51", "--fps: 51, expected"),
    ],
    "convert robot ": [
        ("a.log --start -1", "--start: -1 s, expected a finite time of at least 0"),
        ("a.log --streams laser", "--streams: 'laser', expected some of lidar, encoders, odometry, imu, rgbd"),
        ("a.log --topics lidar", "--topics: 'lidar', expected STREAM=TOPIC with a stream of lidar, odometry, "),
        ("a.log --topics lidar=/a --topics lidar=/b", "--topics: lidar twice, expected lidars to merge as "),
        ("a.log --topics lidar=/scan", "has no topics, expected no names of topics"),
        ("a.log --sequence 7", " (option --sequence)\n"),
        ("a.xyz", "--to: 'a.xyz' has the ending of no format, expected one of .log, .log.gz, .clf, "),
        ("a.log --to db3", "--to: 'db3' is only read, expected one of ucsd, carmen, csv, bag, rosbag2, mcap"),
    ],
    "convert ": [
        ("good.tum a.bag", "--to: good.tum is a trajectory: expected a name that ends in .csv, .g2o, .kitti, "),
        ("good.tum a.g2o --start 3", "--start: of a recording, expected none for a trajectory"),
    ],
    "evaluate good.tum ": [
        ("", f"'{TRACKS}': one file, expected trajectories and, last, their reference"),
        ("truth.tum --sequence 20", "'--sequence': given without a recording"),
        ("truth.tum --scale --no-align", "'--scale': given with --no-align"),
        ("truth.tum --map mine.yaml", "'--map': given without --true-map"),
        ("good.tum truth.tum --map a.yaml --true-map b.yaml", "'--map': given with several EST"),
        ("truth.tum --map a.yaml --true-map b.yaml", "a.yaml: "),
        ("truth.tum --metric nothing", "--metric: 'nothing'"),
        ("truth.tum --delta nan", "--delta: nan m"),
        ("truth.tum --out t.tex", "--out: "),
    ],
    "sweep ": [
        ("spec.toml --shard 3/2", "--shard: "),
        ("spec.toml --time --workers 2", "--time: "),
        ("spec.toml --scheduler tcp://127.0.0.1:9 --workers 2", "--workers: "),
        ("particle", "particle: no specification of this name, expected one of corridor-suite-1, "),
        ("show spec.toml", "spec.toml: is a specification, expected the file that"),
        ("show truth.tum", "truth.tum: no file of a sweep"),
        ("show a.sweep --metric nees", "--metric: 'nees', which no run has; expected one of final.ate"),
        ("export empty.sweep --out y.csv", "empty.sweep: is empty"),
        ("diff a.sweep x.csv", "expected a table that `moteslam sweep export` wrote"),
    ],
    "sweep plot a.sweep --out ": [
        ("there.png", "there.png: exists already"),
        ("b.png --x seed", "--x: 'seed', expected one of scenario, configuration"),
        ("b.png --metric map_f1", "--metric: 'map_f1', which no run has; expected one of final.ate"),
        ("b.png --metric mapf1", "'mapf1', expected one of"),
    ],
    "report ": [
        ("nowhere", "nowhere: there is no such file or folder"),
        ("empty", "empty: no result folder and no .sweep file in it"),
        ("a.sweep --metric nees", "--metric: 'nees', which no run has"),
        ("a.sweep --baseline x", "--baseline: 'x', expected one of"),
    ],
    "compare ": [
        ("a.sweep --baseline best", "'best', expected one of 'plain, slam.tracking.window=1.0', "),
        ("a.sweep --metric final.aet", "expected final.ate"),
        ("no.sweep", "there is no such file"),
        ("one", "1 configuration, expected two"),
    ],
}


@pytest.fixture(scope="module")
def here(simulated_folder: Path, scenario_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the lines name."""
    folder = tmp_path_factory.mktemp("here")
    room = scenario_file.read_text()
    (folder / "robot").symlink_to(simulated_folder)
    for name in ("empty", "one"):
        (folder / name).mkdir()
    swept(folder)
    for name, text in {
        "room.toml": room,
        "wide.toml": room + FAR_WALL,
        "there.png": "",
        "there.html": "",
        "good.tum": TUM,
        "truth.tum": TUM,
        "early.tum": "-1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n",
        "some.relations": "1 2 1 0 0 0 0 0\n",
        "spec.toml": 'scenarios = ["corridor"]\n',
        "empty.sweep": "",
        "x.csv": "a,b\n1,2\n",
        "one/metrics.json": '{"metrics": {}}',
        "one/run.json": "{}",
    }.items():
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    ("line", "words"), [(command + line, words) for command, lines in LINES.items() for line, words in lines]
)
def test_one_line_and_exit_code_2(line: str, words: str, here: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(here)
    before = sorted(here.rglob("*"))
    assert words in refused(capsys, *line.split())
    assert sorted(here.rglob("*")) == before


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("[bold]red[red]", "[bold]red[red]"),
        ("\x1b[31mred\x07", "\\x1b[31mred\\x07"),
        ("two\nlines", "two\\nlines"),
        ("{braces} %s", "{braces} %s"),
    ],
)
def test_names_with_markup_and_escape_codes_are_printed_as_they_are(
    name: str, shown: str, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    line = refused(capsys, "inspect", name)
    assert line == f"moteslam: {shown}: No such file or directory, expected a recording\n"
    assert "\x1b" not in refused(capsys, "evaluate", "one", "two", name)  # a usage error, printed by Typer
    Path(name).write_text("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")
    assert printed(capsys, "evaluate", name, name).startswith(f"{shown} against {shown}, laid on it rigidly\n")
    assert json.loads(printed(capsys, "evaluate", name, name, "--json"))["estimate"] == name


STOPPED = "moteslam: interrupted, nothing was left behind\n"
WHILE_IMPORTING = """
import os, runpy, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "numpy._core._multiarray_umath":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
sys.argv = ["moteslam", "demo"]
runpy.run_module("moteslam", run_name="__main__")
"""


@pytest.mark.usefixtures("signals_are_heard")
def test_an_interrupt_while_the_program_is_read(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WHILE_IMPORTING], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", STOPPED)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "SIGTERM"])
@pytest.mark.usefixtures("signals_are_heard")
def test_an_interrupt_leaves_nothing(number: int, code: int, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "moteslam", "demo", "--set", "particles=5000"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    while not list(tmp_path.iterdir()) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert [entry.suffix for entry in tmp_path.iterdir()] == [".partial"]
    time.sleep(0.7)
    process.send_signal(number)
    out, err = process.communicate(timeout=300)
    assert process.returncode == code, err
    assert (out, err) == ("", STOPPED)
    assert not list(tmp_path.iterdir())


def test_a_closed_pipe_is_no_error(tmp_path: Path) -> None:
    command = f"{sys.executable} -m moteslam scenarios | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.returncode in (0, main.CLOSED_PIPE)  # 0 where the pipe closed too late


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_disk_behind_stdout(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "moteslam", "scenarios"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            cwd=tmp_path,
        )
    assert (done.returncode, done.stderr) == (2, "moteslam: stdout: cannot be written: No space left on device\n")


def test_a_fault_of_ours_is_one_line_too(monkeypatch, capsys) -> None:
    def broken() -> None:
        raise ZeroDivisionError("by zero\nof all things")

    monkeypatch.setattr("moteslam.sim.scenario.bundled_scenarios", broken)
    line = refused(capsys, "scenarios", code=1)
    assert "internal error: ZeroDivisionError: by zero\\nof all things in " in line
    assert f"{Path(__file__).name}, line " in line
    assert "; MOTESLAM_TRACEBACK=1 shows more" in line
    monkeypatch.setenv("MOTESLAM_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        main.run(["scenarios"])


@pytest.mark.parametrize(("module", "name"), [("pymunk._callbacks", "called"), ("pymunk.body", "freebody")])
def test_an_interrupt_within_c_that_calls_python_waits(module: str, name: str, monkeypatch) -> None:
    monkeypatch.setattr(interrupt, "_asked", [])
    called_by_c = {"__name__": module, "ask": lambda: interrupt._interrupt(signal.SIGINT, sys._getframe())}
    exec(f"def {name}():\n    ask()", called_by_c)
    called_by_c[name]()
    with pytest.raises(interrupt.Interrupted):
        interrupt.check_interrupt()


@pytest.mark.slow
def test_a_truth_on_another_clock_is_left_out(simulated_folder: Path, tmp_path: Path, capsys, taichi) -> None:
    shutil.copytree(simulated_folder, tmp_path / "robot")
    (tmp_path / "robot/truth.tum").write_text("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")
    options = ["--set", "particles=5", "--json", "--no-figures"]
    assert main.run(["replay", str(tmp_path / "robot"), "--out", str(tmp_path / "x"), *options]) == 0
    said = capsys.readouterr()
    assert "no stamps in common" in said.err
    assert json.loads(said.out)["metrics"]["final.ate"] == {"absent": "no truth"}
    assert not (tmp_path / "x/truth.tum").exists()
