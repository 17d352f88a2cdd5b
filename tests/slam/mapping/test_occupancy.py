"""The map that grows with the robot."""

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.recording import LidarStream, OdometryStream, Recording
from moteslam.slam.inputs.synchronise import synchronise
from moteslam.slam.mapping.config import MapConfig
from moteslam.slam.mapping.occupancy import CHUNK, UNIT, OccupancyGrid, draw_map

pytestmark = pytest.mark.usefixtures("taichi")


def value(grid: OccupancyGrid, x: float, y: float) -> float:
    """The log-odds of the cell at (x, y) [m]."""
    column, row = np.floor((np.array([x, y]) - grid.origin) / grid.cell_size).astype(int)
    return float(grid.log_odds[row, column]) * UNIT


def test_one_scan_marks_endpoints_and_the_way_to_them():
    grid = OccupancyGrid(MapConfig(cell_size=0.1))
    grid.add_scan((0.05, 0.05), np.array([[1.05, 0.05], [0.05, -0.95]]))
    assert value(grid, 1.05, 0.05) == pytest.approx(np.log(4), abs=1e-3)
    assert value(grid, 0.05, -0.95) == pytest.approx(np.log(4), abs=1e-3)
    assert value(grid, 0.55, 0.05) == pytest.approx(-np.log(4), abs=1e-3)
    assert value(grid, 0.05, -0.45) == pytest.approx(-np.log(4), abs=1e-3)
    assert value(grid, 1.15, 0.05) == 0
    assert grid.occupied.sum() == 2


@pytest.mark.parametrize("target", [(100.05, 3.05), (-100.05, 3.05), (3.05, 100.05), (-7.05, -100.05)])
def test_growing_keeps_what_is_there(target: tuple[float, float]):
    grid = OccupancyGrid(MapConfig(cell_size=0.1))
    grid.add_scan((0.05, 0.05), np.array([[1.05, 0.05]]))
    before = grid.log_odds.astype(int).sum()
    free = value(grid, 0.55, 0.05)
    assert (grid.log_odds.size, free < 0) == (4 * CHUNK * CHUNK, True)
    grid.add_scan(target, np.array([target]))
    assert value(grid, 0.55, 0.05) == free
    assert value(grid, *target) == pytest.approx(np.log(4), abs=1e-3)
    assert grid.log_odds.astype(int).sum() == before + round(np.log(4) / UNIT)
    assert not grid.occupied[[0, -1]].any()
    assert not grid.occupied[:, [0, -1]].any()


def test_a_snapshot_is_cut_to_what_was_seen_and_stays_in_place():
    grid = OccupancyGrid(MapConfig(cell_size=0.1))
    grid.add_scan((-2.0, 0.0), np.array([[3.0, 1.0]]))
    snapshot = grid.snapshot()
    row, column = np.unravel_index(np.argmax(snapshot.values), snapshot.values.shape)
    assert (column + 0.5) * 0.1 + snapshot.origin[0] == pytest.approx(3.0, abs=0.06)
    assert (row + 0.5) * 0.1 + snapshot.origin[1] == pytest.approx(1.0, abs=0.06)
    assert snapshot.values.shape[1] < 60


def test_a_map_beyond_all_bounds_is_refused():
    grid = OccupancyGrid(MapConfig(cell_size=0.005))
    with pytest.raises(InputError, match="the map would grow to"):
        grid.add_scan((0.0, 0.0), np.array([[1e6, 1e6]]))


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
    grid = OccupancyGrid(MapConfig())
    for index in (0, 2):
        points = se2.transform_points(poses[index], scans.points(index))
        grid.add_scan(se2.transform_points(poses[index], np.array((0.2, -0.1))), points)
    drawn, expected = draw_map(MapConfig(), scans, [0, 2], poses[[0, 2]]), grid.snapshot()
    np.testing.assert_array_equal(drawn.values, expected.values)
    assert drawn.origin == expected.origin
    assert (drawn.values > 0).sum() > 60
