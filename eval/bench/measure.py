"""A bench from start to end: rounds of processes, each number of threads in turn, and what they came to."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from moteslam.eval.bench.document import BenchResult, Compiler, TaskResult
from moteslam.eval.bench.figures import doubts, figure, gains, speeds
from moteslam.eval.bench.load import busy_processors
from moteslam.eval.bench.loops import Compiled, compile_loops
from moteslam.eval.bench.peers import Peer, run_peers
from moteslam.eval.bench.process import outcomes
from moteslam.eval.bench.workload import TASKS, WORKLOAD
from moteslam.eval.environment import environment

SECONDS, LEAST, ROUNDS = 0.7, 5, 3
"""Of a task in a process: turns for this long [s], but at least this many; and how many processes."""
QUICK_SECONDS, QUICK_LEAST = 0.1, 2
"""The same of a trial, which makes one round."""


@dataclass(frozen=True)
class Wanted:
    """What is to be measured.

    Attributes:
        tasks: names.
        threads: how many, in rising order.
        rounds: processes for each number of threads.
        quick: few turns.
        peers: SLAM programs of others.
    """

    tasks: Sequence[str]
    threads: Sequence[int]
    rounds: int
    quick: bool = False
    peers: Sequence[Peer] = ()

    @property
    def steps(self) -> int:
        """Steps of progress."""
        return (len(self.tasks) * len(self.threads) + len(self.peers)) * self.rounds


def measure(wanted: Wanted, progress: Callable[[int], None]) -> BenchResult:
    """Measure all that is wanted.

    Args:
        wanted: what.
        progress: called with the number of steps done.
    """
    load = busy_processors()
    with tempfile.TemporaryDirectory(prefix="moteslam-") as folder:
        compiled = compile_loops(Path(folder))
        collected: dict[str, _Collected] = {name: _Collected() for name in wanted.tasks}
        done = 0
        with closing(_all(wanted, compiled, collected)) as found:
            for name, threads, outcome in found:
                collected[name].add(threads, outcome)
                done += 1
                progress(done)
    peers = {}
    if wanted.peers:
        peers = run_peers(wanted.peers, wanted.rounds, lambda more: progress(done + more))
    about = environment()
    result = BenchResult(
        workload=WORKLOAD,
        quick=wanted.quick,
        date=date.today().isoformat(),
        versions=about["versions"],
        hardware=about["hardware"],
        compiler=Compiler(name=compiled.compiler, flags=compiled.flags, absent=compiled.absent),
        load=load,
        threads=tuple(wanted.threads),
        rounds=wanted.rounds,
        tasks={name: one.result(name) for name, one in collected.items()},
        peers=peers,
    )
    return result.model_copy(update={"warnings": tuple(doubts(result))})


class _Collected:
    """What the processes found of a task."""

    def __init__(self) -> None:
        self.error = ""
        self._facts: dict[str, float] = {}
        self._turns: dict[str, dict[str, list[Any]]] = {}

    def add(self, threads: int, outcome: dict[str, Any]) -> None:
        """Add what one process found."""
        if "error" in outcome:
            self.error = self.error or outcome["error"]
            return
        self._facts = {**outcome["facts"], **self._facts}
        of_threads = self._turns.setdefault(str(threads), {})
        for name, turns in outcome["turns"].items():
            of_threads.setdefault(name, []).append(turns)

    def result(self, name: str) -> TaskResult:
        """The task as it goes into the document: with an error it has no times, since they are of different work."""
        task = TASKS[name]
        if self.error:
            return TaskResult(title=task.title, unit=task.unit, serial=task.serial, error=self.error)
        times = {
            threads: {who: figure(rounds) for who, rounds in found.items()}
            for threads, found in self._turns.items()
            if found
        }
        return TaskResult(
            title=task.title,
            unit=task.unit,
            serial=task.serial,
            facts=self._facts,
            times=times,
            speed=speeds(times),
            gain={} if task.serial else gains(times),
        )


def _all(
    wanted: Wanted, compiled: Compiled, collected: dict[str, _Collected]
) -> Generator[tuple[str, int, dict[str, Any]], None, None]:
    """Every outcome of every process; a task that failed once is not tried again."""
    seconds, least = (QUICK_SECONDS, QUICK_LEAST) if wanted.quick else (SECONDS, LEAST)
    for _ in range(wanted.rounds):
        for threads in wanted.threads:
            failed = [name for name in wanted.tasks if collected[name].error]
            for name in failed:
                yield name, threads, {"error": ""}
            left = [name for name in wanted.tasks if name not in failed]
            for name, outcome in outcomes(left, threads, compiled, seconds=seconds, least=least):
                yield name, threads, outcome
