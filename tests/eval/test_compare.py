"""Runs summed up and compared: statistics, pairs of configurations, where sweeps differ, tables in every format."""

import json
import re
from math import inf
from pathlib import Path

import numpy as np
import pytest
from command_lines import Capsys, printed, refused, shown, told
from made_sweeps import Values, recorded, swept

from moteslam.eval.cli import main
from moteslam.eval.page.document import gather, page
from moteslam.eval.runs import compared, read_runs
from moteslam.eval.statistics import Proportion, Summary, compare
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.eval.tables import fitting, latex, markdown, number

TWO = 'scenarios = ["corridor"]\n[configurations.plain]\n[configurations.better]\nset = { slam.particles = 50 }\n'
OTHER = 'scenarios = ["corridor"]\n[vary]\nslam.particles = [1, 10]\n'


def paired(folder: Path, name: str, factor: float = 1.0, *, failed: tuple[int, ...] = (), seeds: int = 10) -> Path:
    """Two configurations on ten seeds; the second is off by nine tenths of the first one's error."""

    def result(run: PlannedRun) -> Values | str:
        error = factor * (1 + run.seed) * (0.9 if run.configuration == "better" else 1.0)
        if run.seed in failed and run.configuration == "better":
            return "stuck"
        return {"final.ate": (error, "m"), "map_f1": "no map"}

    folder.mkdir(exist_ok=True)
    return recorded(folder / f"{name}.sweep", f"seeds = '0-{seeds - 1}'\n{TWO}", result)


def test_the_configurations_of_a_sweep(tmp_path: Path, capsys: Capsys) -> None:
    file = paired(tmp_path, "a", failed=(3,))
    found = shown(capsys, "compare", file)
    better = found["metrics"]["final.ate"]["better"]["corridor"]
    assert (found["by"], found["baseline"]) == ("configuration", "plain")
    assert (better["pairs"], better["wins"], better["losses"], better["failed"]) == (10, 9, 1, [0, 1])
    assert better["p"] == pytest.approx(22 / 1024)
    assert better["high"] < 0
    text = printed(capsys, "compare", file, "--baseline", "better")
    assert text.startswith("final ATE [m], against better\n")
    assert text.splitlines()[2].split()[:4] == ["plain", "10", "1", "9"]
    for form, mark in (("latex", "% "), ("markdown", "")):
        lines = printed(capsys, "compare", file, "--baseline", "better", "--format", form).splitlines()
        assert f"{mark}against better; p is of the sign test" in lines
        assert "failed" in "".join(lines)
    few = paired(tmp_path, "few", seeds=2)
    for form, empty in (("text", False), ("latex", False), ("markdown", False), ("csv", True)):
        text = printed(capsys, "compare", few, "--format", form)
        assert ("failed, first" in text, re.search(r"\b95 \\?%", text.partition("fewer")[0]) is not None) == (
            empty,
            empty,
        )
        assert ("fewer than 6 pairs" in text) == (form != "csv")


def test_a_median_has_its_worst_run_beside_it_in_every_format(tmp_path: Path, capsys: Capsys) -> None:
    file = paired(tmp_path, "a", failed=(3,))
    for form, cells in (
        ("text", " 5.85  2.70 to 8.10  failed"),
        ("csv", "failed"),
        ("latex", r" & 5.85 (2.70 to 8.10) & failed \\"),
    ):
        better = printed(capsys, "sweep", "show", file, "--metric", "final.ate", "--format", form).splitlines()
        assert any(line.endswith(cells) for line in better)
        assert any("medians" in line for line in better) == (form != "csv")


def test_a_program_is_compared_at_equal_values_of_the_scenario(tmp_path: Path, capsys: Capsys) -> None:
    text = 'scenarios = ["corridor"]\n[configurations.plain]\n[configurations.theirs]\ncommand = ["x"]\nversion = "2"\n'
    file = recorded(
        *(tmp_path / "a.sweep", text + "[vary]\nscenario.noise.odometry_scale = [1.0, 1.1]\n"),
        lambda run: {"final.ate": (1.0 + (run.configuration == "plain"), "m")},
    )
    each = shown(capsys, "compare", file, "--baseline", "plain")["metrics"]["final.ate"]["theirs"]
    assert [(one["pairs"], one["wins"]) for one in each.values()] == [(10, 10), (10, 10), (20, 20)]


