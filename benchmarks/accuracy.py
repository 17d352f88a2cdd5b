"""The accuracy of a preset over many seeds, against truth, references and hand-checked relations; a dated result file.

    python benchmarks/accuracy.py --preset default --out result.json
    python benchmarks/accuracy.py --preset default --odometry-noise 3 --out result.json
    python benchmarks/accuracy.py --preset default --all-scenarios --out result.json
    python benchmarks/accuracy.py --preset default --unseen --out result.json
    python benchmarks/accuracy.py --preset default --runs freiburg-101 hall --seeds 5-9 --set particles=100

Simulated scenarios are scored by ATE RMSE after alignment, the Intel log by its relations, the others against the
reference beside them (where MOTESLAM_DATA is). Without --runs: all of these, real logs and the hall on seeds 0 to 4,
corridor, loop and office on seeds 0 to 19; with --odometry-noise these three alone; with --all-scenarios every bundled
scenario on seeds 0 to 4; with --unseen two logs on seeds 0 to 4 and twenty random buildings, which no setting was
chosen on. A row a run; at the end the median and the worst seed of every figure beside what is asked.

Every run is on one thread; the errors do not depend on how many run at once, the processor time a little: two virtual
cores may be halves of one.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

from parts.bars import Bar, summarise, summary_lines
from parts.machine import save, stamp
from parts.options import count, factor, result_file, seeds
from parts.pool import Row, row_or_error, rows_of
from parts.runs import (
    BARS,
    HALL,
    LOGS,
    LOST,
    NEVER_LOST,
    SCENARIOS,
    UNSEEN_BUILDINGS,
    UNSEEN_LOGS,
    errors,
    expect_names,
    load_log,
    log_file,
    simulate_case,
    that_are_there,
)

from moteslam.errors import ConfigError
from moteslam.eval.cli.text import table
from moteslam.slam.settings import resolve_config


def run(name: str, preset: str, settings: list[str], seed: int, odometry_noise: float) -> Row:
    """One seed of a log or a scenario: its errors, and the processor time a scan; what went wrong, if it crashes."""
    return row_or_error({"run": name, "seed": seed}, measure, name, preset, settings, seed, odometry_noise)


def measure(name: str, preset: str, settings: list[str], seed: int, odometry_noise: float) -> Row:
    """The figures of one seed."""
    from moteslam.kernels import runtime
    from moteslam.slam.run import run_slam

    runtime.init("cpu", 1)
    config = resolve_config(preset, settings)
    case = load_log(name) if name in LOGS else simulate_case(name, seed, odometry_noise=odometry_noise)
    began, spent = time.perf_counter(), time.process_time()
    estimate = run_slam(case.recording, config, seed=seed)
    seconds, spent = time.perf_counter() - began, time.process_time() - spent
    scans = len(estimate.trajectory)
    return {
        **errors(name, estimate, case),
        "cpu_seconds_a_scan": spent / scans,
        "scans": scans,
        "updates": int(estimate.diagnostics["updated"].sum()),
        "seconds": seconds,
    }


def chosen(options: argparse.Namespace) -> dict[str, range]:
    """The names of what is run, each with its seeds.

    Raises:
        ConfigError: a run that there is not, a log that is not there, or one that is to be simulated with other noise.
    """
    from moteslam.sim.scenario import bundled_scenarios

    known = [*LOGS, *dict.fromkeys((*SCENARIOS, HALL, *bundled_scenarios()))]
    if options.runs:
        names = options.runs
        expect_names(names, known, field="--runs")
        for name in names:
            if name in LOGS and not log_file(name).is_file():
                raise ConfigError("not there; MOTESLAM_DATA names the folder of the real logs", file=log_file(name))
            if name in LOGS and options.odometry_noise != 1.0:
                raise ConfigError(f"{name} is recorded, expected simulated scenarios", field="--odometry-noise")
    elif options.all_scenarios:
        names = list(bundled_scenarios())
    elif options.unseen:
        names = [*UNSEEN_LOGS, *UNSEEN_BUILDINGS]
    elif options.odometry_noise != 1.0:
        names = list(SCENARIOS)
    else:
        names = [*(name for name in LOGS if name not in UNSEEN_LOGS), *SCENARIOS, HALL]
    return {name: options.seeds or range(usual_seeds(name, options)) for name in that_are_there(names)}


def usual_seeds(name: str, options: argparse.Namespace) -> int:
    """How many seeds of a run where none are asked for."""
    if name in UNSEEN_BUILDINGS:
        return 1
    return 20 if name in SCENARIOS and not options.all_scenarios else 5


def asked_of(name: str, options: argparse.Namespace) -> tuple[Bar, ...]:
    """The bars of a run; with other noise, and where every scenario is looked at, not to get lost is all."""
    if name in LOGS or (name in BARS and not options.all_scenarios and options.odometry_noise == 1.0):
        return BARS.get(name, ())
    return () if diverges(name) else (NEVER_LOST,)


def diverges(name: str) -> bool:
    """Whether a scenario says that an estimate that is lost is no surprise."""
    from moteslam.sim.scenario import load_scenario

    return name not in LOGS and load_scenario(name).expect_divergence


def summarised(rows: list[dict[str, Any]], options: argparse.Namespace) -> dict[str, Any]:
    """The summary of each run."""
    summaries = {}
    for name in dict.fromkeys(row["run"] for row in rows):
        mine = [row for row in rows if row["run"] == name]
        summaries[name] = summarise(mine, asked_of(name, options))
        if name not in LOGS:
            summaries[name]["expect_divergence"] = diverges(name)
            summaries[name]["lost"] = sum(row.get("final", 0.0) >= LOST for row in mine)
    return summaries


def described(name: str, summary: dict[str, Any]) -> str:
    """What a run is called in the table."""
    counts = [f"{summary[key]} {key[2:]}" for key in summary if key.startswith("n_")]
    if summary.get("lost"):
        counts.append(f"{summary['lost']} lost")
    if summary.get("expect_divergence"):
        counts.append("divergence expected")
    return f"{name} ({', '.join(counts)})" if counts else name


def main() -> None:
    """Run, print a table, and write the result file, anew after every run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="default")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--runs", nargs="+", metavar="NAME", help="real logs and scenarios by name")
    which.add_argument("--all-scenarios", action="store_true", help="every bundled scenario")
    which.add_argument("--unseen", action="store_true", help="logs and buildings that no setting was chosen on")
    parser.add_argument("--seeds", type=seeds, metavar="N", help="of each run, from 0; or 10-19")
    parser.add_argument("--odometry-noise", type=factor, default=1.0, metavar="X", help="times the scenarios' own")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    parser.add_argument("--workers", type=count, default=2, help="processes; 2")
    parser.add_argument("--out", type=result_file)
    options = parser.parse_args()
    try:
        resolve_config(options.preset, options.settings)
        runs = chosen(options)
    except ConfigError as error:
        parser.error(str(error))
    rows: list[dict[str, Any]] = []
    about = {
        **stamp(),
        "preset": options.preset,
        "settings": options.settings,
        "odometry_noise": options.odometry_noise,
        "workers": options.workers,
    }
    calls = [
        (name, options.preset, options.settings, seed, options.odometry_noise)
        for name, these in runs.items()
        for seed in these
    ]
    for row in rows_of(run, calls, options.workers):
        rows.append(row)
        save(options.out, {**about, "summary": summarised(rows, options), "rows": rows})
    summaries = summarised(rows, options)
    print()
    print(
        table(summary_lines({described(name, summary): summary for name, summary in summaries.items()}), right=(3, 4))
    )


if __name__ == "__main__":
    main()
