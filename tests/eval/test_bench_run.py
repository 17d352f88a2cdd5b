"""``moteslam bench`` as a user meets it: what it measures, writes and refuses, and what becomes of what goes wrong."""

from __future__ import annotations

import getpass
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from command_lines import refused

from moteslam.errors import ConfigError
from moteslam.eval.bench import load, timing
from moteslam.eval.bench import measure as measure_module
from moteslam.eval.bench import peers as peers_module
from moteslam.eval.bench.contest import Contender
from moteslam.eval.bench.document import read_result
from moteslam.eval.bench.loops import Compiled
from moteslam.eval.bench.measure import Wanted, measure
from moteslam.eval.bench.peers import Peer, read_peers, run_peers
from moteslam.eval.bench.process import outcomes
from moteslam.eval.bench.workload import TASKS
from moteslam.eval.cli import main
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.eval.sweep.workers import Outcome
from moteslam.robot.processors import processor_count

ROOT = Path(__file__).parents[2]
COMMAND = """
scenarios = ["corridor"]
timeout = 50
[configurations.default]
[configurations.theirs]
command = ["python3", "{here}/slam.py", "{recording}", "{out}"]
version = "1.2"
"""
STANDING = """
import sys
recording, out = sys.argv[1:]
scans = [line.split() for line in open(recording) if line.startswith("ROBOTLASER1 ")]
with open(out + "/trajectory.tum", "w") as file:
    for words in scans:
        file.write(f"{words[-3]} {words[-11]} {words[-10]} 0 0 0 0 1\\n")
"""
"""A SLAM that takes the odometry's place, and no heading."""


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, tuple[str, ...]]]:
    """Processes that measure nothing: on two threads everything takes half as long; the calls of them."""
    calls: list[tuple[int, tuple[str, ...]]] = []

    def outcomes(
        tasks: Sequence[str], threads: int, compiled: Compiled, **options: Any
    ) -> Iterator[tuple[str, dict[str, Any]]]:
        calls.append((threads, tuple(tasks)))
        for name in tasks:
            if name == "search":
                yield name, {"error": "scores of kernel and C differ in a share of 0.5, expected at most 0.01"}
            elif name in ("arithmetic", "memory"):
                yield name, {"turns": {"c": [[1e-3 / threads] * 2] * 3}, "facts": {}}
            else:
                turns = {"moteslam": [[4e-3 / threads] * 2] * 3, "c": [[3e-3 / threads] * 2] * 3}
                yield name, {"turns": turns, "facts": {"lookups": 100.0}}

    monkeypatch.setattr(measure_module, "outcomes", outcomes)
    monkeypatch.setattr(measure_module, "busy_processors", lambda: 0.0)
    monkeypatch.setattr("moteslam.robot.processors.processor_count", lambda: 2)
    return calls


@pytest.mark.slow
def test_a_trial_of_one_task(program, tmp_path: Path) -> None:
    done = program(
        "bench", "--quick", "--tasks", "thinning", "--threads", 1, "--out", "a/b.json", "--json", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "a" / "b.json").read_text()
    assert json.loads(done.stdout) == json.loads(text)
    result = read_result(tmp_path / "a" / "b.json")
    assert list(result.tasks) == ["arithmetic", "memory", "thinning"]
    assert (result.threads, result.rounds, result.quick) == ((1,), 1, True)
    contenders = result.tasks["thinning"].times["1"]
    assert contenders["moteslam"].processor.median > 0
    if result.compiler.absent:
        assert set(contenders) == {"moteslam"}
    else:
        assert set(contenders) == {"moteslam", "c"}
        assert result.tasks["thinning"].speed["1"].median > 0
        assert result.compiler.flags[0] == "-O3"
    for folder in (str(Path.home()), str(tmp_path), str(ROOT), sys.prefix):
        assert folder not in text
    assert {socket.gethostname(), getpass.getuser()}.isdisjoint(re.findall(r"[\w.-]+", text))
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "b.json"]


@pytest.mark.slow
def test_without_a_compiler_the_table_says_why(program, tmp_path: Path) -> None:
    done = program("bench", "--quick", "--tasks", "thinning", "--threads", 1, cwd=tmp_path, PATH=str(tmp_path), CC="")
    assert done.returncode == 0, done.stderr
    assert "C          none: no C compiler: none of gcc, clang, cc is there\n" in done.stdout
    assert "thinning  scan" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_rounds_of_processes_for_each_number_of_threads(made_up: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["bench", "--tasks", "grid", "--tasks", "thinning,matching", "--rounds", "2"]) == 0
    tasks = ("arithmetic", "memory", "thinning", "matching", "grid")
    assert made_up == [(1, tasks), (2, tasks)] * 2
    text = capsys.readouterr().out
    assert "thinning  scan       4.00 ms  3.00 ms     0 %   0.75     2.00\n" in text
    assert "grid      scan       4.00 ms  3.00 ms     0 %   0.75        -\n" in text  # serial on purpose
    assert "measured    " in text
    assert ", 2 rounds\n" in text


