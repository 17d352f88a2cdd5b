"""Localising a scan in one particle's TSDF: near the prediction, after a search, or in the relocation window.

And when a registration may overrule the odometry: an offset of many standard deviations must be proved. Along what the
walls do not measure Gauss-Newton goes where errors of the map pull it, or where more of the map is known
(``docs/theory/default-filter.md``).
"""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.registration import RegistrationOptions
from moteslam.robot import se2
from moteslam.robot.se2 import Array, Pose
from moteslam.slam.inputs.lapses import CLOSED, Open
from moteslam.slam.mapping.config import APART, TsdfConfig
from moteslam.slam.mapping.tsdf import TsdfView
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.registrar import (
    Fitted,
    Points,
    Registration,
    Spread,
    bound,
    options_of,
    register,
    register_one,
    residual_variance,
    subsample,
)
from moteslam.slam.registration.search import LEAST_KNOWN, Window, apart, candidates

SLIP, AGAIN = 7.0, math.log(2)
"""Negative log-probability that wheels slip in one step: one in a thousand; in the next one, too: a half."""
NO_SLIP: Spread = (0.0, 0.0, 0.0)
CORRELATION = 10.0  # Neighbouring endpoints err alike: this many of them count as one, as in `backend.correlation`


def heavy_tail(squares: Array, config: TrackingConfig) -> Array:
    """What offsets from the odometry cost [nats]: half their squares in standard deviations, with a heavy tail."""
    return np.asarray(config.prior_tail * np.log1p(squares / (2 * config.prior_tail)))


def against(squares: Array, config: TrackingConfig) -> Array:
    """What speaks against offsets far from the odometry [nats], by their squares in standard deviations of it.

    Wheels slip seldom, and then by the odometry's heavy tail; or the odometry fails altogether, and the robot is at one
    of all the places of the relocation window that a registration can tell apart.
    """
    window = (config.relocation_distance, config.relocation_distance, config.relocation_rotation)
    places = max(float(np.prod(window / config.basin)), 1.0)
    return np.asarray(SLIP + np.minimum(heavy_tail(squares, config), np.log(places)))


def nats_for(found: Registration, held: Registration, points: int, unknown: float, correlation: float) -> Array:
    """The evidence [N] of a scan's endpoints for where it was found, against a place near the odometry [nats].

    The difference of the mean costs of the endpoints that each place knows, times the smaller number of them, counting
    as many as err independently. That a place knows more is no evidence for it, nor are rays through what was a surface
    evidence against one: doors open. But the place near the odometry counts as knowing ``LEAST_KNOWN`` of what the one
    found does: round a corner a heading that is wrong by 20 degrees puts nearly all endpoints behind walls, where
    nothing is known, and the few that are left would prove nothing however badly they fit.
    """

    def mean_cost(fit: Registration) -> Array:
        return np.asarray((fit.costs - unknown * (points - fit.known)) / np.maximum(fit.known, 1.0))

    known = np.minimum(np.maximum(held.known, LEAST_KNOWN * found.known), found.known)
    return np.asarray((mean_cost(held) - mean_cost(found)) * known / correlation)


def proved(
    found: Registration,
    maps: TsdfView,
    predicted: Array,
    spread: Array,
    points: Points,
    origin: Array,
    config: RegistrationConfig,
    tracking: TrackingConfig,
    slip: Spread = NO_SLIP,
) -> Registration:
    """What was found, and a registration held near the odometry where the endpoints do not prove what was found.

    Of N particles as ``register`` keeps the odometry along degenerate directions. One of more than ``config.gate``
    standard deviations must be more probable than ``against`` has it. After a ``slip``, which makes them wider by as
    much, another slip is as likely as none. Along a bare direction a proof is of a fit, not of a place.
    """
    far = (np.abs(found.free) > config.gate * spread).any(axis=1)
    if not far.any():
        return found
    here, tight = np.zeros_like(predicted), spread / config.gate
    held = register(maps, predicted, tight, points, origin, here, config, coarse=False, keep=True)
    evidence = nats_for(found, held, len(points), config.unknown_cost, CORRELATION)
    least = against(np.square(found.free / spread).sum(axis=1), tracking)
    if any(slip):
        wider = spread + slip
        again = AGAIN + np.log(wider / spread).sum() + np.square(found.free / wider).sum(axis=1) / 2
        least = np.minimum(least, again)
    wins = far & (evidence > least)
    if wins.any():
        found = found._replace(offsets=np.where(wins[:, None], bound(found, spread, config), found.offsets))
    return _chosen(far & ~wins, held, found)


