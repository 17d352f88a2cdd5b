"""The maps that grow with the robot: occupancy, and the signed distances of all particles."""

from functools import partial

import numpy as np
import pytest
from slam_rooms import circled_room, run
from tile_pools import room_scan, thinned

from moteslam.errors import InputError
from moteslam.kernels.scans import ThinnedScan
from moteslam.kernels.tiles import CELLS, FINE_CELLS, SIDE, TileStore
from moteslam.robot import se2
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.recording import LidarStream, OdometryStream, Recording
from moteslam.slam.inputs.synchronise import synchronise
from moteslam.slam.mapping import tsdf
from moteslam.slam.mapping.config import MapConfig, TsdfConfig
from moteslam.slam.mapping.occupancy import CHUNK, UNIT, OccupancyGrid, draw_map
from moteslam.slam.mapping.tsdf import TsdfMaps

pytestmark = pytest.mark.usefixtures("taichi")


def value(grid: OccupancyGrid, x: float, y: float) -> float:
    """The log-odds of the cell at (x, y) [m]."""
    column, row = np.floor((np.array([x, y]) - grid.origin) / grid.cell_size).astype(int)
    return float(grid.log_odds[row, column]) * UNIT


def test_one_scan_marks_endpoints_and_the_way_to_them():
    grid = OccupancyGrid(MapConfig(cell_size=0.1))
    grid.add_scan(se2.IDENTITY, [[1.05, 0.05], [0.05, -0.95]], (0.05, 0.05))
    assert value(grid, 1.05, 0.05) == pytest.approx(np.log(4), abs=1e-3)
    assert value(grid, 0.05, -0.95) == pytest.approx(np.log(4), abs=1e-3)
    assert value(grid, 0.55, 0.05) == pytest.approx(-np.log(4), abs=1e-3)
    assert value(grid, 0.05, -0.45) == pytest.approx(-np.log(4), abs=1e-3)
    assert value(grid, 1.15, 0.05) == 0
    assert grid.occupied.sum() == 2


@pytest.mark.parametrize("target", [(100.05, 3.05), (-7.05, -100.05)])
def test_growing_keeps_what_is_there(target: tuple[float, float]):
    grid = OccupancyGrid(MapConfig(cell_size=0.1))
    grid.add_scan(se2.IDENTITY, [[1.05, 0.05]], (0.05, 0.05))
    before = grid.log_odds.astype(int).sum()
    free = value(grid, 0.55, 0.05)
    assert (grid.log_odds.size, free < 0) == (4 * CHUNK * CHUNK, True)
    grid.add_scan(se2.IDENTITY, [target], target)
    assert value(grid, 0.55, 0.05) == free
    assert value(grid, *target) == pytest.approx(np.log(4), abs=1e-3)
    assert grid.log_odds.astype(int).sum() == before + round(np.log(4) / UNIT)
    assert not grid.occupied[[0, -1]].any()
    assert not grid.occupied[:, [0, -1]].any()


def test_a_snapshot_is_cut_to_what_was_seen_and_stays_in_place():
    grid = OccupancyGrid(MapConfig(cell_size=0.1))
    grid.add_scan(se2.IDENTITY, [[3.0, 1.0]], (-2.0, 0.0))
    snapshot = grid.snapshot()
    row, column = np.unravel_index(np.argmax(snapshot.values), snapshot.values.shape)
    assert (column + 0.5) * 0.1 + snapshot.origin[0] == pytest.approx(3.0, abs=0.06)
    assert (row + 0.5) * 0.1 + snapshot.origin[1] == pytest.approx(1.0, abs=0.06)
    assert snapshot.values.shape[1] < 60


def test_a_map_beyond_all_bounds_is_refused():
    grid = OccupancyGrid(MapConfig(cell_size=0.005))
    with pytest.raises(InputError, match="the map would grow to"):
        grid.add_scan(se2.IDENTITY, [[1e6, 1e6]], (0.0, 0.0))


