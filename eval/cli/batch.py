"""Many simulations at once: a process each, one thread a process, since Taichi cannot fork."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moteslam.errors import ConfigError, MoteslamError
from moteslam.eval.cli.progress import progress_bar

if TYPE_CHECKING:
    from moteslam.sim.scenario import Scenario
    from moteslam.sim.simulate import Simulation

RANDOM = "random-corridors"
MAX_BATCH = 100_000


@dataclass(frozen=True)
class Job:
    """One simulation to make.

    Attributes:
        scenario: name of a bundled one, ``random-corridors``, or a path.
        seed: of its randomness, and of a random building; None for the scenario's own.
        folder: to write it into, made if need be.
        map_resolution: of the true map [m], None for none.
        camera: record images, even if the scenario does not.
    """

    scenario: str
    seed: int | None
    folder: Path
    map_resolution: float | None = None
    camera: bool = False


def chosen_scenario(name: str, seed: int | None) -> Scenario:
    """The scenario of that name; ``random-corridors`` is the building of that seed.

    Raises:
        ConfigError: there is none, or it is not well made.
    """
    from moteslam.sim.scenario import load_scenario

    return load_scenario(f"{RANDOM}-{seed or 0}" if name == RANDOM else name)


@contextmanager
def named_in_errors(scenario: str) -> Iterator[None]:
    """Name the scenario, as the user wrote it, in what a run finds wrong with it."""
    try:
        yield
    except ConfigError as error:
        if error.file is not None:
            raise
        if error.field == "resolution":  # the only one that the command line sets
            raise ConfigError(error.problem, field="--true-map") from error
        raise ConfigError(error.problem, file=scenario, field=error.field) from error


def run_batch(jobs: list[Job], *, processes: int | None = None) -> list[dict[str, Any]]:
    """Do all of the jobs, with a progress bar; what ``about`` gives of each, in their job.

    Args:
        jobs: at most 100 000.
        processes: at a time; as many as there are cores by default.

    Raises:
        MoteslamError: the first that fails ends them all, and is named with its seed.
    """
    if len(jobs) > MAX_BATCH:
        raise ConfigError(f"{len(jobs)} simulations, expected at most {MAX_BATCH}", field="batch")
    from moteslam.robot.processors import processor_count

    spawn = multiprocessing.get_context("spawn")
    found: dict[int, dict[str, Any]] = {}
    with (
        spawn.Pool(min(processes or processor_count(), len(jobs)), _start) as pool,
        progress_bar("batch", len(jobs), "runs") as bar,
    ):
        coming = pool.imap_unordered(_do, list(enumerate(jobs)))
        while len(found) < len(jobs):
            bar.update(len(found))
            try:
                index, outcome = coming.next(timeout=0.2)
            except multiprocessing.TimeoutError:
                continue
            if isinstance(outcome, str):
                raise MoteslamError(outcome, file=jobs[index].scenario, field=f"seed {jobs[index].seed}")
            found[index] = outcome
    return [found[index] for index in range(len(jobs))]


def about(simulation: Simulation) -> dict[str, Any]:
    """The outcome of a simulation: scenario, seed, distance, time, end, and how many readings each stream has."""
    truth, recording = simulation.truth, simulation.recording
    readings = {
        name: len(stream) for name in ("lidar", "encoders", "imu") if (stream := getattr(recording, name)) is not None
    }
    if recording.rgbd is not None:
        readings |= {"rgb": len(recording.rgbd.rgb_stamps), "disparity": len(recording.rgbd.disparity_stamps)}
    return {
        "scenario": simulation.scenario.name,
        "seed": simulation.scenario.seed,
        "distance_m": truth.length,
        "duration_s": float(truth.stamps[-1] - truth.stamps[0]),
        "end": simulation.end,
        "readings": readings,
    }


def _start() -> None:
    """In each process: leave Ctrl-C to the parent, and use one thread."""
    from moteslam.kernels import runtime

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    runtime.init("cpu", 1)


def _do(numbered: tuple[int, Job]) -> tuple[int, dict[str, Any] | str]:
    """Simulate and write one; what is wrong with it as text, since exceptions with fields cannot be pickled."""
    from moteslam.sim.output import write_simulation
    from moteslam.sim.scenario import with_camera
    from moteslam.sim.simulate import simulate

    index, job = numbered
    try:
        scenario = chosen_scenario(job.scenario, job.seed)
        simulation = simulate(with_camera(scenario) if job.camera else scenario, job.seed)
        job.folder.mkdir(parents=True, exist_ok=True)
        write_simulation(job.folder, simulation, map_resolution=job.map_resolution)
    except MoteslamError as error:
        return index, str(error)
    except OSError as error:
        return index, f"{error.filename}: {error.strerror}"
    return index, about(simulation)
