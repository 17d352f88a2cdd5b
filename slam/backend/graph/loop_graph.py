"""The pose graph while loops are looked for: those of the surest relative position first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.backend.graph.chain import Chain
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.loop_search import WINDOW_DEVIATIONS, Loop, LoopSearch
from moteslam.slam.backend.graph.nodes import Nodes
from moteslam.slam.backend.graph.pose_graph import Edges, solve
from moteslam.slam.backend.graph.submaps import Submaps
from moteslam.slam.backend.graph.uncertainty import Uncertainty
from moteslam.slam.backend.ledger import LoopCandidate

Array = NDArray[np.float64]

KEPT = 0.25
"""A loop of a smaller weight after graduated non-convexity is contradicted by the others."""
SAME_PREDICTION, SAME_WINDOW = 0.3, 0.5
"""A pair is not searched again where the prediction moved by less [m], and the window changed by less [share]."""
LEAST_WINDOW, LARGEST_TURN = np.array([0.5, 0.5, 0.06]), 0.5
"""Half widths of a search window: at least [m, m, rad], and at most [rad]."""
FITS_DISTANCE, FITS_ROTATION = 0.2, 0.035
"""A loop within this of the final poses is confirmed by them [m], [rad]."""
PASSAGE_GAP = 3
"""Nodes within reach that follow each other with at most this many between are one passage."""


class LoopGraph:
    """The pose graph while loops are looked for: those of the surest relative position first.

    What is proved makes the relative covariance smaller, and with it the next searches.

    Args:
        nodes, chain: n nodes and the steps between them.
        config: of the back end.

    Attributes:
        poses: [n, 3] as solved last.
    """

    def __init__(self, nodes: Nodes, chain: Chain, config: GraphConfig) -> None:
        n = len(nodes)
        self._nodes, self._config = nodes, config
        information = np.asarray(np.linalg.inv(chain.covariance))
        self._chain = Edges(np.arange(n - 1), np.arange(1, n), chain.steps, information, np.zeros(n - 1, bool))
        self._start = chain.poses
        self._submaps = Submaps(nodes, chain.poses, config)
        self._search = LoopSearch(nodes, self._submaps, config)
        self._candidates: dict[tuple[int, int], Loop] = {}
        self.poses = chain.poses

    @property
    def ledger(self) -> tuple[LoopCandidate, ...]:
        """Every candidate, the latest search of each pair."""
        return tuple(loop.candidate for loop in self._candidates.values())

    def close(self) -> Array:
        """Search and solve until nothing new is found; the corrected poses [n, 3]."""
        c = self._config.loops
        deviation, uncertainty = c.first_deviation, Uncertainty(self.poses, self._edges())
        for _ in range(c.rounds):
            searched = self._search_all(uncertainty, deviation)
            if searched:
                self._solve()
                uncertainty = Uncertainty(self.poses, self._edges())
            elif WINDOW_DEVIATIONS * deviation >= c.max_window:
                break
            deviation *= 2
        return self.poses

    def _accepted(self) -> list[tuple[int, int]]:
        return [pair for pair, loop in self._candidates.items() if loop.candidate.accepted]

    def _edges(self) -> Edges:
        """The chain and the loops that are accepted."""
        pairs = self._accepted()
        if not pairs:
            return self._chain
        found = [self._candidates[pair] for pair in pairs]
        loops = Edges(
            np.array([a for a, _ in pairs]),
            np.array([b for _, b in pairs]),
            np.array([loop.candidate.found for loop in found]),
            np.array([loop.information for loop in found]),
            np.ones(len(pairs), bool),
        )
        return self._chain.plus(loops)

    def _solve(self) -> None:
        """The poses of the graph; loops that the others contradict are marked so."""
        pairs = self._accepted()
        self.poses, weights = solve(self._start, self._edges(), graduated=self._config.graduated)
        for pair, weight in zip(pairs, weights[len(self._chain) :], strict=True):
            if weight < KEPT:
                loop = self._candidates[pair]
                self._candidates[pair] = loop._replace(candidate=replace(loop.candidate, verdict="contradicted"))

    def _search_all(self, uncertainty: Uncertainty, deviation: float) -> int:
        """Search all nodes in the submaps of those that may show the same place; how many pairs were."""
        c, path = self._config.loops, self._submaps.path
        searched, last = 0, -np.inf
        for query in range(len(self._nodes)):
            if path[query] - last < c.every:
                continue
            last = path[query]
            before = path < path[query] - c.least_path
            if not before.any():
                continue
            distance = np.hypot(*(self.poses[:, :2] - self.poses[query, :2]).T)
            if not (before & (distance < c.near + 2 * min(deviation, c.max_window / WINDOW_DEVIATIONS))).any():
                continue
            position, heading = uncertainty.of(query)
            near = before & (distance < c.near + 2 * position)
            near &= (position < deviation) & (WINDOW_DEVIATIONS * position < c.max_window)
            for submap in _passages(np.flatnonzero(near), distance + position)[: c.candidates]:
                half = np.array([position[submap], position[submap], heading[submap]]) * WINDOW_DEVIATIONS
                half = np.maximum(half, LEAST_WINDOW)
                half[2] = min(half[2], LARGEST_TURN)
                searched += self._try(submap, query, half)
        return searched

    def _try(self, submap: int, query: int, half: Array) -> bool:
        """Search one pair, unless it was, from about the same prediction; whether it was now."""
        predicted = np.asarray(se2.between(self.poses[submap], self.poses[query]))
        if (submap, query) in self._candidates:
            last = self._candidates[submap, query].candidate
            if last.accepted and (np.abs(se2.between(predicted, last.found)) < half).all():
                return False
            moved = np.asarray(se2.between(last.predicted, predicted))
            same = abs(last.window[0] - half[0]) < SAME_WINDOW * half[0]
            if same and np.abs(moved[:2]).max() < SAME_PREDICTION:
                return False
        found = self._search.match(submap, query, predicted, half)
        if found is None:
            return False
        self._candidates[submap, query] = found
        return True


def checked(ledger: tuple[LoopCandidate, ...], nodes: Nodes, poses: Array) -> tuple[LoopCandidate, ...]:
    """The ledger with the loops that the final poses contradict marked so.

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
        replace(candidate, verdict="contradicted") if candidate.accepted and not fit else candidate
        for candidate, fit in zip(ledger, fits, strict=True)
    )


def _passages(near: NDArray[np.intp], cost: Array) -> list[int]:
    """Of every passage among nodes that are near, in order of the path, the one of least cost; the best passage first.

    Args:
        near: [m] nodes.
        cost: [n] of all nodes.
    """
    if not len(near):
        return []
    passages = np.split(near, np.flatnonzero(np.diff(near) > PASSAGE_GAP) + 1)
    best = [int(passage[cost[passage].argmin()]) for passage in passages]
    return sorted(best, key=lambda node: float(cost[node]))
