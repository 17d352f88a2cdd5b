"""The pose graph as it grows: chain, accepted loops, the poses that follow, and how sure they are of each other."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.backend.graph.chain import LATEST, Chain
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.loop_search import Loop, Submaps
from moteslam.slam.backend.graph.nodes import Nodes
from moteslam.slam.backend.graph.pose_graph import Edges, MeasuredChain, solve
from moteslam.slam.backend.protocol import LoopCandidate, Verdict

Pair = tuple[int, int]  # Two nodes, the earlier first

PROVED: tuple[Verdict, ...] = ("accepted", "contradicted")  # Verdicts of loops that the graph decides between
KEPT = 0.25  # A loop of a smaller weight after graduated non-convexity is contradicted by the others
FITS_DISTANCE, FITS_ROTATION = 0.2, 0.035  # A loop within this of the final poses is confirmed by them [m], [rad]
TURN_DISTANCE = 5.0  # At this distance a heading's error counts in the choice of the surest path [m]


class Uncertainty:
    """How uncertain two nodes' relative pose is: along the surest path of the graph that joins them.

    As the Dijkstra projection of Olson (2008, Robust and efficient robotic mapping): an upper bound of the marginal
    covariance, in the time of a shortest path. An error of a heading moves all that follows about the place where it is
    made, so that place and heading err together: after a long way out and back the robot is at one side of where it
    should be if it is turned one way, and at the other if it is turned the other way.

    Nodes have poses [n, 3]; each edge binds two of them, ``first`` and ``second`` [e], with a covariance [e, 3, 3] in
    the frame of the second. Where a pair is bound more than once the surest counts.
    """

    def __init__(self, poses: Array, first: NDArray[np.intp], second: NDArray[np.intp], covariance: Array) -> None:
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
        # of what lies at the origin, by errors of the edges where they end
        x, y, theta = poses[second[kept]].T
        c, s, zero, one = np.cos(theta), np.sin(theta), np.zeros(len(x)), np.ones(len(x))
        by = np.array([[c, -s, y], [s, c, -x], [zero, zero, one]]).transpose(2, 0, 1)
        self._terms = by @ covariance[kept] @ by.transpose(0, 2, 1)

    def of(self, node: int, at: Array | None = None) -> Array:
        """The covariance [n, 3, 3] of one node's pose as seen from each of all nodes, in the frame of that one pose.

        With a pose ``at`` [3] that of what moves with the node.
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
        x, y, theta = self._poses[node] if at is None else at
        c, s = np.cos(theta), np.sin(theta)
        by = np.array([[c, s, 0.0], [-s, c, 0.0], [0, 0, 1.0]]) @ np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0, 0, 1.0]])
        return np.asarray(by @ sums @ by.T)


