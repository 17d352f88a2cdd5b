"""What SLAM and simulation cost: processor time, speed beside real time, memory.

    python benchmarks/cost.py --set backend.method=none --out cost.csv
    python benchmarks/cost.py --cases filter start --seeds 3
    python benchmarks/cost.py --against ../older-clone

| case | what |
|---|---|
| filter | `intel_key_scans`, 30 particles, 1 thread: processor time of the filter and of `run_slam` a scan |
| every_scan_1, every_scan_30 | `corridor` (1081 beams, 40 Hz), 1 and 30 particles, 1 thread: the same, and in kernels |
| live | `corridor` message by message, 1 thread: all calls from one scan that is taken in to the next |
| process | `filter` by `moteslam replay`, without figures: the whole process |
| real_time | `corridor`, 1000 particles, 2 threads: against real time |
| memory | `intel_raw_part` by `moteslam replay`, 1000 particles, 2 threads: most memory |
| tenths | `campus` (1.6 km, 181 beams), 30 particles, 1 thread: the last tenth beside the first |
| start, start_figures | three seconds of a CARMEN log by `moteslam replay`: without kernels and bytecode, then with |
| simulation | lidar, encoders and IMU of `corridor`, 2 threads, warm, scaled to 120 s |
| solver | 2000 nodes on nested rings, 5000 edges, a tenth of the loops false: all stages of the non-convexity |
| joint | the joint registration of 1000 scans of 180 beams, the first nodes of `campus`, from their solved graph |
| campus_keys, campus | `campus` as key scans of a poor odometry, and every scan: loop search and graph beside filter |

Each case runs in a fresh process, with the kernels in the cache on disk; loading them is given apart, and counted where
the whole process is measured. The error of the same run stands beside its cost. --quick takes a short log and 25 s of
the scenarios: a trial. --against runs the same command in this checkout and in another one, in turns, each with the
Python of its own `.venv`, and prints the ratios of their processor times. Bars are of the filter alone.
"""

import cProfile
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from parts.back_end_costs import back_end, joint, solver
from parts.harness import Bar, Row, arguments, benchmark, count, memory, parsed, status
from parts.runs import add, errors, load_log, log_file, messages, reference_file, simulate_case, start_kernels

from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories.text import read_tum
from moteslam.slam.config import SlamConfig
from moteslam.slam.online import OnlineSlam, run_slam

FIRST = 30  # Scans that are run before the clock starts, so that the kernels are loaded
WARM_STARTS = 7


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
    spent = usage.ru_utime + usage.ru_stime
    return {"wall_s": seconds, "cpu_s": spent, "peak_mb": 1024e-6 * usage.ru_maxrss}


def replay(log: Path, out: Path, settings: list[str], *flags: str, **more: str) -> dict[str, float]:
    words = [word for setting in settings for word in ("--set", setting)]
    return python("-m", "moteslam", "replay", str(log), "--out", str(out), *words, *flags, **more)


def load_kernels(recording: Recording, config: SlamConfig) -> None:
    """Run the first scans, so that all the usual kernels are compiled or loaded."""
    lidar = recording.lidar
    assert lidar is not None
    odometry = None if lidar.odometry is None else lidar.odometry[:FIRST]
    few = replace(lidar, stamps=lidar.stamps[:FIRST], ranges=lidar.ranges[:FIRST], odometry=odometry)
    run_slam(recording.replace(lidar=few), config)


