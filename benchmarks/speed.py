"""How fast the kernels are beside the same work in plain C, in Python, and by other libraries.

    python benchmarks/speed.py
    python benchmarks/speed.py --tasks registration integration --rounds 21 --threads 2
    python benchmarks/speed.py --out speed.csv

A ratio is how many times as long the other takes for a unit of the work: above 1 the kernel is faster. Kernel and
others take turns in one process, in random order: a round makes a pair with each other. The median of the pairs' ratios
counts, with its 95 % bootstrap interval. Times are processor time on one thread, by the clock on more, where only what
uses them is measured. Before a task is timed all must give the same result, else it has no figures, and the exit code
is 1. The C loops (loops.c, maps.c) are compiled by CC, gcc, clang or cc.
"""

import argparse
import csv
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the twins
from parts.harness import count, result_file, stamp
from parts.tasks import (
    Contender,
    Loops,
    Task,
    grid_update,
    integration,
    matching,
    raycasting,
    registration,
    search,
    thinning,
)

from moteslam.eval.statistics import median_interval
from moteslam.eval.tables import aligned
from moteslam.kernels import runtime

SOURCES = [Path(__file__).with_name(name) for name in ("loops.c", "maps.c")]
COMPILERS = ("gcc", "clang", "cc")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fPIC")
SHORTEST = 2e-3  # Of a turn [s]: in it a shorter call is made several times
TASKS: dict[str, Callable[[Loops], Task]] = {
    "thinning": thinning,
    "registration": registration,
    "integration": integration,
    "search": search,
    "matching": matching,
    "raycasting": raycasting,
    "grid": grid_update,
}
HEAD = ("task", "unit", "beside", "kernel [us]", "other [us]", "ratio", "low", "high")


class Differs(Exception):  # noqa: N818 - a finding
    """Another does not compute what the kernel does."""


def compile_loops(folder: Path, threads: int) -> tuple[Loops, str]:
    """The C loops, compiled into a folder, and how."""
    compiler = shlex.split(os.environ.get("CC", "")) or list(filter(None, map(shutil.which, COMPILERS)))[:1] or ["cc"]
    openmp, objects = ("-fopenmp",) if threads > 1 else (), [source.with_suffix(".o").name for source in SOURCES]
    # not linked with -ffast-math: loaded, the library would have the whole process take the smallest numbers for 0
    for words in ([*compiler, *FLAGS, *openmp, "-c", *SOURCES], [*compiler, *openmp, "-shared", *objects, "-lm"]):
        subprocess.run(words, cwd=folder, check=True)
    return Loops(folder / "a.out"), " ".join(("C by", *compiler, *FLAGS, *openmp))


def measure(task: Task, rounds: int, threads: int) -> dict[str, tuple[list[float], list[float]]]:
    """By name of each other, what a unit takes the kernel and the other, a pair a round [s].

    Raises:
        Differs: another's result is not the kernel's.
    """
    for name, other in task.others.items():
        for what, theirs in other.results(other.call()).items():
            share, most = task.results[what].differing(theirs), task.results[what].most
            if not share <= most:
                raise Differs(f"{what} of the kernel and of {name} differ: {share:.2g} of them, expected {most:g}")
    clock = time.process_time if threads == 1 else time.perf_counter
    contenders = [task.kernel, *task.others.values()]
    calls, order = [_calls(one) for one in contenders], np.random.default_rng(0)
    times = np.empty((rounds, len(contenders)))
    for row in times:
        for index in order.permutation(len(contenders)):
            if calls[index] > 1:
                contenders[index].call()  # what came before was in the caches
            began = clock()
            for _ in range(calls[index]):
                contenders[index].call()
            row[index] = (clock() - began) / (calls[index] * contenders[index].work)
    ours, *others = times.T.tolist()
    return {name: (ours, theirs) for name, theirs in zip(task.others, others, strict=True)}


def _calls(one: Contender) -> int:
    """How many make a turn."""
    one.call()
    began = time.perf_counter()
    one.call()
    return int(np.ceil(SHORTEST / max(time.perf_counter() - began, 1e-7)))


def digits(value: float | None) -> str:
    """Three of them, without an exponent; none for what so few rounds do not say."""
    return "" if value is None else f"{float(f'{value:.3g}'):.12g}"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="\n".join(["tasks:", *(f"  {name:12}  {task.__doc__}" for name, task in TASKS.items())]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS), metavar="NAME", help="only these")
    parser.add_argument("--rounds", type=count, default=9, help="pairs of each [9]")
    parser.add_argument("--threads", type=count, default=1, help="of the kernels and the C loops [1]")
    parser.add_argument("--out", type=result_file, metavar="FILE.csv", help="the table as CSV")
    options = parser.parse_args(arguments)
    # read when OpenMP is loaded; passive: idle threads would spin, and hold a processor of whoever is next
    os.environ.update(OMP_NUM_THREADS=str(options.threads), OMP_WAIT_POLICY="passive")
    runtime.init("cpu", options.threads)
    about, rows, failed = stamp(), [], 0
    with tempfile.TemporaryDirectory() as folder:
        loops, how = compile_loops(Path(folder), options.threads)
        print(f"{about['date']}, {about['hardware']}, load {about['load']:.1f}, threads: {options.threads}\n{how}")
        for name in options.tasks:
            task = TASKS[name](loops)
            for other, contender in list(task.others.items()):
                if contender.serial and options.threads > 1:
                    del task.others[other]
            if not task.others:
                print(f"{name}: left out, nothing here does its work on several threads")
                continue
            try:
                found = measure(task, options.rounds, options.threads)
            except Differs as error:
                failed = 1
                print(f"{name}: {error}", file=sys.stderr)
                continue
            for other, (ours, theirs) in found.items():
                ratios = np.sort(np.divide(theirs, ours))
                figures = (1e6 * median(ours), 1e6 * median(theirs), float(np.median(ratios)), *median_interval(ratios))
                rows.append([name, task.unit, other, *map(digits, figures)])
    if rows:
        print(aligned([HEAD, *rows]))
    if options.out is not None:
        with options.out.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([(*HEAD, "rounds", "threads", "date", "hardware")])
            more = options.rounds, options.threads, about["date"], about["hardware"]
            csv.writer(file).writerows([*row, *more] for row in rows)
    return failed


if __name__ == "__main__":
    sys.exit(main())
