"""One run of a sweep, as a worker process makes it: the recording, SLAM over it, and its metrics."""

import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from moteslam.errors import InputError, MoteslamError
from moteslam.eval.metrics.evidence import FINAL, Cost, Evidence
from moteslam.eval.metrics.registry import COSTS, Value, measure
from moteslam.eval.metrics.relations import Relations
from moteslam.eval.scores import doubted, doubted_maps, evidence_of, relations_beside, true_map_beside, truth_file
from moteslam.eval.sweep.plan import COMMAND, PlannedRun
from moteslam.eval.sweep.spec import Configuration, run_program
from moteslam.robot.formats import open_recording
from moteslam.robot.formats.map_server import read_map
from moteslam.robot.formats.ucsd import write_ucsd
from moteslam.robot.formats.written import write_carmen
from moteslam.robot.platforms import write_platform
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories import read_trajectory
from moteslam.robot.trajectories.text import read_tum
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue
from moteslam.sim.logged import with_odometry
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate
from moteslam.slam.config import resolve_config
from moteslam.slam.online import OnlineSlam

MAP_CELL = 0.05  # Of the true map [m]


class Case(NamedTuple):
    """What is run over, and what it is scored by."""

    recording: Recording
    truth: Trajectory | None
    true_map: Raster | None
    relations: Relations | None


_latest: dict[Any, Case] = {}


def load_case(run: PlannedRun) -> Case:
    """Simulate the scenario of a run, or read its recording."""
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
    evidence = replace(evidence, cost=cost if timed else None)
    metres, by = evidence.driven
    scans = len(evidence.trajectories[FINAL])
    values = {"scans": Value(scans, ""), "distance": Value(metres, "m", more={"by": by})}
    costs = [name for name in COSTS if timed and name not in run.metrics]
    values |= measure(evidence, (*run.metrics, *costs) if run.metrics else None)
    told = [issue.as_dict() for issue in (*case.recording.warnings, *issues)]
    told += [issue for issue in doubted(evidence) if issue not in told]
    told += [issue.as_dict() for issue in doubted_maps(evidence, values)] if run.command else []
    if run.command and (part := next((one for one in told if one["code"] in ("few-matched", "not-scored")), None)):
        raise InputError(f"its trajectory: {part['message']}", file=run.command[0][0])
    return {"values": {name: value.as_dict() for name, value in values.items()}, "issues": told}


def _ours(run: PlannedRun, case: Case) -> tuple[Evidence, Cost, tuple[Issue, ...]]:
    config = resolve_config(run.preset, run.for_slam())
    began, clock = time.process_time(), time.perf_counter()
    session = OnlineSlam.over(case.recording, config, seed=run.seed)
    for _ in session:
        pass
    found = session.estimate()
    cpu, wall = time.process_time() - began, time.perf_counter() - clock
    evidence = evidence_of(found, **case._asdict())
    memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return evidence, Cost(cpu, wall, memory, tuple(found.diagnostics["seconds"].tolist())), found.warnings


def estimate(external: Configuration, recording: Recording, seed: int) -> tuple[Trajectory, Raster | None]:
    """Run the command of a configuration over a recording; its trajectory, and its map if it wrote one.

    Nothing but the recording and its robot is given to it; of what it prints the last line of one that fails is kept.
    """
    with tempfile.TemporaryDirectory(prefix="moteslam-") as temporary:
        out, given = Path(temporary) / "out", Path(temporary) / "in"
        out.mkdir()
        given.mkdir()
        try:
            file = given
            if external.format == "ucsd":
                write_ucsd(given, recording, sequence=0)
            else:  # a log has odometry poses, as the base integrates them
                file = given / "recording.log"
                posed = recording.odometry is not None or getattr(recording.lidar, "odometry", None) is not None
                write_carmen(file, recording if posed else with_odometry(recording, gyro=recording.imu is not None))
        except MoteslamError as error:
            problem = f"the recording cannot be given to it in the format {external.format}: {error.problem}"
            raise InputError(problem, file=external.command[0]) from error
        robot = given / "platform.toml"
        write_platform(robot, recording.platform)
        words = list(external.command)
        for name, value in {"recording": file, "platform": robot, "out": out, "seed": seed}.items():
            words = [word.replace(f"{{{name}}}", str(value)) for word in words]
        run_program(words, out)
        if not (out / external.trajectory).is_file():
            raise InputError(f"wrote no {external.trajectory}, expected its trajectory in {{out}}", file=words[0])
        try:
            occupancy = read_map(out / external.map) if (out / external.map).exists() else None
            found = read_trajectory(out / external.trajectory)
            told = (replace(issue, message=issue.message.replace(f"{out}/", "")) for issue in found.warnings)
            return replace(found, warnings=tuple(told)), occupancy
        except MoteslamError as error:  # its file is gone soon
            where = f"{Path(error.file).name}: " if error.file is not None else ""
            raise InputError(f"{where}{error.problem}", file=words[0], field=error.field) from error


def _external(run: PlannedRun, case: Case) -> tuple[Evidence, Cost, tuple[Issue, ...]]:
    external = Configuration(**dict(zip(COMMAND, run.command, strict=False)))
    clock, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    trajectory, occupancy = estimate(external, case.recording, run.seed)
    wall, after = time.perf_counter() - clock, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    evidence = Evidence({FINAL: trajectory}, occupancy=occupancy, **case._asdict())
    return evidence, Cost(cpu, wall, 1024 * after.ru_maxrss), trajectory.warnings
