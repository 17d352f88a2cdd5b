"""Correlative search over a window: the most promising places for Gauss-Newton to start from (Olson 2009)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.correlative import MAX_SEARCH_POINTS, search_scans
from moteslam.kernels.tiles import STEPS
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.mapping.tsdf import TsdfView
from moteslam.slam.registration.config import SearchConfig
from moteslam.slam.registration.registrar import Points, Registration, subsample

CROSSING = 0.3  # What a ray through a surface costs [endpoints]: little, since doors open and people walk
LEAST_KNOWN = 0.3  # A place that knows less of the endpoints than another counts as if it knew this share of them
AT_ONCE = 2048  # Offsets, best first, that are compared at once
ELSEWHERE_DISTANCE, ELSEWHERE_ROTATION = 0.5, 0.15  # A place this far off is another one [m], [rad]


class Window(NamedTuple):
    half: Array  # [3] half width along its two axes [m], [m], and in theta [rad]
    step: float  # of the lattice [m]
    heading_step: float  # likewise [rad]
    along: float = 0.0  # heading of its first axis in the frame of the predicted pose [rad]
    drift: tuple[float, float] = (0.0, 0.0)  # its middle moves by this for a radian of turn, along its axes [m/rad]

    @classmethod
    def of(cls, covariance: Array, deviations: float, step: float, heading_step: float) -> Window:
        """What is within this many standard deviations of a covariance [3, 3]; headings half round at most.

        For each heading the places that go with it: where both err together that is a part of all.
        """
        turn = float(covariance[2, 2])
        by_turn = covariance[:2, 2] / turn
        variances, axes = np.linalg.eigh(covariance[:2, :2] - turn * np.outer(by_turn, by_turn))
        half = deviations * np.sqrt([max(variances[1], 0.0), max(variances[0], 0.0), turn])
        (x, y), (u, w) = axes[:, 1].tolist(), by_turn.tolist()
        drift = x * u + y * w, x * w - y * u
        return cls(np.minimum(half, (np.inf, np.inf, np.pi)), step, heading_step, math.atan2(y, x), drift)

    @property
    def places(self) -> int:
        """Of the lattice."""
        steps = self.step, self.step, self.heading_step
        return math.prod(2 * _steps_to(half, step) + 1 for half, step in zip(self.half, steps, strict=True))


def candidates(
    maps: TsdfView, predicted: Array, spread: Array, points: Points, window: Window, most: int, config: SearchConfig
) -> Array:
    """The most promising offsets [m, 3] of a window, by the coarse level of the TSDF and the prior, best first.

    The window is around ``predicted`` [3], the prior about it of standard deviations ``spread`` [3], the scan's points
    are [k, 2]. Each is ``config.separation`` of the basin away from the better ones.
    """
    few = subsample(points, MAX_SEARCH_POINTS)
    c, s = math.cos(window.along), math.sin(window.along)
    axes = np.array([[c, -s], [s, c]])
    most_x, most_y = (_steps_to(half, window.step) for half in window.half[:2])
    shifts, blocks = lattice(most_x, most_y, window.step, config.search_block)
    most_turns = _steps_to(window.half[2], window.heading_step)
    turns = np.arange(-most_turns, most_turns + 1, dtype=np.float64) * window.heading_step
    weight = config.search_prior * len(few)
    scores, chosen = search_scans(
        maps.tiles,
        maps.frame(se2.as_pose(np.add(predicted, (0.0, 0.0, window.along)))),
        few if window.along == 0 else few @ axes.astype(np.float32),
        turns,
        weight * (turns / spread[2]) ** 2 * STEPS,
        shifts,
        weight * (np.square(shifts).sum(axis=1) / spread[0] ** 2) * STEPS,
        blocks=blocks,
        cell_size=maps.config.cell_size,
        near=config.search_near / maps.config.coarse_truncation,
        drift=window.drift,
    )
    best = np.argsort(-scores.ravel(), kind="stable")
    turned = turns[best // blocks]
    places = shifts[chosen.ravel()[best]] + turned[:, None] * window.drift
    found = np.column_stack((places @ axes.T, turned))
    return np.asarray(found[apart(found, most, config.separation * config.basin)])


def apart(offsets: Array, most: int, distance: Array) -> NDArray[np.intp]:
    """The indices of the first ``most`` of offsets [m, 3] that are ``distance`` from those before in a component."""
    chosen: list[int] = []
    places = np.stack((*offsets[:, :2].T, se2.wrap(offsets[:, 2])))
    for first in range(0, len(offsets), AT_ONCE):  # few of many are looked at
        left = np.arange(first, min(first + AT_ONCE, len(offsets)))
        for one in chosen:
            left = left[is_apart(places[:, left] - places[:, [one]], distance)]
        while len(left) and len(chosen) < most:
            chosen.append(int(left[0]))
            left = left[is_apart(places[:, left] - places[:, left[:1]], distance)]
        if len(chosen) >= most:
            break
    return np.array(chosen, np.intp)


def is_apart(differences: Array, distance: Array) -> NDArray[np.bool_]:
    """Which differences [3, ...] of two places, headings within a turn, are so large in x, y or heading."""
    x, y, turn = np.abs(differences)
    return np.asarray((x >= distance[0]) | (y >= distance[1]) | (np.minimum(turn, 2 * np.pi - turn) >= distance[2]))


@lru_cache(maxsize=16)  # the window of a loop may have megabytes of them
def lattice(most_x: int, most_y: int, step: float, block: int) -> tuple[Array, int]:
    """Shifts up to ``most`` steps in x and y, in equal blocks of neighbours, and the number of blocks."""
    across, sizes = [], []
    for most in (most_x, most_y):
        count = 2 * most + 1
        sizes.append(count if count <= 2 * block else block)
        across.append((np.arange(-(-count // sizes[-1]) * sizes[-1]) - most) * step)
    grid = np.stack(np.meshgrid(*across, indexing="ij"), axis=-1)
    m, n = (len(shifts) // size for shifts, size in zip(across, sizes, strict=True))
    return grid.reshape(m, sizes[0], n, sizes[1], 2).swapaxes(1, 2).reshape(-1, 2), m * n


def _steps_to(half: float, step: float) -> int:
    """The number of steps that reach ``half`` or just beyond."""
    return int(np.ceil(half / step - 1e-9))


def shares(found: Registration, points: int, cost: Array | float = 0.0) -> Array:
    """Of the endpoints on surfaces, less what rays through surfaces and the places themselves [N] cost [endpoints]."""
    return np.asarray((found.known * found.likelihoods - CROSSING * found.crossed - cost) / points)


def is_elsewhere(offsets: Array) -> NDArray[np.bool_]:
    """Whether offsets [..., 3] lead to another place."""
    far = np.hypot(offsets[..., 0], offsets[..., 1]) > ELSEWHERE_DISTANCE
    return np.asarray(far | (np.abs(offsets[..., 2]) > ELSEWHERE_ROTATION))


def runner_up(found: Registration, shares: Array, points: int) -> float:
    """The largest of ``shares`` of a place elsewhere than the best one, 0 at least.

    That a place knows more is no evidence for it: one at the edge of a map counts by what it knows.
    """
    best = int(shares.argmax())
    elsewhere = is_elsewhere(se2.between(found.offsets[best], found.offsets))
    fair = shares * np.maximum(found.known[best] / np.maximum(found.known, LEAST_KNOWN * points), 1.0)
    return max(float(fair[elsewhere].max()), 0.0) if elsewhere.any() else 0.0
