"""The chain: each node registered to a local TSDF of the latest ones, and what that and the odometry say together.

Registration to the particle's whole map would hold the loops already, right or wrong. A registration overrules the
odometry by many standard deviations only where the evidence allows: see ``_overrules``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.thinning import ThinnedScan
from moteslam.robot import se2
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.nodes import Nodes
from moteslam.slam.backend.graph.odometry_model import OdometryModel, fit_odometry
from moteslam.slam.mapping.tsdf import TsdfMaps
from moteslam.slam.registration.degeneracy import keep_odometry
from moteslam.slam.registration.information import measured_information
from moteslam.slam.registration.registrar import Registration, prior_spread, register, subsample

Array = NDArray[np.float64]

FLOOR = np.array([0.003, 0.003, np.radians(0.05)])
"""No step is known better [m], [rad]: the standard deviation of what the TSDF's cells resolve."""
GATE = 6.0
"""An offset of more standard deviations of the odometry must be proved."""
TAIL = 3.0
"""The odometry's tails are heavier than the normal distribution's beyond this many nats."""
SLIP = 7.0
"""Negative log-probability that the wheels slip in one step: one in a thousand."""
DOUBT = 4.0
"""Nats by which evidence and prior may be misjudged: the logistic scale of the doubt that is left."""
AGREEING = 5.0
"""Odometry farther off than this many standard deviations is left out of a step."""
LEAST_INFORMATION = 1e-2
"""Of a step that was not registered [1/m^2]."""
FEW_POINTS = 20
"""A scan of fewer points is not registered."""


@dataclass(frozen=True, eq=False)
class Chain:
    """The steps between n nodes.

    Attributes:
        poses: [n, 3] that follow from them, from the first pose on.
        steps: [n - 1, 3] in the frames where they begin.
        covariance: [n - 1, 3, 3] of them, in the frames where they end.
        odometry: the corrected odometry of the same steps.
        filtered: [n - 1, 3] the filter's steps.
        excess: [n - 1, 3, 3] information of these that the nodes' own scans do not have: of the key scans between.
    """

    poses: Array
    steps: Array
    covariance: Array
    odometry: OdometryModel
    filtered: Array
    excess: Array


def build_chain(nodes: Nodes, path: Array, config: GraphConfig) -> Chain:
    """Register the nodes twice: with the recorded odometry, to learn its errors, then with the corrected one.

    Args:
        nodes: n of them.
        path: [n, 3] the filter's poses of them: its steps are tried, too.
        config: of the back end.
    """
    n = len(nodes)
    # what nothing measured is taken from the filter, loosely
    unmeasured = ~nodes.measured[1:]
    raw = np.where(unmeasured[:, None], se2.between(path[:-1], path[1:]), nodes.odometry[1:])
    spread = np.array(
        [
            prior_spread(config.registration, float(np.hypot(*step[:2])), abs(float(step[2])), measured=bool(measured))
            for step, measured in zip(raw, nodes.measured[1:], strict=True)
        ]
    ).reshape(-1, 3)
    first = _Registered.empty(n)
    _run(first, nodes, path, OdometryModel(raw, spread), config, proved=False)
    model = fit_odometry(raw, first.steps, np.asarray(np.linalg.inv(first.information + LEAST_INFORMATION * np.eye(3))))
    # the corrections are those of the odometry
    model.steps[unmeasured], model.spread[unmeasured] = raw[unmeasured], spread[unmeasured]
    second = _Registered.empty(n)
    _run(second, nodes, path, model, config, proved=True)
    return _fused(second, nodes, path, model)


@dataclass(eq=False)
class _Registered:
    """Steps [n - 1, 3] by registration, their information, and [n - 1, 3] how far off they may be if misjudged."""

    steps: Array
    information: Array
    doubt: Array

    @classmethod
    def empty(cls, n: int) -> _Registered:
        return cls(np.zeros((n - 1, 3)), np.zeros((n - 1, 3, 3)), np.zeros((n - 1, 3)))


