"""The speed of the kernels that runs use, beside their twins and plain C loops, in one run; a dated result file.

    python benchmarks/kernels.py [--out benchmarks/results/kernels-YYYY-MM-DD.json]

Threads are fixed for a process, so each count is measured in a process of its own, in turns; within one, the
contenders take turns too, and the median of all turns counts. Compilation is not counted: the first call is left out.
Processor time stands beside it, which other programs on the machine disturb less. A loop of arithmetic alone measures
how much a second thread can gain at all. A call is whole: what the host prepares for the kernel is counted.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from parts.kernel_rates import SPENT, arithmetic, distance_maps, matching, memory, raycasting, thinning, updating
from parts.machine import save, stamp
from parts.options import result_file
from parts.timing import compile_loops, compiler

ROOT = Path(__file__).parents[1]
ROUNDS = 3
SERIAL = ("grid update",)
"""Kernels that use one thread on purpose: no gain is asked of a second."""


def measure(threads: int) -> dict[str, Any]:
    """All the measurements of one process."""
    os.environ["OMP_NUM_THREADS"] = str(threads)
    os.environ["OMP_WAIT_POLICY"] = "passive"  # else idle OpenMP threads spin, and hold a core of whoever is next
    sys.path.insert(0, str(ROOT / "tests"))  # the NumPy twins
    from moteslam.kernels import runtime

    runtime.init("cpu", threads)
    with tempfile.TemporaryDirectory() as folder:
        loops = compile_loops(Path(__file__).with_name("loops.c"), Path(folder))
        return {
            **arithmetic(loops),
            **memory(loops),
            **distance_maps(loops, threads),
            **thinning(loops),
            **matching(threads),
            **raycasting(loops, threads),
            **updating(loops, threads),
        }


def main() -> None:
    """Measure in processes of their own, print, and write the result file."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--out", type=result_file)
    parser.add_argument("--threads", type=int, help="measure in this process and print JSON")
    options = parser.parse_args()
    if options.threads:
        print(json.dumps(measure(options.threads)))
        return
    runs: dict[int, list[dict[str, Any]]] = {1: [], 2: []}
    for _ in range(ROUNDS):
        for threads, kept in runs.items():
            command = [sys.executable, __file__, "--threads", str(threads)]
            kept.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
    figures = {
        str(threads): {
            task: {name: statistics.median(run[task][name] for run in kept) for name in kept[0][task]}
            for task in kept[0]
        }
        for threads, kept in runs.items()
    }
    ratios: dict[str, float] = {}
    for task, rates in figures["1"].items():
        name = next((name for name in ("moteslam", "c") if name in rates), None)
        if name is not None and SPENT in rates and not task.startswith(SERIAL):
            for what, key in (("two threads / one", name), ("processor time, two threads / one", SPENT)):
                ratios[f"{task}: {what}"] = figures["2"][task][key] / rates[key]
    for number, table in figures.items():
        for task, rates in table.items():
            if "c" in rates and "moteslam" in rates and SPENT in rates:
                ratios[f"{task}, {number} threads: moteslam / C loop"] = rates["moteslam"] / rates["c"]
    for number, table in figures.items():
        for task, rates in table.items():
            print(f"{number} threads  {task}: " + ", ".join(f"{name} {rate:.4g}" for name, rate in rates.items()))
    for what, ratio in ratios.items():
        print(f"{what}: {ratio:.2f}")
    save(options.out, {**stamp(), "compiler": compiler(), "figures by threads": figures, "ratios": ratios})


if __name__ == "__main__":
    main()
