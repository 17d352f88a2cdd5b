"""Results of several computers, or of several versions of the program on one, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from moteslam.errors import InputError
from moteslam.eval.bench.document import BenchResult, read_result
from moteslam.eval.bench.figures import time_of

UNIT = "arithmetic"
"""The task whose time on a computer is the unit in which those of the others are put."""


@dataclass(frozen=True)
class Compared:
    """A task in several results.

    Attributes:
        task: its name.
        unit: of its work.
        times: what one takes in each result [s]; None where it was not measured or failed.
        speeds: of each the time of the C loop over ours; None where there is none.
    """

    task: str
    unit: str
    times: tuple[float | None, ...]
    speeds: tuple[float | None, ...]

    def ratio(self, which: int) -> float | None:
        """The time in one result over that in the first."""
        first, time = self.times[0], self.times[which]
        return None if not first or time is None else time / first


def read_results(paths: Sequence[str | PathLike[str]]) -> list[BenchResult]:
    """Results that can be compared.

    Raises:
        InputError: one is none, or of another workload than the first.
    """
    found = [read_result(path) for path in paths]
    for path, result in zip(paths, found, strict=True):
        if result.workload != found[0].workload:
            problem = (
                f"{result.workload}, expected {found[0].workload} as in {Path(paths[0]).name}: its tasks are others"
            )
            raise InputError(problem, file=path, field="workload")
    return found


def common_threads(paths: Sequence[str | PathLike[str]], results: Sequence[BenchResult]) -> int:
    """The least number of threads that all were measured on.

    Raises:
        InputError: there is none.
    """
    common = set.intersection(*(set(result.threads) for result in results))
    if not common:
        expected = ", ".join(map(str, results[0].threads))
        problem = f"{', '.join(map(str, results[-1].threads))}, expected one of {expected} as in {Path(paths[0]).name}"
        raise InputError(problem, file=paths[-1], field="threads")
    return min(common)


def compare(results: Sequence[BenchResult], threads: int) -> list[Compared]:
    """Every task that one of the results has times of, in the order of the first that has it."""
    names = list(dict.fromkeys(name for result in results for name, task in result.tasks.items() if task.times))
    return [_compared(name, results, threads) for name in names]


def _compared(name: str, results: Sequence[BenchResult], threads: int) -> Compared:
    tasks = [result.tasks.get(name) for result in results]
    speeds = [None if task is None else task.speed.get(str(threads)) for task in tasks]
    return Compared(
        name,
        next(task.unit for task in tasks if task is not None),
        tuple(time_of(result, name, threads) for result in results),
        tuple(None if speed is None else speed.median for speed in speeds),
    )


def machine_ratios(rows: Sequence[Compared]) -> list[float | None]:
    """How much longer arithmetic alone takes in each result than in the first; None where it was not measured."""
    unit = next((row for row in rows if row.task == UNIT), None)
    return [] if unit is None else [unit.ratio(which) for which in range(len(unit.times))]
