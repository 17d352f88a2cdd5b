"""The pose graph as it grows: chain, accepted loops, the poses that follow, and how sure they are of each other."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.backend.graph.chain import Chain
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.loop_search import Loop
from moteslam.slam.backend.graph.measured_chain import MeasuredChain
from moteslam.slam.backend.graph.nodes import Nodes
from moteslam.slam.backend.graph.pose_graph import Edges, solve
from moteslam.slam.backend.graph.submaps import Submaps
from moteslam.slam.backend.graph.uncertainty import Uncertainty
from moteslam.slam.backend.ledger import LoopCandidate, Verdict

Array = NDArray[np.float64]
Pair = tuple[int, int]
"""Two nodes, the earlier first."""

PROVED: tuple[Verdict, ...] = ("accepted", "contradicted")
"""Verdicts of loops that the graph decides between."""
KEPT = 0.25
"""A loop of a smaller weight after graduated non-convexity is contradicted by the others."""
FITS_DISTANCE, FITS_ROTATION = 0.2, 0.035
"""A loop within this of the final poses is confirmed by them [m], [rad]."""


class BoundGraph:
    """Nodes, the steps between them and loops, and the poses that follow from them.

    After a joint registration of all nodes its relative poses stand for the chain and the loops that it knew: what
    comes later bends them by as little as it must.

    Args:
        nodes: at least one.
        chain: the steps between them.
        config: of the back end.

    Attributes:
        nodes: as given.
        submaps: around them.
        loops: every candidate, the latest search of each pair, in the order of these.
        poses: [n, 3] as solved last, from there on along the chain.
        registered: [m, 3] by the latest joint registration; m is 0 before the first.
    """

    def __init__(self, nodes: Nodes, chain: MeasuredChain | Chain, config: GraphConfig) -> None:
        self.nodes, self._steps, self._config = nodes, chain, config
        self.submaps = Submaps(nodes, config)
        self.loops: dict[Pair, Loop] = {}
        self.poses, self.registered = np.zeros((1, 3)), np.zeros((0, 3))
        self._known: set[Pair] = set()  # the loops that the joint registration knew
        self._uncertainty: Uncertainty | None = None

    @property
    def measured(self) -> MeasuredChain:
        """The steps, as a joint registration is to keep them, too."""
        return self._steps if isinstance(self._steps, MeasuredChain) else self._steps.measured

    @property
    def driven(self) -> float:
        """Length of the path [m]."""
        return self.submaps.driven

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
        off = np.asarray(se2.between(found, se2.between(poses[first], poses[second])))
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
        return chain.plus(
            Edges(
                np.array([first for first, _ in pairs]),
                np.array([second for _, second in pairs]),
                np.array([self._relative_pose(pair) for pair in pairs]),
                np.array([self.loops[pair].information for pair in pairs]),
                np.ones(len(pairs), bool),
            )
        )

    def _relative_pose(self, pair: Pair) -> Array:
        first, second = pair
        if pair in self._known:
            return np.asarray(se2.between(self.registered[first], self.registered[second]))
        return self.loops[pair].candidate.found


class LoopGraph(BoundGraph):
    """The graph as it grows with its nodes.

    Attributes:
        chain: the steps between them.
    """

    def __init__(self, nodes: Nodes, config: GraphConfig) -> None:
        self.chain = Chain(nodes, config)
        super().__init__(nodes, self.chain, config)
        self._fits = 0  # of the chain, as taken in

    def extend(self) -> None:
        """Take in the latest node."""
        self.chain.add()
        if self.chain.fits != self._fits:
            self._refit()
            return
        step, _ = self.chain.last()
        self.submaps.extend(step)
        self.poses = np.vstack((self.poses, se2.compose(self.poses[-1], step)))
        self._uncertainty = None

    def settle(self) -> None:
        """Fit the odometry's errors at the end."""
        self.chain.settle()
        if self.chain.fits != self._fits:
            self._refit()

    def rejoin(self) -> None:
        """Take in that the filter's steps have changed."""
        self.chain.renew()
        if self.chain.fits != self._fits:
            self._refit()

    def _refit(self) -> None:
        """Take in all steps of the chain anew."""
        self._fits, self._uncertainty = self.chain.fits, None
        steps = self.chain.steps
        self.submaps.follow(steps)
        if len(self.registered):
            late = np.asarray(se2.accumulate(steps[len(self.poses) - 1 :], self.poses[-1]))
            self.poses = np.vstack((self.poses, late.reshape(-1, 3)))
        else:
            self.poses = self.submaps.poses
            self.solve()


def checked(ledger: tuple[LoopCandidate, ...], nodes: Nodes, poses: Array) -> tuple[LoopCandidate, ...]:
    """The ledger with the accepted loops that the final poses do not confirm marked as overruled.

    Args:
        ledger: of all candidates.
        nodes: n of them.
        poses: [n, 3] final.
    """
    if not ledger:
        return ledger
    earlier = np.searchsorted(nodes.indices, [candidate.earlier for candidate in ledger])
    later = np.searchsorted(nodes.indices, [candidate.later for candidate in ledger])
    found = np.array([candidate.found for candidate in ledger])
    off = np.asarray(se2.between(found, se2.between(poses[earlier], poses[later])))
    fits = (np.hypot(off[:, 0], off[:, 1]) < FITS_DISTANCE) & (np.abs(off[:, 2]) < FITS_ROTATION)
    return tuple(
        replace(candidate, verdict="overruled") if candidate.accepted and not fit else candidate
        for candidate, fit in zip(ledger, fits, strict=True)
    )