def test_a_program_which_has_no_key_that_varies_is_compared_with_each_of_its_values(
    tmp_path: Path, capsys: Capsys
) -> None:
    text = 'scenarios = ["corridor"]\n[configurations.plain]\n[configurations.theirs]\ncommand = ["x"]\n'
    file = recorded(
        *(tmp_path / "a.sweep", text + "[vary]\nslam.particles = [1, 2]\n"),
        lambda run: {"final.ate": (1.0 + (run.configuration == "theirs"), "m")},
    )
    found = shown(capsys, "compare", file, "--by", "configuration", "--baseline", "theirs")
    assert (found["by"], list(found["metrics"]["final.ate"])) == (
        "configuration",
        ["plain, slam.particles=1", "plain, slam.particles=2"],
    )
    assert "not drawn, has no slam.particles: theirs" in told(
        capsys, "sweep", "plot", file, "--out", tmp_path / "a.png"
    )
    assert "in common with 1: without slam.particles" in told(capsys, "compare", file, "--by", "slam.particles")


def test_a_named_metric_that_no_run_has_is_told_with_the_reason(tmp_path: Path, capsys: Capsys) -> None:
    file = recorded(
        *(tmp_path / "a.sweep", f"metrics = ['ate', 'map_f1', 'memory']\n{TWO}"),
        lambda run: "stuck" if run.seed == 3 else {"final.ate": (1.0 + run.seed, "m"), "map_f1": "no map"},
    )
    lines = printed(capsys, "sweep", "show", file).splitlines()
    assert [line for line in lines if "no run" in line] == [
        "no run has map_f1: no map",
        "no run has memory: not measured",
    ]
    assert shown(capsys, "sweep", "show", file)["missing"] == {"map_f1": "no map", "memory": "not measured"}
    assert "no run has" not in printed(capsys, "sweep", "show", file, "--metric", "ate")


def test_two_sweeps_are_matched_by_scenario_platform_and_seed(tmp_path: Path, capsys: Capsys) -> None:
    files = paired(tmp_path, "a"), paired(tmp_path, "b", 2.0)
    assert list(compared(read_runs(files))) == ["a: plain", "a: better", "b: plain", "b: better"]
    found = shown(capsys, "compare", *files)["metrics"]["final.ate"]
    found = {name: each["corridor"] for name, each in found.items()}
    assert [found[name]["losses"] for name in ("a: better", "b: plain", "b: better")] == [0, 10, 10]
    assert found["b: plain"]["median"] == pytest.approx(5.5)
    alike = paired(tmp_path / "other", "a", 0.5)  # of one name: named by their folders
    found = shown(capsys, "compare", files[0], alike)["metrics"]["final.ate"]
    assert found[f"{alike}: plain"]["corridor"]["wins"] == 10


ROBOTS = 'scenarios = ["corridor", "office"]\nplatforms = ["ucsd", "turtlebot3"]\nseeds = "0-2"\n'


def test_robots_are_compared_where_they_vary_and_each_scenario_has_a_row(tmp_path: Path, capsys: Capsys) -> None:
    far = {"corridor": 1.0, "office": 100.0}
    file = recorded(
        *(tmp_path / "a.sweep", ROBOTS),
        lambda run: {"final.ate": (0.01 * far[run.scenario] * (1 + (run.platform == "turtlebot3")), "m")},
    )
    found = shown(capsys, "compare", file)
    assert (found["by"], found["baseline"]) == ("platform", "ucsd")
    each = found["metrics"]["final.ate"]["turtlebot3"]
    assert {place: one["median"] for place, one in each.items()} == {
        "corridor": pytest.approx(0.01), "office": pytest.approx(1.0), "2 places together": None
    }  # fmt: skip
    assert [one["pairs"] for one in each.values()] == [3, 3, 6]
    assert each["corridor"]["low"] is None  # three pairs have no interval
    assert shown(capsys, "compare", file, "--by", "scenario")["baseline"] == "corridor"
    assert "--by: 'seed', expected one of " in refused(capsys, "compare", file, "--by", "seed")
    vary = recorded(tmp_path / "vary.sweep", OTHER, lambda run: {"final.ate": (len(run.configured()), "m")})
    of_key = shown(capsys, "compare", vary, "--by", "slam.particles")["metrics"]["final.ate"]["10"]
    assert [(place, one["losses"]) for place, one in of_key.items()] == [("corridor", 10)]


