"""Searching for scans in signed-distance maps: against the twin, and in a room."""

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from tile_pools import CELL, MIDDLE, Pool, frames, mapped_room, moved, room_scan
from twins import tsdf

from moteslam.kernels import correlative
from moteslam.kernels.correlative import MAX_SEARCH_POINTS, search_scans
from moteslam.kernels.tiles import CELLS, STEPS

pytestmark = pytest.mark.usefixtures("taichi")


@pytest.fixture(scope="module")
def room() -> Pool:
    """The map of one scan from the middle."""
    return mapped_room()


def search(
    pool: Pool, poses: ArrayLike, points: ArrayLike, turns: ArrayLike, shifts: NDArray[np.float64], *, blocks: int = 1,
    turn_costs: ArrayLike | None = None, shift_costs: ArrayLike | None = None, near: float = 0.5,
    drift: tuple[float, float] = (0.0, 0.0),
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:  # fmt: skip
    return search_scans(
        pool.tiles, frames(poses), points, turns,
        np.zeros(len(np.asarray(turns))) if turn_costs is None else turn_costs, shifts,
        np.zeros(len(shifts)) if shift_costs is None else shift_costs, blocks=blocks, cell_size=CELL, near=near,
        drift=drift,
    )  # fmt: skip


def lattice(half: int, step: float) -> NDArray[np.float64]:
    ticks = np.arange(-half, half + 1) * step
    return np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 2)


def few(points: NDArray[np.float32], count: int = MAX_SEARCH_POINTS) -> NDArray[np.float32]:
    return points[np.linspace(0, len(points) - 1, count).astype(int)]


LAID_OUT, IN_TILES = 1e-9, 1e9
"""How often cells would have to be looked up before their scores are laid out."""


@pytest.mark.parametrize("looked_up", [LAID_OUT, IN_TILES])
def test_search_scores_equal_the_twin(room: Pool, monkeypatch: pytest.MonkeyPatch, looked_up: float) -> None:
    """Equal but for points within float32's rounding of a cell's edge: no more than one in all."""
    monkeypatch.setattr(correlative, "LOOKED_UP", looked_up)
    pose, points = MIDDLE + np.array((0.1, -0.2, 0.7)), few(room_scan((0.0, 0.0, 0.7)), 40)
    turns, shifts = np.array((-0.1, 0.0, 0.05)), lattice(3, 0.11)
    expected = tsdf.search(room.tsdf(level=1), pose, points, turns, shifts, cell_size=2 * CELL, near=int(0.5 * STEPS))
    costs = 7.0 * np.arange(3), 3.0 * np.arange(len(shifts))
    scores, chosen = search(room, [pose], points, turns, shifts, turn_costs=costs[0], shift_costs=costs[1], blocks=7)
    expected = expected - costs[0][:, None] - costs[1]
    blocks = expected.reshape(3, 7, 7)
    best = blocks.argmax(axis=2) + 7 * np.arange(7)
    assert (scores.reshape(3, 7) != blocks.max(axis=2)).sum() <= 1
    assert (chosen.reshape(3, 7) != best).sum() <= 1
    assert len(np.unique(expected)) > 50


@pytest.mark.parametrize("at", [(0.0, 0.0), (-7.9, -7.1), (7.9, 7.1), (0.0, 7.1), (40.0, -3.0)])
def test_scores_that_are_laid_out_are_those_of_the_tiles(
    monkeypatch: pytest.MonkeyPatch, at: tuple[float, float]
) -> None:
    """Of three particles, in the middle of the tables, at their edges and beyond, where the edge's cells count."""
    generator = np.random.default_rng(3)
    pool = Pool.empty(3)
    pool.tables[:] = generator.integers(0, 200, pool.tables.shape)
    pool.pool[CELLS:] = generator.integers(-(1 << 15), 1 << 15, len(pool.pool) - CELLS)
    poses = MIDDLE + np.array((*at, 0.4)) + generator.uniform(-0.5, 0.5, (3, 3))
    found = []
    for looked_up in (LAID_OUT, IN_TILES):
        monkeypatch.setattr(correlative, "LOOKED_UP", looked_up)
        found.append(search(pool, poses, few(room_scan()), 0.1 * np.arange(-8, 9), lattice(12, 0.11), blocks=25))
    for laid_out, in_tiles in zip(*found, strict=True):
        np.testing.assert_array_equal(laid_out, in_tiles)
    assert len(np.unique(found[0][0])) > 20


def test_shifts_drift_with_the_turn(room: Pool) -> None:
    """As if each turn were looked for among shifts of its own."""
    shifts, turns, drift = lattice(6, 0.1), np.array((-0.2, 0.1, 0.3)), (2.0, -1.5)
    pose, points = moved(MIDDLE, (0.5, -0.3, 0.2)), few(room_scan())
    scores, chosen = search(room, [pose], points, turns, shifts, blocks=13, drift=drift)
    for k, turn in enumerate(turns):
        alone = search(room, [pose], points, [turn], shifts + turn * np.array(drift), blocks=13)
        np.testing.assert_array_equal((scores[0, 13 * k :][:13], chosen[0, 13 * k :][:13]), np.array(alone)[:, 0])
    assert len(np.unique(scores)) > 10


def test_costs_decide_between_places_that_fit_alike(room: Pool) -> None:
    nothing = np.empty((0, 2), np.float32)
    shifts = lattice(2, 0.1)
    costs = 10.0 * np.abs(shifts - 0.1).sum(axis=1)
    (scores,), (chosen,) = search(room, [MIDDLE], nothing, (-0.1, 0.0), shifts, shift_costs=costs, turn_costs=(5, 1e30))
    np.testing.assert_allclose(shifts[chosen], [(0.1, 0.1)] * 2)
    assert scores.tolist() == [-5, -100_000_000]
