"""The back end ``graph``: chain, loops, pose graph, joint registration.

And how it binds a session to a building: by loops between them, with the same proofs as within one session.
"""

from array import array
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.se2 import Array, umeyama
from moteslam.robot.values import Issue, counted
from moteslam.slam.backend.building import Building, Measured, between_known
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.joint import Endpoints, cells_along, register_jointly, sharpness
from moteslam.slam.backend.graph.loop_closing import LoopClosing
from moteslam.slam.backend.graph.loop_graph import BoundGraph, LoopGraph, Pair, checked
from moteslam.slam.backend.graph.loop_search import Loop
from moteslam.slam.backend.graph.nodes import MAX_RANGE, Nodes
from moteslam.slam.backend.graph.pose_graph import CONTRADICTED
from moteslam.slam.backend.protocol import BackendKind, KeyScan, LoopCandidate
from moteslam.slam.mapping.config import LOST_DISTANCE, LOST_ROTATION
from moteslam.slam.rows import Rows

OFF, WELL_GROWN = 0.05, 1.25
"""The filter's path is corrected where a new loop is off by the first [m], and the path has grown by the second factor
since the last correction ..."""
CLEARLY_OFF, GROWN = 0.1, 1.03  # ... or by these
MOVED = 0.02  # A correction registers jointly the nodes that the loops have moved by this much [m] ...
FAR_OFF = 0.3  # ... and all of them where a loop was off by more than this [m] ...
ROUNDS = 6  # ... in at most this many rounds
FARTHEST, SLACK = 10.0, 0.2
"""A correction moves no node farther than the first factor times what the new loops are off, plus the second [m]: so
large a move follows from a wrong step of the chain, not from the loops."""
SAME_START = 0.3  # Two paths, laid over each other, are the same start of a joint registration up to this [m]
CLEARLY = 3.0
"""A map is clearly sharper by so many standard errors of the mean over the directions of the grid: of four directions
95 % of the differences that mean nothing are within them (Student's t)."""
LEAST_NODES = 3  # Fewer have nothing to correct