def filter_alone(seed: int, settings: list[str], particles: int, log: str = "", duration: float | None = None) -> Row:
    """Processor time a scan over a log or `corridor`: of the filter; of ``run_slam``, which draws the map at the end.

    ``kernels_ms_a_scan`` is of a run of its own, and what is outside the kernels the difference.
    """
    config = start_kernels(settings, 1, particles=particles)
    case = load_log(log) if log else simulate_case("corridor", seed, duration=duration)
    loading = time.process_time()
    load_kernels(case.recording, config)
    loading = time.process_time() - loading
    session = OnlineSlam.over(case.recording, config, seed=seed)
    began = time.process_time()
    for _ in session:
        pass
    stepped = time.process_time()
    estimate = session.estimate()
    ended = time.process_time()
    profile, again = cProfile.Profile(time.process_time), OnlineSlam.over(case.recording, config, seed=seed)
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
    config = start_kernels(settings, 1, particles=30)
    case = simulate_case("campus", seed, platform="lms200", duration=duration)
    load_kernels(case.recording, config)
    session = OnlineSlam.over(case.recording, config, seed=seed)
    scans, updates, spent, updated = len(session) // 10, iter(session), [], []
    for _ in range(10):
        began = time.process_time()
        updated.append(sum(update.updated for update in islice(updates, scans)))
        spent.append(1e3 * (time.process_time() - began) / scans)
    return {
        "last_over_first": spent[-1] / spent[0],
        "an_update_last_over_first": spent[-1] / max(updated[-1], 1) / (spent[0] / max(updated[0], 1)),
        "tenths_cpu_ms_a_scan": spent,
        "tenths_updates": updated,
        "scans": len(session),
    }


def process(seed: int, settings: list[str], log: str, threads: int, particles: int) -> Row:
    """Processor time a scan, most memory, and error of the whole command where there is a reference trajectory."""
    flags = ("--no-figures", "--threads", str(threads), "--seed", str(seed))
    with tempfile.TemporaryDirectory() as folder:
        cost = replay(log_file(log), Path(folder) / "out", [f"particles={particles}", *settings], *flags)
        path = read_tum(Path(folder) / "out" / "trajectory_final.tum")
    row: Row = {"cpu_ms_a_scan": 1e3 * cost["cpu_s"] / len(path), "scans": len(path), **cost}
    reference = reference_file(log)
    if reference.suffix == ".tum":
        row["ate_m"] = absolute_trajectory_error(path, read_tum(reference)).rmse
    return row


