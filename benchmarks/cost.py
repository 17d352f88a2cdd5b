"""What SLAM costs: processor time a scan, speed beside real time, memory; a dated result file.

    python benchmarks/cost.py --set backend.method=none --out result.json
    python benchmarks/cost.py --cases filter real_time_100 --seeds 1
    python benchmarks/cost.py --quick
    python benchmarks/cost.py --against ../older-clone

Everything is measured in a fresh process of its own, with the kernels in the cache on disk; loading them is given
apart, and counted where the whole process is measured. The error of the same run stands beside its cost. --quick is a
trial of a minute or two with other, shorter recordings: whether it runs, and no more. --against runs the same command
in this checkout and in another one, in turns, each with the Python of its own `.venv`, and prints the ratios of their
processor times. The bars are of the filter alone, without back end.

| case | what |
|---|---|
| filter | `intel_key_scans`, 30 particles, 1 thread: processor time of the filter and of `run_slam` a scan |
| every_scan_1, every_scan_30 | `corridor` (1081 beams, 40 Hz), 1 and 30 particles, 1 thread: the same, and in kernels |
| process, process_figures | the same by `moteslam replay`, without and with figures: the whole process |
| real_time_100, real_time_1000 | `corridor` (1081 beams, 40 Hz), 100 and 1000 particles, 2 threads: against real time |
| memory_1000, memory_1000_figures | `intel_raw_part` by `moteslam replay`, 1000 particles, 2 threads: most memory |
| played_again | a ring of corridors driven ten times over, 1 thread: memory after each round |
| tenths | `campus` (1.6 km, 181 beams), 30 particles, 1 thread: the last tenth beside the first |
| start, start_figures | three seconds of a CARMEN log by `moteslam replay`: without kernels and bytecode, then with |
| same_bytes | `freiburg-101` by `moteslam replay` on 1 and on 2 threads: trajectories and map compared |
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from parts.bars import Bar, summarise, summary_lines
from parts.machine import save, stamp
from parts.options import count, result_file

RESULTS = ("trajectory.tum", "trajectory_final.tum", "map.pgm")
TIMES = 10
WARM_STARTS = 7
BARS: dict[str, tuple[Bar, ...]] = {
    "filter": (Bar("run_slam_cpu_ms_a_scan", "worst", 3.5), Bar("ate_m", "worst", 0.09)),
    "every_scan_1": (Bar("filter_cpu_ms_a_scan", "median", 0.35), Bar("outside_kernels_ms_a_scan", "median", 0.1)),
    "every_scan_30": (Bar("filter_cpu_ms_a_scan", "median", 1.0),),
    "process": (Bar("cpu_ms_a_scan", "worst", 10.0), Bar("ate_m", "worst", 0.09)),
    "process_figures": (),
    "real_time_100": (Bar("times_real_time", "worst", 2.0, least=True), Bar("ate_m", "worst", 0.15, strict=True)),
    "real_time_1000": (Bar("times_real_time", "worst", 3.0, least=True), Bar("ate_m", "worst", 0.15, strict=True)),
    "memory_1000": (Bar("peak_mb", "worst", 1000.0, strict=True),),
    "memory_1000_figures": (Bar("peak_mb", "worst", 1000.0, strict=True),),
    "played_again": (Bar("maps_last_over_second", "worst", 1.0),),
    "tenths": (
        Bar("last_over_first", "median", 1.05),
        Bar("an_update_last_over_first", "worst", 1.05),
        Bar("large_maps_over_small", "worst", 1.05),
    ),
    "start": (Bar("warm_cpu_s", "median", 1.0), Bar("cold_cpu_s", "worst", 12.0)),
    "start_figures": (),
    "same_bytes": (Bar("files_that_differ", "worst", 0.0),),
}
MANY_SEEDS = ("filter", "every_scan_1", "every_scan_30", "process", "real_time_100", "real_time_1000")
"""Measured with 5 seeds, the others with one."""


def python(
    *arguments: str, executable: str = sys.executable, environment: dict[str, str] | None = None
) -> tuple[str, dict[str, float]]:
    """Run Python in a fresh process: what it prints, and its wall time, processor time [s] and most memory [MB].

    It has this process's environment unless it is given another.

    Raises:
        RuntimeError: it failed, with its last line of error.
    """
    began = time.perf_counter()
    with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as failed:
        child = subprocess.Popen([executable, *arguments], stdout=said, stderr=failed, env=environment)
        try:
            _, status, usage = os.wait4(child.pid, 0)
        except BaseException:
            child.kill()
            raise
        child.returncode = os.waitstatus_to_exitcode(status)
        seconds = time.perf_counter() - began
        said.seek(0)
        failed.seek(0)
        if child.returncode:
            lines = failed.read().strip().splitlines() or [f"exit code {child.returncode}"]
            raise RuntimeError(f"{' '.join(arguments[:3])}: {lines[-1]}")
        memory = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6
        return said.read(), {"wall_s": seconds, "cpu_s": usage.ru_utime + usage.ru_stime, "peak_mb": memory}


class Costs:
    """The cases, as the command line asks for them.

    Args:
        preset, settings: of the filter.
        quick: take a short log in place of the Intel logs, and little of the simulated ones.
        arch: of the cases against real time.
    """

    def __init__(self, preset: str, settings: list[str], *, quick: bool, arch: str = "cpu") -> None:
        self._preset, self._settings, self._quick, self._arch = preset, settings, quick, arch
        self._duration = 25.0 if quick else None
        self.cases: dict[str, Callable[[int], dict[str, Any]]] = {
            "filter": self.filter,
            "every_scan_1": lambda seed: self.every_scan(seed, 1),
            "every_scan_30": lambda seed: self.every_scan(seed, 30),
            "process": lambda seed: self.process(seed, "--no-figures"),
            "process_figures": self.process,
            "real_time_100": lambda seed: self.real_time(seed, 100),
            "real_time_1000": lambda seed: self.real_time(seed, 1000),
            "memory_1000": lambda seed: self.memory(seed, "--no-figures"),
            "memory_1000_figures": self.memory,
            "played_again": self.played_again,
            "tenths": self.tenths,
            "start": lambda seed: self.start(seed, "--no-figures"),
            "start_figures": self.start,
            "same_bytes": self.same_bytes,
        }

    def filter(self, seed: int) -> dict[str, Any]:
        """Processor time a scan of the filter, in Python."""
        return self._measure("filter", seed, 30, threads=1, log=self._log("intel_key_scans"))

    def every_scan(self, seed: int, particles: int) -> dict[str, Any]:
        """Processor time a scan of the filter where it updates its particles with one scan of five."""
        given = {"scenario": "corridor", "duration": self._duration}
        return self._measure("filter", seed, particles, threads=1, **given)

    def real_time(self, seed: int, particles: int) -> dict[str, Any]:
        """Wall time of a recording beside how long it took to record."""
        given = {"scenario": "corridor", "duration": self._duration, "arch": self._arch}
        return self._measure("real time", seed, particles, threads=2, **given)

    def played_again(self, seed: int) -> dict[str, Any]:
        """Memory after each round of a ring."""
        times = 3 if self._quick else TIMES  # always the whole ring: its end must meet its beginning
        return self._measure("played again", seed, 30, threads=1, times=times, every=4, duration=None)

    def tenths(self, seed: int) -> dict[str, Any]:
        """Processor time a scan as the map grows."""
        return self._measure("tenths", seed, 30, threads=1, duration=self._duration)

    def process(self, seed: int, *flags: str) -> dict[str, Any]:
        """Processor time a scan and memory of the whole command; ``flags`` are more of its options."""
        from parts.runs import log_file, reference_file

        log = self._log("intel_key_scans")
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "result"
            cost = self._replay(log_file(log), seed, 30, 1, out, *flags)
            scans = len((out / "trajectory_final.tum").read_text().splitlines()) - 1
            arguments = ("evaluate", str(out / "trajectory_final.tum"), str(reference_file(log)), "--json")
            scores = json.loads(python("-m", "moteslam", *arguments)[0])
        error = scores["ate"]["translation_m"]["rmse"]
        return {"cpu_ms_a_scan": 1e3 * cost["cpu_s"] / scans, "ate_m": error, "scans": scans, **cost}

    def memory(self, seed: int, *flags: str) -> dict[str, Any]:
        """The most memory that the command had with many particles."""
        from parts.runs import log_file

        log, particles = log_file(self._log("intel_raw_part")), 100 if self._quick else 1000
        with tempfile.TemporaryDirectory() as folder:
            return self._replay(log, seed, particles, 2, Path(folder) / "result", *flags)

    def start(self, seed: int, *flags: str) -> dict[str, Any]:
        """Processor time of the command on a log of three seconds, the first time and from then on."""
        with tempfile.TemporaryDirectory() as folder:
            drive, log = f"{folder}/drive", Path(folder) / "three.log"
            made = ("--platform", "lms200", "--format", "carmen", "--seed", str(seed))
            python("-m", "moteslam", "simulate", "corridor", "--out", drive, *made)
            python("-m", "moteslam", "convert", f"{drive}/corridor.log.gz", str(log), "--start", "7", "--end", "10")
            environment = {
                **{name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
                "MOTESLAM_CACHE": f"{folder}/kernels",
                "PYTHONPYCACHEPREFIX": f"{folder}/bytecode",
            }
            results = [Path(folder) / f"result-{number}" for number in range(1 + WARM_STARTS)]
            spent = [self._replay(log, seed, 30, 1, out, *flags, environment=environment)["cpu_s"] for out in results]
        return {"cold_cpu_s": spent[0], "warm_cpu_s": statistics.median(spent[1:])}

    def same_bytes(self, seed: int) -> dict[str, Any]:
        """How many files of the result differ between one thread and two."""
        from parts.runs import log_file

        digests = []
        with tempfile.TemporaryDirectory() as folder:
            for threads in (1, 2):
                out = Path(folder) / str(threads)
                self._replay(log_file("freiburg-101"), seed, 30, threads, out, "--no-figures")
                digests.append([hashlib.sha256((out / name).read_bytes()).hexdigest() for name in RESULTS])
        return {"files_that_differ": sum(one != two for one, two in zip(*digests, strict=True))}

    def _log(self, name: str) -> str:
        return "freiburg-101" if self._quick else name

    def _measure(self, name: str, seed: int, particles: int, **more: Any) -> dict[str, Any]:
        """A function of ``parts/costs.py`` in a process of its own."""
        given = {"preset": self._preset, "settings": self._settings, "seed": seed, "particles": particles, **more}
        said, cost = python(__file__, "--measure", name, json.dumps(given))
        row: dict[str, Any] = json.loads(said.splitlines()[-1])
        return {**row, "peak_mb": cost["peak_mb"]}

    def _replay(
        self,
        log: Path,
        seed: int,
        particles: int,
        threads: int,
        out: Path,
        *flags: str,
        environment: dict[str, str] | None = None,
    ) -> dict[str, float]:
        """What ``moteslam replay`` of a log costs."""
        settings = [word for setting in self._settings for word in ("--set", setting)]
        numbers = ("--set", f"particles={particles}", "--threads", str(threads), "--seed", str(seed))
        command = ("replay", str(log), "--out", str(out), "--preset", self._preset)
        return python("-m", "moteslam", *command, *settings, *numbers, *flags, environment=environment)[1]


def against(folder: Path, preset: str, settings: list[str], pairs: int, *, quick: bool) -> dict[str, Any]:
    """The processor time of ``moteslam replay`` in this checkout over that in another one, pair by pair.

    A run of each before the first pair loads the kernels. Who runs first changes from pair to pair.
    """
    from parts.runs import log_file

    here, there = Path(__file__).parents[1], folder.resolve()
    logs = ["freiburg-101"] if quick else ["intel_key_scans", "csail"]
    ratios: dict[str, list[float]] = {}
    for log in logs:
        for pair in range(-1, pairs):
            spent = {}
            for checkout in (here, there) if pair % 2 else (there, here):
                with tempfile.TemporaryDirectory() as scratch:
                    command = ["replay", str(log_file(log)), "--out", f"{scratch}/result", "--preset", preset]
                    command += ["--threads", "1", "--no-figures"]
                    command += [word for setting in settings for word in ("--set", setting)]
                    executable = str(checkout / ".venv" / "bin" / "python")
                    spent[checkout] = python("-m", "moteslam", *command, executable=executable)[1]["cpu_s"]
            if pair >= 0:
                ratios.setdefault(log, []).append(spent[here] / spent[there])
                print(
                    f"{log}  pair {pair}  {spent[here]:.2f} s / {spent[there]:.2f} s = {ratios[log][-1]:.3f}",
                    flush=True,
                )
    return {log: {"median": statistics.median(values), "pairs": values} for log, values in ratios.items()}


def main() -> None:
    """Measure, print a table, and write the result file, anew after every run; exit code 1 where a run crashed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="default")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    parser.add_argument("--cases", nargs="+", choices=list(BARS), metavar="CASE", default=list(BARS))
    parser.add_argument("--seeds", type=count, help="of each case, from 0")
    parser.add_argument("--quick", action="store_true", help="other, shorter recordings: a trial")
    parser.add_argument("--arch", choices=("cpu", "cuda"), default="cpu", help="of the cases against real time")
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="another checkout, with a .venv of its own")
    parser.add_argument("--pairs", type=count, default=7, help="of runs, with --against")
    parser.add_argument("--out", type=result_file)
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        from parts.costs import MEASURES

        print(json.dumps(MEASURES[options.measure[0]](json.loads(options.measure[1]))))
        return
    from moteslam.errors import ConfigError
    from moteslam.eval.cli.text import table
    from moteslam.slam.settings import resolve_config

    try:
        resolve_config(options.preset, options.settings)
    except ConfigError as error:
        parser.error(str(error))
    if options.against is not None:
        if not (options.against / ".venv" / "bin" / "python").exists():
            parser.error(f"{options.against}: no .venv there, expected a checkout after `make setup`")
        found = against(options.against, options.preset, options.settings, options.pairs, quick=options.quick)
        for log, ratio in found.items():
            print(f"{log}: median of {options.pairs} pairs {ratio['median']:.3f}")
        save(options.out, {**stamp(), "preset": options.preset, "processor time, here / there": found})
        return
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the process measured ends with this one
    costs = Costs(options.preset, options.settings, quick=options.quick, arch=options.arch)
    asked = {"settings": options.settings, "quick": options.quick, "arch": options.arch}
    about = {**stamp(), "preset": options.preset, **asked}
    rows: list[dict[str, Any]] = []
    summary: dict[str, Any] = {}
    for case in options.cases:
        for seed in range(options.seeds or (5 if case in MANY_SEEDS and not options.quick else 1)):
            row = {"run": case, "seed": seed, "load": os.getloadavg()[0]}
            try:
                row |= costs.cases[case](seed)
            except RuntimeError as error:
                row["error"] = str(error)
            rows.append(row)
            print("  ".join(f"{k} {v:.4f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
        summary[case] = summarise([row for row in rows if row["run"] == case], BARS[case])
        save(options.out, {**about, "summary": summary, "rows": rows})
    print()
    print(table(summary_lines(summary), right=(3, 4)))
    if any("error" in row for row in rows):
        sys.exit(1)


if __name__ == "__main__":
    main()
