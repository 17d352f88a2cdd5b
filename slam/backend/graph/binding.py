"""Binding a session to a building by loops between them, with the same proofs as within one session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.backend.building import Building
from moteslam.slam.backend.graph.backend import laid_over, sharpest
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.loop_closing import LoopClosing
from moteslam.slam.backend.graph.loop_graph import BoundGraph, Pair, checked
from moteslam.slam.backend.graph.loop_search import Loop
from moteslam.slam.backend.graph.nodes import MAX_RANGE, Nodes
from moteslam.slam.backend.ledger import LoopCandidate
from moteslam.slam.mapping.config import LOST_DISTANCE, LOST_ROTATION

SEARCHED = np.diag(np.square([1 / LOST_DISTANCE, 1 / LOST_DISTANCE, 1 / LOST_ROTATION]))
"""Information of the place that was searched for: it is wrong where it is off by more."""
LEAST_LOOPS = 2  # Loops that bind two sessions, at least: what one says another one confirms


def bind(building: Building, session: Building, node: int, pose: Array, config: GraphConfig) -> Building | None:
    """A session, in a frame of its own, bound to a building, whose frame stays; None where no loops prove that it
    belongs.

    Its node seems to lie at a pose [3] in the frame of the building.
    """
    n, own = int(building.firsts[-1]), session.poses
    both = building.plus(session.at(se2.compose(pose, se2.between(own[node], own))))
    graph = _graph_of(both, config)
    near = int(np.argmin(np.hypot(*(both.poses[:n, :2] - pose[:2]).T)))
    place = near, n + node
    graph.enter(place, _as_known(place, se2.between(both.poses[near], pose), SEARCHED))
    LoopClosing(graph, config, since=n).close(n + node)
    del graph.loops[place]
    graph.solve()
    if len(_between(_accepted(graph, graph.ledger), n)) < LEAST_LOOPS:
        return None
    final, _ = sharpest(graph, graph.poses, config)
    final = laid_over(final, building.poses)
    kept = _accepted(graph, checked(graph.ledger, graph.nodes, final))
    if len(_between(kept, n)) < LEAST_LOOPS:
        return None
    return replace(both.at(final), loops=graph.edges_of(kept))


def _graph_of(building: Building, config: GraphConfig) -> BoundGraph:
    """The graph of a building, at its poses."""
    nodes = Nodes(config)
    for session in building.sessions:
        nodes.scans += session.thinned(config.thinning, MAX_RANGE)
        nodes.stamps += session.stamps[session.nodes].tolist()
    nodes.indices = nodes.updates = list(range(len(nodes.scans)))
    graph = BoundGraph(nodes, building.chain, config)
    graph.submaps.follow(building.chain.steps, (building.firsts[1:-1] - 1).tolist())
    loops = building.loops
    pairs = zip(loops.first.tolist(), loops.second.tolist(), strict=True)
    for pair, relative, information in zip(pairs, loops.relative, loops.information, strict=True):
        graph.enter(pair, _as_known(pair, relative, information))
    graph.register(building.poses)
    return graph


def _as_known(pair: Pair, relative: Array, information: Array) -> Loop:
    """A loop that was proved before."""
    candidate = LoopCandidate.unsearched(*pair, (0.0, 0.0), relative, (0.0, 0.0))
    return Loop(replace(candidate, verdict="accepted"), information)


def _accepted(graph: BoundGraph, ledger: Sequence[LoopCandidate]) -> list[Pair]:
    """The loops that a ledger of the graph accepts."""
    return [pair for pair, candidate in zip(graph.loops, ledger, strict=True) if candidate.accepted]


def _between(pairs: Sequence[Pair], n: int) -> list[Pair]:
    """Those that bind nodes before number n to later ones."""
    return [pair for pair in pairs if pair[0] < n <= pair[1]]
