"""Registering each node to a local TSDF of the latest ones.

Registration to the particle's whole map would hold the loops already, right or wrong.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.nodes import FEW_POINTS
from moteslam.slam.mapping.tsdf import TsdfMaps
from moteslam.slam.registration.config import TrackingConfig
from moteslam.slam.registration.evidence import heavy_tail
from moteslam.slam.registration.information import less_where_unbound, measured_information
from moteslam.slam.registration.localisation import match_score
from moteslam.slam.registration.registrar import register, subsample

SCORES = TrackingConfig()  # Match score and heavy tail are those of tracking
BASIN, TURNED = 0.2, 3.0
"""Registrations begin at headings this far apart [rad], up to so many standard deviations of the odometry's: from twice
as far off Gauss-Newton may end at a place that explains a few of the endpoints."""


class Prediction(NamedTuple):
    """What is known of a step before it is registered."""

    step: Array  # [3] by the odometry
    spread: Array  # [3] standard deviations
    measured: bool  # whether odometry measured it; else it may be overruled without proof
    filtered: Array  # [3] as the filter estimates it: it is tried, too
    open: bool = False  # the odometry leaves several places open, of which the filter has chosen one


class RegisteredStep(NamedTuple):
    """A step [3] and its information [3, 3]."""

    step: Array
    information: Array


class StepRegistration:
    """Registers nodes one after the other, each to the TSDF of the latest ones before it.

    ``scan``: of the first node; origin: [2] where its rays start, in the robot's frame.
    """

    def __init__(self, scan: ThinnedScan, origin: Array, config: GraphConfig) -> None:
        self._origin, self._config = origin, config
        self._pose = np.zeros(3)
        self._local = _LocalMaps(config)
        self._local.add(self._pose, scan, 0.0)

    def add(self, scan: ThinnedScan, predicted: Prediction) -> RegisteredStep:
        """Register the next node's scan, and integrate it."""
        points = subsample(scan.points, self._config.chain.max_points)
        found = RegisteredStep(predicted.step, np.zeros((3, 3)))
        if len(points) >= FEW_POINTS and not predicted.open:
            found = self._registered(points, predicted)
        self._pose = se2.compose(self._pose, found.step)
        self._local.add(self._pose, scan, float(np.hypot(*found.step[:2])))
        return found

    def _registered(self, points: NDArray[np.float32], predicted: Prediction) -> RegisteredStep:
        """From the odometry's prediction, turned too, and the filter's."""
        c, spread = self._config, predicted.spread
        maps, at = self._local.current.of(0), se2.compose(self._pose, predicted.step)
        steps = 0  # of a step that was not measured the filter has searched
        if predicted.measured:
            steps = int(min(TURNED * float(spread[2]), np.pi) / BASIN)
        headings = BASIN * np.arange(-steps, steps + 1)
        turned = np.column_stack((np.zeros((len(headings), 2)), headings))
        starts = np.vstack((turned, se2.between(predicted.step, predicted.filtered)))
        all_at = np.repeat(at[None], len(starts), axis=0)
        found = register(maps, all_at, spread, points, self._origin, starts, c.registration, keep=True)
        off = np.square(found.offsets / spread).sum(axis=1)
        matches = match_score(found.known, found.likelihoods, found.crossed, SCORES) - heavy_tail(off, SCORES)
        best = int(matches.argmax())
        step = se2.compose(predicted.step, found.offsets[best])
        information = measured_information(found, best, c.registration, c.correlation)
        return RegisteredStep(step, less_where_unbound(information, found, best, c.registration))


class _LocalMaps:
    """Two TSDFs of the latest nodes that overlap by half: one to register to, one that will follow it."""

    def __init__(self, config: GraphConfig) -> None:
        self._config = config
        self._maps: list[tuple[TsdfMaps, float, int]] = []  # with the path and the nodes before each began
        self._length, self._count = 0.0, 0

    @property
    def current(self) -> TsdfMaps:
        """The older one."""
        return self._maps[0][0]

    def add(self, pose: Array, scan: ThinnedScan, driven: float) -> None:
        """Integrate a node's scan, ``driven`` [m] after the node before."""
        self._length += driven
        if not self._maps or self._full(self._maps[-1], 0.5):
            self._maps.append((TsdfMaps(self._config.tsdf), self._length, self._count))
        if len(self._maps) > 1 and self._full(self._maps[0], 1.0):
            del self._maps[0]
        self._count += 1
        for maps, _, _ in self._maps:
            maps.integrate(pose[None], scan)

    def _full(self, maps: tuple[TsdfMaps, float, int], share: float) -> bool:
        """Whether a map covers this share of the path, or of the nodes, that one covers at most."""
        c = self._config.chain
        return self._length - maps[1] >= share * c.length or self._count - maps[2] >= share * c.nodes
