"""The pose graph: relative poses between nodes, solved by Gauss-Newton with graduated non-convexity; and the chain that
it begins with, as measured: of one session or of several one after the other.

Graduated non-convexity (Yang, Antonante, Tzoumas and Carlone 2020, with the kernel of Geman and McClure): first every
loop counts in full, then less and less those that the others contradict. With the last scale from the start true loops
would be thrown out, since the skewed estimate contradicts them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import prior_spread

Indices = NDArray[np.intp]

SCHEDULE = (1e5, 1e4, 3e3, 1e3, 300.0, 100.0, 30.0, 10.0)
"""Squared scales of the kernel, in squared standard deviations: the last is beyond the 98 % quantile of chi^2 with
three degrees of freedom."""
CONVEX = 10.0
"""The first scale is the largest below this many times the largest error's square: that loop then counts by half or
so, since the scales are a factor of three or ten apart."""
ITERATIONS, CONVERGED = 6, 1e-4  # Gauss-Newton steps on each scale at most; a smaller step [m, rad] ends it
ANCHOR = 1e9  # Information that holds the first pose where it is [1/m^2, 1/rad^2]
DENSE = 150  # Systems of so many unknowns are solved as full matrices: as fast, and SciPy need not be loaded


@dataclass(frozen=True, eq=False)
class Edges:
    first: Indices  # [e] nodes
    second: Indices  # [e] nodes
    relative: Array  # [e, 3] measured pose of the second in the frame of the first
    information: Array  # [e, 3, 3] of its error, in the frame of the measured pose
    robust: NDArray[np.bool_]  # [e] whether graduated non-convexity may reject it

    def __len__(self) -> int:
        return len(self.first)

    def plus(self, others: "Edges") -> "Edges":
        return Edges(*(np.concatenate(pair) for pair in zip(vars(self).values(), vars(others).values(), strict=True)))

    def errors(self, poses: Array) -> Array:
        """The errors [e, 3] of the measured relative poses, in their frames, where the nodes are at ``poses``."""
        return se2.between(self.relative, se2.between(poses[self.first], poses[self.second]))

    def squares(self, errors: Array) -> Array:
        """The squares [e] of errors [e, 3], in standard deviations."""
        return np.asarray(np.einsum("ei,eij,ej->e", errors, self.information, errors))

    def normal_equations(
        self, poses: Array, errors: Array, information: Array
    ) -> tuple[tuple[Array, Array], tuple[Array, Array], Array]:
        """A step of Gauss-Newton from poses [n, 3], at errors [e, 3] of an information [e, 3, 3].

        Returns the blocks [e, 3, 3] of the first and of the second nodes, likewise the right sides [e, 3], and the
        blocks [e, 3, 3] between the two.
        """
        first, second = relative_jacobians(poses[self.first], poses[self.second], self.relative[:, 2])
        weighted = information @ first, information @ second
        own = np.swapaxes(first, 1, 2) @ weighted[0], np.swapaxes(second, 1, 2) @ weighted[1]
        right = np.einsum("eki,ek->ei", weighted[0], errors), np.einsum("eki,ek->ei", weighted[1], errors)
        return own, right, np.swapaxes(first, 1, 2) @ weighted[1]


def relative_jacobians(first: Array, second: Array, heading: Array) -> tuple[Array, Array]:
    """Of the poses [e, 3] of ``second`` in the frames of ``first``, turned back by the headings [e] of the measured
    ones.

    Returns [e, 3, 3] by (x, y, theta) of the first pose, and by those of the second.
    """
    off = second - first
    turn = first[:, 2] + heading
    c, s = np.cos(turn), np.sin(turn)
    by_first, by_second = np.zeros((len(off), 3, 3)), np.zeros((len(off), 3, 3))
    by_second[:, 0, 0], by_second[:, 0, 1], by_second[:, 1, 0], by_second[:, 1, 1] = c, s, -s, c
    by_second[:, 2, 2] = 1.0
    by_first[:, :2, :2] = -by_second[:, :2, :2]
    by_first[:, 0, 2] = -s * off[:, 0] + c * off[:, 1]
    by_first[:, 1, 2] = -c * off[:, 0] - s * off[:, 1]
    by_first[:, 2, 2] = -1.0
    return by_first, by_second


def solve(poses: Array, edges: Edges, *, graduated: bool = True) -> tuple[Array, Array]:
    """The poses [n, 3] that fit the edges best, from poses to begin with, and the weights [e] of the edges, 0 to 1.

    The first pose stays. With ``graduated`` loops are rejected step by step; else all edges count in full.
    """
    system, poses = BlockSystem(len(poses), edges.first, edges.second), poses.copy()
    weights = np.ones(len(edges))
    largest = float(edges.squares(edges.errors(poses))[edges.robust].max(initial=0.0))
    # from where the largest error counts by half or so
    schedule = [*(scale for scale in SCHEDULE[:-1] if scale < CONVEX * largest), SCHEDULE[-1]]
    for scale in schedule if graduated else SCHEDULE[:1]:
        for _ in range(ITERATIONS):
            errors = edges.errors(poses)
            if graduated:
                weights = _weights(errors, edges, scale)
            blocks, right, between = edges.normal_equations(poses, errors, weights[:, None, None] * edges.information)
            own = system.sums(*blocks)
            own[0] += ANCHOR * np.eye(3)
            step = system.solve(own, between, -system.sums(*right))
            poses += step
            poses[:, 2] = se2.wrap(poses[:, 2])
            if np.abs(step).max() < CONVERGED:
                break
    return poses, _weights(edges.errors(poses), edges, scale) if graduated else weights


def _weights(errors: Array, edges: Edges, scale: float) -> Array:
    """Of Geman and McClure, for the edges that may be rejected."""
    return np.where(edges.robust, np.square(scale / (scale + edges.squares(errors))), 1.0)


class BlockSystem:
    """Sparse symmetric systems of 3 x 3 blocks: the normal equations of n poses and the pairs of them that are bound.

    The places of the blocks are found once for many systems of the same pairs, ``first`` and ``second`` [e]: a pair may
    occur more than once, either way round.
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
        """The solution [n, 3] of the system of the blocks of each pose with itself [n, 3, 3], those between the first
        and the second pose of each pair [e, 3, 3], added of equal pairs, and the right-hand side [n, 3].
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


CONTRADICTED = 10.0  # A path so many deviations from a step is no error of that step but contradicts it
UNKNOWN = 1e6
"""Variance of the step from the last node of a session to the first of the next, which nothing measured [m^2]: so small
a weight only keeps the equations of a graph whole."""


class MeasuredChain(NamedTuple):
    """The steps between n nodes."""

    steps: Array  # [n - 1, 3] in the frames where they begin: by registration, odometry and the filter
    covariance: Array  # [n - 1, 3, 3] of them, in the frames where they end
    prior_steps: Array  # the same as a joint registration is to keep them
    prior_covariance: Array  # likewise
    doubted: NDArray[np.bool_]  # [n - 1] which of these may be far off: the odometry contradicts it, or there is none

    def prior(self, start: Array, config: RegistrationConfig) -> tuple[Array, Array, NDArray[np.bool_]]:
        """The steps for a joint registration that starts at poses [n, 3], their covariance, and which are doubtful.

        Where the start contradicts a step, it is the hypothesis that odometry or registration failed there: its own
        step then, loosely.
        """
        steps, covariance = self.prior_steps.copy(), self.prior_covariance.copy()
        begun = se2.between(start[:-1], start[1:])
        deviations = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        contradicted = (np.abs(se2.between(begun, steps)) >= CONTRADICTED * deviations).any(axis=1)
        for k in np.flatnonzero(contradicted):
            distance, rotation = float(np.hypot(*begun[k, :2])), abs(float(begun[k, 2]))
            loose = prior_spread(config, distance, rotation, measured=False)
            steps[k], covariance[k] = begun[k], np.diag(np.square(loose))
        return steps, covariance, self.doubted | contradicted

    def errors(self, poses: Array) -> tuple[Array, Array]:
        """[n - 1, 3] how far the steps between poses [n, 3] are off the measured ones, and the deviations of these."""
        off = se2.between(self.steps, se2.between(poses[:-1], poses[1:]))
        return off, np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @classmethod
    def of_sessions(cls, chains: Sequence[Self], gaps: Array) -> Self:
        """The chains of k sessions in a row, with the steps [k - 1, 3] between them, which nothing measured."""
        unknown = np.eye(3)[None] * UNKNOWN
        parts = [chains[0]]
        for gap, chain in zip(gaps[:, None], chains[1:], strict=True):
            parts += [cls(gap, unknown, gap, unknown, np.zeros(1, np.bool_)), chain]
        return cls(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
