"""The back end ``graph``: chain, loops, pose graph, joint registration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.backend.graph.chain import Chain, build_chain
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.endpoints import Endpoints, sharpness
from moteslam.slam.backend.graph.joint import register_jointly
from moteslam.slam.backend.graph.loop_graph import LoopGraph, checked
from moteslam.slam.backend.graph.nodes import Nodes, choose_nodes
from moteslam.slam.backend.kinds import BackendKind
from moteslam.slam.backend.ledger import LoopCandidate
from moteslam.slam.backend.protocol import KeyScan
from moteslam.slam.inputs.filling import between_known

Array = NDArray[np.float64]


class GraphBackend:
    """Collects key scans, and corrects their path at the end.

    Args:
        config: of all stages.
    """

    def __init__(self, config: GraphConfig) -> None:
        self._config = config
        self._keys: list[KeyScan] = []
        self._loops: tuple[LoopCandidate, ...] = ()

    @property
    def loops(self) -> tuple[LoopCandidate, ...]:
        """See ``Backend``."""
        return self._loops

    def add(self, key: KeyScan) -> None:
        """Take in a key scan; nothing is corrected before the end."""
        self._keys.append(key)

    def finish(self, path: Array) -> Array | None:
        """See ``Backend``."""
        c = self._config
        nodes = choose_nodes(self._keys[: len(path)], path, c.distance, c.rotation, c.thinning)
        if len(nodes) < 3:
            return None
        filtered = path[nodes.updates]
        chain = build_chain(nodes, filtered, c)
        graph = LoopGraph(nodes, chain, c)
        poses = graph.close() if c.loops.enabled else chain.poses
        best = sharpest(nodes, chain, poses, filtered, c)
        self._loops = checked(graph.ledger, nodes, best)
        return between_known(best, nodes.updates, path)


def sharpest(nodes: Nodes, chain: Chain, solved: Array, filtered: Array, config: GraphConfig) -> Array:
    """The path that draws the sharpest map: registered jointly from the graph's, or as a last resort the filter's.

    Args:
        nodes, chain: n nodes and the odometry between them.
        solved: [n, 3] by the pose graph.
        filtered: [n, 3] by the filter.
        config: of the back end.
    """
    endpoints = Endpoints.of(nodes.scans)
    if not len(endpoints.points):
        return filtered
    paths, values = [solved, filtered], [sharpness(endpoints, solved), sharpness(endpoints, filtered)]
    if config.joint.enabled:
        for start in (solved, filtered):
            paths.append(register_jointly(endpoints, start, chain, config))
            values.append(sharpness(endpoints, paths[-1]))
            if values[-1] < values[1]:
                break
    return paths[int(np.argmin(values))]


GRAPH = BackendKind(GraphConfig, GraphBackend)