def _run(
    result: _Registered, nodes: Nodes, path: Array, odometry: OdometryModel, config: GraphConfig, *, proved: bool
) -> None:
    """Register every node to the local TSDF, into ``result``; with ``proved`` overrule the odometry by proof alone."""
    poses = np.zeros((len(nodes), 3))
    local = _LocalMaps(config)
    local.add(poses[0], nodes.scans[0], 0.0)
    filtered = np.asarray(se2.between(path[:-1], path[1:]))
    for k in range(1, len(nodes)):
        predicted = odometry.steps[k - 1]
        points = subsample(nodes.scans[k].points, config.chain.max_points)
        result.steps[k - 1] = predicted
        if len(points) >= FEW_POINTS:
            maps, at = local.current.of(0), np.asarray(se2.compose(poses[k - 1], predicted))
            spread = odometry.spread[k - 1]
            loose = np.maximum(3 * spread, 0.01) if proved else spread
            starts = np.stack((np.zeros(3), np.asarray(se2.between(predicted, filtered[k - 1]))))
            both = np.repeat(at[None], 2, axis=0)
            found = register(maps, both, loose, points, nodes.origin, starts, config.registration)
            found = keep_odometry(found, loose, config.registration)
            best = _better(found, loose)
            if proved and nodes.measured[k] and (np.abs(found.offsets[best]) > GATE * spread).any():
                held = register(
                    maps, at[None], spread, points, nodes.origin, np.zeros((1, 3)), config.registration,
                    coarse=False,
                )  # fmt: skip
                held = keep_odometry(held, spread, config.registration)
                nats = _overrules(found, best, held, len(points), spread, config)
                belief = 1 / (1 + np.exp(-np.clip(nats / DOUBT, -50, 50)))
                result.doubt[k - 1] = np.sqrt(belief * (1 - belief)) * found.offsets[best]
                if nats < 0:
                    found, best = held, 0
            result.steps[k - 1] = se2.compose(predicted, found.offsets[best])
            result.information[k - 1] = measured_information(found, best, config.registration, config.correlation)
        poses[k] = se2.compose(poses[k - 1], result.steps[k - 1])
        local.add(poses[k], nodes.scans[k], float(np.hypot(*result.steps[k - 1, :2])))


class _LocalMaps:
    """Two TSDFs of the latest nodes that overlap by half: one to register to, one that will follow it.

    Args:
        config: of the back end.
    """

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


def _better(found: Registration, spread: Array) -> int:
    """Which registration has the better match, less what its offset costs by the odometry."""
    match = found.known * (1.5 * found.likelihoods - 0.3) - 0.3 * found.crossed
    off = np.square(found.offsets / spread).sum(axis=1)
    return int((match - TAIL * np.log1p(off / (2 * TAIL))).argmax())


def _overrules(
    found: Registration, best: int, held: Registration, points: int, spread: Array, config: GraphConfig
) -> float:
    """By how many nats a registration far from the odometry is more probable than the one held near it.

    The evidence is the difference of the mean costs of the endpoints that each place knows, times the smaller number of
    them, counting as many as err independently. That a place knows more is no evidence for it, nor are rays through
    what was a surface evidence against one: doors open. Against the evidence stand the odometry's heavy tail and how
    seldom wheels slip.
    """
    unknown = config.registration.unknown_cost

    def mean_cost(fit: Registration, which: int) -> float:
        known = float(fit.known[which])
        return (float(fit.costs[which]) - unknown * (points - known)) / max(known, 1.0)

    both = min(float(held.known[0]), float(found.known[best]))
    evidence = (mean_cost(held, 0) - mean_cost(found, best)) * both / config.correlation
    off = float(np.square(found.offsets[best] / spread).sum())
    return evidence - TAIL * float(np.log1p(off / (2 * TAIL))) - SLIP


def _fused(registered: _Registered, nodes: Nodes, path: Array, odometry: OdometryModel) -> Chain:
    """Registration, odometry and the filter's steps together, weighted by their information.

    Between two nodes of a dense recording the filter has registered the key scans between them, too: its step knows as
    many times what one registration does. Where it contradicts the registration, it may have closed a loop.
    """
    off = np.asarray(se2.between(registered.steps, odometry.steps))
    off[:, 2] = se2.wrap(off[:, 2])
    weights = 1 / np.square(odometry.spread)
    covariance = np.linalg.inv(registered.information + weights[:, :, None] * np.eye(3))
    # where the registration overruled the odometry this says nothing
    weights = np.where(np.abs(off) < AGREEING * odometry.spread, weights, 0.0)
    steps = np.asarray(se2.compose(registered.steps, np.einsum("nij,nj->ni", covariance, weights * off)))
    filtered = np.asarray(se2.between(path[:-1], path[1:]))
    off = np.asarray(se2.between(steps, filtered))
    off[:, 2] = se2.wrap(off[:, 2])
    precision = np.linalg.inv(covariance + np.diag(np.square(FLOOR)))
    agree = np.einsum("ni,nij,nj->n", off, precision, off) < AGREEING**2
    excess = (agree * (np.diff(nodes.updates) - 1))[:, None, None] * registered.information
    covariance = np.linalg.inv(np.linalg.inv(covariance) + excess)
    steps = np.asarray(se2.compose(steps, np.einsum("nij,njk,nk->ni", covariance, excess, off)))
    doubt = registered.doubt
    covariance = covariance + np.diag(np.square(FLOOR)) + doubt[:, :, None] * doubt[:, None, :]
    poses = np.vstack((path[0], se2.accumulate(steps, path[0])))
    return Chain(poses, steps, covariance, odometry, filtered, excess)
