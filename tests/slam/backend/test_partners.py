"""Which scans are held to each other, and the systems that follow: full and sparse matrices say the same."""

import numpy as np
import pytest
from numpy.typing import NDArray

from moteslam.slam.backend.graph import partners, sparse_blocks
from moteslam.slam.backend.graph.endpoints import Endpoints
from moteslam.slam.backend.graph.partners import choose_partners
from moteslam.slam.backend.graph.sparse_blocks import BlockSystem

Array = NDArray[np.float64]
SCANS, EACH = 30, 40


def along_a_wall(rng: np.random.Generator) -> tuple[Endpoints, Array]:
    """Scans that each see ten metres of a wall, a metre on from one to the next; the last sees nothing."""
    counts = np.r_[np.full(SCANS - 1, EACH), 0]
    points = np.column_stack((rng.uniform(0, 10, counts.sum()), rng.uniform(1, 1.4, counts.sum()))).astype(np.float32)
    starts = np.r_[0, np.cumsum(counts)].astype(np.int32)
    owners = np.repeat(np.arange(SCANS), counts).astype(np.int32)
    poses = np.column_stack((np.arange(SCANS), np.zeros((SCANS, 2)))).astype(float)
    return Endpoints(points, np.zeros_like(points), starts, owners), poses


def test_partners_see_the_same_wall_and_full_and_sparse_matrices_choose_the_same(monkeypatch: pytest.MonkeyPatch):
    endpoints, poses = along_a_wall(np.random.default_rng(0))
    held = np.arange(SCANS) % 5 != 3
    full = choose_partners(endpoints, poses, 8, held)
    monkeypatch.setattr(partners, "MOST_DENSE", 0)
    np.testing.assert_array_equal(choose_partners(endpoints, poses, 8, held), full)
    assert (full[~held] == -1).all()
    assert (full[-1] == -1).all()
    for scan, row in enumerate(full):
        others = row[row >= 0]
        assert len(others) == len(set(others.tolist()) - {scan})
        assert (np.abs(others - scan) < 10).all()
    assert (full[10, :8] >= 0).all()


@pytest.mark.parametrize("n", [2, 20])
def test_full_and_sparse_systems_have_the_same_solution(n: int, monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(n)
    first = np.r_[np.arange(n - 1), rng.integers(0, n, 15)]
    second = np.r_[np.arange(1, n), rng.integers(0, n, 15)]
    apart = first != second
    first, second = first[apart], second[apart]
    jacobians = rng.normal(size=(2, len(first), 3, 3))
    one, other = jacobians
    system = BlockSystem(n, first, second)
    own = system.sums(np.swapaxes(one, 1, 2) @ one, np.swapaxes(other, 1, 2) @ other) + np.eye(3)
    pairs, right = np.swapaxes(one, 1, 2) @ other, rng.normal(size=(n, 3))
    full = system.solve(own, pairs, right)
    monkeypatch.setattr(sparse_blocks, "DENSE", 0)
    np.testing.assert_allclose(system.solve(own, pairs, right), full, rtol=1e-9, atol=1e-12)
