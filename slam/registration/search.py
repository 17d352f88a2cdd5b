"""Correlative search over a window: the most promising places for Gauss-Newton to start from (Olson 2009)."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.correlative import MAX_SEARCH_POINTS, search_scans
from moteslam.kernels.tiles import STEPS
from moteslam.robot import se2
from moteslam.slam.mapping.tsdf import TsdfView
from moteslam.slam.registration.config import SearchConfig
from moteslam.slam.registration.registrar import subsample

Array = NDArray[np.float64]
Points = NDArray[np.float32]


class Window(NamedTuple):
    """A search window around a predicted pose.

    Attributes:
        half: [3] half width in x [m], y [m], theta [rad].
        step, heading_step: of the lattice [m], [rad].
    """

    half: Array
    step: float
    heading_step: float


def candidates(
    maps: TsdfView, predicted: Array, spread: Array, points: Points, window: Window, most: int, config: SearchConfig
) -> Array:
    """The most promising offsets [m, 3] of a window, by the coarse level of the TSDF and the prior, best first.

    Args:
        maps: of one particle.
        predicted: [3] the middle of the window.
        spread: [3] standard deviation of the prior about it.
        points: [k, 2] of the scan.
        window: what is searched.
        most: offsets at most; each is ``config.separation`` of the basin away from the better ones.
        config: of the search.
    """
    few = subsample(points, MAX_SEARCH_POINTS)
    shifts, blocks = lattice(_steps_to(window.half[0], window.step), window.step, config.search_block)
    most_turns = _steps_to(window.half[2], window.heading_step)
    turns = np.arange(-most_turns, most_turns + 1, dtype=np.float64) * window.heading_step
    weight = config.search_prior * len(few)
    scores, chosen = search_scans(
        maps.tiles,
        maps.frames(predicted[None]),
        few,
        turns,
        weight * (turns / spread[2]) ** 2 * STEPS,
        shifts,
        weight * (np.square(shifts).sum(axis=1) / spread[0] ** 2) * STEPS,
        blocks=blocks,
        cell_size=maps.config.cell_size,
        near=config.search_near / maps.config.coarse_truncation,
    )
    best = np.argsort(-scores[0], kind="stable")
    found = np.column_stack((shifts[chosen[0, best]], turns[best // blocks]))
    return np.asarray(found[apart(found, most, config.separation * config.basin)])


def apart(offsets: Array, most: int, distance: Array) -> NDArray[np.intp]:
    """The indices of the first ``most`` of offsets [m, 3] that are at least ``distance`` [3] from those before.

    In one component.
    """
    chosen: list[int] = []
    left = np.arange(len(offsets))
    while len(left) and len(chosen) < most:
        chosen.append(int(left[0]))
        off = offsets[left] - offsets[left[0]]
        off[:, 2] = se2.wrap(off[:, 2])
        left = left[~(np.abs(off) < distance).all(axis=1)]
    return np.array(chosen, np.intp)


@lru_cache(maxsize=64)
def lattice(most: int, step: float, block: int) -> tuple[Array, int]:
    """Shifts in x and y up to ``most`` steps, in equal blocks of neighbours, and the number of blocks."""
    across = np.arange(-most, most + 1, dtype=np.float64) * step
    if len(across) <= 2 * block:
        return np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1).reshape(-1, 2), 1
    n = -(-len(across) // block) * block
    across = across[0] + np.arange(n) * step
    grid = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1)
    m = n // block
    return grid.reshape(m, block, m, block, 2).swapaxes(1, 2).reshape(-1, 2), m * m


def _steps_to(half: float, step: float) -> int:
    """The number of steps that reach ``half`` or just beyond."""
    return int(np.ceil(half / step - 1e-9))
