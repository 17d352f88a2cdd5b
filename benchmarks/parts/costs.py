"""What SLAM and simulation cost: the cases of ``cost.py`` but for those of the back end alone."""

from __future__ import annotations

import cProfile
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from parts.harness import Row, memory
from parts.runs import errors, load_log, log_file, reference_file, simulate_case

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording
    from moteslam.slam.config import SlamConfig

FIRST = 30
"""Scans that are run before the clock starts, so that the kernels are loaded."""
WARM_STARTS = 7
NO_FIGURES: dict[bool, tuple[str, ...]] = {False: ("--no-figures",), True: ()}


def python(*words: str, executable: str = sys.executable, **environment: str) -> dict[str, float]:
    """Run Python in a fresh process: its wall time, processor time [s] and most memory [MB].

    Raises:
        RuntimeError: it failed, with its last line of error.
    """
    began = time.perf_counter()
    with tempfile.TemporaryFile("w+") as failed:
        child = subprocess.Popen(
            [executable, *words], stdout=subprocess.DEVNULL, stderr=failed, env=os.environ | environment
        )
        _, code, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(code)
        seconds = time.perf_counter() - began
        failed.seek(0)
        if child.returncode:
            lines = failed.read().strip().splitlines() or [f"exit code {child.returncode}"]
            raise RuntimeError(f"{' '.join(words[:3])}: {lines[-1]}")
    most = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6
    return {"wall_s": seconds, "cpu_s": usage.ru_utime + usage.ru_stime, "peak_mb": most}


def replay(log: Path, out: Path, settings: list[str], *flags: str, **more: str) -> dict[str, float]:
    """What ``moteslam replay`` of a log costs."""
    words = [word for setting in settings for word in ("--set", setting)]
    return python("-m", "moteslam", "replay", str(log), "--out", str(out), *words, *flags, **more)


def start_kernels(settings: list[str], threads: int, **more: Any) -> SlamConfig:
    """Start Taichi and resolve the configuration."""
    from moteslam.kernels import runtime
    from moteslam.slam.settings import resolve_config

    runtime.init("cpu", threads)
    return resolve_config("default", [*settings, *(f"{key}={value}" for key, value in more.items())])


def load_kernels(recording: Recording, config: SlamConfig) -> None:
    """Run the first scans, so that all the usual kernels are compiled or loaded."""
    from moteslam.slam.run import run_slam

    lidar = recording.lidar
    assert lidar is not None
    odometry = None if lidar.odometry is None else lidar.odometry[:FIRST]
    few = replace(lidar, stamps=lidar.stamps[:FIRST], ranges=lidar.ranges[:FIRST], odometry=odometry)
    run_slam(recording.replace(lidar=few), config)


def filter_alone(seed: int, settings: list[str], particles: int, log: str = "", duration: float | None = None) -> Row:
    """Processor time a scan over a log or `corridor`: of the filter; of ``run_slam``, which draws the map at the end.

    ``kernels_ms_a_scan`` is of a run of its own, and what is outside the kernels the difference.
    """
    from moteslam.slam.run import SlamSession

    config = start_kernels(settings, 1, particles=particles)
    case = load_log(log) if log else simulate_case("corridor", seed, duration=duration)
    loading = time.process_time()
    load_kernels(case.recording, config)
    loading = time.process_time() - loading
    session = SlamSession(case.recording, config, seed=seed)
    began = time.process_time()
    for _ in session:
        pass
    stepped = time.process_time()
    estimate = session.estimate()
    ended = time.process_time()
    profile, again = cProfile.Profile(time.process_time), SlamSession(case.recording, config, seed=seed)
    profile.enable()
    for _ in again:
        pass
    profile.disable()
    kernels = sum(entry.totaltime for entry in profile.getstats() if "launch_kernel" in str(entry.code))
    a_scan = 1e3 / len(session)
    return {
        "filter_cpu_ms_a_scan": a_scan * (stepped - began),
        "run_slam_cpu_ms_a_scan": a_scan * (ended - began),
        "kernels_ms_a_scan": a_scan * kernels,
        "outside_kernels_ms_a_scan": a_scan * (stepped - began - kernels),
        "loading_cpu_s": loading,
        "ate_m": errors(estimate, case)["final"],
        "scans": len(session),
        "peak_mb": memory("VmHWM"),
    }


def real_time(seed: int, settings: list[str], particles: int, duration: float | None = None) -> Row:
    """How many times faster than it was recorded `corridor` is worked through, in wall time, kernels loaded."""
    from moteslam.slam.run import run_slam

    config = start_kernels(settings, 2, particles=particles)
    case = simulate_case("corridor", seed, duration=duration)
    load_kernels(case.recording, config)
    began, spent = time.perf_counter(), time.process_time()
    estimate = run_slam(case.recording, config, seed=seed)
    wall, spent = time.perf_counter() - began, time.process_time() - spent
    steps = 1e3 * estimate.diagnostics["seconds"]
    return {
        "times_real_time": float(np.ptp(estimate.trajectory.stamps)) / wall,
        "cpu_ms_a_scan": 1e3 * spent / len(steps),
        "scan_ms_99": float(np.quantile(steps, 0.99)),
        "slowest_scan_ms": float(steps.max()),
        "ate_m": errors(estimate, case)["final"],
        "peak_mb": memory("VmHWM"),
    }