@pytest.mark.parametrize("asked", [("--by", "configuration"), ("--baseline", "plain")])
def test_configurations_alone_are_compared_at_equal_values(
    asked: tuple[str, str], tmp_path: Path, capsys: Capsys
) -> None:
    found = shown(capsys, "compare", swept(tmp_path), *asked)
    assert (found["by"], found["baseline"]) == ("configuration alone", "plain")
    ((other, each),) = found["metrics"]["final.ate"].items()
    assert other == "a_b"
    assert {place: (one["pairs"], one["ties"], one["losses"]) for place, one in each.items()} == {
        "slam.tracking.window=1.0": (4, 4, 0), "slam.tracking.window=2.0": (4, 1, 3), "2 places together": (8, 5, 3)
    }  # fmt: skip
    assert "--baseline: 'a', expected one of 'plain', 'a_b'\n" in refused(
        *(capsys, "compare", tmp_path / "a.sweep", "--by", "configuration", "--baseline", "a")
    )


def result(folder: Path, value: float, scans: int | None = None, **about: object) -> Path:
    """A result folder with this error [m]."""
    folder.mkdir()
    metrics = {"final.ate": {"value": value, "unit": "m"}, "map_f1": {"absent": "no map"}}
    (folder / "metrics.json").write_text(json.dumps({"metrics": metrics, "scans": scans}))
    (folder / "run.json").write_text(json.dumps({"recording": "corridor", "seed": 0, **about}))
    return folder


def test_result_folders(tmp_path: Path, capsys: Capsys) -> None:
    both = result(tmp_path / "a", 0.2), result(tmp_path / "b", 0.1)
    (each,) = shown(capsys, "compare", *both)["metrics"]["final.ate"].values()
    one = each["corridor"]
    assert (one["pairs"], one["wins"], one["median"]) == (1, 1, -0.1)
    assert "which no run has" in refused(capsys, "compare", *both, "--metric", "map_f1")
    (tmp_path / "b" / "run.json").write_text(json.dumps({"recording": "corridor", "seed": 1}))
    problem = f"no run in common with {both[0]} that has final.ate; seed 0 there, 1 here"
    assert problem in refused(capsys, "compare", *both)
    assert "there is no such file or folder" in refused(capsys, "compare", both[0], tmp_path / "c")
    assert "is a folder, expected a file that `moteslam sweep` made" in refused(capsys, "sweep", "diff", *both)
    assert "--metric: 'nees', which no run has; expected one of final.ate" in refused(
        *(capsys, "compare", *both, "--metric", "nees")
    )


def test_a_metric_without_a_trajectory_is_that_of_each(tmp_path: Path, capsys: Capsys) -> None:
    file = paired(tmp_path, "a")
    for line in (("compare", file), ("sweep", "show", file)):
        assert printed(capsys, *line, "--metric", "ate") == printed(capsys, *line, "--metric", "final.ate")


@pytest.mark.parametrize(
    ("scans", "platforms", "doubted"),
    [((9, 9), "aa", False), ((9, 6), "aa", True), ((9, None), "aa", False), ((9, 6), "ab", False)],
)
def test_two_recordings_of_one_name_are_told_but_not_of_two_robots(
    tmp_path: Path, capsys: Capsys, scans: tuple[int | None, ...], platforms: str, doubted: bool
) -> None:
    both = [result(tmp_path / f"{k}", 0.1, scans[k], platform=platforms[k]) for k in (0, 1)]
    assert ("another recording of that name" in told(capsys, "compare", *both)) == doubted


def test_where_two_sweeps_differ(tmp_path: Path, capsys: Capsys) -> None:
    other = recorded(tmp_path / "other.sweep", OTHER, lambda _: {"final.ate": (1.0, "m")})
    first, second, table = (
        paired(tmp_path, "a"),
        paired(tmp_path / "b", "a", failed=(4,)),
        tmp_path / "a.csv",
    )
    printed(capsys, "sweep", "export", first, "--out", table)
    for same in (first, table):
        assert printed(capsys, "sweep", "diff", first, same) == "0 differences in 20 runs\n"
    assert main.run(["sweep", "diff", str(second), str(table)]) == 1
    shown = capsys.readouterr().out.splitlines()
    assert all(line.startswith("corridor, seed 4, better") for line in shown[1:-1])
    assert [line.split()[4] for line in shown[1:-1]] == ["status", "error", "final.ate"]
    assert shown[-1] == "3 differences in 20 runs"
    assert "no run in common" in refused(capsys, "sweep", "diff", first, other)


