"""What SLAM and simulation cost: processor time, speed beside real time, memory.

    python benchmarks/cost.py --set backend.method=none --out cost.csv
    python benchmarks/cost.py --cases filter start --seeds 3
    python benchmarks/cost.py --against ../older-clone

| case | what |
|---|---|
| filter | `intel_key_scans`, 30 particles, 1 thread: processor time of the filter and of `run_slam` a scan |
| every_scan_1, every_scan_30 | `corridor` (1081 beams, 40 Hz), 1 and 30 particles, 1 thread: the same, and in kernels |
| process, process_figures | `filter` by `moteslam replay`, without and with figures: the whole process |
| real_time_100, real_time_1000 | `corridor`, 100 and 1000 particles, 2 threads: against real time |
| memory_1000 | `intel_raw_part` by `moteslam replay`, 1000 particles, 2 threads: most memory |
| tenths | `campus` (1.6 km, 181 beams), 30 particles, 1 thread: the last tenth beside the first |
| start, start_figures | three seconds of a CARMEN log by `moteslam replay`: without kernels and bytecode, then with |
| simulation | lidar, encoders and IMU of `corridor`, 2 threads, warm, scaled to 120 s |
| camera | 120 s of `corridor` with both cameras at 30 Hz, 2 threads, simulated and written |
| solver | 2000 nodes on nested rings, 5000 edges, a tenth of the loops false: all stages of the non-convexity |
| joint | the joint registration of 1000 scans of 180 beams, the first nodes of `campus`, from their solved graph |
| campus_keys, campus | `campus` as key scans of a poor odometry, and every scan: loop search and graph beside filter |

Each case runs in a fresh process, with the kernels in the cache on disk; loading them is given apart, and counted where
the whole process is measured. The error of the same run stands beside its cost. --quick takes a short log and 25 s of
the scenarios: a trial. --against runs the same command in this checkout and in another one, in turns, each with the
Python of its own `.venv`, and prints the ratios of their processor times. Bars are of the filter alone.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from parts.back_end_costs import back_end, joint, solver
from parts.costs import camera, filter_alone, most_memory, process, real_time, replay, simulation, start, tenths
from parts.harness import Bar, Row, arguments, benchmark, count, status
from parts.runs import log_file

from moteslam.errors import MoteslamError
from moteslam.slam.settings import resolve_config

BARS = {
    "filter": (Bar("run_slam_cpu_ms_a_scan", "worst", 3.5), Bar("ate_m", "worst", 0.09)),
    "every_scan_1": (Bar("filter_cpu_ms_a_scan", "median", 0.35), Bar("outside_kernels_ms_a_scan", "median", 0.1)),
    "every_scan_30": (Bar("filter_cpu_ms_a_scan", "median", 1.0),),
    "process": (Bar("cpu_ms_a_scan", "worst", 10.0), Bar("ate_m", "worst", 0.09)),
    "real_time_100": (Bar("times_real_time", "worst", 2.0, least=True), Bar("ate_m", "worst", 0.15)),
    "real_time_1000": (Bar("times_real_time", "worst", 3.0, least=True), Bar("ate_m", "worst", 0.15)),
    "memory_1000": (Bar("peak_mb", "worst", 1000.0),),
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
    "process": (process, {"log": "intel_key_scans", "figures": False}),
    "process_figures": (process, {"log": "intel_key_scans", "figures": True}),
    "real_time_100": (real_time, {"particles": 100, "duration": None}),
    "real_time_1000": (real_time, {"particles": 1000, "duration": None}),
    "memory_1000": (most_memory, {"log": "intel_raw_part", "particles": 1000}),
    "tenths": (tenths, {"duration": None}),
    "start": (start, {"figures": False}),
    "start_figures": (start, {"figures": True}),
    "simulation": (simulation, {"duration": None}),
    "camera": (camera, {"duration": 120.0}),
    "solver": (solver, {}),
    "joint": (joint, {"scans": 1000}),
    "campus_keys": (back_end, {"keys": True}),
    "campus": (back_end, {"keys": False}),
}
QUICK = {"log": "freiburg-101", "duration": 25.0}


def measure(case: str, seed: int, settings: list[str], quick: bool) -> Row:
    """The figures of one case."""
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
    """Measure, and print a table; 1 where a case crashed or a bar does not hold."""
    parser = arguments(__doc__)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings", help="of SLAM")
    parser.add_argument("--cases", nargs="+", choices=CASES, metavar="CASE", default=list(CASES))
    parser.add_argument("--quick", action="store_true", help="shorter recordings: a trial")
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="another checkout, with a .venv of its own")
    parser.add_argument("--pairs", type=count, default=7, help="of runs, with --against [7]")
    options = parser.parse_args()
    try:
        resolve_config("default", options.settings)
    except MoteslamError as error:
        parser.error(str(error))
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
