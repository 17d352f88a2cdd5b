"""A process that makes runs, one after the other: jobs as lines of JSON on its input, outcomes on its output.

``python -m moteslam.eval.sweep.worker``; it ends with its input. Whoever prints, prints to stderr.
"""

from __future__ import annotations

import json
import os
import queue
import resource
import signal
import sys
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

from moteslam.errors import MoteslamError
from moteslam.eval.beside import reference_file, relations_beside, true_map_beside, truth_file
from moteslam.eval.metrics.evidence import FINAL, Cost, Evidence
from moteslam.eval.metrics.registry import COSTS, Value, measure
from moteslam.eval.metrics.relations import Relations
from moteslam.eval.scores import evidence_of
from moteslam.eval.sweep.external import Command, estimate
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories.text import read_tum
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue
from moteslam.slam.run import SlamSession
from moteslam.slam.settings import resolve_config

MAP_CELL = 0.05
"""Of the true map [m]."""


@dataclass(frozen=True, eq=False)
class Case:
    """What is run over, and what it is scored by."""

    recording: Recording
    truth: Trajectory | None
    true_map: Raster | None
    relations: Relations | None


def load_case(run: PlannedRun) -> Case:
    """Simulate the scenario of a run, or read its recording.

    Raises:
        MoteslamError: it cannot be had.
    """
    if run.scenario:
        from moteslam.sim.scenario import load_scenario
        from moteslam.sim.simulate import simulate

        scenario = load_scenario(
            run.scenario, platform=run.platform or None, noise=run.noise or None, settings=run.for_scenario()
        )
        if run.duration is not None:
            scenario = scenario.model_copy(update={"duration": min(run.duration, scenario.duration)})
        simulation = simulate(scenario, seed=run.seed)
        return Case(simulation.recording, simulation.truth, simulation.true_map(MAP_CELL), None)
    from moteslam.robot.formats import open_recording

    path = Path(run.recording)
    file = reference_file(path) or truth_file(path)
    truth = None if file is None else read_tum(file)
    return Case(open_recording(path), truth, None if truth is None else true_map_beside(path), relations_beside(path))


def make(run: PlannedRun, case: Case, *, timed: bool = False) -> dict[str, Any]:
    """Run SLAM and measure it.

    Args:
        run: which.
        case: its recording and truth.
        timed: measure time and memory: of a process that has done nothing else.

    Returns:
        ``values`` of all metrics, scans and distance, each with ``value`` and ``unit`` or ``absent``; and ``issues``.
    """
    if run.command:
        return _make_external(run, case, timed=timed)
    config = resolve_config(run.preset, run.for_slam())
    began, clock = time.process_time(), time.perf_counter()
    session = SlamSession(case.recording, config, seed=run.seed)
    for _ in session:
        pass
    found = session.estimate()
    cpu, wall = time.process_time() - began, time.perf_counter() - clock
    evidence = evidence_of(found, case.truth, recording=case.recording, true_map=case.true_map)
    evidence = replace(evidence, relations=case.relations)
    if timed:
        memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        evidence = replace(evidence, cost=Cost(cpu, wall, memory, tuple(found.diagnostics["seconds"].tolist())))
    return _measured(run, evidence, (*case.recording.warnings, *found.warnings))


def _make_external(run: PlannedRun, case: Case, *, timed: bool) -> dict[str, Any]:
    """The same with anyone's SLAM: see ``external``."""
    clock, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    trajectory, occupancy = estimate(Command(*run.command), case.recording, run.seed)
    wall, after = time.perf_counter() - clock, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    evidence = Evidence(
        {FINAL: trajectory},
        truth=case.truth,
        relations=case.relations,
        occupancy=occupancy,
        true_map=case.true_map,
        recording=case.recording,
        cost=Cost(cpu, wall, 1024 * after.ru_maxrss) if timed else None,
    )
    return _measured(run, evidence, case.recording.warnings)


def _measured(run: PlannedRun, evidence: Evidence, issues: Iterable[Issue]) -> dict[str, Any]:
    final = evidence.trajectories[FINAL]
    about = {"scans": Value(len(final), ""), "distance": Value(final.length, "m")}
    costs = () if evidence.cost is None else (name for name in COSTS if name not in run.metrics)
    values = about | measure(evidence, (*run.metrics, *costs) if run.metrics else None)
    return {
        "values": {name: value.as_dict() for name, value in values.items()},
        "issues": [issue.as_dict() for issue in issues],
    }


def main() -> None:
    """Take jobs ``{"run": ..., "timed": ...}`` until there are no more."""
    outcomes = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no outcome
    jobs: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin, jobs), daemon=True).start()
    from moteslam.kernels import runtime

    runtime.init("cpu", 1)
    known: tuple[Any, Case] | None = None  # the latest case: the next run may be of it
    while True:
        job = json.loads(jobs.get())
        run = PlannedRun.of(job["run"])
        try:
            if known is None or known[0] != run.case:
                known = None
                known = run.case, load_case(run)
            outcome = make(run, known[1], timed=job["timed"])
        except MoteslamError as error:
            outcome = {"error": str(error)}
        except MemoryError:
            outcome = {"error": "out of memory"}
        except Exception as error:  # one run's fault must not stop the others
            outcome = {"error": f"{type(error).__name__}: {error}"}
        outcomes.write(json.dumps(outcome, allow_nan=False) + "\n")
        outcomes.flush()


def _read(lines: TextIO, jobs: queue.SimpleQueue[str]) -> None:
    """Hand on the jobs; where there are no more, nobody is left to take an outcome: end, with what was begun."""
    for line in lines:
        jobs.put(line)
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    main()
