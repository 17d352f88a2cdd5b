"""Registering a scan of 180 points to each of 1000 maps, coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.bench.contest import OURS, C, Contender, Contest, Task, same
from moteslam.eval.bench.inputs import PARTICLES, in_arrays, lines, map_config, room_maps, room_poses
from moteslam.eval.bench.loops import Loops
from moteslam.kernels.tiles import CELLS, FINE_CELLS, SIDE
from moteslam.robot import se2
from moteslam.slam.mapping.tsdf import TsdfView
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import Registration, register

WEIGHT = 1e4
"""The prior's inverse variance [1/m^2, 1/rad^2]."""


def prepare(loops: Loops | None, threads: int) -> Contest:
    """The kernel, and the C loop on as many threads."""
    maps, scan = room_maps()
    view, poses, config = maps.all(), room_poses(), RegistrationConfig()
    starts, spread = np.zeros((PARTICLES, 3)), np.full(3, math.sqrt(config.prior_weight / WEIGHT))

    def kernel() -> Registration:
        return register(view, poses, spread, scan.points, np.zeros(2), starts, config)

    contenders = {OURS: Contender(kernel, PARTICLES)}
    found = kernel()
    size = float(bytes_under(view, se2.compose(poses[0], found.offsets[0]), scan.points))
    if loops is None or (threads > 1 and not loops.openmp):
        return Contest(contenders, facts={"bytes": size})
    sizes, out = map_config(), np.empty((PARTICLES, 13))
    plain = loops.bind(
        "register_all", *in_arrays(view.tiles), view.frames(poses), PARTICLES,
        np.ascontiguousarray(scan.points.T), len(scan.points), np.full(3, WEIGHT, np.float32), sizes.cell_size,
        sizes.truncation, sizes.coarse_truncation, config.residual, config.iterations, out,
    )  # fmt: skip

    def check() -> None:
        plain()
        same("offsets", float((np.abs(out[:, :3] - found.offsets) > 1e-4).mean()), 0)
        same("costs", float((np.abs(out[:, 9] - found.costs) > 1e-2 * found.costs).mean()), 0.01)

    def after() -> Mapping[str, float]:
        passes = float(out[:, 12].mean())
        return {"passes": passes, "lookups": passes * len(scan.points)}

    return Contest({**contenders, C: Contender(plain, PARTICLES)}, check, {"bytes": size}, after)


def bytes_under(view: TsdfView, pose: NDArray[np.float64], points: NDArray[np.float32]) -> int:
    """The memory of the cells that are looked up about a scan's points in the first map, on both levels."""
    ends = se2.transform_points(pose, points) - view.corner
    table, total = view.tiles.table.reshape(-1, view.tiles.columns), 0  # the first map's rows come first
    for level in (0, 1):
        side = SIDE >> level
        base = np.floor(ends / (view.config.cell_size * (1 << level)) - 0.5).astype(int)
        corners = (base[:, None] + np.array([(0, 0), (1, 0), (0, 1), (1, 1)])).reshape(-1, 2)
        tiles = table[corners[:, 1] // side, corners[:, 0] // side]
        inside = corners[:, 1] % side * side + corners[:, 0] % side
        total += lines(tiles * CELLS + FINE_CELLS * level + inside, view.tiles.pool.itemsize)
    return total


TASK = Task("registering a scan", "particle", prepare)
