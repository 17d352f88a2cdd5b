"""Sweeps: what is planned, made, recorded, merged and summed up; what becomes of runs that go wrong."""

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
from command_lines import Capsys, printed, refused, shown, told
from made_sweeps import Values, recorded, swept
from refusals import refusal

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.eval.cli import main
from moteslam.eval.metrics.registry import COSTS
from moteslam.eval.page.document import gather, page
from moteslam.eval.runs import summary_of
from moteslam.eval.sweep.plan import PLATFORMS, SCENARIOS, PlannedRun, digest, plan, shard
from moteslam.eval.sweep.spec import bundled_specs, numbers, read_spec
from moteslam.eval.sweep.store import WHOLE, Row, as_csv, begin, create, merge, opened, read_table
from moteslam.eval.sweep.workers import Outcome, make_all, make_all_on
from moteslam.robot.formats.map_server import OCCUPIED, write_map
from moteslam.robot.raster import Raster

SPEC = """
scenarios = ["corridor"]
duration = 11
seeds = "0-1"
metrics = ["final.ate", "online.ate", "map_f1", "final.rpe_1m"]
[configurations.default]
[configurations.alone]
set = { slam.backend.method = "none" }
[vary]
slam.particles = [1, 3]
"""
"""Eight runs of eleven seconds."""

ROOT = Path(__file__).parents[2]
HERE = "scenarios = ['corridor']\n"


