"""Where in a map a whole path lies: searched for around several of its places, each answer followed along all of it.

A corridor looks like the next one for tens of metres. So every place that some metres of the path fit is followed along
the rest, scan by scan, and what the map knows there speaks for it or against it. A place that others come near to in
that is not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.slam.known_map.config import KnownMapConfig
from moteslam.slam.known_map.hypotheses import LEAST
from moteslam.slam.known_map.maps import KnownMaps
from moteslam.slam.known_map.search import CROSSING, IN_MAP, ON_SURFACE, OUTLIER, POINTS, WINDOW, Sight, WholeMapSearch
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
