"""Submaps: the scans of some neighbouring nodes in one TSDF, and as one set of endpoints that is searched for in it."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.nodes import Nodes
from moteslam.slam.mapping.tsdf import TsdfMaps
from moteslam.slam.registration.registrar import subsample

Points = NDArray[np.float32]

MAP_NODES, QUERY_NODES = 12, 6  # Of a submap and of a query, at most: where the robot turns many lie close together
SPACING = 0.1  # Endpoints of a query are at least about this far apart [m]
MAX_POINTS = 400  # Endpoints of a query, at most
BETWEEN = 1e4  # Sessions are this far apart along the path [m]: no submap reaches from one into the next
CACHED = 64  # TSDFs of submaps that are kept, those used last: about half a megabyte each, those of wide windows more


class Submaps:
    """The submaps around the nodes, built when they are asked for; nodes lie in them as the chain has them.

    Attributes:
        poses: [n, 3] of the chain.
        path: [n] distance driven up to each node [m].
    """

    def __init__(self, nodes: Nodes, config: GraphConfig) -> None:
        self._nodes, self._config = nodes, config
        self.poses, self.path, self._gaps = np.zeros((1, 3)), np.zeros(1), 0
        self._maps: OrderedDict[tuple[int, int], TsdfMaps] = OrderedDict()

    @property
    def driven(self) -> float:
        """Length of the path [m]."""
        return float(self.path[-1]) - BETWEEN * self._gaps

    def follow(self, steps: Array, gaps: Sequence[int] = ()) -> None:
        """Lay the nodes along the chain anew, by its steps [n - 1, 3], of which ``gaps`` lie between two sessions."""
        self.poses = np.vstack((np.zeros(3), se2.accumulate(steps)))
        lengths = np.hypot(steps[:, 0], steps[:, 1])
        lengths[list(gaps)] = BETWEEN
        self._gaps = len(gaps)
        self.path = np.r_[0.0, np.cumsum(lengths)]
        self.forget()

    def extend(self, step: Array) -> None:
        self.poses = np.vstack((self.poses, se2.compose(self.poses[-1], step)))
        self.path = np.append(self.path, self.path[-1] + np.hypot(*step[:2]))

    def forget(self) -> None:
        """Build the TSDFs anew when they are asked for."""
        self._maps.clear()

    def around(self, node: int, reach: float = 0.0) -> TsdfMaps:
        """The TSDF of the nodes around one, in its frame; longer by ``reach`` to both ends, in whole metres [m]."""
        extra = 2 * int(np.ceil(reach))
        if (node, extra) in self._maps:
            self._maps.move_to_end((node, extra))
        else:
            maps, length = TsdfMaps(self._config.tsdf), self._config.loops.submap_length
            members = self._members(node, length + extra, round(MAP_NODES * (1 + extra / length)))
            poses = se2.between(self.poses[node], self.poses[members])
            maps.draw(poses, [self._nodes.scans[k] for k in members])
            self._maps[node, extra] = maps
            if len(self._maps) > CACHED:
                self._maps.popitem(last=False)
        return self._maps[node, extra]

    def query(self, node: int) -> Points:
        """The endpoints [k, 2] of the nodes around one, in its frame [m]."""
        members = self._members(node, self._config.loops.query_length, QUERY_NODES)
        middle, scans = self.poses[node], self._nodes.scans
        seen = [se2.transform_points(se2.between(middle, self.poses[k]), scans[k].points) for k in members]
        points = np.vstack(seen)
        cells = np.floor(points / SPACING).astype(np.int64)
        _, first = np.unique(cells, axis=0, return_index=True)
        return subsample(points[np.sort(first)].astype(np.float32), MAX_POINTS)

    def _members(self, node: int, length: float, most: int) -> list[int]:
        near = np.flatnonzero(np.abs(self.path - self.path[node]) <= length / 2)
        return [int(k) for k in near if abs(k - node) <= most // 2]
