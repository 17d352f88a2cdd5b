"""The maps of all particles: growing, sharing, and refusing to take all memory."""

from functools import partial

import numpy as np
import pytest
from slam_rooms import circled_room
from tile_pools import room_scan, thinned

from moteslam.errors import InputError
from moteslam.kernels.scans import ThinnedScan
from moteslam.kernels.tiles import CELLS, FINE_CELLS, SIDE, TileStore
from moteslam.slam.mapping import tsdf
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.mapping.tsdf import TsdfMaps
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.registrar import register
from moteslam.slam.registration.search import Window, candidates
from moteslam.slam.run import run_slam
from moteslam.slam.settings import resolve_config

pytestmark = pytest.mark.usefixtures("taichi")

START = np.zeros((1, 3))
CONFIG = TsdfConfig(cell_size=0.05, truncation=0.15, coarse_truncation=0.4)


def cells(maps: TsdfMaps, particle: int = 0) -> dict[tuple[int, int], int]:
    """Every fine cell of a particle that was seen, by its column and row in the world."""
    view = maps.of(particle)
    pool, table, rows, columns, _, first = view.tiles
    numbers = table[first : first + rows * columns]
    tiles = pool.reshape(-1, CELLS)[numbers, :FINE_CELLS].reshape(rows, columns, SIDE, SIDE)
    words = tiles.swapaxes(1, 2).reshape(rows * SIDE, columns * SIDE)
    column, row = np.rint(np.array(view.corner) / view.config.cell_size).astype(int)
    return {(int(x) + column, int(y) + row): int(words[y, x]) for y, x in np.argwhere(words & 31)}


def mapped(poses: np.ndarray = START, particles: int = 1) -> TsdfMaps:
    """Maps of one scan of the room from its middle, then one from each pose."""
    maps = TsdfMaps(CONFIG)
    maps.integrate(START, thinned(room_scan()))
    maps.resample(np.zeros(particles, np.int64))
    if len(poses) == particles and poses is not START:
        maps.integrate(poses, thinned(room_scan()))
    return maps


def test_tables_that_grow_lose_nothing_and_stay_where_they_are():
    maps = mapped()
    seen, corner = cells(maps), maps.all().corner
    assert len(seen) > 1000
    maps.integrate(np.array([[-70.0, 40.0, 0.3]]), thinned(room_scan()))
    assert maps.all().corner[0] < -70 < corner[0]
    grown = cells(maps)
    assert seen.items() <= grown.items()
    assert len(grown) > 1.8 * len(seen)
    maps.integrate(np.array([[90.0, -60.0, 0.0]]), thinned(room_scan()))
    assert grown.items() <= cells(maps).items()


def test_a_pool_that_grows_loses_nothing(monkeypatch: pytest.MonkeyPatch):
    poses = np.random.default_rng(3).normal(0, (0.2, 0.2, 0.1), (30, 3))
    monkeypatch.setattr(tsdf, "FIRST_TILES", 4096)
    expected = mapped(poses, 30)
    assert len(expected.all().tiles.pool) == 4096 * CELLS  # it did not grow
    monkeypatch.setattr(tsdf, "FIRST_TILES", 2)
    maps = mapped(poses, 30)
    assert len(maps.all().tiles.pool) > 30 * 20 * CELLS
    for particle in (0, 11, 29):
        assert cells(maps, particle) == cells(expected, particle)


def test_memory_is_that_of_tiles_and_tables_and_does_not_grow_where_nothing_new_is_seen():
    poses = np.random.default_rng(4).normal(0, (0.05, 0.05, 0.02), (20, 3))
    maps = mapped(poses, 20)
    view = maps.all()
    assert maps.memory == view.tiles.pool.nbytes + view.tiles.table.nbytes
    generator, most = np.random.default_rng(5), 0
    for turn in range(60):
        maps.resample(np.sort(generator.integers(0, 20, 20)))
        maps.integrate(poses, thinned(room_scan()))
        if turn == 9:
            most = maps.memory
    assert maps.memory == most


