"""How long calls take, measured in turns, since the speed of a machine wanders; and plain C to compare with."""

from __future__ import annotations

import ctypes
import shutil
import statistics
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

FLAGS = ["-O3", "-march=native", "-ffast-math", "-fopenmp", "-shared", "-fPIC", "-lm"]


class Seconds(NamedTuple):
    """What a call takes: wall time and processor time, medians over all turns [s]."""

    wall: float
    processor: float


def in_turns(contenders: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, Seconds]:
    """The time of each, taking turns after one call that is not counted.

    The order of the turns is random, and with it whose data are in the caches.
    """
    times: dict[str, list[Seconds]] = {name: [] for name in contenders}
    for call in contenders.values():
        call()
    order = np.random.default_rng(0)
    for _ in range(repeats):
        for name in order.permutation(list(contenders)):
            wall, processor = time.perf_counter(), time.process_time()
            contenders[name]()
            times[name].append(Seconds(time.perf_counter() - wall, time.process_time() - processor))
    return {name: Seconds(*map(statistics.median, zip(*found, strict=True))) for name, found in times.items()}


def compile_loops(source: Path, folder: Path) -> ctypes.CDLL | None:
    """C functions, compiled into a folder; None where there is no compiler."""
    if shutil.which("gcc") is None:
        return None
    library = folder / "loops.so"
    subprocess.run(["gcc", str(source), *FLAGS, "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


def compiler() -> str:
    """The C compiler and its flags, or ``none``."""
    if shutil.which("gcc") is None:
        return "none"
    name = subprocess.run(["gcc", "--version"], check=True, capture_output=True, text=True).stdout.splitlines()[0]
    return f"{name} {' '.join(FLAGS)}"


def pointers(*arrays: np.ndarray) -> list[ctypes.c_void_p]:
    """The addresses of arrays."""
    return [ctypes.c_void_p(array.ctypes.data) for array in arrays]
