"""What a run costs, each measured in a fresh process of its own: ``python benchmarks/cost.py --measure NAME JSON``.

The functions here run in that process; the command line is measured from outside, in ``cost.py``.
"""

from __future__ import annotations

import cProfile
import time
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from parts.machine import resident_bytes
from parts.runs import errors, load_log, simulate_case

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from moteslam.robot.recording import Recording
    from moteslam.robot.trajectory import Trajectory
    from moteslam.slam.config import SlamConfig
    from moteslam.slam.mapping.tsdf import TsdfMaps
    from moteslam.slam.run import SlamSession

FIRST = 30
"""Scans that are run before the clock starts, so that the kernels are loaded; its time is given apart."""


def start(given: dict[str, Any]) -> SlamConfig:
    """Start the kernels and resolve the configuration."""
    from moteslam.kernels import runtime
    from moteslam.slam.settings import resolve_config

    runtime.init(given.get("arch", "cpu"), given["threads"])
    return resolve_config(given["preset"], [*given["settings"], f"particles={given['particles']}"])


def filter_alone(given: dict[str, Any]) -> dict[str, Any]:
    """Processor time a scan over a log or a drive: of the filter, and of ``run_slam``, which draws the map at the end.

    ``kernels_ms_a_scan`` is of a run of its own, and what is outside the kernels the difference.
    """
    from moteslam.slam.run import SlamSession

    config = start(given)
    simulated = "scenario" in given
    name = given["scenario" if simulated else "log"]
    case = simulate_case(name, given["seed"], duration=given["duration"]) if simulated else load_log(name)
    loading = time.process_time()
    load_kernels(case.recording, config)
    loading = time.process_time() - loading
    session = SlamSession(case.recording, config, seed=given["seed"])
    began = time.process_time()
    for _ in session:
        pass
    stepped = time.process_time()
    estimate = session.estimate()
    ended = time.process_time()
    scans = len(session)
    kernels = kernel_seconds(case.recording, config, given["seed"])
    return {
        "filter_cpu_ms_a_scan": 1e3 * (stepped - began) / scans,
        "run_slam_cpu_ms_a_scan": 1e3 * (ended - began) / scans,
        "kernels_ms_a_scan": 1e3 * kernels / scans,
        "outside_kernels_ms_a_scan": 1e3 * (stepped - began - kernels) / scans,
        "loading_cpu_s": loading,
        "ate_m": errors(name, estimate, case)["final"],
        "scans": scans,
        "updates": int(estimate.diagnostics["updated"].sum()),
    }


def kernel_seconds(recording: Recording, config: SlamConfig, seed: int) -> float:
    """The wall time in compiled kernels of all scans [s], on one thread the processor time."""
    from moteslam.slam.run import SlamSession

    profile = cProfile.Profile()
    session = SlamSession(recording, config, seed=seed)
    profile.enable()
    for _ in session:
        pass
    profile.disable()
    return sum(entry.totaltime for entry in profile.getstats() if "launch_kernel" in str(entry.code))


def real_time(given: dict[str, Any]) -> dict[str, Any]:
    """How many times faster than it was recorded a simulated scenario is worked through, in wall time, kernels loaded.

    ``slowest_scan_ms`` and ``scan_ms_99`` are of the filter: the longest step, and the one that 99 % are shorter than.
    """
    from moteslam.slam.run import run_slam

    config = start(given)
    case = simulate_case(given["scenario"], given["seed"], duration=given["duration"])
    load_kernels(case.recording, config)
    began, spent = time.perf_counter(), time.process_time()
    estimate = run_slam(case.recording, config, seed=given["seed"])
    wall, spent = time.perf_counter() - began, time.process_time() - spent
    assert case.recording.lidar is not None
    recorded = float(np.ptp(case.recording.lidar.stamps))
    steps = 1e3 * estimate.diagnostics["seconds"]
    return {
        "times_real_time": recorded / wall,
        "wall_s": wall,
        "recorded_s": recorded,
        "cpu_ms_a_scan": 1e3 * spent / len(steps),
        "scan_ms_99": float(np.quantile(steps, 0.99)),
        "slowest_scan_ms": float(steps.max()),
        "ate_m": errors(given["scenario"], estimate, case)["final"],
        "scans": len(steps),
        "updates": int(estimate.diagnostics["updated"].sum()),
    }


