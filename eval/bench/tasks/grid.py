"""Entering a scan of 1081 beams into a grid, by every ray; on one thread on purpose."""

from __future__ import annotations

import numpy as np

from moteslam.eval.bench.contest import OURS, C, Contender, Contest, Task, same
from moteslam.eval.bench.inputs import CELL, CELLS, lines, scan_and_grid
from moteslam.eval.bench.loops import Loops
from moteslam.kernels.occupancy import update_grid

HIT, MISS, LIMIT = 40, 10, 1000
START = np.array((1000, 960))


def prepare(loops: Loops | None, threads: int) -> Contest:
    """The kernel, and the C loop on one thread."""
    occupied, points = scan_and_grid()
    ends = np.ascontiguousarray(START + np.floor(points / CELL), np.int32)
    grid, by_c = (np.zeros(occupied.shape, np.int16) for _ in range(2))
    flags, seen = np.zeros_like(occupied), np.zeros(occupied.shape, np.int32)

    def kernel() -> None:
        update_grid(grid, flags, seen, START, ends, hit=HIT, miss=MISS, limit=LIMIT, threshold=0, scan=1, per_ray=True)

    kernel()
    touched = np.flatnonzero(grid)
    cells = np.abs(ends - START).max(axis=1).sum() + len(ends)
    facts = {"lookups": float(cells), "bytes": 2.0 * lines(touched, grid.itemsize)}
    contenders = {OURS: Contender(kernel, 1)}
    if loops is None or threads > 1:
        return Contest(contenders, facts=facts)
    plain = loops.bind("update", by_c, CELLS, *START.tolist(), ends, len(ends), HIT, MISS, LIMIT)
    plain()

    def check() -> None:
        kernel()
        plain()
        same("cells", float((grid != by_c).mean()), 0)

    return Contest({**contenders, C: Contender(plain, 1)}, check, facts)


TASK = Task("grid update", "scan", prepare, serial=True)
