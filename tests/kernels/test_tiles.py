"""Cells and tiles: packing, interpolation across seams, copies on writing; in NumPy's memory and in Taichi's own."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from tile_pools import MIDDLE, OPTIONS, Pool, frames, room_scan, thinned
from twins import tsdf

from moteslam.kernels import tiles
from moteslam.kernels.tiles import CELLS, EMPTY, MAX_WEIGHT, SIDE, STEPS, TileStore
from moteslam.kernels.tsdf import IntegrationOptions, integrate_scans
from moteslam.kernels.types import F32_1D, F32_2D, I16_1D, I32, I32_1D, kernel, template

pytestmark = pytest.mark.usefixtures("taichi")

ASIDE = MIDDLE + np.array((0.3, -0.2, 0.1))


@kernel
def _pack(distances: F32_1D, weights: I32_1D, words: I16_1D, steps: I32_1D, unpacked: I32_1D):
    for i in range(distances.shape[0]):
        word = tiles.pack(distances[i], weights[i])
        words[i] = word
        steps[i], unpacked[i] = tiles.steps_of(word), tiles.weight_of(word)


@kernel
def _bilinear(pool: I16_1D, table: I32_1D, columns: I32, places: F32_2D, level: template, found: F32_2D):
    for i in range(places.shape[0]):
        f = tiles.bilinear(pool, table, 0, columns, places[i, 0], places[i, 1], level)
        for k in range(4):
            found[i, k] = f[k] / (1.0 if k == 3 else STEPS)


def test_a_cell_holds_every_distance_and_weight() -> None:
    steps, weights = (a.reshape(-1) for a in np.meshgrid(np.arange(-STEPS, STEPS + 1), np.arange(MAX_WEIGHT + 1)))
    words, found, unpacked = np.empty(len(steps), np.int16), *(np.empty(len(steps), np.int32) for _ in range(2))
    _pack((steps / STEPS).astype(np.float32), weights.astype(np.int32), words, found, unpacked)
    np.testing.assert_array_equal(found, steps)
    np.testing.assert_array_equal(unpacked, weights)
    assert len(np.unique(words)) == len(words)


def test_distances_are_rounded_to_the_nearest_step_and_kept_within_the_truncation() -> None:
    distances = np.array((0.49, 0.51, -0.49, -0.51, 5 * STEPS, -5 * STEPS), np.float32) / np.float32(STEPS)
    words, steps, weights = np.empty(6, np.int16), np.empty(6, np.int32), np.empty(6, np.int32)
    _pack(distances, np.full(6, 7, np.int32), words, steps, weights)
    assert steps.tolist() == [0, 1, 0, -1, STEPS, -STEPS]
    assert (weights == 7).all()


@pytest.mark.parametrize("level", [0, 1])
def test_interpolation_equals_the_twin_across_the_seams_of_tiles(level: int) -> None:
    """Within 1e-5 truncations: float32 places below 100 cells are exact to 4e-6, and slopes are at most 2 a cell."""
    generator = np.random.default_rng(level)
    pool = Pool.empty(rows=2, columns=3, tiles=7)
    pool.tables[0] = generator.permutation(6).reshape(2, 3) + 1
    pool.pool[:] = generator.integers(-STEPS, STEPS + 1, len(pool.pool)) * 32
    pool.pool[:] += (generator.integers(1, 32, len(pool.pool)) * (generator.random(len(pool.pool)) < 0.9)).astype(
        np.int16
    )
    side = SIDE >> level
    places = generator.uniform((1, 1), (3 * side - 1, 2 * side - 1), (2000, 2)).astype(np.float32)
    places[:300, 0] = side * generator.integers(1, 3, 300) + generator.uniform(-0.6, 0.6, 300)
    places[300:600, 1] = side + generator.uniform(-0.6, 0.6, 300)
    found = np.empty((len(places), 4), np.float32)
    _bilinear(pool.pool, pool.tables.reshape(-1), 3, places, level, found)
    cells = pool.tsdf(level=level)
    expected = np.array([tsdf.bilinear(cells, float(x), float(y)) for x, y in places])
    np.testing.assert_allclose(found[:, :3], expected[:, :3], rtol=0, atol=2e-5)
    np.testing.assert_array_equal(found[:, 3], expected[:, 3])
    assert 0.4 < expected[:, 3].mean() < 0.9


def test_each_of_many_particles_writes_what_it_would_write_alone() -> None:
    scans = [thinned(room_scan((0.02 * k, 0.01, 0.0))) for k in range(3)]
    poses = MIDDLE + np.random.default_rng(1).normal(0, (0.05, 0.05, 0.03), (20, 3))
    together = Pool.empty(tiles=2)
    together = together.resampled(np.zeros(20, int), more_tiles=1000)
    for scan in scans:
        together.add(poses, scan)
        together = together.resampled(np.arange(20))
    for i in (0, 7, 19):
        alone = Pool.empty()
        for scan in scans:
            alone.add(poses[i : i + 1], scan)
        np.testing.assert_array_equal(together.all_words()[i], alone.all_words()[0])


def test_one_free_tile_is_taken_for_each_tile_written_to_and_no_other() -> None:
    pool = Pool.empty(3)
    free = pool.free.copy()
    left = pool.add([MIDDLE] * 3, thinned(room_scan()))
    named = np.unique(pool.tables[pool.tables != 0])
    assert len(named) == (pool.tables != 0).sum() == len(free) - left  # each particle has tiles of its own
    assert set(named) == set(free[left:].tolist())
    assert (pool.shares[named] == 1).all()
    again = pool.add([MIDDLE] * 3, thinned(room_scan()))  # what is one's own is not copied again
    assert again == left


def test_a_pool_that_is_exhausted_writes_nothing_and_loses_nothing() -> None:
    first, second = thinned(room_scan()), thinned(room_scan((0.3, -0.2, 0.1)))
    small = Pool.empty(tiles=60)
    small.add([MIDDLE], first)
    small = small.resampled([0, 0, 0])
    ample = small.resampled([0, 1, 2], more_tiles=300)
    poses = ASIDE + np.array([(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.0, 0.02, 0.0)])
    before = small.all_words()
    assert small.add(poses, second) is None
    np.testing.assert_array_equal(small.all_words(), before)
    roomy = small.resampled([0, 1, 2], more_tiles=300)
    assert roomy.add(poses, second) is not None
    assert ample.add(poses, second) is not None
    np.testing.assert_array_equal(roomy.all_words(), ample.all_words())


Kind = Callable[..., TileStore]
KINDS: list[Kind] = [TileStore, partial(TileStore, on_device=True)]
MAPS = IntegrationOptions(**OPTIONS)  # type: ignore[arg-type]


def host(array: object) -> NDArray[np.generic]:
    """What is in an array, wherever it is."""
    return array if isinstance(array, np.ndarray) else array.to_numpy()  # type: ignore[attr-defined]


def cells(store: TileStore) -> NDArray[np.generic]:
    """Every cell of every map [n, rows * columns, CELLS], whatever the numbers of the tiles."""
    t = store.tiles
    return host(t.pool).reshape(-1, CELLS)[host(t.table).reshape(t.maps, t.size)]


def mapped(kind: Kind, tiles: int = 400) -> TileStore:
    """Three maps, of which two were written to from places of their own."""
    store = kind(9, 10, tiles)
    assert integrate_scans(store, frames([MIDDLE]), [thinned(room_scan())], options=MAPS)
    store.resample(np.array([0, 0, 0]))
    shifts = np.array([(0.0, 0.0, 0.0), (0.06, 0.0, 0.0), (0.0, -0.04, 0.02)])
    assert integrate_scans(store, frames(MIDDLE + shifts), [thinned(room_scan((0.1, 0.1, 0.1)))], options=MAPS)
    return store


def check_counts(store: TileStore) -> None:
    """Shares and free tiles are what the tables say."""
    store.count()
    table, shares, free = host(store.tiles.table), host(store.shares), host(store.free)[: store.left]
    expected = np.bincount(table, minlength=store.capacity)
    expected[EMPTY] = store.tiles.maps + 1
    np.testing.assert_array_equal(shares, expected)
    assert sorted(free.tolist()) == np.flatnonzero(expected == 0).tolist()


def test_both_hold_the_same_maps_through_all_that_happens_to_them() -> None:
    stores = [mapped(kind) for kind in KINDS]
    for change in (
        lambda store: store.resample(np.array([2, 0, 2, 1, 1])),
        lambda store: store.grow(17, 18, 8, 0),
        lambda store: store.enlarge(),
        lambda store: store.resample(np.array([4, 0])),
        lambda store: store.grow(17, 26, 0, 8),
    ):
        for store in stores:
            change(store)
            check_counts(store)
        np.testing.assert_array_equal(cells(stores[1]), cells(stores[0]))
        assert stores[0].nbytes == stores[1].nbytes == 2 * CELLS * stores[0].capacity + 4 * stores[0].tiles.table.size
        assert stores[0].tiles[2:] == stores[1].tiles[2:]
    assert cells(stores[0]).any(axis=(1, 2)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_children_have_their_parents_map_and_nobody_writes_to_anothers(kind: Kind) -> None:
    store = mapped(kind)
    parents = cells(store)
    assert (parents[0] != parents[1]).any()
    store.resample(np.array([1, 1, 0]))
    np.testing.assert_array_equal(cells(store), parents[[1, 1, 0]])
    ends = room_scan((0.1, 0.1, 0.1))[100:200]
    poses = frames(MIDDLE + np.array([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0)]))
    assert integrate_scans(store, poses, [thinned(ends)], options=MAPS)
    children = cells(store)
    assert (children[0] != children[1]).any()
    assert (children[0] != parents[1]).any()