def _chosen(which: NDArray[np.bool_], some: Registration, others: Registration) -> Registration:
    """Some of N where ``which`` [N], else others."""
    pairs = zip(some, others, strict=True)
    return Registration(*(np.where(which.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in pairs))


Numbers = TypeVar("Numbers", float, NDArray[np.float64])

RIVALS, RIVAL_SHARE = 4, 0.05
"""Rivals of the place where a scan is found, at most; the match score of one, less what its offset from the prediction
costs, is smaller by this share of the points at most."""
WIDE = 6.0  # Wider windows than this are searched in steps twice as long [m], as the relocation window is
OPEN_HEADING = 0.5  # A scan is searched for where the heading is known no better [rad]
OPEN_PLACE = 0.5
"""A lapse of the odometry that leaves more open [m], or more than that of the heading, is undecided until a scan is
found in the map."""
DECIDED = 4.6  # It is found at a place a hundred times as probable as others, and as none in the map [nats]
BENT = 0.03  # Deviation of an endpoint's distance to surfaces of a map that bends a little, of any lidar [m]


class Rivals(NamedTuple):
    """Other places where a scan fits about as well as where it was found."""

    offsets: Array = np.zeros((0, 3))  # [m, 3] from there
    scores: Array = np.zeros(0)  # [m] match scores, less that of the place found [points]
    costs: Array = np.zeros(0)  # [m] of the offsets from the prediction, less that of the place found [nats]

    def log_odds(self, evidence_share: float) -> Array:
        """The log-odds [m] against the place found, 0 at most: it was chosen, if only by the match score.

        Of that a share counts as log-likelihood: neighbouring endpoints err alike.
        """
        return np.asarray(np.minimum(evidence_share * self.scores - self.costs, 0.0))


class Located(NamedTuple):
    fitted: Fitted  # the registration there
    score: float  # its match score [points]
    rivals: Rivals = Rivals()  # other places
    decided: bool = True  # whether the scan says where the robot is, after a lapse of the odometry; true of all others


class _Sought(NamedTuple):
    """A scan that is searched for, as arrays."""

    maps: TsdfView  # this and the next four as of ``Localiser.locate``
    predicted: Array
    spread: Array
    points: Points
    origin: Array
    predictions: Array  # [m, 3] other predictions to try, as offsets from `predicted`
    left: Open = CLOSED  # open by a lapse of the odometry
    slip: Spread = NO_SLIP  # by how much the spread is wider than usual

    @property
    def open(self) -> bool:
        """Whether a lapse of the odometry leaves open where the robot is."""
        return self.left.place > OPEN_PLACE or self.left.heading > OPEN_HEADING

    def log_odds(
        self, tried: Registration, points: int, config: TrackingConfig, costs: RegistrationConfig
    ) -> tuple[Array, Array]:
        """Of places [m] after a lapse of the odometry, against one that is not in the map [nats].

        Either the robot did not turn aside on the way, or it did, with equal odds. All places of a standard deviation
        that registration can tell apart share its probability.

        Returns them, and the same as if each place knew no more endpoints than that of the likely ones which knows
        fewest: that one knows more is no evidence against another, but for one that knows less than ``LEAST_KNOWN``.
        """
        share = len(self.points) / points / CORRELATION
        known = (costs.unknown_cost * points - tried.costs) * share
        aside = np.hypot(tried.offsets[:, 0], tried.offsets[:, 1])
        place, arc = self.left.place, max(self.left.arc, config.basin_distance)
        turned = np.square(aside / place) + 4 * np.log(max(place / arc, 1.0))
        off = np.minimum(np.square(aside / arc), turned) + np.square(tried.offsets[:, 2] / self.spread[2])
        places = np.log(np.maximum(np.array((arc, arc, self.spread[2])) / config.basin, 1.0)).sum()
        odds = np.asarray(known - costs.outlier_cost * tried.crossed * share - off / 2 - places)
        likely = odds > DECIDED
        if not likely.any():
            return odds, odds
        fewest = max(tried.known[likely].min(), LEAST_KNOWN * tried.known[likely].max())
        return odds, np.where(likely, odds - known * (1 - np.minimum(fewest / np.maximum(tried.known, 1), 1)), -np.inf)


class Localiser:
    """Finds a scan in the TSDF of one particle."""

    def __init__(self, config: TrackingConfig, registration: RegistrationConfig) -> None:
        self._config, self._registration = config, registration
        self._options: tuple[TsdfConfig, RegistrationOptions] | None = None  # of the maps of before

    def locate(
        self,
        maps: TsdfView,
        predicted: Pose,
        spread: Spread,
        points: Points,
        origin: tuple[float, float],
        predictions: Callable[[], Array],
        *,
        measured: bool,
        blind: float,
        left: Open = CLOSED,
        slip: Spread = NO_SLIP,
    ) -> Located:
        """Where a scan of points [k, 2], whose rays start at an origin [m], fits: from the prediction, else after a
        search around it, at last in the relocation window.

        Args:
            predictions: of a search, gives others [m, 3] to try beside what it finds, as offsets from ``predicted``.
            measured: whether odometry measured the prediction: then only the endpoints' evidence overrules it.
            slip: by how much ``spread`` is wider than usual, to be searched with, after a slip.
            blind: since the last scan that was registered [s].
        """
        c = self._config
        if self._options is None or self._options[0] is not maps.config:  # made once for all scans
            self._options = maps.config, options_of(maps.config, self._registration)
        fitted = register_one(maps, predicted, spread, points, origin, self._registration, self._options[1])
        usual, (forward, _, turn) = (spread[0] - slip[0], spread[1] - slip[1], spread[2] - slip[2]), spread
        sure = forward <= c.basin_distance and turn <= OPEN_HEADING
        near = sure and _within(c.accept_deviation, fitted.offset, spread)
        score = match_score(fitted.known, fitted.likelihood, fitted.crossed, c)
        known = measured and usual[0] <= c.basin_distance and usual[2] <= OPEN_HEADING
        accepted = near and fitted.likelihood >= c.accept_likelihood and not self.contradicts(score, len(points))
        if accepted and (not known or _within(self._registration.gate, fitted.free, usual)):
            return Located(fitted, score)
        none = np.zeros((0, 3))
        sought = _Sought(maps, np.array(predicted), np.array(spread), points, np.array(origin), none, left, slip)
        if accepted:
            return self._proved(sought, Located(fitted, score))
        sought = sought._replace(predictions=predictions())
        return self._search(sought, sure=sure, measured=known, relocate=blind >= c.relocation_after)

    def _proved(self, sought: _Sought, located: Located) -> Located:
        """Where a scan was found, or near the odometry where its endpoints do not prove that."""
        found = Registration.one(located.fitted)
        here, usual, c = sought.predicted[None], sought.spread - sought.slip, self._config
        of_scan = sought.points, sought.origin, self._registration, c, sought.slip
        kept = proved(found, sought.maps, here, usual, *of_scan)
        fitted = kept.of(0)
        if fitted.free == located.fitted.free:
            return located._replace(fitted=fitted)
        return Located(fitted, match_score(fitted.known, fitted.likelihood, fitted.crossed, c))

    def _search(self, sought: _Sought, *, sure: bool, measured: bool, relocate: bool) -> Located:
        """Where a scan fits, after a search around the prediction, at last in the relocation window."""
        c, spread, points, cell = self._config, sought.spread, len(sought.points), sought.maps.config.cell_size
        half = np.minimum(c.window * spread, (*(sought.maps.reach(sought.predicted),) * 2, np.pi))
        finer = 1 if half.max() <= WIDE else 2
        window = Window(half, finer * cell, finer * c.heading_step)
        largest = c.max_starts if sure else c.retry_starts
        starts = int(np.clip(np.ceil(np.prod(window.half / c.basin)), c.min_starts, largest))
        best = self._best(sought, window, starts)
        if sought.open:
            return best
        if best.fitted.likelihood < c.retry_likelihood:
            best = self._best(sought, window, c.retry_starts)
        if not (relocate and self.contradicts(best.score, points)):
            return self._proved(sought, best) if measured else best
        half = np.array([c.relocation_distance, c.relocation_distance, c.relocation_rotation])
        window = Window(half, 2 * cell, 2 * c.heading_step)
        wider = sought._replace(spread=np.maximum(half / 2, spread))
        wide = self._best(wider, window, c.relocation_starts, keep=False)
        if wide.score < best.score + c.relocation_gain * points:
            return best
        return self._proved(sought, wide) if measured else wide

    def contradicts(self, score: float, points: int) -> bool:
        """Whether a scan of this many points contradicts the map where it was found, by its match score there."""
        return score < self._config.lost_score * points

    def _best(self, sought: _Sought, window: Window, most: int, *, keep: bool = True) -> Located:
        """Registered from the most promising places of a window, the best of them."""
        c, costs = self._config, self._registration
        if sought.open:
            costs = _of_noise(costs, BENT)
        maps, predicted, spread, points, origin, predictions, *_ = sought
        likely = candidates(maps, predicted, spread, points, window, most, c)
        starts = np.vstack((predictions, likely))
        means = np.vstack((predictions, np.zeros_like(likely)))
        some = subsample(points, c.start_points)
        many = np.repeat(predicted[None], len(starts), axis=0)
        tried = register(maps, many, spread, some, origin, starts, costs, means=means)
        off = np.square(tried.offsets / spread).sum(axis=1)
        cost = off / 2
        cost[: len(predictions)] = heavy_tail(off[: len(predictions)], c)
        matched = match_score(tried.known, tried.likelihoods, tried.crossed, c)
        scores = matched * len(points) / len(some)
        values = odds = scores - cost
        away = (np.abs(tried.offsets - means) > window.half + c.basin).any(axis=1)
        if not away.all():  # a registration that leaves the window has found nothing
            values = odds = np.where(away, -np.inf, values)
        if sought.open:
            odds, values = sought.log_odds(tried, len(some), c, costs)
        best = [int(values.argmax())]
        start, mean = tried.offsets[best], means[best]
        here = predicted[None]
        found = register(
            maps, here, spread, points, origin, start, self._registration, means=mean, coarse=False, keep=keep
        )
        order = np.argsort(-values, kind="stable")
        order = order[values[order] > values[best] - RIVAL_SHARE * len(points)]
        rivals = order[apart(tried.offsets[order], RIVALS + 1, APART)[1:]]
        offsets = se2.between(start, tried.offsets[rivals])
        fitted = found.of(0)
        score = match_score(fitted.known, fitted.likelihood, fitted.crossed, c)
        if sought.open:
            deviation = self._registration.residual * residual_variance(fitted.likelihood, self._registration) ** 0.5
            costs = _of_noise(self._registration, min(deviation, BENT))
            tried = register(maps, many, spread, some, origin, tried.offsets, costs, means=means)
            odds, _ = sought.log_odds(tried, len(some), c, costs)
            again = register(maps, here, spread, points, origin, found.offsets, costs, means=mean, coarse=False)
            here_odds = float(sought.log_odds(again, len(points), c, costs)[0][0])
            elsewhere = (np.abs(se2.between(start, tried.offsets)) >= APART).any(axis=1)
            if here_odds <= 0:  # likelier not in the map
                fitted = fitted._replace(offset=(0.0, 0.0, 0.0), free=(0.0, 0.0, 0.0))
            return Located(fitted, score, decided=here_odds - odds[elsewhere].max(initial=0.0) > DECIDED)
        return Located(fitted, score, Rivals(offsets, scores[rivals] - scores[best], cost[rivals] - cost[best]))


def _of_noise(config: RegistrationConfig, deviation: float) -> RegistrationConfig:
    """Costs by endpoints that deviate so much from the surfaces [m], where that is more than ``residual``.

    Else a scan of a noisy lidar would fit no place better than one not in the map. The endpoints' density about a
    surface is lower by as much as it is wider: by so much less does the unknown cost.
    """
    wider = max(deviation / config.residual, 1.0)
    unknown = max(config.unknown_cost - float(np.log(wider)), 0.0)
    return config.model_copy(update={"residual": config.residual * wider, "unknown_cost": unknown})


def _within(most: float, offset: Pose, spread: Spread) -> bool:
    """Whether an offset is within ``most`` standard deviations in each component."""
    (x, y, theta), (along, across, about) = offset, spread
    return abs(x) <= most * along and abs(y) <= most * across and abs(theta) <= most * about


def match_score(known: Numbers, likelihood: Numbers, crossed: Numbers, config: TrackingConfig) -> Numbers:
    """The match score in points, of one scan or of many: endpoints that match, less what contradicts the map."""
    return known * (config.score_likelihood * likelihood - config.score_known) - config.score_crossing * crossed
