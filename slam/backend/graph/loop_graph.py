"""The pose graph while loops are looked for: those of the surest relative position first."""

from __future__ import annotations

from collections.abc import Collection, Sequence
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
from moteslam.slam.backend.graph.uncertainty import Uncertainty, Variances
from moteslam.slam.backend.ledger import LoopCandidate, Verdict

Array = NDArray[np.float64]
Pair = tuple[int, int]

PROVED: tuple[Verdict, ...] = ("accepted", "contradicted")
"""Verdicts of loops that the graph decides between."""
KEPT = 0.25
"""A loop of a smaller weight after graduated non-convexity is contradicted by the others."""
SAME_PREDICTION, SAME_WINDOW = 0.3, 0.5
"""A pair is not searched again where the prediction moved by less [m], and the window changed by less [share]."""
SOLVED = 0.2
"""The graph is solved anew for a loop that is off by more than this [m]."""
LEAST_WINDOW, LARGEST_TURN = np.array([0.5, 0.5, 0.06]), 0.5
"""Half widths of a search window: at least [m, m, rad], and at most [rad]."""
FITS_DISTANCE, FITS_ROTATION = 0.2, 0.035
"""A loop within this of the final poses is confirmed by them [m], [rad]."""
PASSAGE_GAP = 3
"""Nodes within reach that follow each other with at most this many between are one passage."""


