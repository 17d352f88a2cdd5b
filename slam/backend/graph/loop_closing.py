"""Which loops are looked for, and when: those of the surest relative position first.

What is proved makes the relative covariance smaller, and with it the next searches.
"""

from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.correlative import MAX_SEARCH_POINTS
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.loop_graph import PROVED, BoundGraph, Pair
from moteslam.slam.backend.graph.loop_search import FARTHEST, WINDOW_DEVIATIONS, LoopSearch, squares
from moteslam.slam.registration.search import LEAST_KNOWN, is_elsewhere

G = TypeVar("G", bound=BoundGraph)

SAME_PREDICTION, SAME_WINDOW = 0.3, 0.5
"""A pair is not searched again where the prediction moved by less [m], and the window changed by less [share]."""
SOLVED = 0.2  # The graph is solved anew for a loop that is off by more than this [m]
LEAST_DEVIATIONS = np.array([0.5, 0.5, 0.06]) / WINDOW_DEVIATIONS
"""What the relative covariance has besides [m, m, rad]: submaps bend a little."""
CHEAP = 1e8  # A search that looks up fewer endpoints is made in any case: a tenth of a second of one processor
LOOKUPS_PER_METRE = 4e6
"""Endpoints that all other searches together look up at most, for every metre driven: 4 ms of one processor. What that
leaves unsearched stands in the ledger."""
PASSAGE_GAP = 3  # Nodes within reach that follow each other with at most this many between are one passage


