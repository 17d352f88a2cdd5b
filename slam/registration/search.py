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
from moteslam.slam.registration.registrar import Registration, subsample

Array = NDArray[np.float64]
Points = NDArray[np.float32]

CROSSING = 0.3
"""What a ray through a surface costs [endpoints]: little, since doors open and people walk."""
LEAST_KNOWN = 0.3
"""A place that knows less of the endpoints than another counts as if it knew this share of them."""
ELSEWHERE_DISTANCE, ELSEWHERE_ROTATION = 0.5, 0.15
"""A place this far off is another one [m], [rad]."""


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


def shares(found: Registration, points: int, cost: Array | float = 0.0) -> Array:
    """Of the endpoints on surfaces, less what rays through surfaces and the place itself cost [N].

    Args:
        found: at N places.
        points: all endpoints.
        cost: [N] of the places [endpoints].
    """
    return np.asarray((found.known * found.likelihoods - CROSSING * found.crossed - cost) / points)


def runner_up(found: Registration, shares: Array, points: int) -> float:
    """The largest share of a place elsewhere than the best one, 0 at least.

    That a place knows more is no evidence for it: one at the edge of a map counts by what it knows.

    Args:
        found, points: as of ``shares``, which gave the second.
    """
    best = int(shares.argmax())
    off = np.abs(se2.between(found.offsets[best], found.offsets))
    elsewhere = (np.hypot(off[:, 0], off[:, 1]) > ELSEWHERE_DISTANCE) | (off[:, 2] > ELSEWHERE_ROTATION)
    fair = shares * np.maximum(found.known[best] / np.maximum(found.known, LEAST_KNOWN * points), 1.0)
    return max(float(fair[elsewhere].max()), 0.0) if elsewhere.any() else 0.0
