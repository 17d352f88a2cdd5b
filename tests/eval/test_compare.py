"""Configurations in pairs, of sweeps and of result folders; and where two sweeps differ."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_lines import printed, refused
from made_sweeps import Values, recorded

from moteslam.eval.cli import main
from moteslam.eval.page.document import gather, page
from moteslam.eval.runs import compared, read_runs
from moteslam.eval.sweep.plan import PlannedRun

TWO = 'scenarios = ["corridor"]\n[configurations.plain]\n[configurations.better]\nset = { slam.particles = 50 }\n'
OTHER = 'scenarios = ["corridor"]\n[vary]\nslam.particles = [1, 10]\n'


def swept(folder: Path, name: str, factor: float = 1.0, *, failed: tuple[int, ...] = ()) -> Path:
    """Two configurations on ten seeds; the second is off by nine tenths of the first one's error."""

    def result(run: PlannedRun) -> Values | str:
        error = factor * (1 + run.seed) * (0.9 if run.configuration == "better" else 1.0)
        if run.seed in failed and run.configuration == "better":
            return "stuck"
        return {"final.ate": (error, "m"), "map_f1": "no map"}

    folder.mkdir(exist_ok=True)
    return recorded(folder / f"{name}.sweep", TWO, result)


def test_the_configurations_of_a_sweep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = swept(tmp_path, "a", failed=(3,))
    found = json.loads(printed(capsys, "compare", file, "--json"))
    better = found["metrics"]["final.ate"]["better"]["corridor"]
    assert (found["by"], found["baseline"]) == ("configuration", "plain")
    assert (better["pairs"], better["wins"], better["losses"], better["failed"]) == (10, 9, 1, [0, 1])
    assert better["p"] == pytest.approx(22 / 1024)
    assert better["high"] < 0
    text = printed(capsys, "compare", file, "--baseline", "better")
    assert text.startswith("final ATE [cm], against better\n")
    assert text.splitlines()[2].split()[:4] == ["plain", "10", "1", "9"]


def test_two_sweeps_are_matched_by_scenario_platform_and_seed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = swept(tmp_path, "a"), swept(tmp_path, "b", 2.0)
    assert list(compared(read_runs(files))) == ["a: plain", "a: better", "b: plain", "b: better"]
    found = json.loads(printed(capsys, "compare", *files, "--json"))["metrics"]["final.ate"]
    found = {name: each["corridor"] for name, each in found.items()}
    assert [found[name]["losses"] for name in ("a: better", "b: plain", "b: better")] == [0, 10, 10]
    assert found["b: plain"]["median"] == pytest.approx(5.5)
    alike = swept(tmp_path / "other", "a", 0.5)  # of one name: named by their folders
    found = json.loads(printed(capsys, "compare", files[0], alike, "--json"))["metrics"]["final.ate"]
    assert found[f"{alike}: plain"]["corridor"]["wins"] == 10


ROBOTS = 'scenarios = ["corridor", "office"]\nplatforms = ["ucsd", "turtlebot3"]\nseeds = "0-2"\n'