def written(folder: Path, text: str = SPEC, name: str = "spec.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def planned(folder: Path, text: str = SPEC) -> list[PlannedRun]:
    return plan(read_spec(written(folder, text)))


def rows_of(path: Path) -> list[Row]:
    with opened(path) as store:
        return list(store.rows())


def results(path: Path) -> list[list[str]]:
    """Every run as its row of the table, without times."""
    return [row[:-1] if row else row for row in csv.reader(as_csv(rows_of(path)).splitlines())]


def test_every_configuration_with_every_value_on_every_seed(tmp_path: Path) -> None:
    runs = planned(tmp_path)
    assert {(run.seed, run.configuration, dict(run.varied)["slam.particles"]) for run in runs} == {
        (seed, name, count) for seed in (0, 1) for name in ("default", "alone") for count in (1, 3)
    }
    assert runs[0].for_slam() == ("particles=1",)
    assert next(run for run in runs if run.configuration == "alone").for_slam()[0] == 'backend.method="none"'
    assert [run.case for run in runs] == sorted(run.case for run in runs)
    assert [run.id for run in planned(tmp_path)] == [run.id for run in runs]
    assert [PlannedRun.model_validate_json(run.model_dump_json()) for run in runs] == runs


def test_keys_of_scenario_and_robot_vary_too(tmp_path: Path) -> None:
    text = """
scenarios = ["corridor", "random-corridors-7"]
platforms = ["turtlebot3", "lms200"]
noise = ["as_recorded"]
seeds = "4"
[vary]
scenario.noise.odometry_scale = { first = 1, last = 4, steps = 3, spacing = "factor" }
platform.imu = [false]
"""
    runs = planned(tmp_path, text)
    assert len(runs) == 2 * 2 * 3
    assert runs[0].for_scenario() == ("platform.imu=false", "noise.odometry_scale=1")
    assert [dict(run.varied)["scenario.noise.odometry_scale"] for run in runs[:3]] == [1.0, 2.0, 4.0]
    assert "turtlebot3, as_recorded, seed 4, default" in runs[0].name


def test_shards_hold_each_run_once_and_no_case_apart(tmp_path: Path) -> None:
    runs = planned(tmp_path, SPEC.replace('"0-1"', '"0-6"'))
    parts = [shard(runs, number, 3) for number in (1, 2, 3)]
    assert sorted(run.id for part in parts for run in part) == sorted(run.id for run in runs)
    cases = [{run.case for run in part} for part in parts]
    assert all(not cases[a] & cases[b] for a in range(3) for b in range(a))


def test_seeds_as_text() -> None:
    assert numbers("7, 3, 5-6,3") == [7, 3, 5, 6]
    for wrong in ("", "a", "3-1", "1-", "-1", "1.5", "0-99999999"):
        with pytest.raises(ValueError, match="expected"):
            numbers(wrong)


@pytest.mark.parametrize(("words", "count"), [('["slam", "{recording}"]', 1), ('["slam", "{seed}"]', 3)])
def test_a_command_without_a_seed_runs_once_on_a_recording(words: str, count: int, tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("x")
    text = f'recordings = ["a.log"]\nseeds = "0-2"\n[configurations.ours]\n[configurations.theirs]\ncommand = {words}\n'
    runs = plan(read_spec(written(tmp_path, text)), check=False)
    assert [sum(run.configuration == name for run in runs) for name in ("ours", "theirs")] == [3, count]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("seeds = '0'", "neither scenarios nor recordings"),
        (HERE + "seed = '0'", "seed: unknown key, expected one of seeds, "),
        (HERE + "[configurations.a]\ncommand = 'python3 x'", "a.command: expected a list: ['python3', 'x'], found "),
        (HERE + "seeds = '5-'", "seeds: '5-', "),
        (HERE + "seeds = [0.5]", "seeds: [0.5], expected a text"),
        (HERE + "seeds = 5", 'seeds: 5, expected a text: "0-4" for 5 of them, "5" for this, '),
        (HERE + "duration = 10", "duration: 10 s, expected more than 10 s: drive.rest_start and drive.rest_end"),
        (
            HERE + "[configurations.a]\nset = { particles = 5 }",
            "a.set: 'particles', expected slam.particles",
        ),
        (HERE + "platforms = ['r2d2']", "platforms: 'r2d2', "),
        (HERE + "platforms = ['none.toml']", "none.toml', No such file or directory, expected a platform.toml"),
        (HERE + "metrics = ['final.aet']", "metrics: 'final.aet', expected final.ate"),
        (HERE + "[vary]\nslam.particels = [1]", "vary.slam.particels: "),
        (HERE + "[vary]\nslam.particles = [-3]", "vary.slam.particles: "),
        (HERE + "[vary]\nslam.particles = { first = 1, last = 9, steps = 0 }", "vary.slam.particles.range.steps: "),
        (HERE + "[vary]\nslam.particles = []", "vary.slam.particles: [], expected a list of numbers, "),
        (HERE + "[vary]\nslam.particles = [[1, 2]]", "vary.slam.particles: [[1, 2]], expected a list of numbers, "),
        (HERE + "seeds = '0'\n[vary]\nslam.particles = [2, 2]", "(corridor, seed 0, default, slam.particles=2)"),
        (HERE + "[configurations.a]\npreset = 'b'", "configurations.a, b: no such preset"),
        (HERE + "[configurations.a]\nset = { slam.backend.method = 'no' }", "configurations.a, backend.method: "),
        (HERE + "[configurations.paper]", "configurations.paper: of the preset default, expected preset = "),
        (HERE + "[configurations.a]\ntrajectory = 'x'\n", "configurations.a: trajectory without a command"),
        (HERE + "[configurations.a]\ncommand = ['x', '{output}']\n", "{output} in the command, expected {out}"),
        *(
            (f"{HERE}[configurations.theirs]\ncommand = ['x']\n{more}", "configurations.theirs")
            for more in ("preset = 'default'", "set = { slam.particles = 3 }", "format = 'bag'", "map = '/x'")
        ),
        ("scenarios = ['coridor']", "scenarios, coridor: "),
        ("recordings = ['nothing.log']", "recordings: "),
        ("recordings = ['nothing.log']\n[vary]\nplatform.imu = [true]", ": platform.imu, expected slam. keys"),
        (
            "recordings = ['a.log']\n[configurations.a]\nset = { scenario.noise.lidar.range_noise = 0.5 }",
            ": scenario.noise.lidar.range_noise, expected slam. keys",
        ),
        ("recordings = ['a.log']\nduration = 10", ": duration without scenarios"),
        (HERE + "noise = ['datasheet']\n[vary]\nscenario.noise_class = ['as_recorded']", ": noise and scenario.noise"),
        (
            HERE + "platforms = ['lms200']\n[configurations.a]\nset = { scenario.platform = 'ucsd' }",
            "platforms and scenario.platform, expected one of the two",
        ),
    ],
)
def test_a_specification_that_is_wrong_names_the_place(text: str, place: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        begin(tmp_path / "a.sweep", file := written(tmp_path, text), read_spec(file), WHOLE)
    assert caught.value.file is not None
    assert place in str(caught.value)
    assert not (tmp_path / "a.sweep").exists()


def test_one_value_is_taken_for_a_list(tmp_path: Path) -> None:
    text = "scenarios = {0}'corridor'{1}\nnoise = {0}'as_recorded'{1}\nmetrics = {0}'ate'{1}\n"
    text += "[vary]\nslam.particles = {0}3{1}"
    one, listed = (planned(tmp_path, text.format(*brackets)) for brackets in (("", ""), "[]"))
    assert one == listed


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All eight runs, made one after the other and never interrupted."""
    folder = tmp_path_factory.mktemp("whole")
    assert main.run(["sweep", str(written(folder)), "--workers", "1"]) == 0
    return folder / "spec.sweep"


@pytest.mark.slow
def test_all_runs_are_made_summed_up_and_exported(whole: Path, tmp_path: Path, capsys: Capsys) -> None:
    from pyarrow import parquet

    rows = rows_of(whole)
    assert {row.status for row in rows} == {"ok"}
    assert all(0 < (row.values["final.ate"] or 0) < 0.1 for row in rows)
    assert all(row.costs == {} for row in rows)
    text = printed(capsys, "sweep", "show", whole, "--metric", "final.ate", "--metric", "map_f1")
    assert "8 ok" in text
    assert len(text.splitlines()) == 1 + 4 + 4
    groups = shown(capsys, "sweep", "show", whole)["groups"]
    assert [group["runs"] for group in groups] == [2] * 4
    assert groups[0]["success"]["share"] == 1.0
    assert groups[0]["metrics"]["final.ate"]["median"] is not None
    for name in ("a.csv", "a.parquet"):
        printed(capsys, "sweep", "export", whole, "--out", tmp_path / name)
    table = list(csv.DictReader((tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()))
    columns = parquet.read_table(tmp_path / "a.parquet").to_pydict()
    errors = [row.values["final.ate"] for row in rows]
    assert [float(row["final.ate"]) for row in table] == columns["final.ate"] == errors
    assert columns["slam.particles"] == [1, 3] * 4
    assert "exists already" in refused(capsys, "sweep", "export", whole, "--out", tmp_path / "a.csv")


@pytest.mark.slow
def test_killed_it_comes_to_the_same(whole: Path, tmp_path: Path) -> None:
    """The command and whatever it has begun, by SIGKILL, with runs made and others begun."""
    spec, target = written(tmp_path), tmp_path / "spec.sweep"
    command = [sys.executable, "-m", "moteslam", "sweep", str(spec), "--workers", "2"]
    made = 0
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and made < 3:
        time.sleep(0.05)
        if target.exists():
            made = sum(1 for row in rows_of(target) if row.status)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert sum(1 for row in rows_of(target) if row.status) >= made
    assert subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False).returncode == 0
    assert results(target) == results(whole)
    assert main.run(["sweep", str(spec)]) == 0  # there is nothing left to do


KILLED_AMID = """
import os, signal, sqlite3, sys
connection = sqlite3.connect(sys.argv[1])
connection.execute("PRAGMA cache_size = 1")
connection.execute("UPDATE runs SET status = 'ok', error = ?", ("x" * 5000,))
os.kill(os.getpid(), signal.SIGKILL)
"""
"""A process that is killed with half of a transaction on the disk."""


@pytest.mark.parametrize("first", ["read", "write"])
def test_killed_amid_a_transaction_it_is_as_before_it(tmp_path: Path, first: str) -> None:
    file = swept(tmp_path, whole=False)
    before = rows_of(file)
    subprocess.run([sys.executable, "-c", KILLED_AMID, str(file)], check=False, timeout=60)
    assert file.with_name("a.sweep-journal").stat().st_size > 0
    with opened(file, write=first == "write") as store:
        assert list(store.rows()) == before
    assert rows_of(file) == before
    assert not file.with_name("a.sweep-journal").exists()


@pytest.mark.slow
def test_three_shards_come_to_the_same(whole: Path, tmp_path: Path, capsys: Capsys) -> None:
    spec = written(tmp_path)
    parts = []
    for number in (1, 2, 3):
        parts.append(str(tmp_path / f"{number}.sweep"))
        assert main.run(["sweep", str(spec), "--shard", f"{number}/3", "--out", parts[-1], "--workers", "1"]) == 0
    assert "8 runs in" in printed(capsys, "sweep", "merge", *parts, "--out", tmp_path / "all.sweep")
    assert results(tmp_path / "all.sweep") == results(whole)
    other = written(tmp_path, SPEC.replace("[1, 3]", "[1]"), "other.toml")
    for line, problem in (
        (["merge", *parts, "--out", str(tmp_path / "all.sweep")], "all.sweep: exists already"),
        ([str(spec), "--shard", "2/3", "--out", parts[0]], "holds part 1/3, not 2/3"),
        ([str(spec), "--out", parts[0]], "holds part 1/3, not 1/1"),
        ([str(other), "--out", parts[0]], "differs in vary from what was run there"),
    ):
        assert problem in refused(capsys, "sweep", *line)


def test_more_seeds_are_added_and_no_run_is_lost(tmp_path: Path) -> None:
    text = 'scenarios = ["corridor"]\nseeds = "0-1"\n[configurations.plain]\n'
    file = recorded(tmp_path / "a.sweep", text, lambda run: {"final.ate": (1.0 + run.seed, "m")}, digest="")
    for seeds, found in (("0-3", [1.0, 2.0, None, None]), ("0-3", [1.0, 2.0, None, None]), ("0", None)):
        spec = written(tmp_path, text.replace("0-1", seeds))
        with nullcontext() if found else pytest.raises(OutputError, match="and more"):
            begin(file, spec, read_spec(spec), "1/1")
        with opened(file) as store:
            assert [row.known.get("final.ate") for row in store.rows()] == (found or [1.0, 2.0, None, None])
    other = written(tmp_path, text + "set = { slam.particles = 5 }\n")
    with pytest.raises(OutputError, match="differs in seeds, configurations"):
        begin(file, other, read_spec(other), "1/1")


@pytest.mark.slow
def test_time_is_measured_when_asked_for(tmp_path: Path) -> None:
    text = SPEC.replace("[1, 3]", "[3]").replace('"0-1"', '"0"').replace('"map_f1"', '"memory", "cpu_per_scan"')
    assert main.run(["sweep", str(written(tmp_path, text)), "--time"]) == 0
    rows = rows_of(tmp_path / "spec.sweep")
    assert [set(row.costs) for row in rows] == [set(COSTS)] * 2
    assert all(row.costs["memory"] > 50 for row in rows)
    assert set(as_csv(rows).splitlines()[0].split(",")[-len(COSTS) :]) == set(COSTS)


TOY = """
import json, os, signal, sys, time
for line in sys.stdin:
    run = json.loads(line)["run"]
    if run["seed"] == 1: print("Segmentation fault", file=sys.stderr, flush=True); os.kill(os.getpid(), signal.SIGKILL)
    if run["seed"] == 2: time.sleep(60)
    if run["seed"] == 3: print(json.dumps({"error": "corridor: the robot is stuck"}), flush=True); continue
    mark = os.path.join(sys.argv[1], run["configuration"])
    if run["seed"] == 4 and not os.path.exists(mark): open(mark, "w").close(); os._exit(3)
    print(json.dumps({"values": {"final.ate": {"value": run["seed"] / 10, "unit": "m"}}}), flush=True)
"""
"""A worker's part, played by a few lines: what a run does follows from its seed."""


@pytest.fixture
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = subprocess.Popen

    def popen(command: list[str], **options: object) -> subprocess.Popen[str]:
        return real([sys.executable, "-c", TOY, str(tmp_path)], **options)  # type: ignore[call-overload,no-any-return]

    monkeypatch.setattr("moteslam.eval.sweep.workers.subprocess.Popen", popen)


@pytest.mark.slow
@pytest.mark.usefixtures("toys")
def test_runs_that_crash_hang_or_fail_are_rows_and_stop_no_other(tmp_path: Path) -> None:
    """Seed 4 dies once, by what others did, and is made again."""
    text = 'scenarios = ["corridor"]\nseeds = "0-6"\n'
    runs = planned(tmp_path, text)
    create(tmp_path / "a.sweep", "{}", runs)
    with opened(tmp_path / "a.sweep", write=True) as store:
        for outcome in make_all(store.pending(), workers=2, timeout=3.0):
            store.record(outcome)
        rows = {row.run.seed: row for row in store.rows()}
        assert store.counts() == {"crashed": 1, "failed": 1, "ok": 4, "timed out": 1}
    assert {seed: row.status for seed, row in rows.items() if row.status != "ok"} == {
        1: "crashed", 2: "timed out", 3: "failed"
    }  # fmt: skip
    assert rows[1].error == "its process died 3 times, killed by signal 9: Segmentation fault"
    assert rows[2].error == "not done after 3 s"
    assert rows[3].error == "corridor: the robot is stuck"
    assert rows[4].values == {"final.ate": 0.4}
    ate = summary_of(rows.values(), "final.ate")
    assert (ate.runs, ate.failed, ate.best, ate.median) == (7, 3, 0.0, pytest.approx(0.6))
    assert sum(row.succeeded for row in rows.values()) == 3


def test_a_sweep_that_is_made_again_tries_what_did_not_end_well(
    tmp_path: Path, capsys: Capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[int] = []

    def make(runs: list[PlannedRun], **_: object) -> Iterator[Outcome[PlannedRun]]:
        for run in runs:
            tried.append(run.seed)
            yield Outcome(run, "ok", result={"values": {"final.ate": {"value": 0.2, "unit": "m"}}})

    first: dict[int, Values | str | None] = {0: {"final.ate": (0.1, "m")}, 1: "no such program", 2: None}
    text = 'scenarios = ["corridor"]\nseeds = "0-2"\n'
    file = recorded(tmp_path / "a.sweep", text, lambda run: first[run.seed], digest="")
    monkeypatch.setattr("moteslam.eval.sweep.workers.make_all", make)
    for _ in range(2):  # the second time there is nothing to do
        assert main.run(["sweep", str(tmp_path / "a.toml")]) == 0
        assert tried == [2, 1]
    assert capsys.readouterr().err.splitlines() == ["moteslam: tried again: 1 run that did not end well"]
    assert [(row.status, row.error, row.values["final.ate"]) for row in rows_of(file)] == [
        ("ok", "", 0.1), ("ok", "", 0.2), ("ok", "", 0.2)
    ]  # fmt: skip


@pytest.mark.usefixtures("toys")
def test_no_worker_is_left_when_the_sweep_is_given_up(tmp_path: Path) -> None:
    runs = planned(tmp_path, 'scenarios = ["corridor"]\nseeds = "2,0"\n')
    outcomes = make_all(runs, workers=2, timeout=60.0)
    assert next(outcomes).run.seed == 0
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
    outcomes.close()  # type: ignore[attr-defined]
    if children.exists():
        assert not [pid for pid in children.read_text().split() if "seed" in Path(f"/proc/{pid}/cmdline").read_text()]


def test_two_sweeps_do_not_write_one_file(tmp_path: Path) -> None:
    create(tmp_path / "a.sweep", "{}", planned(tmp_path))
    with opened(tmp_path / "a.sweep", write=True):
        with pytest.raises(OutputError, match="another sweep writes it"), opened(tmp_path / "a.sweep", write=True):
            pass
        with opened(tmp_path / "a.sweep") as store:  # but it may be read
            assert store.counts() == {"": 8}


def test_results_that_contradict_each_other_are_not_merged(tmp_path: Path) -> None:
    def made(name: str, ate: float, text: str = SPEC) -> Path:
        return recorded(tmp_path / name, text, lambda run: {"final.ate": (ate, "m")} if run.seed == 0 else None)

    first, same, other = made("a.sweep", 0.1), made("b.sweep", 0.1), made("c.sweep", 0.2)
    assert merge([first, same], tmp_path / "both.sweep") == {"": 4, "ok": 4}
    for wrong in (other, made("d.sweep", 0.1, SPEC.replace("corridor", "loop"))):
        with refusal(InputError, file=wrong):
            merge([first, wrong], tmp_path / "new.sweep")
    assert not list(tmp_path.glob("*new*"))


def test_the_specifications_of_the_documentation_are_what_they_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweeps, external = ((ROOT / f"docs/guide/{page}.md").read_text(encoding="utf-8") for page in ("sweeps", "external"))
    assert "# 160 runs" in sweeps
    assert len(planned(tmp_path, sweeps.partition("```toml\n")[2].partition("```")[0])) == 160
    for text in re.findall(r"```toml\n(\[configurations.*?)```", external, re.S):
        given = re.sub(r"^version = .*$", 'version = "1"', text, flags=re.M)
        runs = planned(tmp_path, f'{HERE}seeds = "0"\n{given}')
        assert [run.version for run in runs] == ["1"]
    (tmp_path / "dpkg-query").write_text("#!/bin/sh\necho 1:2.5.8\n", encoding="utf-8")
    (tmp_path / "dpkg-query").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    runs = plan(read_spec(ROOT / "examples/external/mrpt.toml"))
    assert len(runs) == 2 * 5 * 4
    assert {run.version for run in runs if run.configuration == "icp"} == {"1:2.5.8"}


ANYONES = {
    "works": "awk '/^ROBOTLASER1/ {t = $(NF-8) / 2; print $(NF-2), $(NF-10), $(NF-9), 0, 0, 0, sin(t), cos(t)}' "
    "CONVFMT=%.17g OFMT=%.17g {recording} > {out}/path.tum",
    "fails": "echo no map yet >&2; exit 7",
    "nothing": "true",
    "damaged": "echo what is this > {out}/path.tum",
}
"""Anyone's SLAM as a shell command: the first gives back the odometry of the log."""


def external(folder: Path, mode: str, more: str = "") -> Path:
    words = ["sh", "-c", ANYONES.get(mode, mode)]
    return written(
        folder,
        'scenarios = ["corridor"]\nduration = 14\nseeds = "0"\nplatforms = ["lms200"]\n'
        'metrics = ["final.ate", "map_f1", "final.map_near"]\n[configurations.ours]\n'
        f'[configurations.theirs]\ncommand = {json.dumps(words)}\ntrajectory = "path.tum"\n{more}'
        "[vary]\nslam.particles = [1, 2]\n",
        f"{mode if mode in ANYONES else 'mine'}.toml",
    )


@pytest.mark.slow
def test_anyones_slam_is_a_configuration_like_ours_and_where_it_fails_a_row_with_its_error(
    tmp_path: Path, capsys: Capsys
) -> None:
    """It is run once, not once for each value of a key of ours; dead reckoning is worse than SLAM."""
    errors = {
        "fails": "ended with exit code 7: no map yet",
        "nothing": "wrote no path.tum, expected its trajectory in {out}",
        "damaged": "path.tum: not a line of a trajectory",
    }
    text = external(tmp_path, "works").read_text(encoding="utf-8")
    for mode in errors:
        words = json.dumps(["sh", "-c", ANYONES[mode]])
        text += f'[configurations.{mode}]\ncommand = {words}\ntrajectory = "path.tum"\n'
    printed(capsys, "sweep", written(tmp_path, text), "--workers", "1")
    rows = rows_of(tmp_path / "spec.sweep")
    found = {row.run.configuration: row for row in rows}
    assert sorted((row.run.configuration, row.status) for row in rows) == [
        *((mode, "failed") for mode in sorted(errors)), ("ours", "ok"), ("ours", "ok"), ("theirs", "ok")
    ]  # fmt: skip
    for mode, error in errors.items():
        assert error in found[mode].error
        assert "moteslam-" not in found[mode].error  # the temporary folder
    ours, theirs = (found[name].values["final.ate"] or 0.0 for name in ("ours", "theirs"))
    assert 0 < ours < theirs < 0.2
    assert found["theirs"].scores["map_f1"] == {"absent": "no map"}
    assert "slam.particles" in printed(capsys, "sweep", "show", tmp_path / "spec.sweep").splitlines()[0]
    assert (found["theirs"].values["final.map_near"] or 0) > 0


def test_what_is_doubtful_of_a_commands_path_is_told_and_the_way_driven_is_the_truths(
    tmp_path: Path, capsys: Capsys
) -> None:
    """One that writes millimetres, two that fail: on another clock, and with few poses; and a map that is elsewhere."""
    wrong = {
        "mm": ANYONES["works"].replace("$(NF-10), $(NF-9)", "1000 * $(NF-10), 1000 * $(NF-9)"),
        "clock": ANYONES["works"].replace("print $(NF-2)", "print $(NF-2) + 1000"),
        "few": ANYONES["works"].replace(" > ", " | head -5 > "),
        "map": ANYONES["works"] + f"; cp {tmp_path}/map.* {{out}}",
    }
    write_map(tmp_path / "map.pgm", Raster(np.full((9, 9), OCCUPIED, np.int8), 0.05, (50.0, 50.0, 0.0)))
    text = 'scenarios = ["corridor"]\nduration = 14\nseeds = "0"\nplatforms = ["lms200"]\n'
    text += 'metrics = ["final.ate", "map_f1"]\n'
    for mode, words in wrong.items():
        text += f"[configurations.{mode}]\ncommand = {json.dumps(['sh', '-c', words])}\ntrajectory = 'path.tum'\n"
    spec = written(tmp_path, text)
    said = told(capsys, "sweep", spec, "--workers", "1")
    rows = rows_of(tmp_path / "spec.sweep")
    assert [row.status for row in rows] == ["ok", "failed", "failed", "ok"]
    assert [name in str(rows[3].issues) for name in ("100 % outside", "0 % of the walls of its map")] == [True, True]
    assert rows[0].scores["distance"]["by"] == "truth"
    assert rows[0].known["distance"] < 10
    assert {issue["code"] for issue in rows[0].issues} == {"implausible-speed", "sizes-differ"}
    assert "seems to be another one" in rows[1].error
    assert "covers 0.0 m of the " in rows[2].error
    assert "corridor, lms200, seed 0, mm: path.tum: moves at " in said
    assert "moteslam-" not in said
    doubts = [line for line in said.splitlines() if ": failed: " not in line]
    assert told(capsys, "sweep", "show", tmp_path / "spec.sweep").splitlines() == doubts
    assert [issue in page(gather([tmp_path / "spec.sweep"])) for issue in ("moves at ", "seems to be")] == [True, True]


def test_a_commands_version_and_folder_are_those_of_this_computer(tmp_path: Path, capsys: Capsys) -> None:
    """What a program prints first, or a text; it is recorded, shown and exported, and part of a run's name."""
    (tmp_path / "version").write_text("\n 2.5.8 \nmore", encoding="utf-8")
    spec = external(tmp_path, "{here}", 'version = ["cat", "{here}/version"]\n')
    text = spec.read_text()
    configuration = read_spec(spec).configurations["theirs"]
    assert configuration.version == "2.5.8"
    assert configuration.command[-1] == str(tmp_path)
    runs = plan(read_spec(spec))
    assert [run.version for run in runs] == ["", "", "2.5.8"]
    assert plan(read_spec(external(tmp_path, "{here}", 'version = "2.5.8"\n')))[2].id == runs[2].id
    assert plan(read_spec(external(tmp_path, "{here}", 'version = "2.6"\n')))[2].id != runs[2].id
    file = recorded(tmp_path / "a.sweep", text, lambda _: "not now")
    assert "2.5.8" in printed(capsys, "sweep", "show", file)
    assert [row["version"] for row in csv.DictReader(as_csv(rows_of(file)).splitlines())] == ["", "", "2.5.8"]


@pytest.mark.parametrize("words", [["{here}/nothing"], [sys.executable, "-c", "pass"], [sys.executable, "-c", "1/0"]])
def test_a_version_that_cannot_be_had_is_refused(words: list[str], tmp_path: Path) -> None:
    with refusal(ConfigError, field="configurations.theirs.version"):
        read_spec(external(tmp_path, "works", f"version = {json.dumps(words)}\n"))


@pytest.mark.slow
def test_a_cluster_comes_to_the_same_though_a_worker_dies(whole: Path, tmp_path: Path) -> None:
    """Its worker is killed while it makes the second of two runs or so; the nanny starts another one."""
    distributed = pytest.importorskip("distributed")
    create(
        tmp_path / "a.sweep", "{}", [run for run in planned(tmp_path) if (run.seed, run.configuration) == (0, "alone")]
    )
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, processes=True) as cluster,
        opened(tmp_path / "a.sweep", write=True) as store,
    ):
        for count, outcome in enumerate(make_all_on(cluster.scheduler_address, store.pending(), timeout=120.0)):
            store.record(outcome)
            if count == 0:
                os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
    made = results(tmp_path / "a.sweep")
    assert len(made) == 3
    assert all(row in results(whole) for row in made)


