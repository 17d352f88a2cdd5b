"""Sparse symmetric systems of 3 x 3 blocks: the normal equations of n poses and the pairs of them that are bound."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


DENSE = 150
"""Systems of up to this many unknowns are solved as full matrices: that is as fast, and SciPy need not be loaded."""


class BlockSystem:
    """The places of the blocks, found once for many systems of the same pairs.

    Args:
        n: number of poses.
        first, second: [e] the poses that each pair binds; a pair may occur more than once, either way round.
    """

    def __init__(self, n: int, first: Indices, second: Indices) -> None:
        low, high = np.minimum(first, second), np.maximum(first, second)
        blocks, places = np.unique(np.r_[np.arange(n) * (n + 1), low * n + high], return_inverse=True)
        self._n, self._first, self._second, self._turned = n, first, second, first > second
        self._blocks, self._own, self._pairs = len(blocks), places[:n], places[n:]
        rows, columns = blocks // n, blocks % n
        inner = np.arange(3)
        row, column = np.broadcast_arrays(
            (3 * rows)[:, None, None] + inner[:, None], (3 * columns)[:, None, None] + inner
        )
        beside = np.flatnonzero(rows != columns)
        all_rows = np.r_[row.ravel(), column[beside].ravel()]
        all_columns = np.r_[column.ravel(), row[beside].ravel()]
        sources = np.r_[np.arange(9 * self._blocks), (9 * beside[:, None] + np.arange(9)).ravel()]
        order = np.lexsort((all_rows, all_columns))
        self._sources, self._rows = sources[order], all_rows[order].astype(np.int32)
        self._begin = np.searchsorted(all_columns[order], np.arange(3 * n + 1)).astype(np.int32)

    def sums(self, first: Array, second: Array) -> Array:
        """What pairs give to each pose, summed: [n, ...] of [e, ...] to the first and [e, ...] to the second."""
        total = np.zeros((self._n, *first.shape[1:]))
        np.add.at(total, self._first, first)
        np.add.at(total, self._second, second)
        return total

    def solve(self, own: Array, pairs: Array, right: Array) -> Array:
        """The solution [n, 3] of the system.

        Args:
            own: [n, 3, 3] blocks of each pose with itself; right: [n, 3] right-hand side.
            pairs: [e, 3, 3] blocks between the first and the second pose of each pair; those of equal pairs are added.
        """
        placed = np.where(self._turned[:, None, None], np.swapaxes(pairs, 1, 2), pairs)
        blocks = np.zeros((self._blocks, 9))
        np.add.at(blocks, self._pairs, placed.reshape(-1, 9))
        blocks[self._own] += own.reshape(-1, 9)
        size = 3 * self._n
        if size <= DENSE:
            dense = np.zeros((size, size))
            dense[self._rows, np.repeat(np.arange(size), np.diff(self._begin))] = blocks.ravel()[self._sources]
            solution: Array = np.asarray(np.linalg.solve(dense, right.ravel()), np.float64)
            return solution.reshape(-1, 3)
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        matrix = csc_matrix((blocks.ravel()[self._sources], self._rows, self._begin), shape=(size, size))
        # positive definite: no pivoting, and an order of elimination for symmetric matrices
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        return np.asarray(factors.solve(right.ravel()).reshape(-1, 3))