def start(seed: int, settings: list[str], figures: bool) -> Row:
    """Processor time of the command on a log of three seconds, the first time and from then on."""
    with tempfile.TemporaryDirectory() as folder:
        drive, log = f"{folder}/drive", Path(folder) / "three.log"
        made = ("--platform", "lms200", "--format", "carmen", "--seed", str(seed))
        python("-m", "moteslam", "simulate", "corridor", "--out", drive, *made)
        python("-m", "moteslam", "convert", f"{drive}/corridor.log.gz", str(log), "--start", "7", "--end", "10")
        caches = {"MOTESLAM_CACHE": f"{folder}/kernels", "PYTHONPYCACHEPREFIX": f"{folder}/bytecode"}
        caches["PYTHONDONTWRITEBYTECODE"] = ""
        flags = ("--threads", "1") if figures else ("--threads", "1", "--no-figures")
        spent = [
            replay(log, Path(folder) / f"out-{k}", settings, *flags, **caches)["cpu_s"] for k in range(1 + WARM_STARTS)
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


def live(seed: int, settings: list[str], duration: float | None) -> Row:
    """Seconds of the calls by which a robot's messages are added, from one scan that is taken in to the next."""
    config = start_kernels(settings, 1)
    recording = simulate_case("corridor", seed, duration=duration).recording
    load_kernels(recording, config)
    slam = OnlineSlam(recording.platform, config, seed)
    seconds, spent, known = list[float](), 0.0, 0
    for _, _, stream, index in messages(recording, {}):
        began = time.perf_counter()
        add(slam, recording, stream, index)
        spent += time.perf_counter() - began
        if taken := len(slam) - known:
            seconds += [spent / taken] * taken
            spent, known = 0.0, len(slam)
    median, most = np.quantile(1e3 * np.array(seconds[FIRST:]), (0.5, 0.99)).tolist()
    return {"scan_ms_median": median, "scan_ms_p99": most, "scans": known}


BARS = {
    "filter": (Bar("run_slam_cpu_ms_a_scan", "worst", 3.5), Bar("ate_m", "worst", 0.09)),
    "every_scan_1": (Bar("filter_cpu_ms_a_scan", "median", 0.35), Bar("outside_kernels_ms_a_scan", "median", 0.1)),
    "every_scan_30": (Bar("filter_cpu_ms_a_scan", "median", 1.0),),
    "live": (Bar("scan_ms_p99", "median", 3.0),),
    "process": (Bar("cpu_ms_a_scan", "worst", 10.0), Bar("ate_m", "worst", 0.09)),
    "real_time": (Bar("times_real_time", "worst", 3.0, least=True), Bar("ate_m", "worst", 0.15)),
    "memory": (Bar("peak_mb", "worst", 1000.0),),
    "tenths": (Bar("last_over_first", "median", 1.05), Bar("an_update_last_over_first", "worst", 1.05)),
    "start": (Bar("warm_cpu_s", "median", 1.0), Bar("cold_cpu_s", "worst", 12.0)),
    "solver": (Bar("cpu_s", "worst", 4.0),),
    "joint": (Bar("cpu_s", "worst", 4.0),),
    "campus_keys": (Bar("search_and_graph_over_filter", "worst", 1 / 3),),
    "campus": (Bar("search_and_graph_over_filter", "worst", 1 / 3), Bar("peak_mb", "worst", 1000.0)),
}
CASES: dict[str, tuple[Callable[..., Row], dict[str, Any]]] = {
    "filter": (filter_alone, {"particles": 30, "log": "intel_key_scans"}),
    "every_scan_1": (filter_alone, {"particles": 1, "duration": None}),
    "every_scan_30": (filter_alone, {"particles": 30, "duration": None}),
    "live": (live, {"duration": None}),
    "process": (process, {"log": "intel_key_scans", "particles": 30, "threads": 1}),
    "real_time": (real_time, {"particles": 1000, "duration": None}),
    "memory": (process, {"log": "intel_raw_part", "particles": 1000, "threads": 2}),
    "tenths": (tenths, {"duration": None}),
    "start": (start, {"figures": False}),
    "start_figures": (start, {"figures": True}),
    "simulation": (simulation, {"duration": None}),
    "solver": (solver, {}),
    "joint": (joint, {"scans": 1000}),
    "campus_keys": (back_end, {"keys": True}),
    "campus": (back_end, {"keys": False}),
}
QUICK = {"log": "freiburg-101", "duration": 25.0}


def measure(case: str, seed: int, settings: list[str], quick: bool) -> Row:
    function, given = CASES[case]
    return function(seed, settings, **{key: QUICK.get(key, value) if quick else value for key, value in given.items()})


def against(folder: Path, settings: list[str], pairs: int) -> None:
    """The processor time of ``moteslam replay`` in this checkout over that in another one, pair by pair.

    A run of each before the first pair loads the kernels. Who runs first changes from pair to pair.
    """
    here, there = Path(__file__).parents[1], folder.resolve()
    for log in ("intel_key_scans", "csail"):
        ratios = []
        for pair in range(-1, pairs):
            spent = {}
            for checkout in (here, there) if pair % 2 else (there, here):
                with tempfile.TemporaryDirectory() as scratch:
                    spent[checkout] = replay(
                        log_file(log), Path(scratch) / "out", settings, "--threads", "1", "--no-figures",
                        executable=str(checkout / ".venv" / "bin" / "python"),
                    )["cpu_s"]  # fmt: skip
            if pair >= 0:
                ratios.append(spent[here] / spent[there])
                print(f"{log}  {spent[here]:.2f} s / {spent[there]:.2f} s = {ratios[-1]:.3f}", flush=True)
        print(f"{log}: median of {pairs} pairs {statistics.median(ratios):.3f}")


def main() -> int:
    parser = arguments(__doc__, settings=True)
    parser.add_argument("--cases", nargs="+", choices=CASES, metavar="CASE", default=list(CASES))
    parser.add_argument("--quick", action="store_true", help="shorter recordings: a trial")
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="another checkout, with a .venv of its own")
    parser.add_argument("--pairs", type=count, default=7, help="of runs, with --against [7]")
    options = parsed(parser)
    if options.against is not None:
        if not (options.against / ".venv" / "bin" / "python").exists():
            parser.error(f"{options.against}: no .venv there, expected a checkout after `make setup`")
        against(options.against, options.settings, options.pairs)
        return 0
    about = {"settings": " ".join(options.settings), "length": "quick" if options.quick else "full"}
    cases = [
        ({"run": case, "seed": seed, **about}, (case, seed, options.settings, options.quick))
        for case in options.cases
        for seed in options.seeds or range(3)
    ]
    return status(benchmark(measure, cases, options, bars=BARS, fresh=True), BARS)


if __name__ == "__main__":
    sys.exit(main())
