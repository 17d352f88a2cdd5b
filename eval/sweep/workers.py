"""Processes that make runs side by side, here or on a Dask cluster, and what becomes of those that die or hang.

``python -m moteslam.eval.sweep.workers MODULE`` is such a process: it takes runs as lines of JSON on its input, has the
function ``make`` of the module make them, and writes outcomes to its output. It ends when its input ends.
"""

import importlib
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Generator, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from multiprocessing.connection import wait
from typing import Any, Generic, Protocol, TypeVar

from pydantic_core import to_jsonable_python

from moteslam.errors import BackendError, MoteslamError
from moteslam.eval.sweep.plan import PlannedRun

TRIES = 3
"""A run whose process dies is made again, as the process may have been killed for what others did; this often."""
TAIL = 300  # Characters of what a dead process printed last that go into the error
RUNS = "moteslam.eval.sweep.runs"  # The module that makes the runs of a sweep
WAIT, CONNECT = 0.5, 20
"""Between two looks at the clock, at most, and until a scheduler of a cluster must have answered [s]."""


class Run(Protocol):
    """Something to make; a process is given runs of the same case, one after the other, if there are any."""

    @property
    def case(self) -> Any: ...


R = TypeVar("R", bound=Run)


@dataclass(frozen=True)
class Outcome(Generic[R]):
    """What became of a run: ``ok`` with what ``make`` returned, or ``failed``, ``crashed`` or ``timed out`` and why."""

    run: R
    status: str
    error: str = ""
    result: dict[str, Any] = field(default_factory=dict)


class Worker(Generic[R]):
    """A process that makes a run after another, the first of them at once."""

    def __init__(self, module: str, run: R, *, timed: bool) -> None:
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115 - closed by ``end``
        command = [sys.executable, "-m", "moteslam.eval.sweep.workers", module]
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": self._printed}
        # an interrupt is for the parent
        self._process = subprocess.Popen(command, **pipes, text=True, encoding="utf-8", start_new_session=True)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._output = self._process.stdin, self._process.stdout
        self.begin(run, timed=timed)

    def fileno(self) -> int:
        return self._output.fileno()

    def begin(self, run: R, *, timed: bool) -> None:
        self.run, self.began = run, time.monotonic()
        with suppress(BrokenPipeError):  # dead: its output says so
            self._input.write(json.dumps({"run": to_jsonable_python(run), "timed": timed}) + "\n")
            self._input.flush()

    def take(self) -> Outcome[R] | None:
        """What became of its run; None if the process died."""
        line = self._output.readline()
        if not line.endswith("\n"):
            return None
        result = json.loads(line)
        error = result.get("error")
        return Outcome(self.run, "ok", result=result) if error is None else Outcome(self.run, "failed", error)

    def last_words(self) -> str:
        """How a dead process ended, in one line."""
        code = self._process.wait()
        end = self._printed.seek(0, os.SEEK_END)
        self._printed.seek(max(end - TAIL, 0))
        printed = self._printed.read().decode("utf-8", errors="replace").strip().splitlines()
        how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
        return f"{how}: {printed[-1]}" if printed else how

    def end(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for stream in (self._output, self._input, self._printed):
            with suppress(BrokenPipeError):
                stream.close()


def make_all(
    runs: Iterable[R], *, workers: int, timeout: float = inf, timed: bool = False, module: str = RUNS
) -> Generator[Outcome[R], None, None]:
    """Make runs in so many processes by the ``make`` of a module, and give what became of each as it ends.

    A run that takes longer than ``timeout`` [s] is ended. Where time and memory are measured each has a new process.
    """
    waiting = deque(runs)
    deaths: Counter[int] = Counter()
    alive: list[Worker[R]] = []

    def next_run(case: Any = None) -> R:
        run = next((run for run in waiting if run.case == case), waiting[0])
        waiting.remove(run)
        return run

    def drop(worker: Worker[R]) -> None:
        alive.remove(worker)
        worker.end()

    try:
        while waiting or alive:
            while waiting and len(alive) < workers:
                alive.append(Worker(module, next_run(), timed=timed))
            ready = wait([worker.fileno() for worker in alive], WAIT)
            for worker in [each for each in alive if each.fileno() in ready]:
                run, outcome = worker.run, worker.take()
                if outcome is None:
                    words = worker.last_words()
                    drop(worker)
                    deaths[id(run)] += 1
                    if deaths[id(run)] < TRIES:
                        waiting.appendleft(run)
                        continue
                    outcome = Outcome(run, "crashed", f"its process died {TRIES} times, {words}")
                elif timed or not waiting:
                    drop(worker)
                else:
                    worker.begin(next_run(run.case), timed=timed)
                yield outcome
            for worker in [each for each in alive if time.monotonic() - each.began > timeout]:
                drop(worker)
                yield Outcome(worker.run, "timed out", f"not done after {timeout:g} s")
    finally:
        for worker in alive:
            worker.end()


def make_all_on(
    address: str, runs: Iterable[PlannedRun], *, timeout: float, timed: bool = False
) -> Generator[Outcome[PlannedRun], None, None]:
    """As ``make_all``, on the workers of a cluster, which need moteslam and the recordings under the same paths.

    A run is made in a new process, since Taichi wants the main thread and a run may die. Where a worker of the cluster
    dies the scheduler gives its runs to another one; a run with which several workers died has crashed.
    """
    try:
        from distributed import Client, as_completed

        client = Client(address, timeout=CONNECT, set_as_default=False)
    except ImportError as error:
        problem = "needs Dask, expected it installed: pip install 'moteslam[cluster]'"
        raise BackendError(problem, field="--scheduler") from error
    except (OSError, ValueError) as error:
        raise BackendError(f"no scheduler answers at {address}", field="--scheduler") from error
    with client:
        futures = {
            client.submit(_made, run, timeout, timed=timed, key=f"moteslam-{run.id}", pure=False): run for run in runs
        }
        try:
            for future in as_completed(list(futures), loop=client.loop):
                failure = future.exception()
                if failure is None:
                    yield future.result()
                else:  # the workers that had it died
                    problem = f"{type(failure).__name__}: {failure}".splitlines()[0]
                    yield Outcome(futures[future], "crashed", problem)
        finally:
            client.cancel(list(futures))


def _made(run: PlannedRun, timeout: float, *, timed: bool) -> Outcome[PlannedRun]:
    (outcome,) = make_all([run], workers=1, timeout=timeout, timed=timed)
    return outcome


def main() -> None:
    """Make runs, lines of JSON such as ``{"run": ..., "timed": ...}``, until the input ends."""
    outcomes = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no outcome
    jobs: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            jobs.put(line)
        os.killpg(0, signal.SIGKILL)  # nobody is left to take an outcome: end with all that was begun

    threading.Thread(target=read, daemon=True).start()
    from moteslam.kernels import runtime

    runtime.init("cpu", 1)
    make = importlib.import_module(sys.argv[1]).make
    while True:
        job = json.loads(jobs.get())
        try:
            outcome = make(job["run"], timed=job["timed"])
        except MoteslamError as error:
            outcome = {"error": str(error)}
        except Exception as error:  # one run's fault must not stop the others
            outcome = {"error": f"{type(error).__name__}: {error}"}
        outcomes.write(json.dumps(outcome, allow_nan=False) + "\n")
        outcomes.flush()


if __name__ == "__main__":
    main()
