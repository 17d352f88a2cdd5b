"""How long a whole simulation takes: lidar, encoders and IMU of every bundled scenario, warm; a dated result file.

    python benchmarks/simulation.py [--out result.json]

Each is simulated twice in one process on two threads and the second time counts, in wall and in processor time, and
scaled to 120 s of recording.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
from parts.machine import save, stamp
from parts.options import result_file


def measure(name: str) -> dict[str, float]:
    """Wall and processor time of the second simulation of a scenario, and of it scaled to 120 s."""
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.simulate import simulate

    scenario = load_scenario(name).model_copy(update={"camera": None})
    simulate(scenario, 0)
    wall, spent = time.perf_counter(), time.process_time()
    simulation = simulate(scenario, 0)
    wall, spent = time.perf_counter() - wall, time.process_time() - spent
    recorded = float(np.ptp(simulation.truth.stamps))
    return {
        "recorded [s]": recorded,
        "wall [s]": wall,
        "processor [s]": spent,
        "wall for 120 s [s]": wall * 120 / recorded,
        "processor for 120 s [s]": spent * 120 / recorded,
    }


def main() -> None:
    from moteslam.kernels import runtime
    from moteslam.sim.scenario import bundled_scenarios

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=result_file)
    options = parser.parse_args()
    runtime.init("cpu", 2)
    result: dict[str, Any] = {
        **stamp(),
        "scenarios": {name: measure(name) for name in (*bundled_scenarios(), "random-corridors-7")},
    }
    save(options.out, result)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