def test_variables_of_the_environment_in_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = written(tmp_path, 'recordings = ["${LOGS}/a.log", "b.log"]\n')
    monkeypatch.setenv("LOGS", "/logs")
    assert read_spec(file).recordings == ("/logs/a.log", str(tmp_path / "b.log"))
    monkeypatch.delenv("LOGS")
    with pytest.raises(ConfigError, match=r"spec\.toml: recordings: .*the variable LOGS of the environment to be set"):
        read_spec(file)


SUITE_1 = "e6250b323c16c3c3ba468dcda1f89303fe1a35ee901fcc90a598da2345b8b252"
"""The whole hash of corridor-suite-1."""
RECIPES = {
    *("particles", "lidar-beams", "lidar-range", "range-noise"),
    *("encoder-noise", "yaw-noise", "key-scan-spacing", "people"),
}
ONE = 'scenarios = ["corridor"]\nseeds = "0"\nduration = 11\n'


def runs_of(name: str) -> list[PlannedRun]:
    return plan(read_spec(bundled_specs()[name]), check=False)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({*RECIPES, "corridor-suite-1"}))
def test_each_can_be_run_and_says_what_it_is_for(name: str) -> None:
    spec = read_spec(bundled_specs()[name])
    assert spec.name == name
    assert spec.description.endswith(".")
    assert 100 <= len(plan(spec)) <= 200  # every key and value is checked