class GraphBackend:
    """Corrects the path of the key scans where a loop contradicts it, and at the end."""

    def __init__(self, config: GraphConfig) -> None:
        self._config = config
        self._nodes = Nodes(config)
        self._closing: LoopClosing[LoopGraph] | None = None  # from the first node on
        self._path = Rows(3)  # of all key scans, as the filter's map has them
        self._nearest = array("l")  # of each key scan that is no node, as its place is known, the nearest node; or -1
        self._placed = np.zeros((0, 3))  # of the nodes, on that path
        self._corrected = 0.0  # length of the path at the last correction [m]
        self._known = 0  # nodes before the robot was lost, or all until now
        self._loops: tuple[LoopCandidate, ...] = ()
        self.issues: tuple[Issue, ...] = ()
        self.measured: Measured | None = None

    @property
    def loops(self) -> tuple[LoopCandidate, ...]:
        """See ``Backend``: of the latest estimate, or before there is one as the graph has them."""
        return self._closing.graph.ledger if self._closing is not None and not self._loops else self._loops

    def add(self, key: KeyScan) -> Array | None:
        self._path.add(key.pose[None])
        self._nearest.append(-1)
        added = self._nodes.add(key, self._crowded)
        if not key.lost:
            self._known = len(self._nodes)
        if not added:
            return None
        self._placed = np.vstack((self._placed, self._path.values[self._nodes.updates[-1]]))
        if self._closing is None:
            self._closing = LoopClosing(LoopGraph(self._nodes, self._config), self._config)
            return None
        self._closing.graph.extend()
        if not self._config.loops.enabled or key.lost:
            return None
        self._closing.look()
        return self._correction(self._closing)

    def relocated(self, path: Array) -> None:
        self._move(path)
        if self._closing is not None:
            self._nodes.place(self._placed)
            self._closing.graph.rejoin()
            self._closing.rejoin(self._known, self._placed)

    def _crowded(self) -> bool:
        """Whether there are enough nodes where the key scan before the latest was taken; it goes with the nearest."""
        here, c = self._path.values[-2], self._config
        away = np.hypot(self._placed[:, 0] - here[0], self._placed[:, 1] - here[1])
        near = (away < c.distance) & (np.abs(se2.wrap(self._placed[:, 2] - here[2])) < c.rotation)
        if near.sum() < c.crowd:
            return False
        self._nearest[-2] = int(np.argmin(np.where(near, away, np.inf)))
        return True

    def _between_nodes(self, poses: Array, updates: NDArray[np.intp], path: Array) -> Array:
        """The path [u, 3] of all key scans by the filter, where poses [n, 3] of nodes, the key scans [n], are known.

        A key scan that is no node since its place is known moves with the node nearest to it: the filter saw it at this
        place of its map, and the map there is that node's.
        """
        nearest = np.array(self._nearest[: len(path)])
        others = np.flatnonzero(nearest >= 0)
        if len(others):
            nodes = nearest[others]
            moved = se2.compose(poses[nodes], se2.between(path[updates[nodes]], path[others]))
            known = np.concatenate((updates, others))
            order = np.argsort(known, kind="stable")
            poses, updates = np.concatenate((poses, np.asarray(moved)))[order], known[order]
        return between_known(poses, updates, path)

    def _correction(self, closing: LoopClosing[LoopGraph]) -> Array | None:
        """The corrected path of all key scans where a new loop is off by enough, and the map is sharper after it."""
        graph, updates, path = closing.graph, np.array(self._nodes.updates), self._path.values
        placed = path[updates]
        driven, off = graph.submaps.driven, graph.misfit(closing.news, placed)
        grown = driven / max(self._corrected, 1.0)
        if off < OFF or grown < (GROWN if off > CLEARLY_OFF else WELL_GROWN):
            return None
        graph.solve()
        endpoints = Endpoints.of(self._nodes.scans)
        poses = self._registered(graph, endpoints, off) if self._config.joint.enabled else graph.poses
        poses = laid_over(poses, _frame(graph, placed))
        moved = np.hypot(*(poses[:, :2] - placed[:, :2]).T).max()
        better = moved < FARTHEST * off + SLACK and graph.misfit(closing.news, poses) < off
        better = better and sharpness(endpoints, poses) < sharpness(endpoints, placed)
        self._corrected = driven
        closing.news.clear()
        if not better:
            return None
        if self._config.joint.enabled:
            graph.register(poses)
        path = self._between_nodes(poses, updates, path)
        self._move(path)
        return path

    def _move(self, path: Array) -> None:
        """The path [u, 3] of all key scans is another."""
        self._path, self._placed = Rows(3), path[np.array(self._nodes.updates, np.intp)]
        self._path.add(path)

    def _registered(self, graph: LoopGraph, endpoints: Endpoints, off: float) -> Array:
        """The nodes' poses [n, 3] after a joint registration of those that a loop has moved that was ``off`` [m]."""
        poses, before, free, reach = graph.poses, graph.registered, None, self._config.joint.first_reach
        if len(before) and off < FAR_OFF:
            reach, free = self._config.joint.last_reach, np.ones(len(poses), bool)
            free[: len(before)] = np.hypot(*(poses[: len(before), :2] - before[:, :2]).T) > MOVED
        return register_jointly(endpoints, poses, graph.measured, self._config, reach, free, rounds=ROUNDS)

    def finish(self, path: Array) -> Array | None:
        if self._closing is None:
            return None
        self._closing.graph.submaps.forget()
        # a run may go on after its estimate was asked for
        closing = deepcopy(self._closing)
        graph = closing.graph
        if graph.nodes.close():
            graph.extend()
        if len(graph.nodes) < LEAST_NODES:
            return None
        graph.settle()
        if self._config.loops.enabled:
            closing.close()
        updates = np.array(graph.nodes.updates)
        filtered = path[updates]
        frame = _frame(graph, filtered)
        final, measured = sharpest(graph, filtered, self._config)
        best = laid_over(final, frame)
        self._loops = checked(graph.ledger, graph.nodes, best)
        self.issues = contradictions(graph, best, self._loops, measured=measured)
        kept = [pair for pair, loop in zip(graph.loops, self._loops, strict=True) if loop.accepted]
        self.measured = Measured(np.array(graph.nodes.indices), graph.measured, graph.edges_of(kept))
        return self._between_nodes(best, updates, path)