def test_a_summary_of_some_runs() -> None:
    summary = Summary.of([3.0, 1.0, 2.0, None, 5.0, 4.0])
    assert (summary.runs, summary.failed, summary.absent) == (6, 0, 1)
    assert (summary.median, summary.low_quartile, summary.high_quartile) == (3.0, 2.0, 4.0)
    assert (summary.best, summary.worst) == (1.0, 5.0)
    assert (summary.low, summary.high) == (None, None)  # five values
    six = Summary.of([3.0, 1.0, 2.0, 6.0, 5.0, 4.0])
    assert 1.0 <= six.low <= 3.5 <= six.high <= 6.0
    assert Summary.of([3.0, 1.0, 2.0, 6.0, 5.0, 4.0]) == six
    upwards = Summary.of([1.0, 2.0], better="higher")
    assert (upwards.best, upwards.worst) == (2.0, 1.0)


def test_failed_runs_are_the_worst_and_never_averaged() -> None:
    values = [0.1, 0.2, 0.3]
    for failed, median in ((0, 0.2), (1, 0.25), (2, 0.3), (3, inf), (4, inf)):
        summary = Summary.of(values, failed)
        assert summary.median == pytest.approx(median)
        assert (summary.runs, summary.failed, summary.best) == (3 + failed, failed, 0.1)
    assert Summary.of(values, 2, better="higher").median == 0.1
    assert Summary.of([]).median is None
    assert Summary.of([None]).median is None


def test_the_interval_of_the_median_holds_it_as_often_as_it_says() -> None:
    rng = np.random.default_rng(4)
    inside = 0
    for _ in range(300):
        summary = Summary.of(rng.lognormal(size=25).tolist())
        inside += summary.low <= 1.0 <= summary.high
    assert 0.91 <= inside / 300 <= 0.985


@pytest.mark.parametrize(
    ("count", "total", "low", "high"), [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (81, 263, 0.2553, 0.3662)]
)
def test_wilsons_interval(count: int, total: int, low: float, high: float) -> None:
    """The last one is the example of Newcombe (1998), table I."""
    share = Proportion(count, total)
    assert share.interval == pytest.approx((low, high), abs=1e-4)
    assert share.as_dict() == {
        "share": count / total, "low": share.interval[0], "high": share.interval[1], "count": count, "total": total
    }  # fmt: skip
    assert Proportion(5, 5).range == ""
    assert Proportion(6, 6).range == " (61 to 100 %)"


def test_pairs_leave_out_what_makes_a_seed_harder() -> None:
    """Each seed is as different as the seeds are; the second configuration is a little better on each."""
    rng = np.random.default_rng(3)
    seeds = {seed: float(value) for seed, value in enumerate(rng.lognormal(size=40))}
    better = {seed: 0.95 * value for seed, value in seeds.items()}
    found = compare(seeds, better)
    assert (found.pairs, found.wins, found.losses, found.ties) == (40, 40, 0, 0)
    assert found.p < 1e-9
    assert found.high < 0
    assert compare(seeds, better, better="higher").losses == 40
    same = compare(seeds, seeds)
    assert (same.wins, same.ties, same.p, same.median) == (0, 40, 1.0, 0.0)


def test_failed_runs_lose() -> None:
    first = {0: 0.1, 1: 0.1, 2: None, 3: None, 4: 0.1}
    second = {0: None, 1: 0.2, 2: 0.3, 3: None, 9: 0.1}
    found = compare(first, second)
    assert (found.pairs, found.wins, found.losses, found.ties, found.apart) == (4, 1, 2, 1, 2)
    assert found.failed == (2, 2)
    assert found.median == pytest.approx(0.1)
    lost = compare({0: 0.1, 1: 0.1}, {0: None, 1: None})
    assert lost.median == inf
    nothing = compare({}, {})
    assert (nothing.pairs, nothing.median, nothing.p) == (0, None, 1.0)


def test_rounding_is_no_difference() -> None:
    """Of 1e-17 m neither is better."""
    found = compare({0: 0.1, 1: 0.1, 2: 0.1}, {0: 0.1 + 1e-16, 1: 0.1 - 1e-16, 2: 0.0999})
    assert (found.wins, found.losses, found.ties) == (1, 0, 2)


NASTY = r"a|b \ `c` <d> *e* _f_ [g] ~h~ $i$ & #j 100 % {k} ^l"
HEAD = ("name", "value")


