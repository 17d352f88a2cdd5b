"""Processes that make runs side by side, and what becomes of those that die or take too long."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO, Any

from moteslam.eval.sweep.plan import PlannedRun

TRIES = 3
"""A run whose process dies is made again, as the process may have been killed for what others did; this often."""
TAIL = 300
"""Characters of what a dead process printed last that go into the error."""
WAIT = 0.5
"""A look at the clock at least this often [s]."""


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes:
        run: which.
        status: ``ok``, ``failed``, ``crashed`` or ``timed out``.
        error: why it is not ok, in one line.
        result: what the worker gave, of one that is ok.
        seconds: by the clock.
    """

    run: PlannedRun
    status: str
    error: str = ""
    result: dict[str, Any] = field(default_factory=dict)
    seconds: float = 0.0


class Worker:
    """A process that makes runs.

    Attributes:
        run: the one that it makes; None while it waits.
    """

    def __init__(self) -> None:
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115 - closed by ``end``
        self._process = subprocess.Popen(
            [sys.executable, "-m", "moteslam.eval.sweep.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._printed,
            text=True,
            encoding="utf-8",
            start_new_session=True,  # an interrupt is for the parent
        )
        self.run: PlannedRun | None = None
        self.began = 0.0

    @property
    def output(self) -> IO[str]:
        """Where outcomes come from."""
        assert self._process.stdout is not None
        return self._process.stdout

    def begin(self, run: PlannedRun, *, timed: bool) -> None:
        """Give it a run."""
        self.run, self.began = run, time.monotonic()
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # dead: its output says so
            self._process.stdin.write(json.dumps({"run": run.as_dict(), "timed": timed}) + "\n")
            self._process.stdin.flush()

    def take(self) -> dict[str, Any] | None:
        """The outcome of its run; None if the process died."""
        line = self.output.readline()
        return json.loads(line) if line.endswith("\n") else None

    def last_words(self) -> str:
        """How a dead process ended, in one line."""
        code = self._process.wait()
        end = self._printed.seek(0, 2)
        self._printed.seek(max(end - TAIL, 0))
        printed = self._printed.read().decode("utf-8", errors="replace").strip().splitlines()
        how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
        return f"{how}: {printed[-1]}" if printed else how

    def end(self) -> None:
        """Kill it, whatever it is at."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)  # it leads its own group: what it began ends, too
        self._process.wait()
        self.output.close()
        with suppress(BrokenPipeError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        self._printed.close()


def make_all(runs: Iterable[PlannedRun], *, workers: int, timeout: float, timed: bool = False) -> Iterator[Outcome]:
    """Make runs in processes of their own, and give what became of each as it ends.

    Runs of one case follow each other in one process, which has the recording then.

    Args:
        runs: to make.
        workers: how many processes.
        timeout: of a run [s].
        timed: measure time and memory: a new process for each run.
    """
    waiting = deque(runs)
    tries: dict[str, int] = {}
    cases: dict[int, Any] = {}  # the latest of each worker
    selector = selectors.DefaultSelector()
    alive: list[Worker] = []

    def begin(worker: Worker) -> None:
        index = next((k for k, run in enumerate(waiting) if run.case == cases.get(id(worker))), 0)
        run = waiting[index]
        del waiting[index]
        cases[id(worker)] = run.case
        worker.begin(run, timed=timed)

    def start() -> None:
        worker = Worker()
        alive.append(worker)
        selector.register(worker.output, selectors.EVENT_READ, worker)
        begin(worker)

    def drop(worker: Worker) -> None:
        selector.unregister(worker.output)
        alive.remove(worker)
        cases.pop(id(worker), None)
        worker.end()

    try:
        while waiting or alive:
            while waiting and len(alive) < workers:
                start()
            for key, _ in selector.select(WAIT):
                worker: Worker = key.data
                run, seconds = worker.run, time.monotonic() - worker.began
                assert run is not None
                result = worker.take()
                if result is None:
                    words = worker.last_words()
                    drop(worker)
                    tries[run.id] = tries.get(run.id, 0) + 1
                    if tries[run.id] < TRIES:
                        waiting.appendleft(run)
                    else:
                        yield Outcome(run, "crashed", f"its process died {TRIES} times, {words}", seconds=seconds)
                    continue
                if timed or not waiting:
                    drop(worker)
                else:
                    begin(worker)
                error = result.get("error")
                if error is None:
                    yield Outcome(run, "ok", result=result, seconds=seconds)
                else:
                    yield Outcome(run, "failed", error, seconds=seconds)
            for worker in [each for each in alive if time.monotonic() - each.began > timeout]:
                run = worker.run
                assert run is not None
                drop(worker)
                yield Outcome(run, "timed out", f"not done after {timeout:g} s", seconds=timeout)
    finally:
        for worker in alive:
            worker.end()
        selector.close()
