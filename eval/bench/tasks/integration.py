"""Integrating a scan of 180 points into each of 1000 maps whose tiles are the particles' own."""

from __future__ import annotations

import numpy as np

from moteslam.eval.bench.contest import OURS, C, Contender, Contest, Task, same
from moteslam.eval.bench.inputs import MOVED, PARTICLES, in_arrays, lines, map_config, room_maps, room_poses
from moteslam.eval.bench.loops import Loops
from moteslam.kernels.thinning import ThinnedScan
from moteslam.kernels.tiles import MAX_WEIGHT, WEIGHT_BITS
from moteslam.slam.mapping.tsdf import TsdfMaps

ROUNDED = 1e-3
"""A share of the cells may differ by a step: their averages are rounded."""
STRAY = 1e-5
"""A share of the cells may differ by more: the centre of one lies on the edge of a band."""


def prepare(loops: Loops | None, threads: int) -> Contest:
    """The kernel, and the C loop on as many threads, in a pool of tiles of its own."""
    maps, scan = room_maps()
    poses = room_poses() + MOVED
    contenders = {OURS: Contender(lambda: maps.integrate(poses, scan), PARTICLES)}
    facts = written(scan)
    if loops is None or (threads > 1 and not loops.openmp):
        return Contest(contenders, facts=facts)
    c, view = map_config(), maps.all()
    (pool, *table), frames = in_arrays(view.tiles._replace(pool=view.tiles.pool.copy())), view.frames(poses)
    frames[:, 2:] /= c.cell_size
    plain = loops.bind(
        "integrate_all", pool, *table, frames, PARTICLES,
        np.ascontiguousarray(scan.points.T / np.float32(c.cell_size)), scan.joined, len(scan.points),
        c.truncation / c.cell_size, c.coarse_truncation / (2 * c.cell_size), 2 * c.coarse_chord,
        c.near / c.cell_size, c.near_weight, c.max_weight,
    )  # fmt: skip

    def check() -> None:
        maps.integrate(poses, scan)
        plain()
        ours = maps.all().tiles.pool
        known = ours != 0
        steps = np.abs((ours[known] >> WEIGHT_BITS) - (pool[known] >> WEIGHT_BITS))
        same("cells", float((ours != pool).sum() / known.sum()), ROUNDED)
        same("cells by more than a step", float((steps > 1).mean()), STRAY)
        same("weights", float(((ours ^ pool) & MAX_WEIGHT != 0).sum() / known.sum()), STRAY)

    return Contest({**contenders, C: Contender(plain, PARTICLES)}, check, facts)


def written(scan: ThinnedScan) -> dict[str, float]:
    """The cells that a particle's scan changes, and the bytes of their cache lines, read and written."""
    maps = TsdfMaps(map_config())
    maps.integrate(np.zeros((1, 3)), scan)
    pool = maps.all().tiles.pool
    touched = np.flatnonzero(pool)
    return {"lookups": float(len(touched)), "bytes": 2.0 * lines(touched, pool.itemsize)}


TASK = Task("integrating a scan", "particle", prepare)
