"""How uncertain two nodes' relative pose is: along the surest path of the graph that joins them.

As the Dijkstra projection of Olson (2008, Robust and efficient robotic mapping): an upper bound of the marginal
covariance, in the time of a shortest path. An error of a heading moves all that follows in proportion to its distance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

TURN_DISTANCE = 5.0
"""At this distance a heading's error counts in the choice of the path [m]."""


class Variances(NamedTuple):
    """Of e edges: the largest variance of the position [e] [m^2], and that of the heading [e] [rad^2]."""

    position: Array
    heading: Array

    @classmethod
    def of(cls, covariance: Array) -> Variances:
        """Of relative poses of covariance [e, 3, 3]."""
        return cls(np.asarray(np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1]), covariance[:, 2, 2])


class Uncertainty:
    """Relative uncertainties between the nodes of a graph.

    Args:
        poses: [n, 3] of the nodes.
        first, second: [e] the nodes that each edge binds; where a pair is bound more than once the surest counts.
        variances: of the edges.
    """

    def __init__(self, poses: Array, first: Indices, second: Indices, variances: Variances) -> None:
        from scipy.sparse import csr_matrix

        n = len(poses)
        cost = variances.position + TURN_DISTANCE**2 * variances.heading
        pairs = np.minimum(first, second) * n + np.maximum(first, second)
        order = np.lexsort((cost, pairs))
        _, kept = np.unique(pairs[order], return_index=True)
        kept = order[kept]
        self._pairs = pairs[kept]
        self._position, self._heading = variances.position[kept], variances.heading[kept]
        self._graph = csr_matrix((cost[kept], (first[kept], second[kept])), shape=(n, n))
        self._places = poses[:, :2]

    def of(self, node: int) -> tuple[Array, Array]:
        """The standard deviations of all nodes' positions [n] and headings [n] as seen from one node [m], [rad]."""
        from scipy.sparse.csgraph import dijkstra

        n = len(self._places)
        _, before = dijkstra(self._graph, False, [node], True)
        everyone = np.arange(n)
        before = np.where(before[0] < 0, everyone, before[0]).astype(np.intp)
        pairs = np.minimum(everyone, before) * n + np.maximum(everyone, before)
        edge = np.minimum(np.searchsorted(self._pairs, pairs), len(self._pairs) - 1)
        root = before == everyone
        position, heading = np.where(root, 0.0, self._position[edge]), np.where(root, 0.0, self._heading[edge])
        pivot = self._places[before]
        sums = np.column_stack((position, heading, heading[:, None] * pivot, heading * np.square(pivot).sum(axis=1)))
        # sums back along the shortest path, over twice as many edges each time
        while not (before == before[before]).all():
            sums = sums + np.where((before != everyone)[:, None], sums[before], 0.0)
            before = before[before]
        x = self._places
        by_turns = sums[:, 1] * np.square(x).sum(axis=1) - 2 * (x * sums[:, 2:4]).sum(axis=1) + sums[:, 4]
        return np.sqrt(np.maximum(sums[:, 0] + by_turns, 0.0)), np.sqrt(sums[:, 1])