def tenths(seed: int, settings: list[str], duration: float | None = None) -> Row:
    """Processor time of a scan, and of an update of the maps, in the last tenth of a drive over that in the first.

    How many scans update the maps depends on how fast the robot drives there.
    """
    from moteslam.slam.run import SlamSession

    config = start_kernels(settings, 1, particles=30)
    case = simulate_case("campus", seed, platform="lms200", duration=duration)
    load_kernels(case.recording, config)
    session = SlamSession(case.recording, config, seed=seed)
    scans, updates, spent, updated = len(session) // 10, iter(session), [], []
    for _ in range(10):
        began = time.process_time()
        updated.append(sum(update.updated for update in islice(updates, scans)))
        spent.append(1e3 * (time.process_time() - began) / scans)
    return {
        "last_over_first": spent[-1] / spent[0],
        "an_update_last_over_first": spent[-1] / updated[-1] / (spent[0] / updated[0]),
        "tenths_cpu_ms_a_scan": spent,
        "tenths_updates": updated,
        "scans": len(session),
    }


def process(seed: int, settings: list[str], log: str, figures: bool) -> Row:
    """Processor time a scan, memory and error of the whole command."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.robot.trajectories.text import read_tum

    with tempfile.TemporaryDirectory() as folder:
        flags = (*NO_FIGURES[figures], "--threads", "1", "--seed", str(seed))
        cost = replay(log_file(log), Path(folder) / "out", settings, *flags)
        path = read_tum(Path(folder) / "out" / "trajectory_final.tum")
    ate = absolute_trajectory_error(path, read_tum(reference_file(log))).rmse
    return {"cpu_ms_a_scan": 1e3 * cost["cpu_s"] / len(path), "ate_m": ate, "scans": len(path), **cost}


def most_memory(seed: int, settings: list[str], log: str, particles: int) -> Row:
    """The most memory that the command had with many particles."""
    flags = ("--no-figures", "--set", f"particles={particles}", "--threads", "2", "--seed", str(seed))
    with tempfile.TemporaryDirectory() as folder:
        return dict(replay(log_file(log), Path(folder) / "out", settings, *flags))


def start(seed: int, settings: list[str], figures: bool) -> Row:
    """Processor time of the command on a log of three seconds, the first time and from then on."""
    with tempfile.TemporaryDirectory() as folder:
        drive, log = f"{folder}/drive", Path(folder) / "three.log"
        made = ("--platform", "lms200", "--format", "carmen", "--seed", str(seed))
        python("-m", "moteslam", "simulate", "corridor", "--out", drive, *made)
        python("-m", "moteslam", "convert", f"{drive}/corridor.log.gz", str(log), "--start", "7", "--end", "10")
        caches = {"MOTESLAM_CACHE": f"{folder}/kernels", "PYTHONPYCACHEPREFIX": f"{folder}/bytecode"}
        caches["PYTHONDONTWRITEBYTECODE"] = ""
        spent = [
            replay(log, Path(folder) / f"out-{k}", settings, *NO_FIGURES[figures], "--threads", "1", **caches)["cpu_s"]
            for k in range(1 + WARM_STARTS)
        ]
    return {"cold_cpu_s": spent[0], "warm_cpu_s": statistics.median(spent[1:])}


def simulation(seed: int, _settings: list[str], duration: float | None) -> Row:
    """Wall and processor time of the second simulation of `corridor`, scaled to 120 s."""
    start_kernels([], 2)
    simulate_case("corridor", seed, duration=duration)
    wall, spent = time.perf_counter(), time.process_time()
    case = simulate_case("corridor", seed, duration=duration)
    wall, spent = time.perf_counter() - wall, time.process_time() - spent
    assert case.reference is not None
    scale = 120 / float(np.ptp(case.reference.stamps))
    return {"wall_s_for_120_s": wall * scale, "cpu_s_for_120_s": spent * scale}


def camera(seed: int, _settings: list[str], duration: float) -> Row:
    """Simulating and writing with every frame of both cameras."""
    from moteslam.sim.output import write_simulation
    from moteslam.sim.scenario import load_scenario, with_camera
    from moteslam.sim.simulate import simulate

    start_kernels([], 2)
    scenario = with_camera(load_scenario("corridor"))
    assert scenario.camera is not None
    every = scenario.camera.model_copy(update={"gap": 0.0})
    with tempfile.TemporaryDirectory() as folder:
        began, spent = time.perf_counter(), time.process_time()
        drive = simulate(scenario.model_copy(update={"camera": every, "duration": duration}), seed)
        write_simulation(folder, drive)
        wall, spent = time.perf_counter() - began, time.process_time() - spent
        images = list((Path(folder) / "dataRGBD").rglob("*.png"))
        size = sum(path.stat().st_size for path in images)
    return {"wall_s": wall, "cpu_s": spent, "images": len(images), "images_mb": size / 1e6}
