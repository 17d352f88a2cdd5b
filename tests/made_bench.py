"""Results of a bench that nobody measured: every contender takes a given time, in every round."""

from __future__ import annotations

from collections.abc import Mapping

from moteslam.eval.bench.document import BenchResult, Compiler, TaskResult
from moteslam.eval.bench.figures import figure, gains, speeds

TIMES = {
    "arithmetic": {"1": {"c": 1e-6}, "2": {"c": 5e-7}},
    "memory": {"1": {"c": 0.025}, "2": {"c": 0.02}},
    "registration": {"1": {"moteslam": 40e-6, "c": 30e-6}, "2": {"moteslam": 25e-6, "c": 15e-6}},
    "raycasting": {"1": {"moteslam": 50e-9, "c": 800e-9, "pymunk": 2e-6}, "2": {"moteslam": 30e-9}},
    "run-30": {"1": {"moteslam": 0.4e-3}, "2": {"moteslam": 0.5e-3}},
}
"""Of a unit [s], by task, number of threads and contender."""
FACTS = {
    "registration": {"lookups": 1000.0, "bytes": 16000.0},
    "raycasting": {"pymunk near": 1.0},
    "run-30": {"recorded": 30.0, "scans": 1000.0, "ate": 0.0042},
}


def made(
    factor: float = 1.0,
    *,
    times: Mapping[str, Mapping[str, Mapping[str, float]]] = TIMES,
    errors: Mapping[str, str] | None = None,
) -> BenchResult:
    """A result of two threads in which everything takes ``factor`` times as long."""
    tasks = {}
    for name, by_threads in times.items():
        found = {
            threads: {who: figure([[(factor * time, factor * time)]] * 2) for who, time in contenders.items()}
            for threads, contenders in by_threads.items()
        }
        tasks[name] = TaskResult(
            title=name, unit="thing", facts=FACTS.get(name, {}), times=found, speed=speeds(found), gain=gains(found)
        )
    tasks |= {name: TaskResult(title=name, unit="thing", error=error) for name, error in (errors or {}).items()}
    return BenchResult(
        workload=1,
        quick=False,
        date="2026-11-24",
        versions={"moteslam": "0.1.0", "taichi": "1.7.4"},
        hardware={"cpu": "Some Processor", "cores": "2", "memory_gib": "8.0"},
        compiler=Compiler(name="cc 12.2", flags=("-O3",)),
        load=0.0,
        threads=(1, 2),
        rounds=2,
        tasks=tasks,
    )