def test_a_task_that_fails_stops_no_other(made_up: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "a.json"
    assert main.run(["bench", "--tasks", "search,grid", "--out", str(file)]) == 1
    out, err = capsys.readouterr()
    assert err == (
        "moteslam: warning: search: scores of kernel and C differ in a share of 0.5, expected at most 0.01\n"
    )
    assert "failed  why\nsearch  scores of kernel and C differ" in out
    assert out.endswith(f"wrote {file}\n")
    result = read_result(file)
    assert result.tasks["search"].times == {}
    assert len(result.tasks["grid"].times["1"]["c"].wall.rounds) == 3
    assert [tasks for _, tasks in made_up].count(("arithmetic", "memory", "search", "grid")) == 1  # not tried again


def test_without_arguments_everything_is_measured(made_up: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["bench"]) == 1  # the search fails
    assert made_up[0][1] == tuple(TASKS)
    assert main.run(["sweep"]) == 2  # other groups print their help


def test_progress_is_counted_to_its_end(made_up: Any) -> None:
    steps: list[int] = []
    wanted = Wanted(["arithmetic", "search", "grid"], (1, 2), 2)
    measure(wanted, steps.append)
    assert steps == list(range(1, wanted.steps + 1))


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("--tasks", "nothing"), f"--tasks: 'nothing', expected one of {', '.join(TASKS)}\n"),
        (("--tasks", ""), "--tasks: '', expected one of arithmetic"),
        (("--threads", "3"), "--threads: 3, expected at most the 2 processors\n"),
        (("--threads", "0"), "--threads: 0, expected at least 1"),
        (("--rounds", "0"), "--rounds: 0, expected at least 1"),
        (("--rounds", "many"), "--rounds: many, expected a whole number"),
        (("--format", "pdf"), "--format: 'pdf', expected one of text"),
        (("--format", "csv", "--json"), "--format: 'csv' with --json"),
        (("--peers", "missing.toml"), "missing.toml: No such file"),
        (("mine.json",), "Got unexpected extra argument(s) (mine.json)"),
    ],
)
def test_what_cannot_be_measured_is_refused(
    arguments: tuple[str, ...], problem: str, made_up: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(capsys, "bench", *arguments).removeprefix("moteslam: ").startswith(problem)
    assert made_up == []


def test_a_file_that_cannot_be_written_is_found_before(
    made_up: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for out, problem in (
        ("file", "exists already; name a new file, or replace it with --force"),
        ("file/a.json", f"cannot be made: {tmp_path / 'file'} is a file, expected a folder"),
    ):
        assert problem in refused(capsys, "bench", "--out", tmp_path / out)
    for force in ((), ("--force",)):
        problem = refused(capsys, "bench", *force, "--out", tmp_path / "folder")
        assert "it is a folder, expected the name of a file" in problem
    assert made_up == []


def test_a_process_that_dies_is_an_error_of_its_task(tmp_path: Path) -> None:
    no_library = tmp_path / "loops.so"
    no_library.write_text("no library")
    found = list(outcomes(["thinning"], 1, Compiled(no_library), seconds=0.0, least=1))
    assert [name for name, _ in found] == ["thinning"]
    assert found[0][1]["error"].startswith("its process died, exit code 1: OSError: loops.so: ")


def test_contenders_take_turns_and_short_ones_several_calls_each(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    now = [0.0]

    def work(name: str, seconds: float) -> None:
        calls.append(name)
        now[0] += seconds

    clock = SimpleNamespace(perf_counter=lambda: now[0], process_time=lambda: now[0] / 4)
    monkeypatch.setattr(timing, "time", clock)
    contenders = {
        "long": Contender(lambda: work("long", 0.5), 10.0),
        "short": Contender(lambda: work("short", 3e-4), 1.0),
    }
    found = timing.in_turns(contenders, seconds=0.0, least=3)
    assert {name: len(turns) for name, turns in found.items()} == {"long": 3, "short": 3}
    assert calls.count("long") == 3 + 1  # one call that is not counted
    assert calls.count("short") == 3 * 7 + 2  # seven take two milliseconds
    times = timing.medians(found)
    assert times["long"] == pytest.approx((0.05, 0.0125))
    assert times["short"] == pytest.approx((3e-4, 7.5e-5))
    assert len(timing.in_turns(contenders, seconds=2.6, least=3)["long"]) == 6  # rounds of half a second


def test_how_busy_the_processors_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load, "WATCHED", 0.0)
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    counts = iter([(100, 1000), (125, 1050)])
    monkeypatch.setattr(load, "_jiffies", lambda: next(counts))
    assert load.busy_processors() == 2.0  # half of the time of four
    monkeypatch.setattr(load, "_jiffies", lambda: (100, 1000))
    assert load.busy_processors() is None  # the clock stood still
    monkeypatch.setattr(load, "_jiffies", lambda: None)
    monkeypatch.setattr("os.getloadavg", lambda: (1.5, 1.0, 1.0))
    assert load.busy_processors() == 1.5


def test_commands_of_a_specification_are_peers(tmp_path: Path) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text(COMMAND)
    first, second, theirs = read_peers(spec)
    assert [first.name, second.name, theirs.name] == ["moteslam, 1 particle", "moteslam, 30 particles", "theirs"]
    assert "backend.method=none" in first.command[0]
    words, form, trajectory, _, version = theirs.command
    assert words[1] == f"{tmp_path.absolute()}/slam.py"
    assert (form, trajectory, version, theirs.timeout) == ("carmen", "trajectory.tum", "1.2", 50.0)
    spec.write_text('scenarios = ["corridor"]\n[configurations.ours]\n')
    with pytest.raises(ConfigError, match="configurations: no configuration with a command"):
        read_peers(spec)
    spec.write_text(COMMAND + "set = { platform.imu = false }\n")
    with pytest.raises(ConfigError, match=r"configurations\.theirs\.set: platform\.imu, expected none"):
        read_peers(spec)


def test_a_program_that_fails_once_has_no_times(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[PlannedRun] = []

    def make_all(runs: list[PlannedRun], **options: Any) -> Iterator[Outcome]:
        made.extend(runs)
        values = {"cpu_per_scan": {"value": float(len(made)), "unit": "ms"}, "final.ate": {"value": 0.01, "unit": "m"}}
        if len(made) == 2:
            yield Outcome(runs[0], "failed", "/home/somebody/bin/b: ended with exit code 3: /tmp/x/y is full")
        else:
            yield Outcome(runs[0], "ok", result={"values": values})

    monkeypatch.setattr(peers_module, "make_all", make_all)
    steps: list[int] = []
    command = (("words",), "carmen", "trajectory.tum", "", "2.5")
    found = run_peers([Peer("a", command), Peer("b", command)], 2, steps.append)
    assert [run.configuration for run in made] == ["a", "b", "a", "b"]
    assert {(run.scenario, run.duration, run.seed) for run in made} == {("corridor", 30.0, 0)}
    assert found["a"].processor is not None
    assert found["a"].processor.rounds == pytest.approx((1e-3, 3e-3))
    assert (found["a"].ate, found["a"].version) == (0.01, "2.5")
    assert found["b"].processor is None
    assert found["b"].error == "failed: b: ended with exit code 3: y is full"
    assert steps == [1, 2, 3, 4]


@pytest.mark.slow
def test_every_task_on_one_thread_and_on_more(program, tmp_path: Path) -> None:
    done = program("bench", "--quick", "--out", "a.json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    result = read_result(tmp_path / "a.json")
    assert list(result.tasks) == list(TASKS)
    counts = sorted({1, processor_count()})
    assert list(result.threads) == counts
    for name, task in result.tasks.items():
        if result.compiler.absent and name in ("arithmetic", "memory"):
            continue
        assert list(task.times) == [str(count) for count in counts], name
        assert set(task.gain) == ({str(count) for count in counts[1:]} if name != "grid" else set())
    for name in ("run-1", "run-30"):
        assert 0 < result.tasks[name].facts["ate"] < 0.05
    assert "pymunk" in result.tasks["raycasting"].times["1"]
    assert "| run-30 | scan |" in program("bench", "show", "a.json", "--format", "markdown", cwd=tmp_path).stdout


@pytest.mark.slow
def test_programs_of_others_run_over_the_same_drive(program, tmp_path: Path) -> None:
    (tmp_path / "spec.toml").write_text(COMMAND)
    (tmp_path / "slam.py").write_text(STANDING)
    arguments = ("--quick", "--tasks", "thinning", "--threads", 1, "--peers", "spec.toml", "--out", "a.json")
    done = program("bench", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    peers = read_result(tmp_path / "a.json").peers
    assert list(peers) == ["moteslam, 1 particle", "moteslam, 30 particles", "theirs"]
    ours, theirs = peers["moteslam, 30 particles"], peers["theirs"]
    assert ours.ate is not None
    assert theirs.ate is not None
    assert 0 < ours.ate < theirs.ate < 1
    assert theirs.version == "1.2"
    assert "theirs 1.2" in done.stdout
    (tmp_path / "slam.py").write_text("import sys; sys.exit('no licence')")
    failed = program("bench", *arguments, "--force", cwd=tmp_path)
    assert failed.returncode == 1
    assert "moteslam: warning: theirs: failed: python3: ended with exit code 1: no licence\n" in failed.stderr
    assert read_result(tmp_path / "a.json").peers["theirs"].processor is None


@pytest.mark.slow
@pytest.mark.usefixtures("signals_are_heard")
def test_an_interrupt_leaves_nothing(tmp_path: Path) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    bench = subprocess.Popen(
        [sys.executable, "-m", "moteslam", "bench", "--out", "a/b.json"],
        cwd=tmp_path,
        env={**os.environ, "TMPDIR": str(scratch)},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    end = time.monotonic() + 60
    while not list(scratch.glob("moteslam-*/loops.so")) and time.monotonic() < end:
        time.sleep(0.1)
    time.sleep(2.0)  # a process measures
    bench.send_signal(signal.SIGINT)
    assert bench.communicate(timeout=60) == (None, "moteslam: interrupted, nothing was left behind\n")
    assert bench.returncode == 130
    assert list(scratch.iterdir()) == []
    assert [path.name for path in tmp_path.iterdir()] == ["scratch"]