def played_again(given: dict[str, Any]) -> dict[str, Any]:
    """Bytes of the particles' maps, and of the whole process, after each round of a ring driven many times."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.robot.trajectory import Trajectory
    from moteslam.slam.run import SlamSession

    config = start(given)
    case = simulate_case("loop", given["seed"], laps=1.0, duration=given["duration"])
    assert case.reference is not None
    recording, truth = repeated(case.recording, case.reference, config, times=given["times"], every=given["every"])
    session = SlamSession(recording, config, seed=given["seed"])
    scans = len(session) // given["times"]
    rounds = [
        {"map_bytes": session.map_bytes, "process_bytes": resident_bytes()}
        for update in session
        if (update.index + 1) % scans == 0
    ]
    second, last = rounds[1], rounds[-1]
    final = session.estimate().trajectory_final
    score = absolute_trajectory_error(final, Trajectory(final.stamps, truth))
    return {
        "maps_last_over_second": last["map_bytes"] / max(second["map_bytes"], 1),
        "maps_mb": last["map_bytes"] / 1e6,
        "process_mb": last["process_bytes"] / 1e6,
        "process_growth_mb": (last["process_bytes"] - second["process_bytes"]) / 1e6,
        "ate_m": score.rmse,
        "scans": len(session),
        "rounds": rounds,
    }


def repeated(
    recording: Recording, truth: Trajectory, config: SlamConfig, *, times: int, every: int
) -> tuple[Recording, NDArray[np.float64]]:
    """A recording that begins and ends at the same place, at rest, repeated ``times`` times; and its true poses.

    Stamps go on, and so do the odometry's poses, which are logged with the scans: a round's own dead reckoning, and
    from its last pose to the next round's first the true step of a few centimetres.

    Args:
        recording: with a lidar and odometry of any kind.
        truth: of it.
        config: how its streams are synchronised.
        times: how many rounds.
        every: takes every ``every``-th scan only.
    """
    from moteslam.robot import se2
    from moteslam.slam.odometry.dead_reckoning import dead_reckon

    lidar = recording.lidar
    assert lidar is not None
    stamps = lidar.stamps[::every]
    true_poses = truth.at(stamps).poses
    path = dead_reckon(recording, config.sync).poses[::every]
    seam = se2.between(true_poses[-1], true_poses[0])
    steps = np.concatenate([np.vstack((seam, se2.between(path[:-1], path[1:])))] * times)
    steps[0] = 0.0
    period = float(stamps[-1] - stamps[0]) + 1.0
    many = replace(
        lidar,
        stamps=np.concatenate([stamps + period * i for i in range(times)]),
        ranges=np.tile(lidar.ranges[::every], (times, 1)),
        odometry=se2.accumulate(steps),
    )
    name = f"{recording.name}, {times} times"
    return recording.replace(name=name, lidar=many, encoders=None, imu=None), np.tile(true_poses, (times, 1))


def load_kernels(recording: Recording, config: SlamConfig) -> None:
    """Run the first scans, so that all the usual kernels are compiled or loaded."""
    from moteslam.slam.run import run_slam

    assert recording.lidar is not None
    few = replace(
        recording.lidar,
        stamps=recording.lidar.stamps[:FIRST],
        ranges=recording.lidar.ranges[:FIRST],
        odometry=None if recording.lidar.odometry is None else recording.lidar.odometry[:FIRST],
    )
    run_slam(recording.replace(lidar=few), config)


def tenths(given: dict[str, Any]) -> dict[str, Any]:
    """Processor time a scan in each tenth of a drive over a campus [ms], and of the last tenth over the first.

    How many scans update the maps depends on how fast the robot drives there, and a scan costs more where more of it is
    known: so the ratio of an update, too; and of the first tenth with maps as large as at the end, but for what is in
    them, over the same with maps as they are.
    """
    from moteslam.slam.run import SlamSession

    config = start(given)
    case = simulate_case("campus", given["seed"], platform="lms200", duration=given["duration"])
    load_kernels(case.recording, config)
    session = SlamSession(case.recording, config, seed=given["seed"])
    scans = len(session) // 10
    updates, spent, updated = iter(session), [], []
    for _ in range(10):
        began = time.process_time()
        updated.append(sum(update.updated for update in islice(updates, scans)))
        spent.append(1e3 * (time.process_time() - began) / scans)
    return {
        "last_over_first": spent[-1] / spent[0],
        "an_update_last_over_first": spent[-1] / updated[-1] / (spent[0] / updated[0]),
        "large_maps_over_small": large_over_small(case.recording, config, given["seed"], session, scans),
        "tenths_cpu_ms_a_scan": spent,
        "tenths_updates": updated,
        "scans": len(session),
    }


def large_over_small(recording: Recording, config: SlamConfig, seed: int, done: SlamSession, scans: int) -> float:
    """Processor time of the first scans with tables and a pool as large as those of a session, over that without.

    Args:
        recording, config, seed: of the session.
        done: the session, at its end.
        scans: how many are run.

    Returns:
        the median of the ratios of five pairs, in turns.
    """
    from moteslam.kernels.tiles import SIDE
    from moteslam.slam.run import SlamSession

    end, ratios = maps_of(done), []
    for pair in range(5):
        spent = {}
        for large in (False, True) if pair % 2 else (True, False):
            session = SlamSession(recording, config, seed=seed)
            if large:
                maps = maps_of(session)
                far = SIDE * maps._config.cell_size * min(end._store.tiles.rows, end._store.tiles.columns) / 2.5
                maps._cover(np.array([(-far, -far, 0.0), (far, far, 0.0)]), 0.0)
                while maps._store.capacity < end._store.capacity:
                    maps._store.enlarge()
            began = time.process_time()
            for _ in islice(session, scans):
                pass
            spent[large] = time.process_time() - began
        ratios.append(spent[True] / spent[False])
    return float(np.median(ratios))


def maps_of(session: SlamSession) -> TsdfMaps:
    """The particles' maps."""
    from moteslam.slam.tsdf.filter import TsdfFilter

    assert isinstance(session._filter, TsdfFilter)
    return session._filter._particles.maps


MEASURES = {"filter": filter_alone, "real time": real_time, "tenths": tenths, "played again": played_again}
"""What can be measured, by name."""