def test_a_map_is_drawn_of_some_scans_from_where_they_were_seen():
    ranges = np.random.default_rng(1).uniform(1, 6, (3, 40)).astype(np.float32)
    stamps, poses = np.arange(3.0), np.array([(0, 0, 0), (0.5, 0.1, 0.3), (1.0, -0.2, -0.4)])
    recording = Recording(
        "drawn",
        Platform(lidar=LidarSpec(x=0.2, y=-0.1)),
        lidar=LidarStream(stamps, ranges, -2.0, 0.1, 0.1, 30.0),
        odometry=OdometryStream(stamps, poses),
    )
    scans = synchronise(recording).scans
    angles = -2.0 + 0.1 * np.arange(40)
    ends = (0.2, -0.1) + ranges[1][:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    np.testing.assert_allclose(scans.points(1), ends, atol=1e-5)
    grid = OccupancyGrid(MapConfig())
    for index in (0, 2):
        seen = se2.transform_points(poses[index], np.vstack(((0.2, -0.1), scans.points(index))))
        grid.add_scan(se2.IDENTITY, seen[1:], seen[0])
    drawn, expected = draw_map(MapConfig(), scans, [0, 2], poses[[0, 2]]).snapshot(), grid.snapshot()
    np.testing.assert_array_equal(drawn.values, expected.values)
    assert drawn.origin == expected.origin
    assert (drawn.values > 0).sum() > 60


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


@pytest.mark.parametrize("looked_at", [0, 17, 29])
def test_a_map_that_is_looked_at_has_its_scan_whenever_the_others_are_written(looked_at: int) -> None:
    """Where one alone was looked at for several scans the others are written later, to the same cells."""
    poses = np.random.default_rng(3).normal(0, (0.2, 0.2, 0.1), (30, 3))
    expected, maps = mapped(poses, 30), mapped(particles=30)
    for _ in range(5):
        maps.of(looked_at)
    maps.integrate(poses, thinned(room_scan()))
    for particle in (looked_at, 0, 14, 15, 29):
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


def test_a_truncation_beyond_the_coarse_one_stays_within_the_tables():
    maps = TsdfMaps(TsdfConfig(cell_size=0.05, truncation=4.0, coarse_truncation=0.1))
    maps.integrate(np.array([[6.0, -7.0, 0.0]]), thinned(room_scan()))
    assert len(cells(maps)) > 20_000


def test_a_full_pool_is_refused_before_memory_runs_out(monkeypatch: pytest.MonkeyPatch):
    maps = mapped(particles=40)
    monkeypatch.setattr(tsdf, "MAX_TILES", 300)
    seen = cells(maps)
    maps.integrate(np.random.default_rng(6).normal(0, 0.1, (40, 3)), thinned(room_scan()))
    with pytest.raises(InputError, match=r"^particles: 256 tiles of 40 particles' maps are full, expected fewer"):
        maps.all()
    assert all(cells(maps, particle) == seen for particle in range(40))


def test_tables_that_would_take_all_memory_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tsdf, "MAX_ENTRIES", 20 * 16 * 16)
    with pytest.raises(InputError, match=r"^particles: 21 tables of 16 x 16 tiles of 1.6 m, expected at most"):
        mapped(particles=21)
    maps = mapped(particles=20)
    maps.integrate(np.tile((12.0, 0.0, 0.0), (20, 1)), thinned(room_scan()))
    with pytest.raises(InputError, match=r"^particles: 20 tables of 24 x 16 tiles"):
        maps.all()


@pytest.mark.parametrize("step", [0.003, 0.05, 1.0])
def test_nobody_writes_into_the_empty_tile_or_one_that_is_shared(step: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the path of the surface: every tile that a cell of it lies in is copied before."""
    monkeypatch.setattr(tsdf, "FIRST_TILES", 256)  # where they run out, the last that shares one may write to it
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
        estimate = run(recording, "particles=20", "resample_below=1", seed=1)
        assert estimate.diagnostics["resampled"].any()
        runs.append(estimate)
    for path in ("trajectory", "trajectory_final"):
        np.testing.assert_array_equal(getattr(runs[1], path).poses, getattr(runs[0], path).poses)
    np.testing.assert_array_equal(runs[1].map.values, runs[0].map.values)
