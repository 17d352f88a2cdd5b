"""When a registration may overrule the odometry: an offset of many standard deviations must be proved.

Along what the walls do not measure Gauss-Newton goes where errors of the map pull it, or where more of the map is known
(``docs/theory/default-filter.md``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.se2 import Array
from moteslam.slam.mapping.tsdf import TsdfView
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.registrar import Registration, register
from moteslam.slam.registration.search import LEAST_KNOWN

Points = NDArray[np.float32]

SLIP = 7.0  # Negative log-probability that the wheels slip in one step: one in a thousand
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
) -> Registration:
    """What was found, and a registration held near the odometry where the endpoints do not prove what was found.

    Of N particles as ``register`` keeps the odometry along degenerate directions. One of more than ``config.gate``
    standard deviations must be more probable than ``against`` has it. One that is proved is taken in full, along
    degenerate directions, too.
    """
    far = (np.abs(found.free) > config.gate * spread).any(axis=1)
    if not far.any():
        return found
    here, tight = np.zeros_like(predicted), spread / config.gate
    held = register(maps, predicted, tight, points, origin, here, config, coarse=False, keep=True)
    evidence = nats_for(found, held, len(points), config.unknown_cost, CORRELATION)
    off = np.square(found.free / spread).sum(axis=1)
    wins = evidence > against(off, tracking)
    full = found._replace(offsets=np.where((far & wins)[:, None], found.free, found.offsets))
    back = far & ~wins

    def chosen(near: Array, away: Array) -> Array:
        return np.where(back.reshape(-1, *(1,) * (near.ndim - 1)), near, away)

    return Registration(*(chosen(near, away) for near, away in zip(held, full, strict=True)))
