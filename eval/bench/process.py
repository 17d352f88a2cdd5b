"""The processes that measure, seen from the one that started them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

from moteslam.eval.bench.loops import Compiled, without_folders

TAIL = 300
"""Characters of what a dead process printed last that go into the error."""

Outcome = tuple[str, dict[str, Any]]
"""The name of a task, and ``turns`` with ``facts``, or an ``error``."""


def outcomes(
    tasks: Sequence[str], threads: int, compiled: Compiled, *, seconds: float, least: int
) -> Iterator[Outcome]:
    """Measure tasks one after the other in one process; what became of each as it ends.

    A process that dies is an error of the task that it was at; the others go on in another one. Where the iterator is
    closed, the process ends.

    Args:
        tasks: their names.
        threads: of the process.
        compiled: the C functions.
        seconds, least: see ``in_turns``.
    """
    left = list(tasks)
    while left:
        for name, outcome in _one_process(left, threads, compiled, seconds, least):
            left.remove(name)
            yield name, outcome


def _one_process(
    tasks: Sequence[str], threads: int, compiled: Compiled, seconds: float, least: int
) -> Iterator[Outcome]:
    environment = {
        "OMP_NUM_THREADS": str(threads),
        "OMP_WAIT_POLICY": "passive",  # else idle OpenMP threads spin, and hold a processor of whoever is next
        "OPENBLAS_NUM_THREADS": "1",
    }
    job = {
        "tasks": list(tasks),
        "threads": threads,
        "library": str(compiled.library or ""),
        "openmp": compiled.openmp,
        "seconds": seconds,
        "least": least,
    }
    with tempfile.TemporaryFile() as printed:
        process = subprocess.Popen(
            [sys.executable, "-m", "moteslam.eval.bench.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=printed,
            text=True,
            encoding="utf-8",
            env={**os.environ, **environment},
            start_new_session=True,  # an interrupt is for the parent
        )
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            with suppress(BrokenPipeError):  # dead: its output says so
                process.stdin.write(json.dumps(job) + "\n")
                process.stdin.flush()
            for name in tasks:
                line = process.stdout.readline()
                if not line.endswith("\n"):
                    yield name, {"error": f"its process died, {_last_words(process.wait(), printed)}"}
                    return
                outcome = json.loads(line)
                yield outcome.pop("task"), outcome
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # it leads its own group: what it began ends, too
            process.wait()
            process.stdout.close()
            with suppress(BrokenPipeError):
                process.stdin.close()


def _last_words(code: int, printed: Any) -> str:
    end = printed.seek(0, os.SEEK_END)
    printed.seek(max(end - TAIL, 0))
    lines = printed.read().decode("utf-8", errors="replace").strip().splitlines()
    how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    return f"{how}: {without_folders(lines[-1])}" if lines else how
