"""Registering scans to signed-distance maps: from the odometry's prediction, or in a wide window when that is lost."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.correlative import MAX_SEARCH_POINTS
from moteslam.kernels.registration import COST, CROSSED, FITS, INFORMATION, KNOWN, LIKELIHOOD
from moteslam.slam.motion_model import odometry_spread
from moteslam.slam.surface_config import ProposalConfig, RegistrationConfig
from moteslam.slam.surface_maps import MapView

Array = NDArray[np.float64]
Points = NDArray[np.float32]
TURN = 0.02
"""Between the headings that are searched [rad]."""
SOME = 90
"""Endpoints that are registered from every promising place."""
CROSSING = 0.3
"""What a ray through a surface counts against a place, in endpoints: doors open, people walk, gaps get closed."""
FAR = 6
"""Standard deviations of the odometry beyond which a scan found at the first try is looked for all the same."""
TAIL = 3.0
"""How heavy the tails of what odometry is off by are: less than the normal distribution's beyond so many nats."""
REACH = np.array([0.2, 0.2, 0.06])
"""How far from where it starts Gauss-Newton finds a place [m], [m], [rad]."""
SYMMETRIC = np.arange(FITS)[INFORMATION][[0, 1, 2, 1, 3, 4, 2, 4, 5]]
"""Where in a row of fits the elements of the whole information matrix are."""
BLOCK = 10
"""Shifts along an edge of the blocks whose best one is kept."""
WHOLE = np.eye(3)[None]
"""Of what a scan says of a place: all of it."""


class Registration(NamedTuple):
    """Where scans were found, for each of N particles.

    Attributes:
        offsets: [N, 3] from the predicted pose, in its frame.
        information: [N, 3, 3] of the endpoints about them.
        costs: [N] negative log-likelihood of the endpoints.
        known: [N] endpoints where the map knows something.
        likelihoods: [N] mean likelihood of those, 0 to 1.
        crossed: [N] rays that pass through a surface of the map.
    """

    offsets: Array
    information: Array
    costs: Array
    known: Array
    likelihoods: Array
    crossed: Array


