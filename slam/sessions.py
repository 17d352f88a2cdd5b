"""Going on with a building: the place of a new session in it is found as by localisation, then loops bind the two."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.recording import Recording
from moteslam.robot.values import Issue, counted
from moteslam.slam.backend.building import Building
from moteslam.slam.backend.graph.binding import bind
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.config import SlamConfig
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.run import SlamSession
from moteslam.slam.scan_records import Update
from moteslam.slam.settings import resolve_config

Array = NDArray[np.float64]

LEAST_SURE = 2.0
"""Path over which localisation must be sure of a place [m]."""
TRIED = 3
"""Places, of the longest paths, that are tried."""


def expect_graph(config: SlamConfig) -> GraphConfig:
    """The back end's configuration, if it can bind sessions.

    Raises:
        ConfigError: it cannot.
    """
    if not isinstance(config.backend, GraphConfig):
        raise ConfigError(f'"{config.backend.method}", expected "graph" to bind sessions', field="backend.method")
    return config.backend


def go_on(
    estimate: Estimate,
    recording: Recording,
    building: Building,
    known_map: Path,
    *,
    watch: Callable[[Update], None] | None = None,
) -> Estimate:
    """The estimate of a recording bound to a building that was mapped before: in its frame, with the map of both.

    Where no loops prove that it belongs there it stays as it is, with a warning.

    Args:
        estimate: of the recording.
        recording: whose place is looked for.
        building: of the sessions before.
        known_map: the ``.yaml`` file of its map.
        watch: called after every scan of the localisation.
    """
    config, session = expect_graph(estimate.config), estimate.building
    if session is None:
        return _apart(estimate, "it has too few scans for a graph")
    places = _places(session, recording, estimate, known_map, watch)
    for node, pose in places:
        bound = bind(building, session, node, pose, config)
        if bound is None:
            continue
        final = bound.sessions[-1].trajectory
        drawn = bound.draw(estimate.config.map)
        return replace(estimate, trajectory_final=final, map=drawn, graph=bound.graph, building=bound)
    found = f"{counted(len(places), 'place')} where it may lie" if places else "no place where its scans fit for long"
    return _apart(estimate, f"there is {found} in the map, and not {counted(2, 'loop')} that bind it there")


def _apart(estimate: Estimate, why: str) -> Estimate:
    text = f"the recording is not bound to the sessions before: {why}; the result is its own, in a frame of its own"
    return replace(estimate, warnings=(*estimate.warnings, Issue("session-apart", text)))


def _places(
    session: Building,
    recording: Recording,
    estimate: Estimate,
    known_map: Path,
    watch: Callable[[Update], None] | None,
) -> list[tuple[int, Array]]:
    """Nodes of the session in the middle of paths over which localisation is sure, the longest first, and their poses.

    The poses are in the frame of the map.
    """
    config = resolve_config("localize", [f"known_map={json.dumps(str(known_map.absolute()))}"])
    config = config.model_copy(update={"sync": estimate.config.sync, "max_range": estimate.config.max_range})
    poses, sure = [], []
    for update in SlamSession(recording, config, seed=estimate.seed):
        poses.append(update.pose)
        sure.append(update.state is LocalisationState.SURE)
        if watch is not None:
            watch(update)
    path, known = np.array(poses), np.array(sure)
    driven = np.r_[0.0, np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))]
    (one,) = session.sessions
    found = []
    for stretch in np.split(np.arange(len(path)), np.flatnonzero(np.diff(known)) + 1):
        length = driven[stretch[-1]] - driven[stretch[0]]
        if known[stretch[0]] and length >= LEAST_SURE:
            scan = int(np.searchsorted(driven, driven[stretch[0]] + length / 2))
            node = int(np.abs(one.nodes - scan).argmin())
            off = se2.between(one.path[scan], one.path[one.nodes[node]])
            found.append((length, node, np.asarray(se2.compose(path[scan], off))))
    found.sort(key=lambda each: -each[0])
    return [(node, pose) for _, node, pose in found[:TRIED]]
