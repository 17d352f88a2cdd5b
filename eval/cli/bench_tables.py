"""What ``moteslam bench`` prints of a result: the computer, tasks, limits, runs, and programs of others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from moteslam.eval.cli.text import say, say_json, say_table

if TYPE_CHECKING:
    from moteslam.eval.bench.document import BenchResult, Figure, Spread, TaskResult

Row = tuple[str, ...]
SCALES = ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (0.0, "ns"))
"""From what time on [s] in which unit."""


def say_result(result: BenchResult, form: str) -> None:
    """A result: its tasks; as text what else there is of it, too; as JSON or CSV all numbers."""
    if form == "json":
        say_json(result.model_dump(mode="json"))
        return
    if form == "csv":
        say_table(_numbers(result), form)
        return
    rows = _tasks(result)
    if form != "text":
        say_table(rows, form, right=range(2, len(rows[0])))
        return
    say_table(_about(result))
    if len(rows) > 1:  # arithmetic and memory alone stand above
        say()
        say_table(rows, right=range(2, len(rows[0])))
        base, *more = result.threads
        say(f"On {threads_in_words(base)}. Speed: C's time over moteslam's, above 1 where moteslam is faster.")
        if more:
            say("Gain: how many times sooner it is done with more threads.")
    for table in (
        _limits(result),
        _runs(result),
        _modules(result),
        _commands(result),
        [("failed", "why"), *failures(result)],
    ):
        if len(table) > 1:
            say()
            say_table(table, right=() if table[0][0] == "failed" else range(1, len(table[0])))


def _about(result: BenchResult) -> list[Row]:
    """The computer, what was measured there, and what it gives at most."""
    versions, hardware, compiler = result.versions, result.hardware, result.compiler
    names = ("moteslam", "taichi", "numpy", "python")
    memory = f", {hardware['memory_gib']} GiB" if hardware.get("memory_gib", "None") != "None" else ""
    trial = ", a trial" if result.quick else ""
    rows: list[Row] = [
        ("measured", f"{result.date}{trial}, {result.rounds} round{'s' if result.rounds > 1 else ''}"),
        ("versions", ", ".join(f"{name} {versions[name]}" for name in names if name in versions)),
        ("processor", f"{hardware.get('cpu', '')}, {hardware.get('cores', '?')} cores{memory}"),
        ("C", f"none: {compiler.absent}" if compiler.absent else f"{compiler.name} {' '.join(compiler.flags)}"),
    ]
    for name, scale, words in (("memory", 1.0, "{:.1f} GB/s"), ("arithmetic", 1e-6, "{:.2f} G steps/s")):
        rates = [(count, scale / time) for count in result.threads if (time := _time_of(result, name, count))]
        if rates:
            found = ", ".join(f"{words.format(rate)} on {threads_in_words(count)}" for count, rate in rates)
            rows.append((name, found))
    return rows


def _tasks(result: BenchResult) -> list[Row]:
    """A row a task: what a unit takes us and C on the least number of threads, and what more of them gain."""
    base, *more = result.threads
    rows: list[Row] = [("task", "one", "moteslam", "C", "spread", "speed", *(f"gain x{count}" for count in more))]
    for name, task in result.tasks.items():
        figures = task.times.get(str(base), {})
        if "moteslam" not in figures:
            continue
        ours, speed = _shown(figures["moteslam"], base), task.speed.get(str(base))
        rows.append(
            (
                name,
                task.unit,
                time_in_words(ours.median),
                time_in_words(_time_of(result, name, base, "c")),
                f"{100 * (ours.high_quartile - ours.low_quartile) / ours.median:.0f} %",
                "-" if speed is None else f"{speed.median:.2f}",
                *(_gain(task, count) for count in more),
            )
        )
    return rows


def _gain(task: TaskResult, count: int) -> str:
    gain = task.gain.get(str(count))
    return "-" if gain is None else f"{gain.median:.2f}"


def _limits(result: BenchResult) -> list[Row]:
    """What a look at a cell, or a change of it, takes; and what memory alone would need for the bytes of a unit."""
    base = result.threads[0]
    memory = _time_of(result, "memory", base)
    rows: list[Row] = [("limits", "lookups", "each", "in C", "read, written", "memory alone")]
    for name, task in result.tasks.items():
        ours, size, lookups = _time_of(result, name, base), task.facts.get("bytes"), task.facts.get("lookups")
        if ours is None or not lookups:
            continue
        by_c = _time_of(result, name, base, "c")
        alone = None if size is None or memory is None else memory * size / 1e9
        rows.append(
            (
                name,
                f"{lookups:.0f}",
                f"{1e9 * ours / lookups:.2f} ns",
                "-" if by_c is None else f"{1e9 * by_c / lookups:.2f} ns",
                "-" if size is None else f"{size / 1e3:.1f} kB",
                "-" if alone is None else f"{time_in_words(alone)}, {100 * alone / ours:.1f} %",
            )
        )
    return rows


def _runs(result: BenchResult) -> list[Row]:
    """How many times faster than real time the drive goes, by the clock, and how far off it is."""
    rows: list[Row] = [("times real time", *map(threads_in_words, result.threads), "ATE")]
    for name, task in result.tasks.items():
        recorded = task.facts.get("recorded")
        if recorded is None:
            continue
        found = [task.times.get(str(count), {}).get("moteslam") for count in result.threads]
        units = task.facts.get("scans") or 1.0
        shares = ["-" if one is None else f"{recorded / (units * one.wall.median):.0f}" for one in found]
        rows.append((name, *shares, _error(task.facts.get("ate"))))
    return rows


def _modules(result: BenchResult) -> list[Row]:
    """Python modules of others that do one of the tasks."""
    base = result.threads[0]
    rows: list[Row] = [("modules of others", "takes", "moteslam", "ranges within 0.2 m of ours")]
    for name, task in result.tasks.items():
        for other, figure in task.times.get(str(base), {}).items():
            if other not in ("moteslam", "c"):
                near, ours = task.facts.get(f"{other} near"), _time_of(result, name, base)
                share = "-" if near is None else f"{100 * near:.0f} %"
                times = map(time_in_words, (_shown(figure, base).median, ours))
                rows.append((f"{name}: {other}", *times, share))
    return rows


def _commands(result: BenchResult) -> list[Row]:
    """SLAM programs over the drive, from start to end."""
    rows: list[Row] = [("whole commands, start included", "processor time a scan", "ATE")]
    for name, peer in result.peers.items():
        if peer.processor is not None:
            version = f" {peer.version}" if peer.version else ""
            rows.append((f"{name}{version}", time_in_words(peer.processor.median), _error(peer.ate)))
    return rows


def failures(result: BenchResult) -> list[tuple[str, str]]:
    """The tasks and programs that failed, and why."""
    errors = [(name, task.error) for name, task in result.tasks.items()]
    errors += [(name, peer.error) for name, peer in result.peers.items()]
    return [each for each in errors if each[1]]


def _error(ate: float | None) -> str:
    return "-" if ate is None else f"{100 * ate:.2f} cm"


def _numbers(result: BenchResult) -> list[Row]:
    """The table for programs: a row a task, number of threads and contender, times in seconds with all digits."""
    parts = ("median", "low_quartile", "high_quartile", "least", "most")
    kinds = ("wall", "processor")
    rows: list[Row] = [("task", "unit", "threads", "contender", *(f"{k}.{part}" for k in kinds for part in parts))]
    for name, task in result.tasks.items():
        for count, figures in task.times.items():
            for contender, figure in figures.items():
                found = [getattr(getattr(figure, kind), part) for kind in kinds for part in parts]
                rows.append((name, task.unit, count, contender, *map(repr, found)))
    return rows


def threads_in_words(count: int) -> str:
    """``1 thread``, ``2 threads``."""
    from moteslam.robot.wording import counted

    return counted(count, "thread")


def time_in_words(seconds: float | None) -> str:
    """A time with three digits."""
    if seconds is None:
        return "-"
    scale, unit = next((scale, unit) for scale, unit in SCALES if seconds >= scale)
    value = float(f"{seconds / (scale or 1e-9):.3g}")
    return f"{value:.{max(0, 3 - len(str(int(value))))}f} {unit}"


def _time_of(result: BenchResult, name: str, threads: int, contender: str = "") -> float | None:
    from moteslam.eval.bench.figures import time_of

    return time_of(result, name, threads, contender)


def _shown(figure: Figure, threads: int) -> Spread:
    from moteslam.eval.bench.figures import shown

    return shown(figure, threads)
