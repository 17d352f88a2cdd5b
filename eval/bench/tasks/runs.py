"""Whole runs: the corridor simulated, and the preset default without back end over it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial

import numpy as np

from moteslam.eval.bench.contest import OURS, Contender, Contest, Task
from moteslam.eval.bench.loops import Loops
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.sim.scenario import Scenario, load_scenario
from moteslam.sim.simulate import Simulation, simulate
from moteslam.slam.run import SlamSession
from moteslam.slam.settings import resolve_config

SCENARIO, DURATION, SEED = "corridor", 30.0, 0
"""The drive: 1081 beams at 40 Hz, encoders, IMU; the first seconds at rest [s]."""


def scenario() -> Scenario:
    """What is driven."""
    return load_scenario(SCENARIO).model_copy(update={"duration": DURATION, "camera": None})


@lru_cache(maxsize=1)
def drive() -> Simulation:
    """The recording and its truth."""
    return simulate(scenario(), SEED)


def prepare_simulation(loops: Loops | None, threads: int) -> Contest:
    """The whole simulation; there is no C loop of it."""
    del loops, threads
    one = scenario()
    return Contest({OURS: Contender(lambda: simulate(one, SEED), 1)}, after=recorded)


def prepare_run(particles: int, loops: Loops | None, threads: int) -> Contest:
    """All scans of the drive, without the map at the end; there is no C loop of it."""
    del loops, threads
    simulation = drive()
    config = resolve_config("default", ['backend.method="none"', f"particles={particles}"])
    ended: list[SlamSession] = []

    def run() -> None:
        session = SlamSession(simulation.recording, config, seed=SEED)
        for _ in session:
            pass
        ended[:] = [session]

    def after() -> Mapping[str, float]:
        error = absolute_trajectory_error(ended[0].estimate().trajectory_final, simulation.truth)
        return {**recorded(), "ate": error.rmse}

    scans = len(SlamSession(simulation.recording, config, seed=SEED))
    return Contest({OURS: Contender(run, scans)}, facts={"scans": float(scans)}, after=after)


def recorded() -> Mapping[str, float]:
    """How long the drive is [s]."""
    return {"recorded": float(np.ptp(drive().truth.stamps))}


SIMULATION = Task("simulating 30 s", "drive", prepare_simulation)
RUN_1 = Task("run, 1 particle", "scan", partial(prepare_run, 1))
RUN_30 = Task("run, 30 particles", "scan", partial(prepare_run, 30))
