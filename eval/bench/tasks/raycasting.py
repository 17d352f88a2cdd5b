"""Casting 216 200 exact rays, 200 scans of 1081 beams, in a world of 500 segments; the C loop tries every segment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.bench.contest import OURS, C, Contender, Contest, Task, same
from moteslam.eval.bench.inputs import BEAMS, offices
from moteslam.eval.bench.loops import Loops
from moteslam.eval.bench.tasks import ray_peers
from moteslam.kernels.raycast import build_buckets, cast_rays

POSES, MAX_RANGE = 200, 30.0
SLIPPED = 1e-3
"""A share of the rays may pass a corner on its other side: by rounding."""


def prepare(loops: Loops | None, threads: int) -> Contest:
    """The kernel, the C loop on as many threads, and on one thread the programs of others that are installed."""
    segments = offices()
    generator = np.random.default_rng(3)
    poses = np.column_stack((generator.uniform(10, 80, (POSES, 2)), generator.uniform(-np.pi, np.pi, POSES)))
    beams = np.linspace(np.radians(-135), np.radians(135), BEAMS)
    origins, angles = np.repeat(poses[:, :2], BEAMS, axis=0), (poses[:, 2:] + beams).reshape(-1)
    buckets = build_buckets(segments)

    def kernel() -> NDArray[np.float32]:
        return cast_rays(buckets, origins, angles, max_range=MAX_RANGE)

    exact = np.minimum(kernel(), MAX_RANGE)
    contenders, facts = {OURS: Contender(kernel, len(angles))}, {"bytes": 16.0}
    plain = None
    rays, out = np.column_stack((origins, angles)).astype(np.float32), np.empty(len(angles), np.float32)
    if loops is not None and (threads == 1 or loops.openmp):
        flat = np.ascontiguousarray(segments, np.float32)
        plain = loops.bind("cast_all", flat, len(flat), rays, len(rays), MAX_RANGE, out)
        contenders[C] = Contender(plain, len(rays))
    if threads == 1:
        others, near = ray_peers.contenders(segments, rays, exact, MAX_RANGE)
        contenders, facts = contenders | others, facts | near

    def check() -> None:
        if plain is not None:
            plain()
            same("ranges", float((np.abs(out - exact) > 1e-3).mean()), SLIPPED)

    return Contest(contenders, check, facts)


TASK = Task("raycasting", "ray", prepare)