def test_the_suite_is_what_it_was() -> None:
    assert digest(runs_of("corridor-suite-1")) == SUITE_1, (
        "the runs of corridor-suite-1 have changed: a spec, scenario or robot was edited. Published tables are of the "
        "runs as they were, so undo that, or leave corridor-suite-1 out and add corridor-suite-2 with a new hash"
    )


def test_the_hash_follows_from_scenarios_and_robots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, folder in (("SCENARIOS", SCENARIOS), ("PLATFORMS", PLATFORMS)):
        shutil.copytree(folder, tmp_path / name)
        monkeypatch.setattr(f"moteslam.eval.sweep.plan.{name}", tmp_path / name)
    runs = runs_of("corridor-suite-1")
    before = digest(runs)

    def changed(file: str, old: str, new: str) -> bool:
        text = (tmp_path / file).read_text(encoding="utf-8")
        assert old in text
        (tmp_path / file).write_text(text.replace(old, new, 1), encoding="utf-8")
        after = digest(runs)
        (tmp_path / file).write_text(text, encoding="utf-8")
        return after != before

    assert changed("SCENARIOS/corridor.toml", "[[world", "[drive]\nspeed = 0.5\n\n[[world")
    assert changed("PLATFORMS/lms200.toml", "range_noise = 0.005", "range_noise = 0.006")
    assert not changed("SCENARIOS/campus.toml", "[[world", "[drive]\nspeed = 0.5\n\n[[world")
    assert not changed("PLATFORMS/lms200.toml", "# technical", "# the technical")
    assert not changed("SCENARIOS/corridor.toml", "description = ", 'description = "Other words." # ')
    assert digest(runs[::-1]) == before
    assert digest(runs[1:]) != before


