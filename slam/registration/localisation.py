"""Localising a scan in one particle's TSDF: near the prediction, after a search, or in the relocation window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.mapping.tsdf import TsdfView
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.degeneracy import keep_odometry
from moteslam.slam.registration.registrar import Registration, register, subsample
from moteslam.slam.registration.search import Window, candidates

Array = NDArray[np.float64]
Points = NDArray[np.float32]


class Localiser:
    """Finds a scan in the TSDF of one particle.

    Args:
        config: of search and relocation.
        registration: of each registration.
    """

    def __init__(self, config: TrackingConfig, registration: RegistrationConfig) -> None:
        self._config, self._registration = config, registration

    def locate(
        self, maps: TsdfView, predicted: Array, spread: Array, points: Points, origin: Array, predictions: Array
    ) -> Registration:
        """Where a scan fits: from the prediction, else after a search around it, at last in the relocation window.

        Args:
            maps: of one particle.
            predicted: [3] pose by the odometry.
            spread: [3] standard deviation of that.
            points: [k, 2] of the scan.
            origin: [2] where its rays start.
            predictions: [m, 3] other predictions, as offsets from ``predicted``, tried beside what a search finds.
        """
        c = self._config
        found = register(maps, predicted[None], spread, points, origin, np.zeros((1, 3)), self._registration)
        found = keep_odometry(found, spread, self._registration)
        near = spread[0] <= c.basin_distance and bool((abs(found.offsets[0]) <= c.accept_deviation * spread).all())
        if near and found.likelihoods[0] >= c.accept_likelihood and not self.lost(found, len(points)):
            return found
        window = Window(c.window * spread, maps.config.cell_size, c.heading_step)
        starts = int(np.clip(np.ceil(np.prod(window.half / c.basin)), c.min_starts, c.max_starts))
        found = self._best(maps, predicted, spread, points, origin, window, starts, predictions)
        if found.likelihoods[0] < c.retry_likelihood:
            found = self._best(maps, predicted, spread, points, origin, window, c.retry_starts, predictions)
        found = keep_odometry(found, spread, self._registration)
        if not self.lost(found, len(points)):
            return found
        half = np.array([c.relocation_distance, c.relocation_distance, c.relocation_rotation])
        window = Window(half, 2 * maps.config.cell_size, 2 * c.heading_step)
        wider = np.maximum(half / 2, spread)
        wide = self._best(maps, predicted, wider, points, origin, window, c.relocation_starts, predictions)
        clearly = match_score(wide, c)[0] >= match_score(found, c)[0] + c.relocation_gain * len(points)
        return wide if clearly else found

    def lost(self, found: Registration, points: int) -> bool:
        """Whether a scan of this many points contradicts the map where it was found."""
        return bool(match_score(found, self._config)[0] < self._config.lost_score * points)

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
    ) -> Registration:
        """Registered from the most promising places of a window, the best of them."""
        c = self._config
        found = candidates(maps, predicted, spread, points, window, most, c)
        starts = np.vstack((predictions, found))
        means = np.vstack((predictions, np.zeros_like(found)))
        some = subsample(points, c.start_points)
        many = np.repeat(predicted[None], len(starts), axis=0)
        tried = register(maps, many, spread, some, origin, starts, self._registration, means=means)
        off = np.square(tried.offsets / spread).sum(axis=1)
        cost = off / 2
        heavy = slice(len(predictions))
        cost[heavy] = heavy_tail(off[heavy], c)
        best = [int((match_score(tried, c) * len(points) / len(some) - cost).argmax())]
        start, mean = tried.offsets[best], means[best]
        return register(
            maps, predicted[None], spread, points, origin, start, self._registration, means=mean, coarse=False
        )


def match_score(found: Registration, config: TrackingConfig) -> Array:
    """The match score [N] in points: endpoints that match, less what contradicts the map."""
    c = config
    return found.known * (c.score_likelihood * found.likelihoods - c.score_known) - c.score_crossing * found.crossed


def heavy_tail(squares: Array, config: TrackingConfig) -> Array:
    """What offsets from the odometry cost [nats]: half their squares in standard deviations, with a heavy tail."""
    return np.asarray(config.prior_tail * np.log1p(squares / (2 * config.prior_tail)))
