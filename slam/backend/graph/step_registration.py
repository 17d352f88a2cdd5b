"""Registering each node to a local TSDF of the latest ones.

Registration to the particle's whole map would hold the loops already, right or wrong. A registration overrules the
odometry by many standard deviations only where the evidence allows: see ``against``.
"""

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
from moteslam.slam.registration.localisation import against, heavy_tail, match_score, nats_for
from moteslam.slam.registration.registrar import (
    Registration,
    less_where_unbound,
    measured_information,
    register,
    subsample,
)

AGREEING = 5.0  # Odometry so many standard deviations from a registration, or from the filter, contradicts it
GATE = 4.0  # An offset of more standard deviations of the odometry must be proved
SCORES = TrackingConfig()  # Match score and heavy tail are those of tracking
LOOSE, LOOSEST = 3.0, 0.01
"""With the corrected odometry the registration searches within this many of its standard deviations, and the second at
least [m], [rad]: what is found farther off must be proved."""
BASIN = 0.2
"""Registrations begin at headings this far apart [rad], as far as they are searched for: from twice as far off
Gauss-Newton may end at a place that explains a few of the endpoints."""
MOST_NATS = 50.0  # Certainty enough [nats]; the exponential of more overflows
DOUBT = 4.0  # Nats by which evidence and prior may be misjudged: the logistic scale of the doubt that is left


class Prediction(NamedTuple):
    """What is known of a step before it is registered."""

    step: Array  # [3] by the odometry
    spread: Array  # [3] standard deviations
    measured: bool  # whether odometry measured it; else it may be overruled without proof
    filtered: Array  # [3] as the filter estimates it: it is tried, too
    open: bool = False  # the odometry leaves several places open, of which the filter has chosen one
    late: bool = False  # the odometry's pose came late: either it or the filter, which it contradicts, is right

    @property
    def contradicted(self) -> bool:
        """Whether the filter contradicts the odometry."""
        return self.measured and bool((np.abs(se2.between(self.step, self.filtered)) >= AGREEING * self.spread).any())


class RegisteredStep(NamedTuple):
    """A step [3], its information [3, 3], and [3] how far off it may be if the evidence was misjudged."""

    step: Array
    information: Array
    doubt: Array
    by_filter: bool = False  # found where the filter has it, which contradicts the odometry


class StepRegistration:
    """Registers nodes one after the other, each to the TSDF of the latest ones before it.

    Rays start at an origin [2] in the robot's frame. With ``proved`` the odometry is overruled by proof alone.
    """

    def __init__(self, scan: ThinnedScan, origin: Array, config: GraphConfig, *, proved: bool) -> None:
        self._origin, self._config, self._proved = origin, config, proved
        self._pose = np.zeros(3)
        # two TSDFs of the latest nodes that overlap by half: one to register to, one that will follow it; with the path
        # and the nodes before each began
        self._maps: list[tuple[TsdfMaps, float, int]] = []
        self._length, self._count = 0.0, 0
        self._integrate(scan)

    def add(self, scan: ThinnedScan, predicted: Prediction) -> RegisteredStep:
        """Register the next node's scan, and integrate it."""
        points = subsample(scan.points, self._config.chain.max_points)
        found = RegisteredStep(predicted.step, np.zeros((3, 3)), np.zeros(3))
        if len(points) >= FEW_POINTS and not predicted.open:
            found = self._registered(points, predicted)
        self._pose = se2.compose(self._pose, found.step)
        self._length += float(np.hypot(*found.step[:2]))
        self._integrate(scan)
        return found

    def _registered(self, points: NDArray[np.float32], predicted: Prediction) -> RegisteredStep:
        """From the odometry's prediction, turned too, and the filter's, and where need be held near the odometry's.

        Of a step whose pose came late the scan decides between both; by the filter's it needs no other proof.
        """
        c, spread, doubt = self._config, predicted.spread, np.zeros(3)
        maps, at = self._maps[0][0].of(0), se2.compose(self._pose, predicted.step)
        loose = np.maximum(LOOSE * spread, LOOSEST) if self._proved else spread
        steps = int(min(float(loose[2]), np.pi) / BASIN) if predicted.measured else 0  # else the filter has searched
        headings = BASIN * np.arange(-steps, steps + 1)
        turned = np.column_stack((np.zeros((len(headings), 2)), headings))
        starts = np.vstack((turned, se2.between(predicted.step, predicted.filtered)))
        all_at, means = np.repeat(at[None], len(starts), axis=0), np.zeros_like(starts)
        means[-1] = predicted.late * starts[-1]
        found = register(maps, all_at, loose, points, self._origin, starts, c.registration, means=means, keep=True)
        off = np.square((found.offsets - means) / loose).sum(axis=1)
        matches = match_score(found.known, found.likelihoods, found.crossed, SCORES) - heavy_tail(off, SCORES)
        best = int(matches.argmax())
        by_filter = predicted.late and best == len(starts) - 1
        if self._proved and predicted.measured and not by_filter and _far(found, spread)[best]:
            held = register(maps, all_at, spread, points, self._origin, starts, c.registration, coarse=False, keep=True)
            near = _nearest(held, spread, len(points), c)
            fits = found.at(best), held.at(near)
            evidence = float(nats_for(*fits, len(points), c.registration.unknown_cost, c.correlation)[0])
            # by how many nats the one far from the odometry is more probable than the one held near it
            nats = evidence - float(against(np.square(found.offsets[best] / spread).sum(), SCORES))
            belief = 1 / (1 + np.exp(-np.clip(nats / DOUBT, -MOST_NATS, MOST_NATS)))
            doubt = np.sqrt(belief * (1 - belief)) * found.offsets[best]
            if nats < 0:
                found, best = held, near
        step = se2.compose(predicted.step, found.offsets[best])
        information = measured_information(found, best, c.registration, c.correlation)
        return RegisteredStep(step, less_where_unbound(information, found, best, c.registration), doubt, by_filter)

    def _integrate(self, scan: ThinnedScan) -> None:
        """Integrate the latest node's scan."""
        if not self._maps or self._full(self._maps[-1], 0.5):
            self._maps.append((TsdfMaps(self._config.tsdf), self._length, self._count))
        if len(self._maps) > 1 and self._full(self._maps[0], 1.0):
            del self._maps[0]
        self._count += 1
        for maps, _, _ in self._maps:
            maps.integrate(self._pose[None], scan)

    def _full(self, maps: tuple[TsdfMaps, float, int], share: float) -> bool:
        """Whether a map covers this share of the path, or of the nodes, that one covers at most."""
        c = self._config.chain
        return self._length - maps[1] >= share * c.length or self._count - maps[2] >= share * c.nodes


def _far(found: Registration, spread: Array) -> NDArray[np.bool_]:
    """Which registrations [N] must be proved, being so far from the odometry."""
    return np.asarray(np.square(found.offsets / spread).sum(axis=1) > GATE**2)


def _nearest(held: Registration, spread: Array, points: int, config: GraphConfig) -> int:
    """The more probable one of those that need no proof; the one nearest to the odometry if all need it.

    That it knows more of the endpoints than the nearest one is no evidence: see ``nats_for``.
    """
    off = np.square(held.offsets / spread).sum(axis=1)
    nearest = int(off.argmin())
    evidence = nats_for(held, held.at(nearest), points, config.registration.unknown_cost, config.correlation)
    near = ~_far(held, spread)
    return int(np.where(near, evidence - heavy_tail(off, SCORES), -np.inf).argmax()) if near.any() else nearest
