"""Matching scans of 1081 beams to a grid: 5 x 5 x 5 poses around each of 2000 particles."""

from __future__ import annotations

import numpy as np

from moteslam.eval.bench.contest import OURS, C, Contender, Contest, Task, same
from moteslam.eval.bench.inputs import BEAMS, CELL, CELLS, scan_and_grid
from moteslam.eval.bench.loops import Loops
from moteslam.kernels.matching import Match, match_poses

POSES = 2000
OFFSETS = np.array((-0.1, -0.05, 0.0, 0.05, 0.1))
"""In x, y and theta [m], [rad]: whole cells."""


def prepare(loops: Loops | None, threads: int) -> Contest:
    """The kernel, and the C loop on as many threads."""
    grid, points = scan_and_grid()
    poses = np.random.default_rng(5).normal((50.0, 48.0, 0.0), (0.1, 0.1, 0.05), (POSES, 3))

    def kernel() -> Match:
        return match_poses(grid, (0.0, 0.0), CELL, poses, points, offsets_xy=OFFSETS, offsets_theta=OFFSETS)

    contenders = {OURS: Contender(kernel, POSES)}
    tried = len(OFFSETS) ** 3
    facts = {"lookups": float(tried * BEAMS), "bytes": float(points.nbytes / 2)}
    if loops is None or (threads > 1 and not loops.openmp):
        return Contest(contenders, facts=facts)
    turned = np.repeat(poses, len(OFFSETS), axis=0)
    turned[:, 2] += np.tile(OFFSETS, POSES)
    frames = np.column_stack((np.cos(turned[:, 2]), np.sin(turned[:, 2]), turned[:, :2] / CELL)).astype(np.float32)
    i, j, k = np.indices((len(OFFSETS),) * 3) - len(OFFSETS) // 2
    order = np.argsort((i**2 + j**2 + k**2).reshape(-1), kind="stable").astype(np.int32)  # nearest the middle first
    scores, best = (np.empty(POSES, np.int32) for _ in range(2))
    plain = loops.bind(
        "match_all", grid, CELLS, CELLS, frames, POSES, len(OFFSETS),
        np.ascontiguousarray((points.T / CELL).astype(np.float32)), BEAMS,
        np.rint(OFFSETS / CELL).astype(np.int32), len(OFFSETS), order, scores, best,
    )  # fmt: skip

    def check() -> None:
        plain()
        ours = kernel()
        chosen = np.stack(np.unravel_index(best, (len(OFFSETS),) * 3), axis=-1)
        same("scores", float((ours.scores != scores).mean()), 0.01)  # a point on the edge of a cell may go either way
        same("poses", float((ours.indices != chosen).any(axis=1).mean()), 0.01)

    return Contest({**contenders, C: Contender(plain, POSES)}, check, facts)


TASK = Task("matching 5 x 5 x 5", "particle", prepare)
