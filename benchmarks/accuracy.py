"""The accuracy of a preset over many seeds, against truth and against hand-checked relations; a dated result file.

    python benchmarks/accuracy.py --preset paper --seeds 20 --out benchmarks/results/accuracy-paper-YYYY-MM-DD.json

Simulated scenarios are scored by ATE RMSE after alignment, the Intel log (where MOTESLAM_DATA is) by its relations.
Every run is a process of its own on one thread; the figures do not depend on how many run at once.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from concurrent.futures import ProcessPoolExecutor
from datetime import date
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(os.environ.get("MOTESLAM_DATA", Path(__file__).parents[2] / "shared" / "data"))


def simulated(scenario: str, preset: str, seed: int) -> dict[str, Any]:
    """One seed of a scenario: ATE RMSE [m] of the online and final trajectory and of dead reckoning."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.kernels import runtime
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.simulate import simulate
    from moteslam.slam.config import load_preset
    from moteslam.slam.run import run_slam

    runtime.init("cpu", 1)
    simulation = simulate(load_scenario(scenario), seed=seed)
    began = time.perf_counter()
    estimate = run_slam(simulation.recording, load_preset(preset), seed=seed)
    seconds = time.perf_counter() - began
    trajectories = {
        "online": estimate.trajectory,
        "final": estimate.trajectory_final,
        "dead_reckoning": estimate.dead_reckoning,
    }
    errors = {
        name: absolute_trajectory_error(trajectory, simulation.truth).translation.rmse
        for name, trajectory in trajectories.items()
    }
    return {"run": scenario, "seed": seed, **errors, "scans": len(estimate.trajectory), "seconds": seconds}


def intel(preset: str, seed: int) -> dict[str, Any]:
    """One seed of the Intel log: mean errors on its relations, clear and all [m], [deg]."""
    from moteslam.eval.metrics.relations import read_relations, relation_errors
    from moteslam.kernels import runtime
    from moteslam.robot.formats import open_recording
    from moteslam.slam.config import load_preset
    from moteslam.slam.run import run_slam

    runtime.init("cpu", 1)
    recording = open_recording(DATA / "intel" / "intel_raw_part.log.gz")
    began = time.perf_counter()
    estimate = run_slam(recording, load_preset(preset), seed=seed)
    row: dict[str, Any] = {"run": "intel_raw_part", "seed": seed, "seconds": time.perf_counter() - began}
    for which, file in (("clear", "intel_raw_part.relations"), ("all", "intel.relations")):
        relations = read_relations(DATA / "intel" / file)
        for name, trajectory in (("online", estimate.trajectory), ("final", estimate.trajectory_final)):
            score = relation_errors(trajectory, relations).all
            row[f"{name}_{which}"] = score.translation.mean
            row[f"{name}_{which}_deg"] = score.rotation.mean
    return row


def main() -> None:
    """Run, print a table, and write the result file."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--scenarios", nargs="*", default=["corridor", "loop", "office"])
    parser.add_argument("--seeds", type=int, default=20, help="of each scenario, from 0")
    parser.add_argument("--intel-seeds", type=int, default=5, help="of the Intel log, from 0; 0 leaves it out")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        jobs = [
            pool.submit(simulated, scenario, options.preset, seed)
            for scenario in options.scenarios
            for seed in range(options.seeds)
        ]
        if DATA.is_dir():
            jobs += [pool.submit(intel, options.preset, seed) for seed in range(options.intel_seeds)]
        rows = []
        for job in jobs:
            rows.append(job.result())
            print("  ".join(f"{k} {v:.4f}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items()))
    summary = {}
    for run in dict.fromkeys(row["run"] for row in rows):
        mine = [row for row in rows if row["run"] == run]
        keys = [key for key in mine[0] if key not in ("run", "seed", "scans")]
        summary[run] = {
            key: {"median": float(np.median([row[key] for row in mine])), "worst": max(row[key] for row in mine)}
            for key in keys
        }
        print(run, *(f"{key} median {s['median']:.4f} worst {s['worst']:.4f};" for key, s in summary[run].items()))
    if options.out:
        result = {
            "date": date.today().isoformat(),
            "preset": options.preset,
            "hardware": f"{platform.machine()}, {os.cpu_count()} cores",
            "versions": {name: version(name) for name in ("moteslam", "taichi", "numpy", "pymunk")},
            "summary": summary,
            "rows": rows,
        }
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