class LoopClosing(Generic[G]):
    """Looks for a node every ``config.loops.every`` metres in the submaps of those that may show the same place.

    Nodes from ``since`` on are looked for, and if it is not the first, in the submaps of those before alone. Loops are
    entered into ``graph``.
    """

    def __init__(self, graph: G, config: GraphConfig, since: int = 0) -> None:
        self.graph, self._config, self._since = graph, config, since
        self._search = LoopSearch(graph.nodes, graph.submaps, config)
        self._searched: dict[int, list[int]] = {}  # the submaps that each node was searched for in
        self._queries: list[int] = []
        self._looked_up = 0.0  # by all searches that are not cheap
        self.news: set[Pair] = set()  # the loops that were accepted since it was emptied last

    def look(self) -> None:
        """Look for the nodes that are due and whose surroundings are complete."""
        path, half = self.graph.submaps.path, self._config.loops.query_length / 2
        while (query := self._next()) is not None and path[-1] - path[query] >= half:
            self._queries.append(query)
            self._look_for(query)

    def rejoin(self, begins: int, poses: Array) -> None:
        """Bind a part of the path to what is before it: its nodes from ``begins`` on lie at poses [n, 3], as searched.

        Else the first search would be as wide as where the part lay is uncertain, and of two places that look alike the
        graph might take the other.
        """
        path = self.graph.submaps.path
        query = int(np.searchsorted(path, path[-1] - self._config.loops.query_length / 2, side="right")) - 1
        if not self._config.loops.enabled or not 0 < begins <= query:
            return
        submap = int(np.argmin(np.hypot(*(poses[:begins, :2] - poses[query, :2]).T)))
        predicted = se2.between(poses[submap], poses[query])
        found = self._search.match(submap, query, predicted, np.diag(np.square(LEAST_DEVIATIONS)))
        if found is not None:
            self.graph.enter((submap, query), found)
            self.graph.solve()

    def close(self, start: int = 0) -> None:
        """Look for all nodes again, those near ``start``, whose place is known best, first, until nothing is found."""
        while (query := self._next()) is not None:
            self._queries.append(query)
        path = self.graph.submaps.path
        self._queries.sort(key=lambda query: abs(path[query] - path[start]))
        for _ in range(self._config.loops.rounds):
            found = [self._look_for(query) for query in self._queries]
            self.graph.solve(PROVED)
            if not any(found):
                break

    def _next(self) -> int | None:
        """The next node to look for; None where there is none yet."""
        path = self.graph.submaps.path
        if not self._queries:
            return self._since
        query = int(np.searchsorted(path, path[self._queries[-1]] + self._config.loops.every))
        return query if query < len(path) else None

    def _look_for(self, query: int) -> bool:
        """Search a node in the submaps of those that may show the same place; whether a loop was accepted."""
        c, graph = self._config.loops, self.graph
        before = graph.submaps.path < graph.submaps.path[query] - c.least_path
        before[self._since or len(before) :] = False
        if not before.any():
            return False
        accepted, deviation = False, c.first_deviation
        covariance, position, reachable, cost = self._reachable(query)
        while True:
            near = before & reachable & (position < deviation)
            found = []
            for submap in _passages(np.flatnonzero(near), cost)[: c.candidates]:
                found += self._try(submap, query, covariance)
            found = [pair for pair in found if not self._has_rival(pair)]
            if found:
                self.news.update(found)
                accepted = True
                if graph.misfit(found, graph.poses) > SOLVED:
                    graph.solve()
                covariance, position, reachable, cost = self._reachable(query)
            if deviation > position.max(where=before & reachable, initial=0.0):
                return accepted
            deviation *= 2

    def _reachable(self, query: int) -> tuple[Array, Array, NDArray[np.bool_], Array]:
        """The covariance [n, 3, 3] of a node's pose as seen from all, in its frame, and the standard deviations [n] of
        the positions along the direction where they are largest [m]; which nodes [n] may show the same walls, and the
        cost [n] of that.

        They are within the window of where it may be, and ``config.loops.near``; the cost is the negative logarithm of
        the density that they are in one place.
        """
        poses, near = self.graph.poses, (self._config.loops.near / WINDOW_DEVIATIONS) ** 2
        covariance = self.graph.relative(query)
        position = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1], 0.0))
        x, y = se2.between(poses[query], poses)[:, :2].T
        xx, xy, yy = covariance[:, 0, 0] + near, covariance[:, 0, 1], covariance[:, 1, 1] + near
        determinant = xx * yy - xy * xy
        squares = (yy * x * x - 2 * xy * x * y + xx * y * y) / determinant
        return covariance, position, squares < WINDOW_DEVIATIONS**2, (squares + np.log(determinant)) / 2

    def _try(self, submap: int, query: int, covariance: Array) -> list[Pair]:
        """Search one pair, unless its passage was, from about the same prediction; the pair if that found a loop."""
        graph, path = self.graph, self.graph.submaps.path
        passage = self._config.loops.submap_length / 2
        before = [node for node in self._searched.get(query, []) if abs(path[node] - path[submap]) <= passage]
        submap = min(before, key=lambda node: abs(node - submap), default=submap)
        pair = submap, query
        predicted = se2.between(graph.poses[submap], graph.poses[query])
        spread = covariance[submap] + np.diag(np.square(LEAST_DEVIATIONS))
        window = self._search.window(spread)
        known = graph.loops.get(pair)
        last = None if known is None or known.candidate.verdict == "unsearched" else known.candidate
        if last is not None:
            off = se2.between(predicted, last.found)
            if last.accepted and off @ np.linalg.inv(spread) @ off < WINDOW_DEVIATIONS**2:
                return []
            moved = se2.between(last.predicted, predicted)
            same = abs(last.window[0] - window.half[0]) < SAME_WINDOW * window.half[0]
            if same and np.abs(moved[:2]).max() < SAME_PREDICTION:
                return []
        cost = float(window.places * MAX_SEARCH_POINTS)
        if cost > CHEAP:
            if self._looked_up + cost > LOOKUPS_PER_METRE * graph.submaps.driven:
                if known is None:
                    graph.enter(pair, self._search.unsearched(submap, query, predicted, window))
                return []
            self._looked_up += cost
        if (found := self._search.match(submap, query, predicted, spread)) is None:
            return []
        if last is None:
            self._searched.setdefault(query, []).append(submap)
        graph.enter(pair, found)
        return [pair] if found.candidate.accepted else []

    def _has_rival(self, pair: Pair) -> bool:
        """Whether the query of a loop fits about as well elsewhere in another submap: the loop is ambiguous then.

        Elsewhere is what the relative pose of the two submaps does not explain.
        """
        submap, query = pair
        graph, loop = self.graph, self.graph.loops[pair]
        nodes = np.array([node for node in self._searched[query] if node != submap], np.intp)
        if not len(nodes):
            return False
        others = [graph.loops[node, query].candidate for node in nodes.tolist()]
        # what is to be compared with the best one: see ``runner_up``
        shares = np.array([o.share * max(loop.candidate.known / max(o.known, LEAST_KNOWN), 1.0) for o in others])
        at = se2.compose(graph.poses[submap], loop.candidate.found)
        off = se2.between(at, se2.compose(graph.poses[nodes], np.array([other.found for other in others])))
        rivals = is_elsewhere(off) & (shares >= loop.candidate.share - self._config.loops.least_margin)
        if not rivals.any():
            return False
        covariance = graph.relative(submap, at)[nodes] + np.diag(np.square(LEAST_DEVIATIONS))
        rivals &= squares(off, covariance) > FARTHEST**2
        if rivals.any():
            second = max(loop.candidate.runner_up, float(shares[rivals].max()))
            candidate = replace(loop.candidate, runner_up=second, verdict="ambiguous")
            graph.enter(pair, loop._replace(candidate=candidate))
        return bool(rivals.any())


def _passages(near: NDArray[np.intp], cost: Array) -> list[int]:
    """Of every passage among nodes [m] in order of the path the one of least cost [n]; the best passage first."""
    if not len(near):
        return []
    passages = np.split(near, np.flatnonzero(np.diff(near) > PASSAGE_GAP) + 1)
    best = [int(passage[cost[passage].argmin()]) for passage in passages]
    return sorted(best, key=lambda node: float(cost[node]))
