"""Localising a scan in one particle's TSDF: near the prediction, after a search, or in the relocation window."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.mapping.tsdf import TsdfView
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.registrar import Registration, register, subsample
from moteslam.slam.registration.search import Window, apart, candidates

Array = NDArray[np.float64]
Points = NDArray[np.float32]

APART = np.array([0.5, 0.5, 0.2])
"""Two places are farther apart than this in one component at least [m], [m], [rad]."""
RIVALS, RIVAL_SHARE = 4, 0.05
"""Rivals of the place where a scan is found, at most; the match score of one, less what its offset from the prediction
costs, is smaller by this share of the points at most."""
START = np.zeros((1, 3))
OPEN_HEADING = 0.5
"""A scan is searched for where the heading is known no better [rad]."""


class Rivals(NamedTuple):
    """Other places where a scan fits about as well as where it was found.

    Attributes:
        offsets: [m, 3] from there.
        scores: [m] match scores, less that of the place found [points].
        costs: [m] of the offsets from the prediction, less that of the place found [nats].
    """

    offsets: Array = np.zeros((0, 3))
    scores: Array = np.zeros(0)
    costs: Array = np.zeros(0)

    def log_odds(self, evidence_share: float) -> Array:
        """The log-odds [m] against the place found, 0 at most: it was chosen, if only by the match score.

        Args:
            evidence_share: share of the match score that counts as log-likelihood: neighbouring endpoints err alike.
        """
        return np.asarray(np.minimum(evidence_share * self.scores - self.costs, 0.0))


class Located(NamedTuple):
    """Where a scan was found.

    Attributes:
        found: the registration there.
        score: its match score [points].
        rivals: other places.
    """

    found: Registration
    score: float
    rivals: Rivals = Rivals()


class Localiser:
    """Finds a scan in the TSDF of one particle.

    Args:
        config: of search and relocation.
        registration: of each registration.
    """

    def __init__(self, config: TrackingConfig, registration: RegistrationConfig) -> None:
        self._config, self._registration = config, registration

    def locate(
        self,
        maps: TsdfView,
        predicted: Array,
        spread: Array,
        points: Points,
        origin: Array,
        predictions: Callable[[], Array],
    ) -> Located:
        """Where a scan fits: from the prediction, else after a search around it, at last in the relocation window.

        Args:
            maps: of one particle.
            predicted: [3] pose by the odometry.
            spread: [3] standard deviation of that.
            points: [k, 2] of the scan.
            origin: [2] where its rays start.
            predictions: of a search, gives other predictions [m, 3] to try beside what it finds, as offsets from
                ``predicted``.
        """
        c = self._config
        found = register(maps, predicted[None], spread, points, origin, START, self._registration, keep=True)
        sure = spread[0] <= c.basin_distance and spread[2] <= OPEN_HEADING
        near = sure and bool((abs(found.offsets[0]) <= c.accept_deviation * spread).all())
        score = float(match_score(found, c)[0])
        if near and found.likelihoods[0] >= c.accept_likelihood and not self.contradicts(score, len(points)):
            return Located(found, score)
        half = np.minimum(c.window * spread, (np.inf, np.inf, np.pi))
        window = Window(half, maps.config.cell_size, c.heading_step)
        most = c.max_starts if sure else c.retry_starts
        starts = int(np.clip(np.ceil(np.prod(window.half / c.basin)), c.min_starts, most))
        others = predictions()
        best = self._best(maps, predicted, spread, points, origin, window, starts, others)
        if best.found.likelihoods[0] < c.retry_likelihood:
            best = self._best(maps, predicted, spread, points, origin, window, c.retry_starts, others)
        if not self.contradicts(best.score, len(points)):
            return best
        half = np.array([c.relocation_distance, c.relocation_distance, c.relocation_rotation])
        window = Window(half, 2 * maps.config.cell_size, 2 * c.heading_step)
        wider = np.maximum(half / 2, spread)
        wide = self._best(maps, predicted, wider, points, origin, window, c.relocation_starts, others, keep=False)
        clearly = wide.score >= best.score + c.relocation_gain * len(points)
        return wide if clearly else best

    def contradicts(self, score: float, points: int) -> bool:
        """Whether a scan of this many points contradicts the map where it was found, by its match score there."""
        return score < self._config.lost_score * points

    def _best(
        self,
        maps: TsdfView,
        predicted: Array,
        spread: Array,
        points: Points,
        origin: Array,
        window: Window,
        most: int,
        predictions: Array,
        *,
        keep: bool = True,
    ) -> Located:
        """Registered from the most promising places of a window, the best of them."""
        c = self._config
        likely = candidates(maps, predicted, spread, points, window, most, c)
        starts = np.vstack((predictions, likely))
        means = np.vstack((predictions, np.zeros_like(likely)))
        some = subsample(points, c.start_points)
        many = np.repeat(predicted[None], len(starts), axis=0)
        tried = register(maps, many, spread, some, origin, starts, self._registration, means=means)
        off = np.square(tried.offsets / spread).sum(axis=1)
        cost = off / 2
        heavy = slice(len(predictions))
        cost[heavy] = heavy_tail(off[heavy], c)
        scores = match_score(tried, c) * len(points) / len(some)
        values = scores - cost
        best = [int(values.argmax())]
        start, mean = tried.offsets[best], means[best]
        found = register(
            maps,
            predicted[None],
            spread,
            points,
            origin,
            start,
            self._registration,
            means=mean,
            coarse=False,
            keep=keep,
        )
        order = np.argsort(-values, kind="stable")
        order = order[values[order] > values[best] - RIVAL_SHARE * len(points)]
        rivals = order[apart(tried.offsets[order], RIVALS + 1, APART)[1:]]
        offsets = np.asarray(se2.between(start, tried.offsets[rivals]))
        score = float(match_score(found, c)[0])
        return Located(found, score, Rivals(offsets, scores[rivals] - scores[best], cost[rivals] - cost[best]))


def match_score(found: Registration, config: TrackingConfig) -> Array:
    """The match score [N] in points: endpoints that match, less what contradicts the map."""
    c = config
    return found.known * (c.score_likelihood * found.likelihoods - c.score_known) - c.score_crossing * found.crossed


def heavy_tail(squares: Array, config: TrackingConfig) -> Array:
    """What offsets from the odometry cost [nats]: half their squares in standard deviations, with a heavy tail."""
    return np.asarray(config.prior_tail * np.log1p(squares / (2 * config.prior_tail)))
