"""Configurations in pairs: of sweeps and of result folders."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from moteslam.eval.cli import main
from moteslam.eval.cli.compare import populations
from moteslam.eval.statistics import compare
from moteslam.eval.sweep.plan import plan
from moteslam.eval.sweep.spec import read_spec
from moteslam.eval.sweep.store import create, opened
from moteslam.eval.sweep.workers import Outcome


def swept(folder: Path, name: str, factor: float = 1.0, *, failed: tuple[int, ...] = ()) -> Path:
    """Two configurations on ten seeds; the second is off by nine tenths of the first one's error."""
    spec = folder / f"{name}.toml"
    spec.write_text(
        'scenarios = ["corridor"]\n[configurations.plain]\n[configurations.better]\nset = { slam.particles = 50 }\n'
    )
    runs = plan(read_spec(spec))
    create(folder / f"{name}.sweep", "{}", runs)
    with opened(folder / f"{name}.sweep", write=True) as store:
        for run in runs:
            error = factor * (1 + run.seed) * (0.9 if run.configuration == "better" else 1.0)
            values = {"final.ate": {"value": error, "unit": "m"}, "map_f1": {"absent": "no map"}}
            if run.seed in failed and run.configuration == "better":
                store.record(Outcome(run, "failed", "stuck"))
            else:
                store.record(Outcome(run, "ok", result={"values": values}))
    return folder / f"{name}.sweep"