def test_robots_are_compared_where_they_vary_and_each_scenario_has_a_row(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = {"corridor": 1.0, "office": 100.0}
    file = recorded(
        *(tmp_path / "a.sweep", ROBOTS),
        lambda run: {"final.ate": (0.01 * far[run.scenario] * (1 + (run.platform == "turtlebot3")), "m")},
    )
    found = json.loads(printed(capsys, "compare", file, "--json"))
    assert (found["by"], found["baseline"]) == ("platform", "ucsd")
    each = found["metrics"]["final.ate"]["turtlebot3"]
    assert {place: one["median"] for place, one in each.items()} == {
        "corridor": pytest.approx(0.01), "office": pytest.approx(1.0), "2 places together": None
    }  # fmt: skip
    assert [one["pairs"] for one in each.values()] == [3, 3, 6]
    assert each["corridor"]["low"] is None  # three pairs have no interval
    assert json.loads(printed(capsys, "compare", file, "--by", "scenario", "--json"))["baseline"] == "corridor"
    assert "--by: 'seed', expected one of " in refused(capsys, "compare", file, "--by", "seed")


def test_robots_that_drove_other_distances_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def made(name: str, metres: float) -> Path:
        driven = {"ucsd": 10.0, "turtlebot3": metres}
        return recorded(
            *(tmp_path / name, ROBOTS),
            lambda run: {"final.ate": (0.1, "m"), "distance": (driven[run.platform], "m")},
        )

    far, alike = made("far.sweep", 4.0), made("alike.sweep", 9.0)
    assert "driven: ucsd 10.0 m, turtlebot3 4.00 m" in printed(capsys, "compare", far)
    last = printed(capsys, "compare", alike).splitlines()[-1]
    assert last == "wheels, gyro and speed of a platform may differ, too"
    assert "wheels" not in printed(capsys, "compare", far, "--by", "scenario")
    assert printed(capsys, "compare", far, "--format", "csv").count("wheels") == 0
    text = page(gather([far]))
    assert "driven: ucsd 10.0 m, turtlebot3 4.00 m. The" in text
    assert "all else the same" not in text


THREE = 'scenarios = ["corridor"]\nmetrics = ["online.ate", "map_f1"]\nseeds = "0-1"\n[vary]\nslam.particles = [1, 2]\n'


def test_tables_have_the_metrics_of_the_sweep_and_no_success_that_was_not_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def made(name: str, text: str) -> Path:
        return recorded(tmp_path / name, text, lambda _: {"map_f1": (0.9, ""), "online.ate": (0.1, "m")})

    file, limited = made("a.sweep", THREE), made("b.sweep", f'success = {{ "online.ate" = 0.5 }}\n{THREE}')
    for (each, success), other in zip(((file, None), (limited, 2)), ("-", "2"), strict=True):
        groups = json.loads(printed(capsys, "sweep", "show", each, "--json"))["groups"]
        assert list(groups[0]["metrics"]) == ["online.ate", "map_f1"]
        assert (groups[0]["success"] and groups[0]["success"]["count"]) == success
        assert printed(capsys, "sweep", "show", each).splitlines()[1].split()[2] == other
    assert list(json.loads(printed(capsys, "compare", file, "--json"))["metrics"]) == ["online.ate", "map_f1"]
    only = printed(capsys, "compare", file, "--metric", "map_f1", "--json")
    assert list(json.loads(only)["metrics"]) == ["map_f1"]
    text = page(gather([file]))
    assert "success was not measured" in text
    assert "(0 to" not in text
    printed(capsys, "sweep", "plot", file, "--out", tmp_path / "a.png")  # which has no final.ate


def test_result_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, value in (("a", 0.2), ("b", 0.1)):
        (tmp_path / name).mkdir()
        metrics = {"final.ate": {"value": value, "unit": "m"}, "map_f1": {"absent": "no map"}}
        (tmp_path / name / "metrics.json").write_text(json.dumps({"metrics": metrics}))
        (tmp_path / name / "run.json").write_text(json.dumps({"recording": "corridor", "seed": 0}))
    both = tmp_path / "a", tmp_path / "b"
    (each,) = json.loads(printed(capsys, "compare", *both, "--json"))["metrics"]["final.ate"].values()
    one = each["corridor"]
    assert (one["pairs"], one["wins"], one["median"]) == (1, 1, -0.1)
    assert "no run in common" in refused(capsys, "compare", *both, "--metric", "map_f1")
    (tmp_path / "b" / "run.json").write_text(json.dumps({"recording": "corridor", "seed": 1}))
    assert "no run in common" in refused(capsys, "compare", *both)


def test_result_folders_of_two_robots(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, value in (("ucsd", 0.2), ("lms200", 0.1)):
        (tmp_path / name).mkdir()
        figures = {"metrics": {"final.ate": {"value": value, "unit": "m"}}, "scans": int(1000 * value)}
        (tmp_path / name / "metrics.json").write_text(json.dumps(figures))
        about = {"scenario": "corridor", "platform": name, "seed": 0}
        (tmp_path / name / "run.json").write_text(json.dumps(about))
    assert main.run(["compare", str(tmp_path / "ucsd"), str(tmp_path / "lms200"), "--json"]) == 0
    out, err = capsys.readouterr()
    assert [one["wins"] for each in json.loads(out)["metrics"]["final.ate"].values() for one in each.values()] == [1]
    assert err == ""  # other robots have other numbers of scans


@pytest.mark.parametrize(("scans", "told"), [((100, 100), False), ((100, 60), True), ((100, None), False)])
def test_two_recordings_of_one_name_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], scans: tuple[int | None, ...], told: bool
) -> None:
    for name, count in zip("ab", scans, strict=True):
        (tmp_path / name).mkdir()
        figures = {"metrics": {"final.ate": {"value": 0.1, "unit": "m"}}, "scans": count}
        (tmp_path / name / "metrics.json").write_text(json.dumps(figures))
        (tmp_path / name / "run.json").write_text(json.dumps({"recording": "drive-20"}))
    assert main.run(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    assert ("another recording of that name" in capsys.readouterr().err) == told


def test_where_two_sweeps_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = recorded(tmp_path / "other.sweep", OTHER, lambda _: {"final.ate": (1.0, "m")})
    first, second, table = swept(tmp_path, "a"), swept(tmp_path / "b", "a", failed=(4,)), tmp_path / "a.csv"
    printed(capsys, "sweep", "export", first, "--out", table)
    for same in (first, table):
        assert printed(capsys, "sweep", "diff", first, same) == "0 differences in 20 runs\n"
    assert main.run(["sweep", "diff", str(second), str(table)]) == 1
    shown = capsys.readouterr().out.splitlines()
    assert all(line.startswith("corridor, seed 4, better") for line in shown[1:-1])
    assert [line.split()[4] for line in shown[1:-1]] == ["status", "error", "final.ate"]
    assert shown[-1] == "3 differences in 20 runs"
    assert "no run in common" in refused(capsys, "sweep", "diff", first, other)
