"""Going on with a building: the place of a new session in it is found as by localisation, then loops bind the two."""

from dataclasses import replace

import numpy as np

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.formats.map_server import trinary
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue
from moteslam.slam.backend.building import Building, Session
from moteslam.slam.backend.graph.backend import bind
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.config import SlamConfig
from moteslam.slam.estimate import Estimate
from moteslam.slam.known_map.search import Found, find_path, is_same

SAME = 0.005
"""Endpoints of one scan differ by less [m]: they were written in steps of up to some millimetres."""


def expect_graph(config: SlamConfig) -> GraphConfig:
    """The back end's configuration; ``ConfigError`` if it cannot bind sessions."""
    if not isinstance(config.backend, GraphConfig):
        raise ConfigError(f'"{config.backend.method}", expected "graph" to bind sessions', field="backend.method")
    return config.backend


def go_on(estimate: Estimate, building: Building) -> Estimate:
    """The estimate of a recording bound to a building that was mapped before: in its frame, with the map of both.

    Where no loops prove that it belongs there it stays as it is, with a warning.
    """
    if estimate.building is None:
        return _apart(estimate, "it has too few scans for a graph")
    bound = joined(building, estimate.building, estimate.config)
    if isinstance(bound, str):
        return _apart(estimate, bound)
    final, drawn = bound.sessions[-1].trajectory, bound.draw(estimate.config.map)
    return replace(estimate, trajectory_final=final, map=drawn, building=bound)


def joined(building: Building, new: Building, config: SlamConfig) -> Building | str:
    """A building with the session of a new one, in its frame; why not, where nothing proves that it belongs there."""
    backend = expect_graph(config)
    (session,) = new.sessions
    if (number := next((k for k, one in enumerate(building.sessions, 1) if _holds(one, session)), None)) is not None:
        return f"all its scans are those of session {number}"
    place, decided, places = _found(session, building, _trinary(building, config), backend)
    if place is None:
        return "it lies nowhere in their map"
    own = _trinary(new, config)
    other_way = [(old, _found(old, new, own, backend)) for old in building.sessions]
    ways = [found.decided for old, found in other_way if _agrees(place.track, new.poses, old, found)]
    if not ways:
        return "where it seems to lie in their map they do not lie in its own"
    if not (decided or any(ways)):
        return "it may lie at several places of their map" if places > 1 else "their map contradicts it"
    bound = bind(building, new, place.node, place.track[place.node], backend)
    return "no loops prove the place of their map where it seems to lie" if bound is None else bound


def _trinary(building: Building, config: SlamConfig) -> Raster:
    drawn = building.draw(config.map)
    return replace(drawn, values=trinary(drawn.values))


def _found(session: Session, building: Building, occupancy: Raster, config: GraphConfig) -> Found:
    """Where a session lies in the map of a building, if it does."""
    scans = [scan.points for scan in session.thinned(config.thinning, np.inf)]
    return find_path(occupancy, building.poses, session.path[session.nodes], scans, session.origin)


def _agrees(path: Array, own: Array, old: Session, found: Found) -> bool:
    """Whether a session, whose nodes own [n, 3] lie along a path [n, 3] in a building, was found by one of that, too.

    Two corridors of equal width fit each other somewhere, either way at another place; the same one fits at one.
    """
    if found.place is None:
        return False
    node, track = found.place.node, found.place.track
    near = int(np.argmin(np.hypot(*(own[:, :2] - track[node, :2]).T)))
    there = se2.compose(old.path[old.nodes[node]], se2.between(track[node], own[near]))
    return is_same(path[near], there)


def _holds(old: Session, new: Session) -> bool:
    """Whether all scans of a session are those of an older one: simulated ones may have the same stamps alone."""
    there, here = (np.split(one.points, one.begins[1:]) for one in (old, new))
    _, i, j = np.intersect1d(old.stamps[old.nodes], new.stamps[new.nodes], return_indices=True)
    pairs = [(there[a], here[b]) for a, b in zip(i, j, strict=True) if len(here[b])]
    alike = [len(a) == len(b) and bool((np.abs(a - b) < SAME).all()) for a, b in pairs]
    return bool(np.isin(new.stamps, old.stamps).all()) and 2 * sum(alike) > len(alike)


def _apart(estimate: Estimate, why: str) -> Estimate:
    text = f"the recording is not bound to the sessions before: {why}; the result is its own, in a frame of its own"
    return replace(estimate, warnings=(*estimate.warnings, Issue("session-apart", text)))
