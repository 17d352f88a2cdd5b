"""What ``moteslam bench compare`` prints: results side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from string import ascii_uppercase
from typing import TYPE_CHECKING

from moteslam.eval.cli.bench_tables import Row, threads_in_words, time_in_words
from moteslam.eval.cli.text import say, say_json, say_table

if TYPE_CHECKING:
    from moteslam.eval.bench.comparison import Compared
    from moteslam.eval.bench.document import BenchResult


def say_comparison(files: Sequence[Path], results: Sequence[BenchResult], threads: int, form: str) -> None:
    """Results side by side, on a number of threads."""
    from moteslam.eval.bench.comparison import compare, machine_ratios

    compared = compare(results, threads)
    machines = machine_ratios(compared)
    labels = _labels(files)
    if form == "json":
        say_json(
            {
                "threads": threads,
                "files": labels,
                "tasks": {row.task: _as_dict(row, machines) for row in compared},
            }
        )
        return
    rows: list[Row] = [_head(labels)]
    rows += [_row(row, machines, exact=form == "csv") for row in compared]
    if form != "text":
        say_table(rows, form, right=range(2, len(rows[0])))
        return
    say_table([_about(label, result) for label, result in zip(labels, results, strict=True)])
    say()
    say_table(rows, right=range(2, len(rows[0])))
    say(f"On {threads_in_words(threads)}. Over: one time over the other. Alike: as if arithmetic alone took as long.")
    say("Speed: C's time over moteslam's, above 1 where moteslam is faster.")


def _about(label: str, result: BenchResult) -> Row:
    version, hardware = result.versions.get("moteslam", "?"), result.hardware
    trial = ", a trial" if result.quick else ""
    computer = f"{hardware.get('cpu', '')}, {hardware.get('cores', '?')} cores"
    return label, f"moteslam {version}, {computer}, {result.date}{trial}"


def _labels(files: Sequence[Path]) -> list[str]:
    """A letter and the name of each file; where letters end, numbers."""
    return [f"{_letter(k)}: {file.stem}" for k, file in enumerate(files)]


def _letter(which: int) -> str:
    return ascii_uppercase[which] if which < len(ascii_uppercase) else str(which + 1)


def _head(labels: Sequence[str]) -> Row:
    letters = [_letter(k) for k in range(len(labels))]
    others = [column for letter in letters[1:] for column in (f"{letter} over {letters[0]}", "alike")]
    return ("task", "one", *labels, *others, *(f"speed {letter}" for letter in letters))


def _row(row: Compared, machines: Sequence[float | None], *, exact: bool) -> Row:
    cells = [row.task, row.unit, *((_plain(time) if exact else time_in_words(time)) for time in row.times)]
    for which in range(1, len(row.times)):
        cells += [_number(number, exact=exact) for number in (row.ratio(which), _alike(row, machines, which))]
    return (*cells, *(_number(speed, exact=exact) for speed in row.speeds))


def _alike(row: Compared, machines: Sequence[float | None], which: int) -> float | None:
    """The ratio to the first result, over that of arithmetic alone."""
    ratio, machine = row.ratio(which), machines[which] if machines else None
    return None if ratio is None or not machine else ratio / machine


def _as_dict(row: Compared, machines: Sequence[float | None]) -> dict[str, object]:
    which = range(len(row.times))
    return {
        "unit": row.unit,
        "seconds": list(row.times),
        "over_first": [row.ratio(k) for k in which],
        "over_first_alike": [_alike(row, machines, k) for k in which],
        "speed": list(row.speeds),
    }


def _number(value: float | None, *, exact: bool) -> str:
    return _plain(value) if exact else "-" if value is None else f"{value:.2f}"


def _plain(value: float | None) -> str:
    return "" if value is None else repr(value)