class LoopGraph:
    """The pose graph while loops are looked for: those of the surest relative position first.

    Every ``config.loops.every`` metres a node is looked for in the submaps of those that may show the same place. What
    is proved makes the relative covariance smaller, and with it the next searches.

    Args:
        nodes, chain: the nodes and the steps between them; it grows with them.
        config: of the back end.
    """

    def __init__(self, nodes: Nodes, chain: Chain, config: GraphConfig) -> None:
        self._nodes, self._chain, self._config = nodes, chain, config
        self._submaps = Submaps(nodes, config)
        self._search = LoopSearch(nodes, self._submaps, config)
        self._candidates: dict[Pair, Loop] = {}
        self._searched: dict[int, list[int]] = {}  # the submaps that each node was searched for in
        self._variances: dict[Pair, Variances] = {}  # of the loops
        self._steps = Variances.of(np.zeros((0, 3, 3)))
        self._poses = np.zeros((1, 3))
        self._queries: list[int] = []
        self._fits = 0
        self._uncertainty: Uncertainty | None = None
        self._new: set[Pair] = set()
        self._registered: Array | None = None  # [m, 3] by the latest joint registration
        self._agreed: set[Pair] = set()  # the loops that it knew

    @property
    def ledger(self) -> tuple[LoopCandidate, ...]:
        """Every candidate, the latest search of each pair."""
        return tuple(loop.candidate for loop in self._candidates.values())

    @property
    def poses(self) -> Array:
        """[n, 3] as solved last, from there on along the chain."""
        return self._poses

    @property
    def driven(self) -> float:
        """Length of the path [m]."""
        return float(self._submaps.path[-1])

    def follow(self) -> None:
        """Take in the latest node of the chain."""
        if self._chain.fits != self._fits:
            self.refit()
            return
        step, covariance = self._chain.last()
        self._submaps.extend(step)
        latest = Variances.of(covariance[None])
        self._steps = Variances(*(np.append(old, new) for old, new in zip(self._steps, latest, strict=True)))
        self._poses = np.vstack((self._poses, se2.compose(self._poses[-1], step)))
        self._uncertainty = None

    def refit(self) -> None:
        """Take in all nodes of the chain again, if their steps have changed."""
        if self._chain.fits == self._fits:
            return
        self._fits, self._uncertainty = self._chain.fits, None
        self._submaps.follow(self._chain.steps)
        self._steps = Variances.of(self._chain.covariance)
        if self._registered is None:
            self._poses = self._submaps.poses
            self.solve()
        else:
            for step in self._chain.steps[len(self._poses) - 1 :]:
                self._poses = np.vstack((self._poses, se2.compose(self._poses[-1], step)))

    def look(self) -> None:
        """Look for the nodes that are due and whose surroundings are complete."""
        path, half = self._submaps.path, self._config.loops.query_length / 2
        while (query := self._next()) is not None and path[-1] - path[query] >= half:
            self._queries.append(query)
            self._look_for(query)

    def close(self) -> None:
        """Look for all nodes again, with what is known at the end, until nothing new is found."""
        while (query := self._next()) is not None:
            self._queries.append(query)
        for _ in range(self._config.loops.rounds):
            found = [self._look_for(query) for query in self._queries]
            self.solve(PROVED)
            if not any(found):
                break

    def solve(self, verdicts: Sequence[Verdict] = ("accepted",)) -> None:
        """Solve the graph with the loops of these verdicts; those that the others contradict are marked so."""
        pairs = [pair for pair, loop in self._candidates.items() if loop.candidate.verdict in verdicts]
        if not pairs:
            return
        self._poses, weights = solve(self._poses, self._edges(pairs), graduated=self._config.graduated)
        for pair, weight in zip(pairs, weights[len(self._chain) :], strict=True):
            loop = self._candidates[pair]
            verdict: Verdict = "contradicted" if weight < KEPT else "accepted"
            self._candidates[pair] = loop._replace(candidate=replace(loop.candidate, verdict=verdict))
        self._uncertainty = None

    def news(self, poses: Array) -> float:
        """How far the loops accepted since ``seen`` are from fitting to poses [n, 3] of the nodes [m]."""
        return self._misfit(self._new, poses)

    def register(self, poses: Array) -> None:
        """Go on from a joint registration of all nodes [n, 3]: their relative poses replace those measured so far."""
        self._poses, self._registered, self._uncertainty = poses, poses, None
        self._agreed = {pair for pair, loop in self._candidates.items() if loop.candidate.accepted}

    def before_news(self) -> Array:
        """The poses [m, 3] of the latest joint registration, none before the first."""
        return np.zeros((0, 3)) if self._registered is None else self._registered

    def unregistered(self) -> Array:
        """The poses [n, 3] by chain and loops alone, as measured."""
        self._registered = None
        self.solve(PROVED)
        return self._poses

    def seen(self) -> None:
        """All loops so far are no news any more."""
        self._new.clear()

    def forget(self) -> None:
        """Drop what can be built anew."""
        self._submaps.forget()

    def _misfit(self, pairs: Collection[Pair], poses: Array) -> float:
        """How far loops are from fitting to poses [n, 3] of the nodes at most [m]; those that are accepted."""
        pairs = [pair for pair in pairs if self._candidates[pair].candidate.accepted]
        if not pairs:
            return 0.0
        first, second = np.array(pairs).T
        found = np.array([self._candidates[pair].candidate.found for pair in pairs])
        off = np.asarray(se2.between(found, se2.between(poses[first], poses[second])))
        return float(np.hypot(off[:, 0], off[:, 1]).max())

    def _next(self) -> int | None:
        """The next node to look for; None where there is none yet."""
        path = self._submaps.path
        if not self._queries:
            return 0
        query = int(np.searchsorted(path, path[self._queries[-1]] + self._config.loops.every))
        return query if query < len(path) else None

    def _edges(self, pairs: list[Pair]) -> Edges:
        """The chain and these loops."""
        n, information = len(self._nodes), np.asarray(np.linalg.inv(self._chain.covariance))
        steps, registered = self._chain.steps, self._registered
        found, relative = [self._candidates[pair] for pair in pairs], []
        for (first, second), loop in zip(pairs, found, strict=True):
            agreed = registered is not None and (first, second) in self._agreed
            relative.append(se2.between(registered[first], registered[second]) if agreed else loop.candidate.found)
        if registered is not None:
            steps[: len(registered) - 1] = se2.between(registered[:-1], registered[1:])
        chain = Edges(np.arange(n - 1), np.arange(1, n), steps, information, np.zeros(n - 1, bool))
        loops = Edges(
            np.array([a for a, _ in pairs]),
            np.array([b for _, b in pairs]),
            np.array(relative),
            np.array([loop.information for loop in found]),
            np.ones(len(pairs), bool),
        )
        return chain.plus(loops)

    def _relative(self, query: int) -> tuple[Array, Array]:
        """The standard deviations of all nodes' positions and headings as seen from one: see ``Uncertainty.of``."""
        if self._uncertainty is None:
            n = len(self._poses)
            accepted = [pair for pair, loop in self._candidates.items() if loop.candidate.accepted]
            first = np.r_[np.arange(n - 1), np.array([a for a, _ in accepted], np.intp)]
            second = np.r_[np.arange(1, n), np.array([b for _, b in accepted], np.intp)]
            all_variances = (self._steps, *(self._variances[pair] for pair in accepted))
            variances = Variances(*(np.concatenate(values) for values in zip(*all_variances, strict=True)))
            self._uncertainty = Uncertainty(self._poses, first, second, variances)
        return self._uncertainty.of(query)

    def _look_for(self, query: int) -> bool:
        """Search a node in the submaps of those that may show the same place; whether a loop was accepted."""
        c, path = self._config.loops, self._submaps.path
        before = path < path[query] - c.least_path
        largest = c.max_window / WINDOW_DEVIATIONS
        distance = np.hypot(*(self._poses[:, :2] - self._poses[query, :2]).T)
        if not (before & (distance < c.near + 2 * largest)).any():
            return False
        accepted, deviation = False, c.first_deviation
        position, heading = self._relative(query)
        while True:
            near = before & (distance < c.near + 2 * position) & (position < min(deviation, largest))
            found = []
            for submap in _passages(np.flatnonzero(near), distance + position)[: c.candidates]:
                half = np.array([position[submap], position[submap], heading[submap]]) * WINDOW_DEVIATIONS
                half = np.maximum(half, LEAST_WINDOW)
                half[2] = min(half[2], LARGEST_TURN)
                found += self._try(submap, query, half)
            if found:
                accepted, self._uncertainty = True, None
                if self._misfit(found, self._poses) > SOLVED:
                    self.solve()
                position, heading = self._relative(query)
                distance = np.hypot(*(self._poses[:, :2] - self._poses[query, :2]).T)
            if deviation >= largest:
                return accepted
            deviation *= 2

    def _try(self, submap: int, query: int, half: Array) -> list[Pair]:
        """Search one pair, unless it was, from about the same prediction; the pair if that accepted a loop."""
        path = self._submaps.path
        passage = self._config.loops.submap_length / 2
        same_passage = [a for a in self._searched.get(query, ()) if abs(path[a] - path[submap]) <= passage]
        submap = min(same_passage, key=lambda node: abs(node - submap), default=submap)
        predicted = np.asarray(se2.between(self._poses[submap], self._poses[query]))
        if (submap, query) in self._candidates:
            last = self._candidates[submap, query].candidate
            if last.accepted and (np.abs(se2.between(predicted, last.found)) < half).all():
                return []
            moved = np.asarray(se2.between(last.predicted, predicted))
            same = abs(last.window[0] - half[0]) < SAME_WINDOW * half[0]
            if same and np.abs(moved[:2]).max() < SAME_PREDICTION:
                return []
        found = self._search.match(submap, query, predicted, half)
        if found is None:
            return []
        if self._candidates.pop((submap, query), None) is None:
            self._searched.setdefault(query, []).append(submap)
        self._candidates[submap, query] = found
        self._variances[submap, query] = Variances.of(np.linalg.inv(found.information)[None])
        if found.candidate.accepted:
            self._new.add((submap, query))
            return [(submap, query)]
        return []


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
