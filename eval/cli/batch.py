"""Many simulations at once: a process each, one thread a process, since Taichi cannot fork."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moteslam.errors import ConfigError, MoteslamError
from moteslam.eval.cli.progress import progress_bar
from moteslam.eval.cli.wanted import MAX_BATCH, Wanted

if TYPE_CHECKING:
    from moteslam.sim.simulate import Simulation


@dataclass(frozen=True)
class Job:
    """One simulation to make: what is wanted, its seed, and the folder for it, which is made if need be."""

    wanted: Wanted
    seed: int
    folder: Path


def run_batch(jobs: list[Job], *, processes: int | None = None) -> list[dict[str, Any]]:
    """Do all of the jobs, with a progress bar; what ``about`` gives of each, in their order.

    Args:
        jobs: at most 100 000.
        processes: at a time; as many as there are processors by default.

    Raises:
        MoteslamError: the first that fails ends them all, and is named with its seed.
    """
    if len(jobs) > MAX_BATCH:
        raise ConfigError(f"{len(jobs)} simulations, expected at most {MAX_BATCH}", field="batch")
    from moteslam.robot.values import processor_count

    count = min(processes or processor_count(), len(jobs))
    found: dict[int, dict[str, Any]] = {}
    with progress_bar("batch", len(jobs), "runs") as bar, _workers(count) as pool:
        waiting = iter(enumerate(jobs))
        running: dict[Future[dict[str, Any] | str], int] = {}
        while len(found) < len(jobs):
            for index, job in islice(waiting, 2 * count - len(running)):  # one more for each, to begin at once
                running[pool.submit(_do, job)] = index
            for future in wait(running, timeout=0.2, return_when=FIRST_COMPLETED).done:
                job = jobs[index := running.pop(future)]
                try:
                    outcome = future.result()
                except BrokenProcessPool:
                    outcome = "its process was killed, expected enough memory"
                if isinstance(outcome, str):
                    raise MoteslamError(outcome, file=job.wanted.scenario, field=f"seed {job.seed}")
                found[index] = outcome
            bar.update(len(found))
    return [found[index] for index in range(len(jobs))]


@contextmanager
def _workers(count: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with the block, whatever they are at."""
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _start)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        mine = set(multiprocessing.active_children()) - others
        for worker in mine:
            worker.terminate()
        for worker in mine:
            worker.join()


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
    """In each process: leave Ctrl-C to the parent, end with it, and use one thread."""
    from moteslam.kernels import runtime

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    runtime.init("cpu", 1)


def _end_with_parent() -> None:
    """Wait for the parent's end, and end this process at once: nobody is left to take what it makes."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _do(job: Job) -> dict[str, Any] | str:
    """Simulate and write one; what is wrong with it as text, since exceptions with fields cannot be pickled."""
    from moteslam.sim.output import write_simulation

    wanted = job.wanted
    try:
        simulation = wanted.simulate(wanted.load(job.seed), job.seed)
        job.folder.mkdir(parents=True, exist_ok=True)
        write_simulation(job.folder, simulation, map_resolution=wanted.map_resolution, file_format=wanted.file_format)
    except MoteslamError as error:
        return str(error)
    except OSError as error:
        return f"{error.filename}: {error.strerror}"
    return about(simulation)
