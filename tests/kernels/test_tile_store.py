"""Stores of tiles: what kernels read is the same in NumPy's memory and in Taichi's own, which on a GPU is the GPU's."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from tile_pools import MIDDLE, OPTIONS, frames, room_scan, thinned

from moteslam.kernels.tile_store import DeviceTileStore, TileStore
from moteslam.kernels.tiles import CELLS, EMPTY
from moteslam.kernels.tsdf import IntegrationOptions, integrate_scans

pytestmark = pytest.mark.usefixtures("taichi")

KINDS = [TileStore, DeviceTileStore]
MAPS = IntegrationOptions(**OPTIONS)  # type: ignore[arg-type]


def host(array: object) -> NDArray[np.generic]:
    """What is in an array, wherever it is."""
    return array if isinstance(array, np.ndarray) else array.to_numpy()  # type: ignore[attr-defined]


def cells(store: TileStore) -> NDArray[np.generic]:
    """Every cell of every map [n, rows * columns, CELLS], whatever the numbers of the tiles."""
    t = store.tiles
    return host(t.pool).reshape(-1, CELLS)[host(t.table).reshape(t.maps, t.size)]


def mapped(kind: type[TileStore], tiles: int = 400) -> TileStore:
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
def test_children_have_their_parents_map_and_nobody_writes_to_anothers(kind: type[TileStore]) -> None:
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


@pytest.mark.parametrize("kind", KINDS)
def test_a_store_without_room_says_so_and_keeps_what_it_has(kind: type[TileStore]) -> None:
    store = kind(9, 10, 8)
    while not integrate_scans(store, frames([MIDDLE]), [thinned(room_scan())], options=MAPS):
        assert not cells(store).any()
        store.enlarge()
    assert store.capacity > 8
    assert cells(store).any()