class Registrar:
    """Finds scans in maps.

    Args:
        config: of the registration.
        costs: what endpoints cost that match nothing.
    """

    def __init__(self, config: RegistrationConfig, costs: ProposalConfig) -> None:
        self._config, self._costs = config, costs

    def register(
        self,
        maps: MapView,
        predicted: Array,
        spread: Array,
        points: Points,
        origin: Array,
        starts: Array,
        means: Array | None = None,
        *,
        coarse: bool = True,
    ) -> Registration:
        """Every scan in its own map, or all in one.

        Args:
            maps: of N particles, or of one.
            predicted: [N, 3] where the odometry puts them.
            spread: [3] standard deviation of that.
            points: [k, 2] of the scan.
            origin: [2] of the rays.
            starts: [N, 3] offsets to begin at.
            means: [N, 3] offsets that are held for the likeliest; none by default.
            coarse: begin on the coarse level of the maps.
        """
        priors = np.zeros((len(predicted), 6))
        priors[:, :3] = self._config.prior_weight / spread**2
        if means is not None:
            priors[:, 3:] = means
        offsets, fits = maps.register(
            predicted,
            points,
            origin,
            starts,
            priors,
            self._config,
            unknown=self._costs.unknown,
            outlier=self._costs.outlier,
            coarse=coarse,
        )
        information = fits.take(SYMMETRIC, axis=1).reshape(-1, 3, 3)
        known = fits[:, KNOWN]
        likelihoods = fits[:, LIKELIHOOD] / np.maximum(known, 1)
        return Registration(offsets, information, fits[:, COST], known, likelihoods, fits[:, CROSSED])

    def trusted(self, found: Registration, spread: Array) -> Registration:
        """What is found, with the odometry kept along a direction of which the scan says next to nothing.

        Between two bare walls a few endpoints pull along them, by what is wrong with the map rather than by where the
        robot is (Zhang, Kaess and Singh 2016, On degeneracy of optimization-based state estimation problems).
        """
        share, along = weakest(found.information)
        error = self._config.degenerate / np.maximum(share, 1e-12)
        offsets, information, usual = found.offsets.copy(), found.information, float(spread[0])
        shift = (along * offsets[:, :2]).sum(axis=1)
        trust = usual**2 / (usual**2 + error * error)
        trust[abs(shift) > 3 * usual] = 1.0
        offsets[:, :2] -= along * ((1 - trust) * shift)[:, None]
        keep = np.repeat(WHOLE, len(along), axis=0)
        keep[:, :2, :2] -= ((1 - np.sqrt(trust))[:, None] * along)[:, :, None] * along[:, None, :]
        return found._replace(offsets=offsets, information=keep @ information @ keep)

    def follow(
        self, maps: MapView, predicted: Array, spread: Array, points: Points, origin: Array, guesses: Array
    ) -> Registration:
        """One particle's scan in its map: where the odometry puts it, else after a search, at last in a wide window.

        Args:
            maps: of that particle.
            predicted: [3] where the odometry puts it.
            spread: [3] standard deviation of that.
            points: [k, 2] of the scan.
            origin: [2] of the rays.
            guesses: [m, 3] offsets that are tried beside what a search finds.
        """
        c = self._config
        found = self.trusted(self.register(maps, predicted[None], spread, points, origin, np.zeros((1, 3))), spread)
        near = spread[0] <= REACH[0] and bool((abs(found.offsets[0]) <= FAR * spread).all())
        if near and found.likelihoods[0] >= c.sure_above and not self.lost(found, len(points)):
            return found
        steps = (maps.cell_size, TURN)
        found = self._best(maps, predicted, spread, points, origin, 3 * spread, steps, places(3 * spread), guesses)
        if found.likelihoods[0] < c.doubtful_below:
            found = self._best(maps, predicted, spread, points, origin, 3 * spread, steps, 200, guesses)
        found = self.trusted(found, spread)
        if not self.lost(found, len(points)):
            return found
        window = np.array([c.wide_distance, c.wide_distance, c.wide_rotation])
        wider = np.maximum(window / 2, spread)
        wide = self._best(maps, predicted, wider, points, origin, window, (2 * maps.cell_size, 2 * TURN), 300, guesses)
        return wide if merit(wide)[0] >= merit(found)[0] + c.clear_gain * len(points) else found

    def lost(self, found: Registration, points: int) -> bool:
        """Whether a scan of so many points contradicts the map where it was found."""
        c = self._config
        return bool(merit(found)[0] < c.lost_below * points)

    def spread(self, travelled: float, turned: float, *, guess: bool = False) -> Array:
        """Standard deviation of the odometry, or of a guess, [3], after so far [m] and so much turning [rad]."""
        c = self._config
        spread = odometry_spread(c, travelled, turned)
        return spread + np.array([c.guess_translation, c.guess_translation, c.guess_rotation]) if guess else spread

    def _best(
        self,
        maps: MapView,
        predicted: Array,
        spread: Array,
        points: Points,
        origin: Array,
        window: Array,
        steps: tuple[float, float],
        most: int,
        guesses: Array,
    ) -> Registration:
        """Registered from the most promising places of a window, the best of them."""
        found = self._search(maps, predicted, spread, points, window, steps, most)
        starts = np.vstack((guesses, found))
        means = np.vstack((guesses, np.zeros_like(found)))
        some = evenly(points, SOME)
        tried = self.register(
            maps, np.repeat(predicted[None], len(starts), axis=0), spread, some, origin, starts, means
        )
        off = np.square(tried.offsets / spread).sum(axis=1)
        cost = off / 2
        cost[: len(guesses)] = TAIL * np.log1p(off[: len(guesses)] / (2 * TAIL))
        best = [int((merit(tried) * len(points) / len(some) - cost).argmax())]
        return self.register(
            maps, predicted[None], spread, points, origin, tried.offsets[best], means[best], coarse=False
        )

    def _search(
        self,
        maps: MapView,
        predicted: Array,
        spread: Array,
        points: Points,
        window: Array,
        steps: tuple[float, float],
        most: int,
    ) -> Array:
        """The most promising offsets [m, 3] of a window, by the coarse level of the map and the prior."""
        few = evenly(points, MAX_SEARCH_POINTS)
        shifts, blocks = lattice(to_reach(window[0], steps[0]), steps[0])
        most_turns = to_reach(window[2], steps[1])
        turns = np.arange(-most_turns, most_turns + 1, dtype=np.float64) * steps[1]
        weight = 0.01 * len(few)  # a standard deviation costs as much as every point one hundredth farther off
        scores, chosen = maps.search(
            predicted[None],
            few,
            turns,
            weight * (turns / spread[2]) ** 2,
            shifts,
            weight * (np.square(shifts).sum(axis=1) / spread[0] ** 2),
            blocks,
        )
        best = np.argsort(-scores[0], kind="stable")
        return apart(np.column_stack((shifts[chosen[0, best]], turns[best // blocks])), most)


def weakest(information: Array) -> tuple[Array, Array]:
    """The direction along which endpoints say least of the place: its share of the most, [N], and itself, [N, 2]."""
    xx, xy, yy = information[:, 0, 0], information[:, 0, 1], information[:, 1, 1]
    middle, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    most = np.arctan2(2 * xy, xx - yy) / 2
    along = np.empty((len(most), 2))
    along[:, 0], along[:, 1] = -np.sin(most), np.cos(most)
    return (middle - half) / np.maximum(middle + half, 1e-9), along


def places(window: Array) -> int:
    """How many starts a window needs: from each, Gauss-Newton finds what is within ``REACH``."""
    return int(np.clip(np.ceil(np.prod(window / REACH)), 2, 16))


def apart(offsets: Array, most: int) -> Array:
    """The first ``most`` of offsets [m, 3] that are not within reach of one before them."""
    chosen: list[int] = []
    left = np.arange(len(offsets))
    while len(left) and len(chosen) < most:
        chosen.append(int(left[0]))
        near = (np.abs(offsets[left] - offsets[left[0]]) < 0.6 * REACH).all(axis=1)
        left = left[~near]
    return offsets[chosen]


def evenly(points: Points, most: int) -> Points:
    """At most so many of the points, evenly chosen."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).astype(np.intp)]


def to_reach(reach: float, step: float) -> int:
    """How many steps it takes to come to ``reach`` or just beyond."""
    return int(np.ceil(reach / step - 1e-9))


@lru_cache(maxsize=64)
def lattice(most: int, step: float) -> tuple[Array, int]:
    """Shifts in x and y up to ``most`` steps, in equal blocks of neighbours, and how many blocks there are."""
    across = np.arange(-most, most + 1, dtype=np.float64) * step
    if len(across) <= 2 * BLOCK:
        return np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1).reshape(-1, 2), 1
    n = -(-len(across) // BLOCK) * BLOCK
    across = across[0] + np.arange(n) * step
    grid = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1)
    m = n // BLOCK
    return grid.reshape(m, BLOCK, m, BLOCK, 2).swapaxes(1, 2).reshape(-1, 2), m * m


def merit(found: Registration) -> Array:
    """How much speaks for a place, [N] in endpoints: those that match less what contradicts the map."""
    return found.known * (1.5 * found.likelihoods - 0.3) - CROSSING * found.crossed
