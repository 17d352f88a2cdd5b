"""False loops, entered into the graph before the final path is solved, to see what a wrong match would cost."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING
from unittest.mock import patch

import numpy as np

if TYPE_CHECKING:
    from moteslam.slam.backend.graph.loop_closing import LoopClosing
    from moteslam.slam.backend.graph.loop_graph import LoopGraph

SHARE, CLUSTER = 0.1, 5  # As many false loops as this share of the accepted ones, in clusters of neighbouring nodes
NEAREST, FARTHEST, TURN = 1.0, 3.0, 0.1
"""How far off a cluster is [m], and its heading at most [rad]: as a look-alike along a corridor would be."""


@contextmanager
def false_loops(seed: int) -> Iterator[None]:
    """Within it every back end ``graph`` that closes its loops at the end is given false ones."""
    from moteslam.slam.backend.graph.loop_closing import LoopClosing

    close = LoopClosing.close

    def close_and_inject(self: LoopClosing[LoopGraph], start: int = 0) -> None:
        close(self, start)
        inject(self.graph, np.random.default_rng(seed))

    with patch.object(LoopClosing, "close", close_and_inject):
        yield


def inject(graph: LoopGraph, rng: np.random.Generator) -> None:
    """Enter clusters of loops beside true ones: all of a cluster agree with each other, and are off alike."""
    from moteslam.robot import se2
    from moteslam.slam.backend.graph.loop_graph import PROVED

    accepted = [pair for pair, loop in graph.loops.items() if loop.candidate.accepted]
    for _ in range(max(round(SHARE * len(accepted) / CLUSTER), 1) if accepted else 0):
        first, second = accepted[int(rng.integers(len(accepted)))]
        like = graph.loops[first, second]
        angle, distance = rng.uniform(-np.pi, np.pi), rng.uniform(NEAREST, FARTHEST)
        off = np.array([distance * np.cos(angle), distance * np.sin(angle), rng.uniform(-TURN, TURN)])
        wrong = np.asarray(se2.compose(like.candidate.found, off))  # the whole passage is somewhere else
        for later in range(second, min(second + CLUSTER, len(graph.nodes))):
            if (first, later) in graph.loops:
                continue
            found = np.asarray(se2.compose(wrong, se2.between(graph.poses[second], graph.poses[later])))
            stamps = float(graph.nodes.stamps[first]), float(graph.nodes.stamps[later])
            candidate = replace(
                like.candidate, later=int(graph.nodes.indices[later]), stamps=stamps, found=found, verdict="accepted"
            )
            graph.enter((first, later), like._replace(candidate=candidate))
    graph.solve(PROVED)