def printed(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main.run(["compare", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main.run(["compare", *map(str, arguments)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


def test_the_configurations_of_a_sweep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = swept(tmp_path, "a", failed=(3,))
    found = json.loads(printed(capsys, file, "--json"))
    better = found["metrics"]["final.ate"]["better"]
    assert found["baseline"] == "plain"
    assert (better["pairs"], better["wins"], better["losses"], better["failed"]) == (10, 9, 1, [0, 1])
    assert better["p"] == pytest.approx(22 / 1024)
    assert better["high"] < 0
    text = printed(capsys, file, "--baseline", "better")
    assert text.startswith("final.ate [m], against better\n")
    assert text.splitlines()[2].split()[:4] == ["plain", "10", "1", "9"]


def test_two_sweeps_are_matched_by_scenario_platform_and_seed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = swept(tmp_path, "a"), swept(tmp_path, "b", 2.0)
    assert list(populations(files)) == ["a: plain", "a: better", "b: plain", "b: better"]
    found = json.loads(printed(capsys, *files, "--json"))["metrics"]["final.ate"]
    assert [found[name]["losses"] for name in ("a: better", "b: plain", "b: better")] == [0, 10, 10]
    assert found["b: plain"]["median"] == pytest.approx(5.5)
    (tmp_path / "other").mkdir()
    alike = swept(tmp_path / "other", "a", 0.5)  # of one name: named by their folders
    found = json.loads(printed(capsys, files[0], alike, "--json"))["metrics"]["final.ate"]
    assert found[f"{alike}: plain"]["wins"] == 10


def test_result_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, value in (("a", 0.2), ("b", 0.1)):
        (tmp_path / name).mkdir()
        metrics = {"final.ate": {"value": value, "unit": "m"}, "map_f1": {"absent": "no map"}}
        (tmp_path / name / "metrics.json").write_text(json.dumps({"metrics": metrics}))
        (tmp_path / name / "run.json").write_text(json.dumps({"recording": "corridor", "seed": 0}))
    found = json.loads(printed(capsys, tmp_path / "a", tmp_path / "b", "--json"))
    (one,) = found["metrics"]["final.ate"].values()
    assert (one["pairs"], one["wins"], one["median"]) == (1, 1, -0.1)
    assert "no run in common" in refused(capsys, tmp_path / "a", tmp_path / "b", "--metric", "map_f1")
    (tmp_path / "b" / "run.json").write_text(json.dumps({"recording": "corridor", "seed": 1}))
    assert "no run in common" in refused(capsys, tmp_path / "a", tmp_path / "b")


def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = swept(tmp_path, "a")
    assert "'best', expected one of 'plain', 'better'" in refused(capsys, file, "--baseline", "best")
    assert "expected one of ate" in refused(capsys, file, "--metric", "final.aet")
    assert "there is no such file" in refused(capsys, tmp_path / "no.sweep")
    (tmp_path / "a").mkdir()
    assert "metrics.json" in refused(capsys, file, tmp_path / "a")
    (tmp_path / "a" / "metrics.json").write_text('{"metrics": {}}')
    (tmp_path / "a" / "run.json").write_text("{}")
    assert "1 configuration, expected two" in refused(capsys, tmp_path / "a")


def timed(folder: Path, times: tuple[float, ...] = (2.0, 8.0, 30.0)) -> Path:
    """Three numbers of particles, the more the better and the slower."""
    spec = folder / "timed.toml"
    spec.write_text('scenarios = ["corridor"]\n[vary]\nslam.particles = [1, 10, 100]\n')
    runs = plan(read_spec(spec))
    create(folder / "timed.sweep", "{}", runs)
    with opened(folder / "timed.sweep", write=True) as store:
        for run in runs:
            count = dict(run.varied)["slam.particles"]
            values = {"final.ate": {"value": (1 + run.seed) / float(count), "unit": "m"}}
            if times:
                values["cpu_per_scan"] = {"value": times[(1, 10, 100).index(int(count))], "unit": "ms"}
            store.record(Outcome(run, "ok", result={"values": values}))
    return folder / "timed.sweep"


def test_the_best_configuration_within_a_budget(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = timed(tmp_path)

    def best(budget: str) -> list[dict]:
        assert main.run(["sweep", "show", str(file), "--budget", budget, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    assert [each["configuration"] for each in best("10 ms")] == [
        "default, slam.particles=10",
        "default, slam.particles=1",
    ]
    assert best("10ms")[1]["best_against_it"]["wins"] == 10
    assert best("1s")[0]["configuration"] == "default, slam.particles=100"
    assert len(best("2000us")) == 1
    assert main.run(["sweep", "show", str(file), "--budget", "10ms"]) == 0
    assert "10 of 10, p 0.002" in capsys.readouterr().out


def test_budgets_that_nothing_meets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = timed(tmp_path)
    for budget, problem in (
        ("1ms", "the cheapest is default, slam.particles=1, 2 ms"),
        ("ten", "--budget: 'ten', expected a time above 0"),
        ("0ms", "expected a time above 0"),
    ):
        assert main.run(["sweep", "show", str(file), "--budget", budget]) == 2
        assert problem in capsys.readouterr().err
    (tmp_path / "b").mkdir()
    assert main.run(["sweep", "show", str(timed(tmp_path / "b", ())), "--budget", "1s"]) == 2
    assert "expected a sweep that was made with --time" in capsys.readouterr().err


def test_where_two_sweeps_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = swept(tmp_path, "a")
    (tmp_path / "b").mkdir()
    second = swept(tmp_path / "b", "a", failed=(4,))
    assert main.run(["sweep", "export", str(first), "--out", str(tmp_path / "a.csv")]) == 0
    capsys.readouterr()
    for same in (first, tmp_path / "a.csv"):
        assert main.run(["sweep", "diff", str(first), str(same)]) == 0
        assert capsys.readouterr().out == "0 differences in 20 runs\n"
    assert main.run(["sweep", "diff", str(second), str(tmp_path / "a.csv")]) == 1
    shown = capsys.readouterr().out.splitlines()
    assert all(line.startswith("corridor, seed 4, better") for line in shown[1:-1])
    assert [line.split()[4] for line in shown[1:-1]] == ["status", "error", "final.ate"]
    assert shown[-1] == "3 differences in 20 runs"
    assert main.run(["sweep", "diff", str(first), str(timed(tmp_path))]) == 2
    assert "no run in common" in capsys.readouterr().err
    (tmp_path / "x.csv").write_text("a,b\n1,2\n")
    assert main.run(["sweep", "diff", str(first), str(tmp_path / "x.csv")]) == 2
    assert "expected a table that `moteslam sweep export` wrote" in capsys.readouterr().err


def test_rounding_is_no_difference() -> None:
    """Of 1e-17 m neither is better."""
    found = compare({0: 0.1, 1: 0.1, 2: 0.1}, {0: 0.1 + 1e-16, 1: 0.1 - 1e-16, 2: 0.0999})
    assert (found.wins, found.losses, found.ties) == (1, 0, 2)