def test_markdown_marks_nothing_up() -> None:
    lines = markdown([HEAD, (NASTY, "1.5")]).splitlines()
    assert lines[:2] == ["| name | value |", "|---|---:|"]
    assert lines[2] == (r"| a\|b \\ \`c\` \<d\> \*e\* \_f\_ \[g\] \~h\~ \$i\$ \& \#j 100 % \{k\} ^l | 1.5 |")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("\\", r"\textbackslash{}"),
        ("#$", r"\#\$"),
        ("~", r"\textasciitilde{}"),
        ("<|>", r"\textless{}\textbar{}\textgreater{}"),
        ("[m] *", "{[}m{]} {*}"),
        ("a--b---c", "a-{}-b-{}-{}-c"),
        ("``a''", "`{}`a'{}'"),
    ],
)
def test_latex_prints_what_it_is_given(text: str, expected: str) -> None:
    assert latex([(text,)]).splitlines()[3] == rf"{expected} \\"


@pytest.mark.parametrize(
    ("unit", "values", "shown"),
    [
        ("m", [0.001697, -8.899e-05], ["mm", "1.70", "-0.0890"]),
        ("m", [0.153, None], ["cm", "15.3", "-"]),
        ("m", [30.0, 0.001, -0.002], ["mm", "30000", "1.00", "-2.00"]),
        ("m", [12.0, 0.05], ["m", "12.0", "0.0500"]),
        ("deg", [0.02, float("inf")], ["deg", "0.0200", "failed"]),
        ("", [12345.0, 0.0], ["", "12345", "0"]),
    ],
)
def test_numbers_have_a_unit_that_fits(unit: str, values: list[float | None], shown: list[str]) -> None:
    unit, factor = fitting(unit, values)
    assert [unit, *(number(None if value is None else factor * value) for value in values)] == shown


def test_a_difference_that_is_there_is_not_shown_as_none() -> None:
    assert [number(value, sign=True) for value in (-3e-5, 0.5, 0.0)] == ["-0.0000300", "+0.500", "0"]


def test_robots_that_drove_other_distances_are_told(tmp_path: Path, capsys: Capsys) -> None:
    def made(name: str, metres: float) -> Path:
        driven = {"ucsd": 10.0, "turtlebot3": metres}
        return recorded(
            *(tmp_path / name, ROBOTS),
            lambda run: {"final.ate": (0.1, "m"), "distance": (driven[run.platform], "m")},
        )

    far, alike = made("far.sweep", 4.0), made("alike.sweep", 9.0)
    assert "driven, by SLAM's path: ucsd 10.0 m, turtlebot3 4.00 m" in printed(capsys, "compare", far)
    head, *lines = printed(capsys, "sweep", "show", far).splitlines()
    assert "driven, by SLAM's path [m]" in head
    assert [line.split()[-3] for line in lines[:4]] == ["10.0", "4.00"] * 2
    assert "driven" not in printed(capsys, "sweep", "show", alike)
    last = printed(capsys, "compare", alike).splitlines()[-1]
    assert last == "wheels, gyro and speed of a platform may differ, too"
    assert "wheels" not in printed(capsys, "compare", far, "--by", "scenario")
    assert printed(capsys, "compare", far, "--format", "csv").count("wheels") == 0
    text = page(gather([far]))
    assert "driven, by SLAM&#39;s path: ucsd 10.0 m, turtlebot3 4.00 m. The" in text
    assert "all else the same" not in text


def test_a_report_has_signed_differences_and_no_pairs_where_nothing_is_in_common(tmp_path: Path) -> None:
    def one(_: PlannedRun) -> Values:
        return {"final.ate": (1.0, "m")}

    worse = paired(tmp_path, "a"), paired(tmp_path, "b", 2.0)
    assert re.search(">[+]5.50</td><td[^>]*>[+]3.00 to [+]8.00</td>", page(gather(worse)))
    alone = (recorded(tmp_path / f"{name}.sweep", f'scenarios = ["{name}"]', one) for name in ("corridor", "office"))
    apart = tuple(alone)
    assert [name in page(gather(apart)) for name in ("<h2>Pairs", "#pairs", "<h2>Runs")] == [False, False, True]


def test_runs_without_a_result_are_counted_on_stderr(tmp_path: Path, capsys: Capsys) -> None:
    file = swept(tmp_path, whole=False)
    assert "13 not made yet, 3 ok" in told(capsys, "sweep", "show", file, "--format", "csv")
