"""What the machine gives: chains of arithmetic without memory, and memory read from end to end; both in C alone."""

from __future__ import annotations

import numpy as np

from moteslam.eval.bench.contest import C, Contender, Contest, Task
from moteslam.eval.bench.loops import Loops

CHAINS, STEPS = 16_000, 1000
FLOATS = 2**26
"""Larger than any cache: 256 MB."""


def prepare_arithmetic(loops: Loops | None, threads: int) -> Contest:
    """Steps of two multiplications and two additions, each waiting for the one before, many chains side by side."""
    if loops is None or (threads > 1 and not loops.openmp):
        return Contest({})
    out = np.empty(CHAINS, np.float32)
    call = loops.bind("arithmetic", CHAINS, STEPS, out)
    return Contest({C: Contender(call, CHAINS * STEPS / 1e3)})


def prepare_memory(loops: Loops | None, threads: int) -> Contest:
    """Floats added up."""
    if loops is None or (threads > 1 and not loops.openmp):
        return Contest({})
    values = np.ones(FLOATS, np.float32)
    call = loops.bind("sum", values, values.size)
    return Contest({C: Contender(call, values.nbytes / 1e9)}, facts={"bytes": 1e9})


ARITHMETIC = Task("arithmetic alone", "1000 steps", prepare_arithmetic)
MEMORY = Task("memory alone", "GB read", prepare_memory)
