"""Searching 900 places around each of 1000 particles with 60 points, by the coarse level of their maps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.bench.contest import OURS, C, Contender, Contest, Task, same
from moteslam.eval.bench.inputs import PARTICLES, in_arrays, lines, map_config, room_maps, room_poses
from moteslam.eval.bench.loops import Loops
from moteslam.kernels.correlative import MAX_SEARCH_POINTS, search_scans
from moteslam.kernels.tiles import CELLS, FINE_CELLS, SIDE, STEPS
from moteslam.slam.mapping.tsdf import TsdfView

TURNS = np.linspace(-0.1, 0.1, 9)
SHIFTS = 0.06 * np.stack(np.divmod(np.arange(100), 10), axis=1) - 0.3
NEAR = 0.5
"""Of the coarse truncation."""


def prepare(loops: Loops | None, threads: int) -> Contest:
    """The kernel, and the C loop on as many threads."""
    maps, scan = room_maps()
    view, few = maps.all(), scan.points[::3][:MAX_SEARCH_POINTS]
    frames, cell = view.frames(room_poses()), map_config().cell_size

    def kernel() -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        return search_scans(
            view.tiles, frames, few, TURNS, np.zeros(len(TURNS)), SHIFTS, np.zeros(len(SHIFTS)), blocks=1,
            cell_size=cell, near=NEAR,
        )  # fmt: skip

    contenders = {OURS: Contender(kernel, PARTICLES)}
    facts = {"lookups": float(len(TURNS) * len(SHIFTS) * len(few)), "bytes": float(bytes_under(view, frames[0], few))}
    if loops is None or (threads > 1 and not loops.openmp):
        return Contest(contenders, facts=facts)
    scores, chosen = (np.empty((PARTICLES, len(TURNS)), np.int32) for _ in range(2))
    places = frames.copy()
    places[:, 2:] /= 2 * cell
    plain = loops.bind(
        "search_all", *in_arrays(view.tiles), places, PARTICLES,
        np.ascontiguousarray(few.T / np.float32(2 * cell)), len(few), TURNS.astype(np.float32),
        np.zeros(len(TURNS), np.int32), len(TURNS), (SHIFTS / (2 * cell)).astype(np.float32),
        np.zeros(len(SHIFTS), np.int32), len(SHIFTS), int(NEAR * STEPS), scores, chosen,
    )  # fmt: skip

    def check() -> None:
        ours, places = kernel()
        plain()
        same("scores", float((ours != scores).mean()), 0.01)  # a point on the edge of a cell may go either way
        same("places", float((places != chosen).mean()), 0.01)

    return Contest({**contenders, C: Contender(plain, PARTICLES)}, check, facts)


def bytes_under(view: TsdfView, frame: NDArray[np.float64], points: NDArray[np.float32]) -> int:
    """The memory of the cells that a search looks up in the first map."""
    c, s, x, y = frame.tolist()
    turned = np.stack((np.cos(TURNS) * c - np.sin(TURNS) * s, np.sin(TURNS) * c + np.cos(TURNS) * s), axis=-1)
    px, py = points.T
    ends = np.stack(
        (turned[:, :1] * px - turned[:, 1:] * py + x, turned[:, 1:] * px + turned[:, :1] * py + y), axis=-1
    )  # [turns, points, 2]
    moved = SHIFTS @ np.array([(c, s), (-s, c)])
    cells = np.floor((ends[:, :, None] + moved) / (2 * view.config.cell_size)).astype(int).reshape(-1, 2)
    side = SIDE // 2
    table = view.tiles.table.reshape(-1, view.tiles.columns)  # the first map's rows come first
    tiles = table[cells[:, 1] // side, cells[:, 0] // side]
    inside = cells[:, 1] % side * side + cells[:, 0] % side
    return lines(tiles * CELLS + FINE_CELLS + inside, view.tiles.pool.itemsize)


TASK = Task("searching 900 places", "particle", prepare)
