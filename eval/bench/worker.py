"""A process that measures tasks on a number of threads: a job as a line of JSON on its input, outcomes on its output.

``python -m moteslam.eval.bench.worker``; it ends with its input. Taichi's threads are fixed for a process, so each
number of them has processes of its own.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from pathlib import Path
from typing import Any, TextIO

from moteslam.errors import MoteslamError
from moteslam.eval.bench.contest import Disagreement
from moteslam.eval.bench.loops import Loops, without_folders
from moteslam.eval.bench.timing import in_turns
from moteslam.eval.bench.workload import TASKS


def measure(name: str, loops: Loops | None, threads: int, *, seconds: float, least: int) -> dict[str, Any]:
    """One task: ``turns`` of each contender, and ``facts``; or ``error``, why there are none.

    Args:
        name: of the task.
        loops: the C functions, if there are any.
        threads: of this process.
        seconds, least: see ``in_turns``.
    """
    try:
        contest = TASKS[name].prepare(loops, threads)
        contest.check()
        turns = in_turns(contest.contenders, seconds=seconds, least=least)
        return {"turns": turns, "facts": {**contest.facts, **(contest.after() if turns else {})}}
    except (Disagreement, MoteslamError) as error:
        return {"error": without_folders(str(error))}
    except MemoryError:
        return {"error": "out of memory"}
    except Exception as error:  # one task's fault must not stop the others
        return {"error": without_folders(f"{type(error).__name__}: {error}".splitlines()[0])}


def main() -> None:
    """Take the job ``{"tasks", "threads", "library", "openmp", "seconds", "least"}``, and print an outcome a task."""
    outcomes = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no outcome
    job = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with, args=(sys.stdin,), daemon=True).start()
    from moteslam.kernels import runtime

    runtime.init("cpu", job["threads"])
    loops = Loops(Path(job["library"]), openmp=job["openmp"]) if job["library"] else None
    for name in job["tasks"]:
        outcome = measure(name, loops, job["threads"], seconds=job["seconds"], least=job["least"])
        outcomes.write(json.dumps({"task": name, **outcome}) + "\n")
        outcomes.flush()
    os._exit(0)  # nothing is left to tidy, and the thread would wait for the end of the input


def _end_with(lines: TextIO) -> None:
    """Where the input ends before the job, nobody is left to take an outcome."""
    lines.read()
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    main()