class BoundGraph:
    """Nodes, one at least, the steps between them and loops, and the poses that follow from them.

    After a joint registration of all nodes its relative poses stand for the chain and the loops that it knew: what
    comes later bends them by as little as it must.
    """

    def __init__(self, nodes: Nodes, chain: MeasuredChain | Chain, config: GraphConfig) -> None:
        self.nodes, self._steps, self._config = nodes, chain, config
        self.submaps = Submaps(nodes, config)  # around them
        self.loops: dict[Pair, Loop] = {}  # every candidate, the latest search of each pair, in the order of these
        self.poses = np.zeros((1, 3))  # [n, 3] as solved last, from there on along the chain
        self.registered = np.zeros((0, 3))  # [m, 3] by the latest joint registration; none before the first
        self._known: set[Pair] = set()  # the loops that the joint registration knew
        self._uncertainty: Uncertainty | None = None

    @property
    def measured(self) -> MeasuredChain:
        """The steps, as a joint registration is to keep them, too."""
        return self._steps if isinstance(self._steps, MeasuredChain) else self._steps.measured

    @property
    def ledger(self) -> tuple[LoopCandidate, ...]:
        """Every candidate, in the order of the latest searches."""
        return tuple(loop.candidate for loop in self.loops.values())

    def enter(self, pair: Pair, loop: Loop) -> None:
        """Enter a candidate as searched; it takes the place of an earlier search of the pair."""
        self.loops.pop(pair, None)
        self.loops[pair] = loop
        self._uncertainty = None

    def solve(self, verdicts: Sequence[Verdict] = ("accepted",)) -> None:
        """Solve the graph with the loops of these verdicts; those that the others contradict are marked so."""
        pairs = [pair for pair, loop in self.loops.items() if loop.candidate.verdict in verdicts]
        if not pairs:
            return
        self.poses, weights = solve(self.poses, self._edges(pairs), graduated=self._config.graduated)
        for pair, weight in zip(pairs, weights[len(self.nodes) - 1 :], strict=True):
            verdict: Verdict = "contradicted" if weight < KEPT else "accepted"
            loop = self.loops[pair]
            self.loops[pair] = loop._replace(candidate=replace(loop.candidate, verdict=verdict))
        self._uncertainty = None

    def register(self, poses: Array) -> None:
        """Go on from a joint registration of all nodes [n, 3]."""
        self.poses = self.registered = poses
        self._known = {pair for pair, loop in self.loops.items() if loop.candidate.accepted}
        self._uncertainty = None

    def solve_as_measured(self) -> None:
        """Solve chain and loops alone, without what a joint registration made of them."""
        self.registered, self._known = np.zeros((0, 3)), set()
        self.solve(PROVED)

    def edges_of(self, pairs: Sequence[Pair]) -> Edges:
        """Some loops as they were measured."""
        first, second = np.array(pairs, np.intp).reshape(-1, 2).T
        found = np.array([self.loops[pair].candidate.found for pair in pairs]).reshape(-1, 3)
        information = np.array([self.loops[pair].information for pair in pairs]).reshape(-1, 3, 3)
        return Edges(first, second, found, information, np.ones(len(pairs), bool))

    def misfit(self, pairs: Collection[Pair], poses: Array) -> float:
        """The largest distance between where loops were found and where poses [n, 3] have them [m]; of the accepted."""
        accepted = [pair for pair in pairs if self.loops[pair].candidate.accepted]
        if not accepted:
            return 0.0
        first, second = np.array(accepted).T
        found = np.array([self.loops[pair].candidate.found for pair in accepted])
        off = se2.between(found, se2.between(poses[first], poses[second]))
        return float(np.hypot(off[:, 0], off[:, 1]).max())

    def relative(self, node: int, at: Array | None = None) -> Array:
        """The covariance [n, 3, 3] of a node's pose as seen from all others: see ``Uncertainty.of``."""
        if self._uncertainty is None:
            n = len(self.poses)
            accepted = [pair for pair, loop in self.loops.items() if loop.candidate.accepted]
            first = np.r_[np.arange(n - 1), np.array([a for a, _ in accepted], np.intp)]
            second = np.r_[np.arange(1, n), np.array([b for _, b in accepted], np.intp)]
            loops = np.array([self.loops[pair].information for pair in accepted]).reshape(-1, 3, 3)
            covariance = np.concatenate((self._steps.covariance, np.linalg.inv(loops)))
            self._uncertainty = Uncertainty(self.poses, first, second, covariance)
        return self._uncertainty.of(node, at)

    def _edges(self, pairs: list[Pair]) -> Edges:
        """The chain and these loops, by the joint registration where it knew them."""
        n, steps = len(self.nodes), self._steps.steps.copy()
        information = np.asarray(np.linalg.inv(self._steps.covariance))
        steps[: max(len(self.registered) - 1, 0)] = se2.between(self.registered[:-1], self.registered[1:])
        chain = Edges(np.arange(n - 1), np.arange(1, n), steps, information, np.zeros(n - 1, bool))
        loops = self.edges_of(pairs)
        for k, (first, second) in enumerate(pairs):
            if (first, second) in self._known:
                loops.relative[k] = se2.between(self.registered[first], self.registered[second])
        return chain.plus(loops)


class LoopGraph(BoundGraph):
    """The graph as it grows with its nodes."""

    def __init__(self, nodes: Nodes, config: GraphConfig) -> None:
        self.chain = Chain(nodes, config)  # the steps between them
        super().__init__(nodes, self.chain, config)
        self._fits = 0  # of the chain, as taken in

    def extend(self) -> None:
        step = self.chain.add()
        if self.chain.fits != self._fits:
            # the latest steps may be other ones now, which no loop has bent yet
            self.poses = self.poses[: max(len(self.registered), len(self.poses) - LATEST, 1)]
            self._refit()
            return
        self.submaps.extend(step)
        self.poses = np.vstack((self.poses, se2.compose(self.poses[-1], step)))
        self._uncertainty = None

    def settle(self) -> None:
        self.chain.settle()
        self._refit()

    def rejoin(self) -> None:
        """Take in that the filter's steps have changed."""
        self.poses = self.poses[: max(len(self.registered), 1)]  # those after lie along the chain as it is now
        self.chain.renew()
        self._refit()

    def _refit(self) -> None:
        """Take in all steps of the chain anew, if they have changed."""
        if self.chain.fits == self._fits:
            return
        self._fits, self._uncertainty = self.chain.fits, None
        steps = self.chain.steps
        self.submaps.follow(steps)
        if len(self.registered):
            late = se2.accumulate(steps[len(self.poses) - 1 :], self.poses[-1])
            self.poses = np.vstack((self.poses, late.reshape(-1, 3)))
        else:
            self.poses = self.submaps.poses
            self.solve()


def checked(ledger: tuple[LoopCandidate, ...], nodes: Nodes, poses: Array) -> tuple[LoopCandidate, ...]:
    """The ledger with the accepted loops that the final poses [n, 3] do not confirm marked as overruled."""
    if not ledger:
        return ledger
    earlier = np.searchsorted(nodes.indices, [candidate.earlier for candidate in ledger])
    later = np.searchsorted(nodes.indices, [candidate.later for candidate in ledger])
    found = np.array([candidate.found for candidate in ledger])
    off = se2.between(found, se2.between(poses[earlier], poses[later]))
    fits = (np.hypot(off[:, 0], off[:, 1]) < FITS_DISTANCE) & (np.abs(off[:, 2]) < FITS_ROTATION)
    return tuple(
        replace(candidate, verdict="overruled") if candidate.accepted and not fit else candidate
        for candidate, fit in zip(ledger, fits, strict=True)
    )
