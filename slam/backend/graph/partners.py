"""Which scans see the same places, and are therefore held to each other in the joint registration."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.backend.graph.endpoints import Endpoints

Array = NDArray[np.float64]
Indices = NDArray[np.intp] | NDArray[np.int32]

OVERLAP_CELL, LEAST_OVERLAP = 0.5, 0.2
"""Two scans are partners where they share this much of the cells [m] that the endpoints of one lie in."""
NEAR_SHARE = 1 / 3
"""Of the partners, those nearest along the path; the others are spread over all that overlap."""
MOST_DENSE = 2**20
"""Up to this many pairs of a scan and a cell are a full matrix: that is as fast, and SciPy need not be loaded."""


def choose_partners(endpoints: Endpoints, poses: Array, most: int, held: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The scans that each scan's endpoints are held to: int32 [n, most], -1 for none.

    Scans that see the same places: some of those nearest along the path, and some spread over all that overlap, so that
    every passage is bound to every other. Those that are not to be held to others have none.
    """
    n = len(poses)
    points, _ = endpoints.placed(poses)
    cells = np.floor(points / OVERLAP_CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    _, column = np.unique(cells @ np.array((1, int(cells[:, 0].max()) + 1)), return_inverse=True)
    rows = np.flatnonzero(held)
    sizes, overlaps = _overlaps(endpoints.owners, column, n, rows)
    partners = np.full((n, most), -1, np.int32)
    near_count = int(NEAR_SHARE * most)
    for a, (others, overlap) in zip(rows.tolist(), overlaps, strict=True):
        others = np.sort(others[(others != a) & (overlap >= LEAST_OVERLAP * sizes[a])])
        if len(others) > most:
            near = np.argsort(np.abs(others - a), kind="stable")[:near_count]
            rest = np.delete(others, near)
            spread = np.linspace(0, len(rest) - 1, most - near_count).round().astype(int)
            others = np.sort(np.r_[others[near], rest[spread]])
        partners[a, : len(others)] = others
    return partners


def _overlaps(
    owners: Indices, cells: Indices, n: int, rows: Indices
) -> tuple[Indices, Iterator[tuple[Indices, NDArray[np.float32]]]]:
    """How many cells scans share.

    Args:
        owners, cells: [k] the scan and the cell of each endpoint.
        n: number of scans.
        rows: [r] of the scans that are asked for.

    Returns:
        [n] in how many cells each scan has endpoints, and for each of ``rows`` the scans that share some with it, and
        how many.
    """
    columns = int(cells.max()) + 1
    if n * columns <= MOST_DENSE:
        seen = np.zeros((n, columns), np.float32)
        seen[owners, cells] = 1
        shared = seen[rows] @ seen.T
        some = (np.flatnonzero(row) for row in shared)
        return seen.sum(axis=1).astype(np.intp), (
            (others, row[others]) for others, row in zip(some, shared, strict=True)
        )
    from scipy.sparse import csr_matrix

    sparse = csr_matrix((np.ones(len(cells), np.float32), (owners, cells)), shape=(n, columns))
    sparse.sum_duplicates()
    sparse.data[:] = 1
    products = (sparse[rows] @ sparse.T).tocsr()
    spans = (slice(*span) for span in pairwise(products.indptr.tolist()))
    return np.diff(sparse.indptr), ((products.indices[span], products.data[span]) for span in spans)
