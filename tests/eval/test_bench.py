"""The result of a bench: its figures, its file, what is printed of it, and results side by side."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_lines import refused
from made_bench import TIMES, made

from moteslam.errors import InputError
from moteslam.eval.bench.comparison import compare, machine_ratios, read_results
from moteslam.eval.bench.document import TaskResult, read_result, write_result
from moteslam.eval.bench.figures import doubts, figure, gains, speeds, spread, time_of
from moteslam.eval.cli import main


def written(folder: Path, name: str = "a.json", factor: float = 1.0, **changes: object) -> Path:
    path = folder / name
    write_result(path, made(factor).model_copy(update=changes))
    return path


def on_threads(count: int) -> dict[str, TaskResult]:
    """The tasks, with the times on this many threads alone."""
    tasks = {}
    for name, task in made().tasks.items():
        kept = {key: {c: v for c, v in getattr(task, key).items() if c == str(count)} for key in ("times", "speed")}
        tasks[name] = task.model_copy(update={**kept, "gain": {}})
    return tasks


def edited(path: Path, *keys: str, value: object) -> Path:
    """The same file with another value somewhere."""
    table = json.loads(path.read_text())
    within = table
    for key in keys[:-1]:
        within = within[key]
    within[keys[-1]] = value
    path.write_text(json.dumps(table))
    return path


def printed(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main.run(["bench", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_the_figure_of_rounds_is_the_median_of_their_medians() -> None:
    found = spread([[1.0, 2.0, 9.0], [4.0, 5.0, 6.0], [2.0, 3.0, 4.0]])
    assert found.rounds == (2.0, 5.0, 3.0)
    assert (found.median, found.least, found.most) == (3.0, 1.0, 9.0)
    assert (found.low_quartile, found.high_quartile) == (2.0, 5.0)
    assert spread([[0.0]]).median > 0  # of a coarse clock


def test_ratios_are_taken_round_by_round() -> None:
    """The machine was twice as slow in the second round: that moves neither ratio."""
    ours, theirs = figure([[(4.0, 3.0)], [(8.0, 6.0)]]), figure([[(2.0, 1.5)], [(4.0, 3.0)]])
    two = figure([[(2.0, 4.0)], [(4.0, 8.0)]])
    times = {"1": {"moteslam": ours, "c": theirs}, "2": {"moteslam": two}}
    (speed,) = speeds(times).values()
    assert (speed.median, speed.least, speed.most) == (0.5, 0.5, 0.5)
    (gain,) = gains(times).values()
    assert (gain.median, gain.least, gain.most) == (2.0, 2.0, 2.0)  # by the clock


def test_one_thread_counts_by_processor_time_and_more_by_the_clock() -> None:
    times = {str(count): {"moteslam": figure([[(2.0, 1.0)]]), "c": figure([[(2.0, 3.0)]])} for count in (1, 2)}
    assert speeds(times)["1"].median == 3.0
    assert speeds(times)["2"].median == 1.0


def test_what_makes_times_doubtful_is_said() -> None:
    assert doubts(made()) == []
    (busy,) = doubts(made().model_copy(update={"load": 0.8}))
    assert "0.8 processors busy" in busy
    shared = {**TIMES, "arithmetic": {"1": {"c": 1e-6}, "2": {"c": 0.9e-6}}}
    (halves,) = doubts(made(times=shared))
    assert "2 threads do plain arithmetic 1.11 times as fast as 1" in halves
    task = made().tasks["run-30"]
    uneven = task.model_copy(update={"times": {"1": {"moteslam": figure([[(1.0, 1.0)], [(1.2, 1.2)]])}}})
    (unsteady,) = doubts(made().model_copy(update={"tasks": {"run-30": uneven}}))
    assert "more than a tenth in run-30" in unsteady


def test_a_result_reads_back_the_same(tmp_path: Path) -> None:
    assert read_result(written(tmp_path)) == made()
    assert time_of(made(), "registration", 1) == pytest.approx(40e-6)
    assert time_of(made(), "registration", 1, "c") == pytest.approx(30e-6)
    assert time_of(made(), "memory", 2) == pytest.approx(0.02)
    assert time_of(made(), "grid", 1) is None


def test_a_result_as_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = printed(capsys, "show", written(tmp_path))
    assert "task          one    moteslam        C  spread  speed  gain x2\n" in text
    assert "registration  thing   40.0 us  30.0 us     0 %   0.75     1.60\n" in text
    assert "raycasting    thing   50.0 ns   800 ns     0 %  16.00     1.67\n" in text
    assert "memory      40.0 GB/s on 1 thread, 50.0 GB/s on 2 threads\n" in text
    assert "arithmetic  1.00 G steps/s on 1 thread, 2.00 G steps/s on 2 threads\n" in text
    # 16 kB at 40 GB/s are 0.4 us, a hundredth of 40
    assert "registration     1000  40.00 ns  30.00 ns        16.0 kB  400 ns, 1.0 %\n" in text
    assert "run-30                 75         60  0.42 cm\n" in text  # 30 s in 0.4 s
    assert "raycasting: pymunk  2.00 us   50.0 ns                        100 %\n" in text
    assert "failed" not in text
    assert max(map(len, text.splitlines())) <= 80


def test_a_result_in_other_formats(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path)
    assert json.loads(printed(capsys, "show", file, "--json")) == json.loads(file.read_text())
    assert printed(capsys, "show", file, "--format", "markdown").startswith("| task | one | moteslam | C |")
    assert r"registration & thing & 40.0 us" in printed(capsys, "show", file, "--format", "latex")
    rows = [line.split(",") for line in printed(capsys, "show", file, "--format", "csv").splitlines()]
    row = dict(zip(rows[0], next(row for row in rows if row[0] == "registration"), strict=True))
    assert (row["threads"], row["contender"], float(row["wall.median"])) == ("1", "moteslam", pytest.approx(40e-6))
    assert len(rows) == 1 + sum(len(figures) for task in TIMES.values() for figures in task.values())


def test_the_machine_alone_stands_above(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_result(tmp_path / "a.json", made(times={name: TIMES[name] for name in ("arithmetic", "memory")}))
    text = printed(capsys, "show", tmp_path / "a.json")
    assert "GB/s on 1 thread" in text
    assert "task" not in text
    assert "Speed" not in text


def test_what_failed_stands_below(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_result(tmp_path / "a.json", made(errors={"search": "scores of kernel and C differ"}))
    assert printed(capsys, "show", tmp_path / "a.json").endswith(
        "\nfailed  why\nsearch  scores of kernel and C differ\n"
    )


def test_a_machine_twice_as_slow_is_alike(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = written(tmp_path, "fast.json"), written(tmp_path, "slow.json", 2.0)
    text = printed(capsys, "compare", *files)
    assert "A: fast  moteslam 0.1.0, Some Processor, 2 cores, 2026-11-24\n" in text
    assert "task          one    A: fast  B: slow  B over A  alike  speed A  speed B\n" in text
    assert "registration  thing  40.0 us  80.0 us      2.00   1.00     0.75     0.75\n" in text
    assert "run-30        thing   400 us   800 us      2.00   1.00        -        -\n" in text
    found = json.loads(printed(capsys, "compare", *files, "--json"))
    assert found["threads"] == 1
    assert found["tasks"]["registration"]["over_first"] == pytest.approx([1.0, 2.0])
    assert found["tasks"]["registration"]["over_first_alike"] == pytest.approx([1.0, 1.0])
    assert found["tasks"]["registration"]["speed"] == pytest.approx([0.75, 0.75])
    assert printed(capsys, "compare", *files, "--format", "csv").splitlines()[0].count(",") == 7
    assert printed(capsys, "compare", *files, *files, "--format", "markdown").splitlines()[0].count("|") == 17


def test_what_one_result_lacks_is_a_gap() -> None:
    few = made(times={name: TIMES[name] for name in ("registration",)})
    rows = {row.task: row for row in compare([few, made()], 1)}
    assert list(rows) == ["registration", "arithmetic", "memory", "raycasting", "run-30"]
    assert rows["run-30"].times == (None, pytest.approx(0.4e-3))
    assert rows["run-30"].ratio(1) is None
    assert machine_ratios(list(rows.values())) == [None, None]  # the first has no arithmetic
    assert machine_ratios([]) == []


def test_results_are_compared_on_threads_that_all_have(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, two = written(tmp_path, "one.json"), written(tmp_path, "two.json", threads=(2,), tasks=on_threads(2))
    assert json.loads(printed(capsys, "compare", one, two, "--json"))["threads"] == 2
    alone = written(tmp_path, "alone.json", threads=(4,), tasks={})
    assert "alone.json: threads: 4, expected one of 1, 2 as in one.json" in refused(
        capsys, "bench", "compare", one, alone
    )


def test_other_work_is_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = written(tmp_path, "a.json"), written(tmp_path, "b.json", workload=2)
    line = refused(capsys, "bench", "compare", *files)
    assert line.startswith(f"moteslam: {files[1]}: workload: 2, expected 1 as in a.json")
    with pytest.raises(InputError, match="workload"):
        read_results(files)
    assert "1 file, expected two or more" in refused(capsys, "bench", "compare", files[0])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("nothing", "not JSON, expected a result of `moteslam bench`"),
        ("[" * 100_000, "not JSON"),
        ("[1, 2]", "no such document, expected a result of `moteslam bench`"),
        ('{"format": "something"}', "no such document"),
        ('{"format": "moteslam bench"}', "format_version: None, expected 1"),
        ('{"format": "moteslam bench", "format_version": 7}', "format_version: 7, expected 1"),
        ('{"format": "moteslam bench", "format_version": 1}', "workload: missing, expected in every result"),
    ],
)
def test_no_result_is_refused(text: str, problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "a.json"
    file.write_text(text)
    assert refused(capsys, "bench", "show", file).startswith(f"moteslam: {file}: {problem}")


@pytest.mark.parametrize(
    ("keys", "value", "problem"),
    [
        (("quik",), True, "quik: unknown key, expected one of format"),
        (("threads",), [], "threads: 0 items, expected at least 1"),
        (("threads",), [0], "threads.0: 0, expected at least 1"),
        (("tasks", "run-30", "times", "1", "moteslam", "wall", "median"), 0, "median: 0, expected above 0"),
        (("tasks", "run-30", "times", "1", "moteslam", "wall", "rounds"), [], "rounds: 0 items, expected at least 1"),
        (("tasks", "run-30", "times", "none"), {}, "tasks.run-30.times.none"),
        (("tasks", "run-30", "times", "1", "c"), {"wal": 1}, "times.1.c.wal: unknown key, expected one of wall, proc"),
        (
            ("tasks", "run-30", "times", "1", "c"),
            {},
            "times.1.c.wall: missing, expected in every tasks.run-30.times.1.c",
        ),
        (
            ("tasks", "run-30", "facts", "scans"),
            float("nan"),
            "tasks.run-30.facts.scans: nan, expected a finite number",
        ),
        (("tasks", "run-30", "error"), 7, "tasks.run-30.error: 7, expected a text"),
        (("threads",), [2, 4], "tasks.arithmetic.times: 1, expected one of 2, 4 as in threads"),
        (
            ("tasks", "run-30", "gain"),
            {"3": {"median": 1, "least": 1, "most": 1}},
            "run-30.gain: 3, expected one of 1, 2",
        ),
    ],
)
def test_a_broken_result_is_refused(
    keys: tuple[str, ...], value: object, problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = edited(written(tmp_path), *keys, value=value)
    line = refused(capsys, "bench", "show", file)
    assert line.startswith(f"moteslam: {file}: ")
    assert problem in line


def test_a_strange_result_is_shown_and_not_obeyed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = edited(written(tmp_path), "hardware", "cpu", value="\x1b[31mred\n")
    for name in ("scans", "recorded", "lookups", "bytes"):
        edited(file, "tasks", "run-30", "facts", name, value=0)
    edited(file, "tasks", "run-30", "times", "2", value={})
    text = printed(capsys, "show", file)
    assert r"\x1b[31mred\n, 2 cores" in text
    assert "\x1b" not in text
    assert "\x1b" not in printed(capsys, "compare", file, file)
