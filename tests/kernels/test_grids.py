"""The update of a grid and the search on it against their twins."""

import numpy as np
import pytest
from twins import grids

from moteslam.kernels.matching import match_poses
from moteslam.kernels.occupancy import update_grid

pytestmark = pytest.mark.usefixtures("taichi")

STEP = {"hit": 7, "miss": 3, "limit": 20, "threshold": 6}


def empty(height: int = 24, width: int = 32) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    shape = (height, width)
    return np.zeros(shape, np.int16), np.zeros(shape, np.uint8), np.zeros(shape, np.int32)


@pytest.mark.parametrize(("per_ray", "guard"), [(False, 0), (True, 0), (False, 1), (False, 2)])
@pytest.mark.parametrize(("seed", "shape"), [(0, (3, 8)), (1, (31, 56)), (2, (64, 24))])
def test_the_update_equals_the_twin(seed: int, per_ray: bool, guard: int, shape: tuple[int, int]) -> None:
    generator = np.random.default_rng(seed)
    log_odds, occupied, seen = empty(*shape)
    high = (shape[1] - 1, shape[0] - 1)
    for scan in range(1, 7):
        start, ends = generator.integers(1, high), generator.integers(1, high, (generator.integers(0, 60), 2))
        expected = grids.update_grid(
            log_odds, start, ends, hit=7, miss=3, limit=20, guard=guard, per_ray=per_ray
        )  # fmt: skip
        update_grid(log_odds, occupied, seen, start, ends, **STEP, scan=scan, guard=guard, per_ray=per_ray)
        np.testing.assert_array_equal(log_odds, expected)
        np.testing.assert_array_equal(occupied, log_odds > STEP["threshold"])
    assert not occupied[[0, -1]].any()
    assert not occupied[:, [0, -1]].any()


def test_a_scan_changes_a_cell_once_and_hits_win() -> None:
    log_odds, occupied, seen = empty()
    ends = [(10, 5), (10, 5), (20, 5)]  # the third ray runs over the end of the others
    update_grid(log_odds, occupied, seen, (2, 5), ends, **STEP, scan=1)
    assert log_odds[5].tolist() == [0, 0, *[-3] * 8, 7, *[-3] * 9, 7, *[0] * 11]
    assert np.flatnonzero(occupied[5]).tolist() == [10, 20]


def test_every_ray_counts_when_asked() -> None:
    log_odds, occupied, seen = empty()
    update_grid(log_odds, occupied, seen, (2, 5), [(4, 5), (4, 5), (6, 5)], **STEP, scan=1, per_ray=True)
    assert log_odds[5, :8].tolist() == [0, 0, -9, -9, 11, -3, 7, 0]


CELL = 0.05
PAPER = (-0.1, -0.05, 0.0, 0.05, 0.1)
ORIGIN = (-2.3, -1.9)


def random_case(seed: int, *, beams: int, particles: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    grid = np.zeros((61, 88), np.uint8)
    grid[1:-1, 1:-1] = generator.random((59, 86)) < 0.2
    points = generator.normal(0, 0.8, (beams, 2)).astype(np.float32)
    poses = np.column_stack((generator.uniform(-3, 3, (particles, 2)), generator.uniform(-7, 7, particles)))
    return grid, poses, points


@pytest.mark.parametrize("beams", [0, 1, 57, 600])
@pytest.mark.parametrize(
    ("offsets_xy", "offsets_theta"),
    [
        (PAPER, (-0.1, 0.0, 0.1)),
        ((0.0,), (0.0,)),
        ((0.05, 0.15), (0.02,)),  # whole cells on one side, of even number
        ((-0.2, 0.0, 0.2), (0.0, 0.1)),  # whole cells, too far apart for the windows
        ((-0.07, 0.0, 0.03), (-0.2, 0.0)),  # no whole cells
    ],
)
def test_the_search_equals_the_twin(
    beams: int, offsets_xy: tuple[float, ...], offsets_theta: tuple[float, ...]
) -> None:
    grid, poses, points = random_case(beams, beams=beams, particles=3)
    offsets = {"offsets_xy": offsets_xy, "offsets_theta": offsets_theta}
    scores, indices = grids.match_poses(grid, ORIGIN, CELL, poses, points, **offsets)
    found = match_poses(grid, ORIGIN, CELL, poses, points, **offsets)
    assert found.scores.tolist() == scores
    assert found.indices.tolist() == [list(index) for index in indices]
    i, j, k = found.indices.T
    moved = poses + np.column_stack((np.take(offsets_xy, i), np.take(offsets_xy, j), np.take(offsets_theta, k)))
    np.testing.assert_array_equal(found.poses, moved)


def test_ties_go_to_the_centre_then_to_the_first() -> None:
    grid = np.zeros((40, 40), np.uint8)
    nothing = match_poses(grid, (0, 0), CELL, [(1.0, 1.0, 0.0)], [(0.1, 0.1)], offsets_xy=PAPER, offsets_theta=PAPER)
    assert nothing.indices.tolist() == [[2, 2, 2]]
    grid[19, 20] = grid[21, 20] = grid[20, 19] = grid[20, 21] = 1  # each one cell from the centre
    tied = match_poses(grid, (0, 0), CELL, [(1.01, 1.01, 0.0)], [(0.0, 0.0)], offsets_xy=PAPER, offsets_theta=(0.0,))
    assert tied.scores.tolist() == [1]
    assert tied.indices.tolist() == [[1, 2, 0]]


def test_particles_far_apart_and_off_the_map() -> None:
    grid, poses, points = random_case(5, beams=50, particles=8)
    poses[:4, :2] = [(1e6, 0), (-1e6, 0), (0, 1e9), (-2.3, 1e3)]
    scores, indices = grids.match_poses(grid, ORIGIN, CELL, poses, points, offsets_xy=PAPER, offsets_theta=(0.0, 0.1))
    found = match_poses(grid, ORIGIN, CELL, poses, points, offsets_xy=PAPER, offsets_theta=(0.0, 0.1))
    assert found.scores.tolist() == scores
    assert found.indices.tolist() == [list(index) for index in indices]
    beyond = [(-100.0, 0, 0), (0, -1e12, 3), (1e30, 1, 1)]
    for offsets in (PAPER, (-0.07, 0.0, 0.03)):
        nothing = match_poses(grid, ORIGIN, CELL, beyond, points, offsets_xy=offsets, offsets_theta=(0.0, 0.1))
        assert nothing.scores.tolist() == [0, 0, 0]