def test_scans_are_found_in_the_maps_they_were_written_to():
    truth = np.array([(0.0, 0.0, 0.0), (0.08, -0.05, 0.03)])
    maps = TsdfMaps(CONFIG)
    maps.resample(np.zeros(2, np.int64))
    scan = thinned(room_scan())
    maps.integrate(truth, scan)
    spread = np.full(3, 2.0)
    found = register(
        maps.all(), np.zeros((2, 3)), spread, scan.points, np.zeros(2), np.zeros((2, 3)), RegistrationConfig()
    )
    np.testing.assert_allclose(found.offsets, truth, rtol=0, atol=1e-3)
    window = Window(np.array((0.5, 0.5, 0.02)), 0.1, 0.02)
    start = truth[1] + np.array((0.3, -0.4, 0.0))
    (best,) = candidates(maps.of(1), start, spread, scan.points, window, 1, TrackingConfig())
    np.testing.assert_allclose(best[:2], (-0.3, 0.4), atol=0.11)


def test_a_truncation_beyond_the_coarse_one_stays_within_the_tables():
    maps = TsdfMaps(TsdfConfig(cell_size=0.05, truncation=4.0, coarse_truncation=0.1))
    maps.integrate(np.array([[6.0, -7.0, 0.0]]), thinned(room_scan()))
    assert len(cells(maps)) > 20_000


def test_a_full_pool_is_refused_before_memory_runs_out(monkeypatch: pytest.MonkeyPatch):
    maps = mapped(particles=40)
    monkeypatch.setattr(tsdf, "MAX_TILES", 300)
    seen = cells(maps)
    with pytest.raises(InputError, match=r"^particles: 256 tiles of 40 particles' maps are full, expected fewer"):
        maps.integrate(np.random.default_rng(6).normal(0, 0.1, (40, 3)), thinned(room_scan()))
    assert all(cells(maps, particle) == seen for particle in range(40))


def test_tables_that_would_take_all_memory_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tsdf, "MAX_ENTRIES", 20 * 16 * 16)
    with pytest.raises(InputError, match=r"^particles: 21 tables of 16 x 16 tiles of 1.6 m, expected at most"):
        mapped(particles=21)
    maps = mapped(particles=20)
    with pytest.raises(InputError, match=r"^particles: 20 tables of 24 x 16 tiles"):
        maps.integrate(np.tile((12.0, 0.0, 0.0), (20, 1)), thinned(room_scan()))


@pytest.mark.parametrize("step", [0.003, 0.02, 0.05, 0.3, 1.0])
def test_nobody_writes_into_the_empty_tile_or_one_that_is_shared(step: float) -> None:
    """Whatever the path of the surface: every tile that a cell of it lies in is copied before."""
    for seed in range(20):
        generator = np.random.default_rng(seed)
        path = np.cumsum(generator.normal(0, step, (generator.integers(2, 60), 2)), axis=0)
        scan = ThinnedScan(path.astype(np.float32), (generator.random(len(path)) < 0.9).astype(np.int32))
        maps, poses = TsdfMaps(TsdfConfig()), generator.uniform(-6, 6, (4, 3))
        maps.resample(np.zeros(4, np.int64))
        maps.integrate(poses, scan)
        maps.resample(np.array([0, 0, 1, 2]))
        view = maps.all()
        before = view.tiles.pool.copy().reshape(-1, CELLS)
        shared = np.flatnonzero(np.bincount(view.tiles.table, minlength=len(before)) > 1)
        maps.integrate(poses + generator.normal(0, 0.3, (4, 3)), scan)
        np.testing.assert_array_equal(maps.all().tiles.pool.reshape(-1, CELLS)[shared], before[shared])


def test_a_run_with_maps_in_taichis_memory_is_the_same_to_the_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a GPU they are kept there. Tiles run out, and particles are resampled."""
    monkeypatch.setattr(tsdf, "FIRST_TILES", 2)
    recording, _ = circled_room(scans=40)
    runs = []
    for store in (TileStore, partial(TileStore, on_device=True)):
        monkeypatch.setattr(tsdf, "tile_store", store)
        estimate = run_slam(recording, resolve_config("default", ["particles=20", "resample_below=1"]), seed=1)
        assert estimate.diagnostics["resampled"].any()
        runs.append(estimate)
    np.testing.assert_array_equal(runs[1].trajectory.poses, runs[0].trajectory.poses)
    np.testing.assert_array_equal(runs[1].trajectory_final.poses, runs[0].trajectory_final.poses)
    np.testing.assert_array_equal(runs[1].map.values, runs[0].map.values)
