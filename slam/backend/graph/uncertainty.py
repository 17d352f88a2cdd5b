"""How uncertain two nodes' relative pose is: along the surest path of the graph that joins them.

As the Dijkstra projection of Olson (2008, Robust and efficient robotic mapping): an upper bound of the marginal
covariance, in the time of a shortest path. An error of a heading moves all that follows about the place where it is
made, so that place and heading err together: after a long way out and back the robot is at one side of where it should
be if it is turned one way, and at the other if it is turned the other way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

TURN_DISTANCE = 5.0
"""At this distance a heading's error counts in the choice of the path [m]."""


class Uncertainty:
    """Relative uncertainties between the nodes of a graph.

    Args:
        poses: [n, 3] of the nodes.
        first, second: [e] the nodes that each edge binds; where a pair is bound more than once the surest counts.
        covariance: [e, 3, 3] of the edges, in the frame of the second node.
    """

    def __init__(self, poses: Array, first: Indices, second: Indices, covariance: Array) -> None:
        from scipy.sparse import csr_matrix

        n = len(poses)
        # the largest variance of the position, and that of the heading
        cost = np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1] + TURN_DISTANCE**2 * covariance[:, 2, 2]
        pairs = np.minimum(first, second) * n + np.maximum(first, second)
        order = np.lexsort((cost, pairs))
        _, kept = np.unique(pairs[order], return_index=True)
        kept = order[kept]
        self._pairs = pairs[kept]
        self._graph = csr_matrix((cost[kept], (first[kept], second[kept])), shape=(n, n))
        self._poses = poses
        self._terms = _about_the_origin(poses[second[kept]], covariance[kept])

    def of(self, node: int, at: Array | None = None) -> Array:
        """The covariance [n, 3, 3] of one node's pose as seen from each of all nodes, in the frame of that one pose.

        Args:
            node: the one.
            at: [3] pose of what moves with it, which takes the place of its own.
        """
        from scipy.sparse.csgraph import dijkstra

        n = len(self._poses)
        _, before = dijkstra(self._graph, False, [node], True)
        everyone = np.arange(n)
        before = np.where(before[0] < 0, everyone, before[0]).astype(np.intp)
        pairs = np.minimum(everyone, before) * n + np.maximum(everyone, before)
        edge = np.minimum(np.searchsorted(self._pairs, pairs), len(self._pairs) - 1)
        sums = np.where((before == everyone)[:, None, None], 0.0, self._terms[edge])
        # sums back along the shortest path, over twice as many edges each time
        while not (before == before[before]).all():
            sums = sums + np.where((before != everyone)[:, None, None], sums[before], 0.0)
            before = before[before]
        # seen from another node it is that node's pose which moves the one about the origin, the other way round
        return _moved(sums, self._poses[node] if at is None else at)


def _about_the_origin(poses: Array, covariance: Array) -> Array:
    """Covariances [e, 3, 3] of what lies at the origin, by errors at poses [e, 3], of covariances in their frames."""
    c, s, zero, one = np.cos(poses[:, 2]), np.sin(poses[:, 2]), np.zeros(len(poses)), np.ones(len(poses))
    by = np.array([[c, -s, poses[:, 1]], [s, c, -poses[:, 0]], [zero, zero, one]]).transpose(2, 0, 1)
    return np.asarray(by @ covariance @ by.transpose(0, 2, 1))


def _moved(covariance: Array, pose: Array) -> Array:
    """The covariances [n, 3, 3] of a pose in its own frame, by those of motions about the origin."""
    x, y, theta = pose
    c, s = np.cos(theta), np.sin(theta)
    by = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0, 0, 1.0]])
    return np.asarray(by @ covariance @ by.T)