def test_the_hash_is_of_the_code_of_other_packages_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    about = tmp_path / "mine-1.0.dist-info"
    (tmp_path / "mine_slam").mkdir()
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[moteslam.filters]\nmine = mine_slam.method:METHOD\n")
    (tmp_path / "mine_slam/__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("moteslam.plugins._installed", entry_points)

    def hashes(code: str) -> list[str]:
        (tmp_path / "mine_slam/motion.py").write_text(code)
        of = ((), ('slam.method="mine"',))
        return [digest([PlannedRun(scenario="corridor", seed=0, configuration="c", settings=one)]) for one in of]

    before, after = hashes("SCALE = 1.0"), hashes("SCALE = 0.5")
    assert before[0] == after[0]
    assert before[1] != after[1]


def test_the_hash_is_recorded_and_other_runs_of_the_same_names_are_refused(
    tmp_path: Path, capsys: Capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = written(tmp_path, ONE)
    monkeypatch.setattr("moteslam.eval.sweep.workers.make_all", lambda *_, **__: iter(()))
    assert shown(capsys, "sweep", spec)["hash"] == digest(plan(read_spec(spec)))
    printed(capsys, "sweep", written(tmp_path, f'description = "What it is for."\n{ONE}'))  # words are no other sweep
    monkeypatch.setattr("moteslam.eval.sweep.store.digest", lambda _: "0" * 64)
    assert "its scenarios, robots or plug-ins have changed since its runs" in refused(capsys, "sweep", spec)


def test_they_are_listed_and_printed(capsys: Capsys, tmp_path: Path) -> None:
    lines = printed(capsys, "sweep", "list").splitlines()
    assert [line.split()[0] for line in lines[1:]] == sorted(bundled_specs())
    suite = next(line for line in lines if line.startswith("corridor-suite-1"))
    assert suite.split()[1:3] == ["200", SUITE_1[:16]]
    found = {one["name"]: one for one in shown(capsys, "sweep", "list")}
    assert found["corridor-suite-1"]["hash"] == SUITE_1
    assert planned(tmp_path, printed(capsys, "sweep", "list", "people")) == runs_of("people")
    assert 'name = "people"' in shown(capsys, "sweep", "list", "people")["toml"]


def test_the_published_results_of_the_suite_are_of_its_runs() -> None:
    """So that ``sweep diff`` compares all of them."""
    table = read_table(ROOT / "benchmarks" / "results" / "corridor-suite-1.csv")
    assert set(table) == {run.id for run in runs_of("corridor-suite-1")}
    assert {row["status"] for row in table.values()} == {"ok"}


def test_seeds_as_a_list_and_values_in_their_order(tmp_path: Path) -> None:
    runs = planned(tmp_path, f"{HERE}seeds = [2, 0]\n[vary]\nplatform.lidar.range_max = [12.0, 4.0]\n")
    assert [(run.seed, dict(run.varied)["platform.lidar.range_max"]) for run in runs] == [
        *((2, 12.0), (2, 4.0), (0, 12.0), (0, 4.0))
    ]


def test_a_cluster_that_is_not_there(tmp_path: Path, capsys: Capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("moteslam.eval.sweep.workers.CONNECT", 0.5)
    line = refused(capsys, "sweep", written(tmp_path), "--scheduler", "tcp://127.0.0.1:9")
    assert "--scheduler: no scheduler answers at tcp://127.0.0.1:9" in line


def test_the_hash_follows_from_robots_that_scenarios_name(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('base = "rplidar_a1"\nwidth = 0.3\n', encoding="utf-8")
    scenario = (SCENARIOS / "corridor.toml").read_text(encoding="utf-8")
    (tmp_path / "here.toml").write_text(f'platform = "mine.toml"\n{scenario}', encoding="utf-8")
    runs = planned(tmp_path, ONE.replace('"corridor"', '"here.toml"'))
    before = digest(runs)
    (tmp_path / "mine.toml").write_text('base = "rplidar_a1"\nwidth = 0.31\n', encoding="utf-8")
    assert digest(runs) != before


@pytest.mark.slow
def test_a_sweep_in_which_no_run_ends_well_says_so(tmp_path: Path, capsys: Capsys) -> None:
    text = ONE + """[configurations.bad]\ncommand = ["sh", "-c", "echo '\\u001b[31m<b>' >&2; exit 3"]\n"""
    assert main.run(["sweep", str(written(tmp_path, text)), "--workers", "1"]) == 1
    assert "1 failed" in capsys.readouterr().out
    table = as_csv(rows_of(tmp_path / "spec.sweep"))
    assert r"ended with exit code 3: \x1b[31m<b>" in table
    plot = ["sweep", "plot", str(tmp_path / "spec.sweep"), "--out", str(tmp_path / "a.png"), "--x", "configuration"]
    assert main.run(plot) == 2
