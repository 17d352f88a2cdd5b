"""One run of a sweep, as a worker process makes it: the recording, SLAM over it, and its metrics."""

from __future__ import annotations

import resource
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from moteslam.eval.metrics.evidence import FINAL, Cost, Evidence
from moteslam.eval.metrics.registry import COSTS, Value, measure
from moteslam.eval.metrics.relations import Relations
from moteslam.eval.scores import evidence_of, relations_beside, true_map_beside, truth_file
from moteslam.eval.sweep.external import Command, estimate
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories.text import read_tum
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue
from moteslam.slam.online import OnlineSlam
from moteslam.slam.settings import resolve_config

MAP_CELL = 0.05
"""Of the true map [m]."""


class Case(NamedTuple):
    """What is run over, and what it is scored by."""

    recording: Recording
    truth: Trajectory | None
    true_map: Raster | None
    relations: Relations | None


_latest: dict[Any, Case] = {}


def load_case(run: PlannedRun) -> Case:
    """Simulate the scenario of a run, or read its recording."""
    from moteslam.robot.formats import open_recording
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.simulate import simulate

    if run.scenario:
        platform, noise = run.platform or None, run.noise or None
        scenario = load_scenario(run.scenario, platform=platform, noise=noise, settings=run.for_scenario())
        if run.duration is not None:
            scenario = scenario.model_copy(update={"duration": min(run.duration, scenario.duration)})
        simulation = simulate(scenario, seed=run.seed)
        return Case(simulation.recording, simulation.truth, simulation.true_map(MAP_CELL), None)
    path = Path(run.recording)
    file = truth_file(path)
    truth, true_map = (None, None) if file is None else (read_tum(file), true_map_beside(path))
    return Case(open_recording(path), truth, true_map, relations_beside(path))


def make(table: dict[str, Any], *, timed: bool = False) -> dict[str, Any]:
    """Make a run, a ``PlannedRun`` as JSON has it; time and memory are those of a process that did nothing else.

    Returns:
        ``values`` of all metrics, scans and distance, each with ``value`` and ``unit`` or ``absent``; and ``issues``.
    """
    run = PlannedRun.model_validate(table)
    if run.case not in _latest:  # the next run may be of it
        _latest.clear()
        _latest[run.case] = load_case(run)
    case = _latest[run.case]
    evidence, cost, issues = (_external if run.command else _ours)(run, case)
    evidence = replace(evidence, relations=case.relations, cost=cost if timed else None)
    final = evidence.trajectories[FINAL]
    values = {"scans": Value(len(final), ""), "distance": Value(final.length, "m")}
    costs = [name for name in COSTS if timed and name not in run.metrics]
    values |= measure(evidence, (*run.metrics, *costs) if run.metrics else None)
    return {
        "values": {name: value.as_dict() for name, value in values.items()},
        "issues": [issue.as_dict() for issue in (*case.recording.warnings, *issues)],
    }


def _ours(run: PlannedRun, case: Case) -> tuple[Evidence, Cost, tuple[Issue, ...]]:
    config = resolve_config(run.preset, run.for_slam())
    began, clock = time.process_time(), time.perf_counter()
    session = OnlineSlam.over(case.recording, config, seed=run.seed)
    for _ in session:
        pass
    found = session.estimate()
    cpu, wall = time.process_time() - began, time.perf_counter() - clock
    evidence = evidence_of(found, case.truth, recording=case.recording, true_map=case.true_map)
    memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return evidence, Cost(cpu, wall, memory, tuple(found.diagnostics["seconds"].tolist())), found.warnings


def _external(run: PlannedRun, case: Case) -> tuple[Evidence, Cost, tuple[Issue, ...]]:
    command = Command(*run.command)  # type: ignore[arg-type]  # its fields in their order
    clock, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    trajectory, occupancy = estimate(command, case.recording, run.seed)
    wall, after = time.perf_counter() - clock, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    about = {"truth": case.truth, "occupancy": occupancy, "true_map": case.true_map, "recording": case.recording}
    evidence = Evidence({FINAL: trajectory}, **about)  # type: ignore[arg-type]
    return evidence, Cost(cpu, wall, 1024 * after.ru_maxrss), trajectory.warnings