def sharpest(graph: BoundGraph, filtered: Array, config: GraphConfig) -> tuple[Array, bool]:
    """The path that is nearest to what was measured, of those that draw about as few cells as any.

    Candidates are, in this order, the joint registrations that begin at the graph as measured, at the corrected graph
    and at the filter's path [n, 3], with the corrections while it drove, of each the one within the last reach, then
    the one within the first; then these three themselves. A later one is taken only where its map is clearly sharper.
    The graph is solved as measured afterwards.

    Returns [n, 3] poses, and whether the graph's measurements led there rather than the filter's path.
    """
    endpoints = Endpoints.of(graph.nodes.scans)
    corrected = graph.poses
    graph.solve_as_measured()
    starts = [graph.poses, corrected, filtered]
    paths: list[tuple[Array, bool]] = []
    if config.joint.enabled:
        tried: list[Array] = []
        for start in starts:
            if any(np.hypot(*(laid_over(start, other) - other)[:, :2].T).max() < SAME_START for other in tried):
                continue
            reaches = config.joint.last_reach, config.joint.first_reach
            found = [register_jointly(endpoints, start, graph.measured, config, reach) for reach in reaches]
            paths += [(registered, start is not filtered) for registered in found]
            tried += [start, *found]
    paths += [(start, start is not filtered) for start in starts]
    best, fewest = paths[0], cells_along(endpoints, paths[0][0])
    for path in paths[1:]:
        cells = cells_along(endpoints, path[0])
        fewer = fewest - cells
        if fewer.mean() > CLEARLY * fewer.std(ddof=1) / np.sqrt(len(fewer)):
            best, fewest = path, cells
    return best


def contradictions(
    graph: LoopGraph, poses: Array, loops: tuple[LoopCandidate, ...], *, measured: bool
) -> tuple[Issue, ...]:
    """What the final poses [n, 3], which confirm the ``loops``, contradict of what the graph ``measured``, if it led
    there.
    """
    issues, stamps = [], graph.nodes.stamps
    if not measured and any(loop.accepted for loop in graph.ledger):
        known, kept = (sum(loop.accepted for loop in ledger) for ledger in (graph.ledger, loops))
        text = "the final path follows from the filter's, whose map is clearly sharper than the graph's: it confirms "
        text += f"{kept} of {counted(known, 'loop')}"
        issues.append(Issue("graph-left", text, known - kept))
    off, deviations = graph.measured.errors(poses)
    far = (np.abs(off) > CONTRADICTED * deviations).any(axis=1)
    if far.any():
        size = np.hypot(off[:, 0], off[:, 1]) + np.abs(off[:, 2])
        worst = int(np.where(far, size, -1.0).argmax())
        distance, turn = float(np.hypot(*off[worst, :2])), abs(float(np.degrees(off[worst, 2])))
        text = f"the final path contradicts odometry and registration by over {CONTRADICTED:g} standard deviations in "
        text += f"{counted(int(far.sum()), 'step')}, most from {stamps[worst]:.2f} to {stamps[worst + 1]:.2f} s, by "
        text += f"{distance:.2f} m and {turn:.1f} degrees: the map may be bent there"
        issues.append(Issue("step-contradicted", text, int(far.sum())))
    return tuple(issues)


def _frame(graph: LoopGraph, filtered: Array) -> Array:
    """The poses [m, 3] that hold the frame: of the latest correction, before the first the filter's of all nodes."""
    return graph.registered if len(graph.registered) else filtered


def laid_over(poses: Array, before: Array) -> Array:
    """Poses [n, 3] moved rigidly so that the first m lie on those before [m, 3], by least squares.

    What holds the frame is the map as it was, not the first scan alone: a tenth of a degree in its heading would move
    a large building's far end by decimetres. Headings count as points a metre ahead and behind, for nodes on one spot.
    """
    moved = umeyama(_ends(poses[: len(before)]), _ends(before))
    return se2.compose(moved, poses)


def _ends(poses: Array) -> Array:
    """The points [2n, 2] a metre ahead of poses [n, 3] and behind them."""
    ahead = np.column_stack((np.cos(poses[:, 2]), np.sin(poses[:, 2])))
    return np.vstack((poses[:, :2] + ahead, poses[:, :2] - ahead))


GRAPH = BackendKind(GraphConfig, GraphBackend)  # The kind that `backend.method = "graph"` chooses


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
    known = LoopCandidate(*pair, (0.0, 0.0), relative, relative, (0.0, 0.0), verdict="accepted")
    return Loop(known, information)


def _accepted(graph: BoundGraph, ledger: Sequence[LoopCandidate]) -> list[Pair]:
    """The loops that a ledger of the graph accepts."""
    return [pair for pair, candidate in zip(graph.loops, ledger, strict=True) if candidate.accepted]


def _between(pairs: Sequence[Pair], n: int) -> list[Pair]:
    """Those that bind nodes before number n to later ones."""
    return [pair for pair in pairs if pair[0] < n <= pair[1]]
