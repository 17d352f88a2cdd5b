"""The grid update against its twin, cell by cell."""

import numpy as np
import pytest
from twins import grids

from moteslam.kernels.occupancy import update_grid

pytestmark = pytest.mark.usefixtures("taichi")

STEP = {"hit": 7, "miss": 3, "limit": 20, "threshold": 6}


def empty(height: int = 24, width: int = 32) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    shape = (height, width)
    return np.zeros(shape, np.int16), np.zeros(shape, np.uint8), np.zeros(shape, np.int32)


@pytest.mark.parametrize(("per_ray", "guard"), [(False, 0), (True, 0), (False, 1), (False, 2)])
@pytest.mark.parametrize(("seed", "shape"), [(0, (3, 8)), (1, (31, 56)), (2, (64, 24))])
def test_equals_the_twin(seed: int, per_ray: bool, guard: int, shape: tuple[int, int]) -> None:
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
