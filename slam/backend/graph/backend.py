"""The back end ``graph``: chain, loops, pose graph, joint registration."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.alignment import umeyama
from moteslam.slam.backend.graph.chain import Chain
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.endpoints import Endpoints, sharpness
from moteslam.slam.backend.graph.joint import register_jointly
from moteslam.slam.backend.graph.loop_graph import LoopGraph, checked
from moteslam.slam.backend.graph.nodes import Nodes
from moteslam.slam.backend.kinds import BackendKind
from moteslam.slam.backend.ledger import LoopCandidate
from moteslam.slam.backend.protocol import KeyScan
from moteslam.slam.inputs.filling import between_known

Array = NDArray[np.float64]

OFF, CLEARLY_OFF = 0.02, 0.1
"""The filter's path is corrected where a new loop is off by this much [m] ..."""
WELL_GROWN, GROWN = 1.25, 1.03
"""... and the path has grown by this factor since the last correction."""
MOVED, FAR_OFF, ROUNDS = 0.02, 0.3, 6
"""In the joint registration of a correction the nodes move that the loops have moved by this much [m]; all of them
where a loop was off by more than the second [m]; rounds at most."""
LEAST_NODES = 3
"""Fewer have nothing to correct."""


class GraphBackend:
    """Corrects the path of the key scans where a loop contradicts it, and at the end.

    Args:
        config: of all stages.
    """

    def __init__(self, config: GraphConfig) -> None:
        self._config = config
        self._nodes = Nodes(config)
        self._chain: Chain | None = None
        self._graph: LoopGraph | None = None
        self._path: list[Array] = []  # of all key scans, as the filter's map has them
        self._corrected = 0.0  # length of the path at the last correction [m]
        self._loops: tuple[LoopCandidate, ...] = ()

    @property
    def loops(self) -> tuple[LoopCandidate, ...]:
        """See ``Backend``."""
        return self._loops

    def add(self, key: KeyScan) -> Array | None:
        """See ``Backend``."""
        self._path.append(key.pose)
        if not self._nodes.add(key):
            return None
        if self._chain is None or self._graph is None:
            self._chain = Chain(self._nodes, self._config)
            self._graph = LoopGraph(self._nodes, self._chain, self._config)
            return None
        self._chain.add()
        self._graph.follow()
        if not self._config.loops.enabled:
            return None
        self._graph.look()
        return self._correction(self._chain, self._graph)

    def _correction(self, chain: Chain, graph: LoopGraph) -> Array | None:
        """The corrected path of all key scans where a new loop is off by enough, and fits better after it."""
        updates = np.array(self._nodes.updates)
        placed = np.array([self._path[update] for update in self._nodes.updates])
        off, grown = graph.news(placed), graph.driven / max(self._corrected, 1.0)
        if off < OFF or grown < (GROWN if off > CLEARLY_OFF else WELL_GROWN):
            return None
        before = graph.before_news()
        graph.solve()
        poses = graph.poses
        if self._config.joint.enabled:
            endpoints = Endpoints.of(self._nodes.scans)
            moved = np.ones(len(poses), bool)
            moved[: len(before)] = np.hypot(*(poses[: len(before), :2] - before[:, :2]).T) > MOVED
            free = moved if len(before) and off < FAR_OFF else None
            poses = register_jointly(endpoints, poses, chain, self._config, free, rounds=ROUNDS)
            poses = laid_over(poses, before)
        better = graph.news(poses) < off
        self._corrected = graph.driven
        graph.seen()
        if not better:
            return None
        if self._config.joint.enabled:
            graph.register(poses)
        path = between_known(poses, updates, np.array(self._path))
        self._path = list(path)
        return path

    def finish(self, path: Array) -> Array | None:
        """See ``Backend``."""
        if self._graph is None:
            return None
        self._graph.forget()
        # a run may go on after its estimate was asked for
        nodes, chain, graph = deepcopy((self._nodes, self._chain, self._graph))
        if nodes.close():
            chain.add()
            graph.follow()
        if len(nodes) < LEAST_NODES:
            return None
        chain.settle()
        graph.refit()
        if self._config.loops.enabled:
            graph.close()
        updates = np.array(nodes.updates)
        before = graph.before_news()
        best = laid_over(sharpest(nodes, chain, graph, path[updates], self._config), before)
        self._loops = checked(graph.ledger, nodes, best)
        return between_known(best, updates, path)


def sharpest(nodes: Nodes, chain: Chain, graph: LoopGraph, filtered: Array, config: GraphConfig) -> Array:
    """The path that draws the sharpest map: registered jointly from where the last correction left it, or anew.

    Args:
        nodes, chain: n nodes and the steps between them.
        graph: of them, as it was solved last.
        filtered: [n, 3] by the filter.
        config: of the back end.
    """
    endpoints = Endpoints.of(nodes.scans)
    if not len(endpoints.points):
        return filtered
    paths = [filtered, graph.poses]
    values = [sharpness(endpoints, poses) for poses in paths]

    def register(start: Array) -> bool:
        paths.append(register_jointly(endpoints, start, chain, config))
        values.append(sharpness(endpoints, paths[-1]))
        return values[-1] == min(values)

    if config.joint.enabled and not register(graph.poses):
        register(graph.unregistered())
        register(filtered)
    return paths[int(np.argmin(values))]


def laid_over(poses: Array, before: Array) -> Array:
    """Poses [n, 3] moved rigidly so that the first m lie on those before a correction [m, 3], by least squares.

    What holds the frame is the map as it was, not the first scan alone: a tenth of a degree in its heading would move
    a large building's far end by decimetres.
    """
    if len(before) < 2:
        return poses
    moved = umeyama(poses[: len(before), :2], before[:, :2])
    return np.asarray(se2.compose(moved, poses))


GRAPH = BackendKind(GraphConfig, GraphBackend)
"""The kind that ``backend.method = "graph"`` chooses."""
