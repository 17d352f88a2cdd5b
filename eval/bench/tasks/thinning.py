"""Thinning scans of 1081 beams to about 200 points: 64 in a call, as in SLAM; one after the other in C."""

from __future__ import annotations

from typing import Any

import numpy as np

from moteslam.eval.bench.contest import OURS, C, Contender, Contest, Task, same
from moteslam.eval.bench.inputs import BEAMS, scan_and_grid
from moteslam.eval.bench.loops import Loops
from moteslam.kernels.thinning import thin_scans

SCANS = 64
OPTIONS = {"spacing": 0.02, "max_spacing": 0.06, "max_points": 200, "gap": 0.3, "gap_from_range": 0.03}


def prepare(loops: Loops | None, threads: int) -> Contest:
    """The kernel, and the C loop on one thread."""
    ends = np.tile(scan_and_grid()[1].astype(np.float32), (SCANS, 1))
    begins, counts = np.arange(SCANS) * BEAMS, np.full(SCANS, BEAMS)

    def kernel() -> list[Any]:
        return thin_scans(ends, begins, counts, (0.0, 0.0), **OPTIONS)  # type: ignore[arg-type]

    contenders = {OURS: Contender(kernel, SCANS)}
    facts = {"lookups": float(BEAMS), "bytes": float(ends.nbytes / SCANS)}
    if loops is None or threads > 1:
        return Contest(contenders, facts=facts)
    points, joined = np.empty((BEAMS, 2), np.float32), np.empty(BEAMS, np.int32)
    lengths = [float(OPTIONS[name]) for name in ("gap", "gap_from_range", "spacing", "max_spacing")]
    calls = [
        loops.bind("thin", ends[begin:], BEAMS, *lengths, OPTIONS["max_points"], points, joined)
        for begin in begins.tolist()
    ]

    def plain() -> int:
        return [call() for call in calls][-1]

    def check() -> None:
        ours, left = kernel()[-1].points, plain()
        same("numbers of points", float(len(ours) != left), 0)
        same("points", float((np.abs(points[:left] - ours) > 1e-5).mean()), 0)

    return Contest({**contenders, C: Contender(plain, SCANS)}, check, facts)


TASK = Task("thinning a scan", "scan", prepare)
