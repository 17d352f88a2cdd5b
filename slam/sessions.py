"""Going on with a building: the place of a new session in it is found as by localisation, then loops bind the two.

A corridor looks like the next one for tens of metres. So every place that some metres of the path fit is followed along
the rest, scan by scan, and what the map knows there speaks for it or against it. A place that others come near to in
that is not known. Loops between the two sessions have the same proofs as within one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.formats.map_server import trinary
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue
from moteslam.slam.backend.building import Building
from moteslam.slam.backend.graph.backend import laid_over, sharpest
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.loop_closing import LoopClosing
from moteslam.slam.backend.graph.loop_graph import BoundGraph, Pair, checked
from moteslam.slam.backend.graph.loop_search import Loop
from moteslam.slam.backend.graph.nodes import MAX_RANGE, Nodes
from moteslam.slam.backend.ledger import LoopCandidate
from moteslam.slam.config import SlamConfig
from moteslam.slam.estimate import Estimate
from moteslam.slam.known_map.config import KnownMapConfig
from moteslam.slam.known_map.hypotheses import LEAST
from moteslam.slam.known_map.maps import KnownMaps
from moteslam.slam.known_map.search import CROSSING, IN_MAP, ON_SURFACE, OUTLIER, POINTS, WINDOW, Sight, WholeMapSearch
from moteslam.slam.mapping.config import LOST_DISTANCE, LOST_ROTATION
from moteslam.slam.registration.evidence import CORRELATION
from moteslam.slam.registration.registrar import register, subsample
from moteslam.slam.registration.search import is_elsewhere

Points = NDArray[np.float32]

APART, MOST = 20.0, 20  # Searches are this far apart along the path [m], at least, and at most so many
FOLLOWED = 10  # Places that each finds of which at most so many are followed
STEP = np.array([0.02, 0.02, 0.005])
"""Standard deviations of a step of the path from scan to scan, in a map that is bent a little [m, m, rad]."""
CORRECTING = 0.7  # A scan corrects the path where so many of its endpoints are known: the rest of a wall pulls aside
KNOWN = 0.9  # What an endpoint on known cells says for a place [nats]: four outweigh one that contradicts it
LEAST_EVIDENCE = 200.0  # Places of less count for nothing [nats]: ten metres of a path through known cells have it
STOOD = 2.0
"""Nearer than this to where a robot stood the map shows all that is seen from there [m]: farther on it shows of a wall
what few rays met."""
CONTRADICTED = 0.1  # A place is none where the map contradicts more: a tenth of the furniture, moved, is half of it
CLEARLY = 0.5  # A place is known where the map contradicts less than this times the share of any other one


class Place(NamedTuple):
    """Where a path may lie."""

    node: int  # the scan of it around which it was searched for
    evidence: float  # of all its scans [nats]
    contradicted: float  # share of the endpoints that the map knows, of scans where a robot stood; 1 without any
    track: Array  # [n, 3] where they lie


def find_path(
    occupancy: Raster, stood: Array, path: Array, scans: Sequence[Points], origin: Array
) -> tuple[Place | None, int]:
    """Where in a map, drawn from poses [m, 3], a path [n, 3] in a frame of its own lies, None where that is open.

    And how many answers there are. The n scans are endpoints [k, 2] in the robot's frame, their rays start at an origin
    [2] [m].
    """
    config = KnownMapConfig()
    maps = KnownMaps(occupancy, config.tsdf)
    search, near = WholeMapSearch(maps, config.registration), cKDTree(stood[:, :2])
    driven = np.r_[0.0, np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))]
    some = np.arange(min(WINDOW, driven[-1]), driven[-1] + APART / 2, max(APART, driven[-1] / MOST))
    places: list[Place] = []
    for node in np.unique(np.minimum(np.searchsorted(driven, some), len(path) - 1)).tolist():
        search.begin()
        for k in np.flatnonzero((driven >= driven[node] - WINDOW) & (driven <= driven[node])).tolist():
            search.see(Sight(path[k], scans[k], origin))
        found = search.find(Sight(path[node], scans[node], origin))
        if found.probabilities.sum() > IN_MAP:
            likely = found.poses[found.probabilities > LEAST * found.probabilities[0]][:FOLLOWED]
            places += _followed(maps, near, config, path, scans, origin, node, likely)
    places = [place for place in places if place.evidence > LEAST_EVIDENCE]
    best = max(places, key=lambda place: place.evidence, default=None)
    if best is None or best.contradicted > CONTRADICTED:
        return None, 0
    others = [place for place in places if is_elsewhere(se2.between(best.track[best.node], place.track[best.node]))]
    decided = all(best.contradicted < CLEARLY * place.contradicted for place in others)
    return (best if decided else None), 1 + len(others)


def _followed(
    maps: KnownMaps,
    near: cKDTree,
    config: KnownMapConfig,
    path: Array,
    scans: Sequence[Points],
    origin: Array,
    node: int,
    poses: Array,
) -> list[Place]:
    """Places [m, 3] of a scan, followed along the path to both ends."""
    view, still = maps.of(0), np.zeros_like(poses)
    tracks = np.zeros((len(poses), len(path), 3))
    evidence, known, far = np.zeros((3, len(poses)))
    for way in (range(node, len(path)), range(node - 1, -1, -1)):
        at, last = poses, node
        for k in way:
            points = subsample(scans[k], POINTS)
            at, last = se2.compose(at, se2.between(path[last], path[k])), k
            if len(points):
                fit = register(view, at, STEP, points, origin, still, config.registration, coarse=False)
                corrects = fit.known >= CORRECTING * len(points)
                at = np.where(corrects[:, None], se2.compose(at, fit.offsets), at)
                against = (OUTLIER - ON_SURFACE) * fit.far + CROSSING * fit.crossed
                evidence += (KNOWN * fit.known - against) / CORRELATION
                here = near.query(at[:, :2])[0] < STOOD
                known, far = known + here * fit.known, far + here * fit.far
            tracks[:, k] = at
    contradicted = np.where(known > 0, far / np.maximum(known, 1), 1.0)
    return [Place(node, *each) for each in zip(evidence.tolist(), contradicted.tolist(), tracks, strict=True)]


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


def expect_graph(config: SlamConfig) -> GraphConfig:
    """The back end's configuration, if it can bind sessions.

    Raises:
        ConfigError: it cannot.
    """
    if not isinstance(config.backend, GraphConfig):
        raise ConfigError(f'"{config.backend.method}", expected "graph" to bind sessions', field="backend.method")
    return config.backend


def go_on(estimate: Estimate, building: Building) -> Estimate:
    """The estimate of a recording bound to a building that was mapped before: in its frame, with the map of both.

    Where no loops prove that it belongs there it stays as it is, with a warning.

    Args:
        estimate: of the recording.
        building: of the sessions before.
    """
    if estimate.building is None:
        return _apart(estimate, "it has too few scans for a graph")
    bound = joined(building, estimate.building, estimate.config)
    if isinstance(bound, str):
        return _apart(estimate, bound)
    final, drawn = bound.sessions[-1].trajectory, bound.draw(estimate.config.map)
    return replace(estimate, trajectory_final=final, map=drawn, building=bound)


def joined(building: Building, new: Building, config: SlamConfig) -> Building | str:
    """A building with one session more, in its frame; why not, where nothing proves that it belongs there.

    Args:
        building: of the sessions before.
        new: of one session, in a frame of its own.
        config: of map and back end.
    """
    backend = expect_graph(config)
    (session,) = new.sessions
    drawn = building.draw(config.map)
    scans = [scan.points for scan in session.thinned(backend.thinning, np.inf)]
    path, occupancy = session.path[session.nodes], replace(drawn, values=trinary(drawn.values))
    place, places = find_path(occupancy, building.poses, path, scans, session.origin)
    if place is None:
        return "it may lie at several places of their map" if places else "it lies nowhere in their map"
    bound = bind(building, new, place.node, place.track[place.node], backend)
    return "no loops prove the place of their map where it seems to lie" if bound is None else bound


def _apart(estimate: Estimate, why: str) -> Estimate:
    text = f"the recording is not bound to the sessions before: {why}; the result is its own, in a frame of its own"
    return replace(estimate, warnings=(*estimate.warnings, Issue("session-apart", text)))
