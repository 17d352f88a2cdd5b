"""Registration of scans to TSDFs by Gauss-Newton, coarse to fine, with the odometry as a loose prior.

And its information, by what its own residuals are, and the motions that the endpoints do not bind.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels import registration as kernel
from moteslam.kernels.gauss_newton import LEAST_INFORMATION, LEAST_RATIO, MOST_NOISE, NOISE_RATIO, RIDGE, Kept
from moteslam.kernels.gauss_newton import keep_predictions as kept
from moteslam.kernels.registration import LIKELIHOODS, RegistrationOptions, register_scans
from moteslam.robot.se2 import Array, Pose, as_pose
from moteslam.slam.mapping.config import LOST_DISTANCE, TsdfConfig
from moteslam.slam.mapping.tsdf import TsdfView
from moteslam.slam.registration.config import RegistrationConfig

Points = NDArray[np.float32]
Spread = tuple[float, float, float]  # Standard deviations of a predicted pose: forward [m], left [m], turn [rad]
FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # Where in an upper triangle 00 01 02 11 12 22 the full matrix's elements are


class Registration(NamedTuple):
    """Where scans were found, for each of N particles."""

    offsets: Array  # [N, 3] from the predicted pose, in its frame
    information: Array  # [N, 3, 3] of the endpoints about them
    costs: Array  # [N] negative log-likelihood of the endpoints
    known: Array  # [N] number of endpoints where the map is known
    likelihoods: Array  # [N] mean likelihood of those, 0 to 1
    crossed: Array  # [N] number of rays that pass through a surface of the map
    free: Array  # [N, 3] the offsets before the odometry was kept along degenerate directions
    far: Array  # [N] number of endpoints that the coarse level knows to be `LOST_DISTANCE` or more from the surface
    means: Array  # [N, 3] of the fine level's endpoints: x, y, x^2 + y^2 from the robot, in the axes of the offset

    def of(self, which: int) -> Fitted:
        (xx, xy, xt), (_, yy, yt), (_, _, tt) = self.information[which].tolist()
        offset, free, information = as_pose(self.offsets[which]), as_pose(self.free[which]), (xx, xy, xt, yy, yt, tt)
        several = self.costs, self.known, self.likelihoods, self.crossed, self.far
        cost, known, likelihood, crossed, far = (float(values[which]) for values in several)
        return Fitted(offset, information, cost, known, likelihood, crossed, free, far)

    def at(self, which: int) -> Registration:
        """One of them, as of one particle."""
        return Registration(*(values[which : which + 1] for values in self))

    @classmethod
    def one(cls, fitted: Fitted) -> Registration:
        """Of one particle: what ``of`` took out, without ``means``."""
        columns = [np.array((each,)) for each in (*fitted, (0.0, 0.0, 0.0))]
        columns[1] = columns[1][:, FULL].reshape(1, 3, 3)
        return cls(*columns)


def register(
    maps: TsdfView,
    predicted: Array,
    spread: Array,
    points: Points,
    origin: Array,
    starts: Array,
    config: RegistrationConfig,
    *,
    means: Array | None = None,
    coarse: bool = True,
    keep: bool = False,
    deviation: float | None = None,
) -> Registration:
    """Register one scan to the TSDF of every particle, or from many starts to that of one.

    Its points [k, 2], and where its rays start [2], are in the robot's frame [m].

    Args:
        predicted: [N, 3] poses by the odometry, of standard deviation ``spread`` [3].
        starts: [N, 3] offsets from these to begin at.
        means: [N, 3] of the prior on the offsets; zeros by default.
        keep: keep the odometry along degenerate directions, as ``keep_odometry`` does.
        deviation: of the odometry along these [m]; by default that of the prediction.
    """
    x, y, theta = spread.tolist()
    weight = config.prior_weight
    queries = np.empty((len(predicted), kernel.QUERY))
    queries[:, kernel.FRAME], queries[:, kernel.START] = maps.frames(predicted), starts
    queries[:, kernel.PRIOR] = weight / x**2, weight / y**2, weight / theta**2, 0.0, 0.0, 0.0
    if means is not None:
        queries[:, kernel.PRIOR_MEAN] = means
    options, kept = options_of(maps.config, config), Kept(x if deviation is None else deviation, config.degenerate)
    found = register_scans(
        maps.tiles, queries, points, origin.tolist(), options=options, coarse=coarse, kept=kept if keep else None
    )
    information = found[:, kernel.INFORMATION][:, FULL].reshape(-1, 3, 3)
    cost, known, likelihood, crossed = (
        found[:, column] for column in (kernel.COST, kernel.KNOWN, kernel.LIKELIHOOD, kernel.CROSSED)
    )
    free, far, about = found[:, kernel.FREE], found[:, kernel.FAR], found[:, kernel.MEANS]
    likelihoods = likelihood / np.maximum(known, 1)
    return Registration(found[:, kernel.OFFSET], information, cost, known, likelihoods, crossed, free, far, about)


class Fitted(NamedTuple):
    """Where one scan was found, in plain numbers: see ``Registration``."""

    offset: Pose
    information: tuple[float, float, float, float, float, float]  # the elements xx, xy, xt, yy, yt, tt; t is theta
    cost: float
    known: float
    likelihood: float
    crossed: float
    free: Pose
    far: float


def register_one(
    maps: TsdfView,
    predicted: Pose,
    spread: Spread,
    points: Points,
    origin: tuple[float, float],
    config: RegistrationConfig,
    options: RegistrationOptions,
) -> Fitted:
    """``register`` of one scan to the TSDF of one particle, from the predicted pose, in plain numbers.

    In 35 us where arrays of one row take 64 (250 points, one thread): every scan is tracked by it. ``options`` are
    ``options_of`` the maps and ``config``.
    """
    x, y, theta = spread
    weight = config.prior_weight
    prior = weight / x**2, weight / y**2, weight / theta**2, 0.0, 0.0, 0.0
    queries = np.array(((*maps.frame(predicted), 0.0, 0.0, 0.0, *prior),))
    kept = Kept(x, config.degenerate)
    found = register_scans(maps.tiles, queries, points, origin, options=options, kept=kept)[0].tolist()
    x, y, theta, xx, xy, xt, yy, yt, tt, cost, known, likelihood, crossed = found[: kernel.CROSSED + 1]
    free_x, free_y, free_turn = found[kernel.FREE]
    offset, information, free = (x, y, theta), (xx, xy, xt, yy, yt, tt), (free_x, free_y, free_turn)
    return Fitted(offset, information, cost, known, likelihood / max(known, 1), crossed, free, found[kernel.FAR])


def options_of(maps: TsdfConfig, config: RegistrationConfig) -> RegistrationOptions:
    """The options of registrations to maps of this kind."""
    both = {**vars(config), **vars(maps), "far": LOST_DISTANCE}
    return RegistrationOptions._make(both[name] for name in RegistrationOptions._fields)


def prior_deviations(config: RegistrationConfig, distance: float, rotation: float, *, measured: bool = True) -> Spread:
    """Standard deviations of a predicted motion: forward [m], left [m], turn [rad].

    The rotation is the sum of absolute turns [rad]; what odometry did not measure was extrapolated.
    """
    place = config.translation + config.translation_from_translation * distance
    turn = config.rotation + config.rotation_from_rotation * rotation
    if not measured:
        place, turn = place + config.extrapolated_translation, turn + config.extrapolated_rotation
    return place, place, turn


def prior_spread(config: RegistrationConfig, distance: float, rotation: float, *, measured: bool = True) -> Array:
    """``prior_deviations`` as an array [3]."""
    return np.array(prior_deviations(config, distance, rotation, measured=measured))


def subsample(points: Points, most: int) -> Points:
    """At most this many of the points, evenly chosen."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).astype(np.intp)]


UPPER = [0, 1, 2, 4, 5, 8]  # The upper triangle of a 3 x 3 matrix, of its elements row by row


def residual_variance(likelihood: float, config: RegistrationConfig) -> float:
    """The variance of the endpoints' residuals by their mean likelihood, in squares of ``config.residual``.

    It is no setting: with normal residuals of variance t^2 the mean of exp(-(r / width)^2 / 2) is
    1 / sqrt(1 + (t / width)^2).
    """
    mean = min(max(likelihood, LIKELIHOODS[0]), LIKELIHOODS[1])
    return config.likelihood_width**2 * (1 / mean**2 - 1)


def measured_information(found: Registration, which: int, config: RegistrationConfig, correlation: float) -> Array:
    """The information [3, 3] of one registration, about its offset, by the variance of its own residuals.

    Neighbouring endpoints err alike: ``correlation`` of them count as one.
    """
    variance = residual_variance(float(found.likelihoods[which]), config)
    return np.asarray(found.information[which] / (variance * correlation))


def least_informed(information: Array) -> tuple[Array, Array]:
    """The direction in the plane that information [N, 3, 3] of poses (x, y, theta) is least along.

    Returns [N] the ratio of the information along it to that across it, and [N, 2] the direction as a unit vector.
    """
    xx, xy, yy = information[:, 0, 0], information[:, 0, 1], information[:, 1, 1]
    middle, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    most = np.arctan2(2 * xy, xx - yy) / 2
    along = np.empty((len(most), 2))
    along[:, 0], along[:, 1] = -np.sin(most), np.cos(most)
    return (middle - half) / np.maximum(middle + half, 1e-9), along


def bound(found: Registration, spread: Array, config: RegistrationConfig) -> Array:
    """Where scans were found [N, 3], but along a direction that their endpoints bind less than the odometry does."""
    ratio, along = least_informed(found.information)
    variances = np.array([residual_variance(likelihood, config) for likelihood in found.likelihoods.tolist()])
    bare = config.degenerate * np.minimum(variances, MOST_NOISE) > spread[0] * ratio
    away = bare * (found.free[:, :2] * along).sum(axis=1)
    return np.asarray(found.free - np.column_stack((away[:, None] * along, np.zeros(len(away)))))


def least_bound_turn(
    information: Array, means: Array, variances: Array, errors: Array, config: RegistrationConfig
) -> tuple[Array, Array]:
    """The turn that changes the endpoints' distances least, and how much they know of it: as ``keep_predictions``.

    Args:
        information: [N, 3, 3] of the pose (x, y, theta).
        means: [N, 3] of the endpoints' x, y, x^2 + y^2 from the robot, in the axes of the information [m, m^2].
        variances: [N] of the residuals, in squares of standard ones.
        errors: [N] along the direction that is bound least [m]: where they are large a turn does not move along it.

    Returns [N, 3] how the robot moves in a turn of a radian; [N] 1 where it is bound, 0 where that is noise of the
    slopes.
    """
    ratio, along = least_informed(information)
    weight = 1 / (1 + np.square(errors / config.translation))
    total = np.maximum(information[:, 0, 0] + information[:, 1, 1], LEAST_INFORMATION)
    least = total * np.maximum(ratio, 0.0) / (1 + ratio)
    across = np.column_stack((along[:, 1], -along[:, 0]))
    pull, push = ((information[:, :2, 2] * way).sum(axis=1) for way in (along, across))
    turn = np.ones((len(information), 3))
    turn[:, :2] = -(weight * pull / (least + RIDGE * total))[:, None] * along
    turn[:, :2] -= (push / (total - least + RIDGE * total))[:, None] * across
    x, y, _ = turn.T
    lever = np.maximum(means[:, 2] + x * x + y * y + 2 * (y * means[:, 0] - x * means[:, 1]), LEAST_INFORMATION)
    known = np.einsum("ni,nij,nj->n", turn, information, turn) / (total * lever)
    return turn, np.clip(2 * known / (NOISE_RATIO * np.minimum(variances, MOST_NOISE)) - 2, 0.0, 1.0)


def keep_odometry(found: Registration, spread: Array, config: RegistrationConfig) -> Registration:
    """What registration found, with odometry of a ``spread`` [3] kept along what the endpoints do not bind.

    See ``keep_predictions``.
    """
    upper = found.information.reshape(-1, 9)[:, UPPER]
    offsets, information = kept(found.offsets, upper, found.means, Kept(float(spread[0]), config.degenerate))
    return found._replace(offsets=offsets, information=information[:, FULL].reshape(-1, 3, 3))


def less_where_unbound(information: Array, found: Registration, which: int, config: RegistrationConfig) -> Array:
    """Information [3, 3] of a registration with its errors along the motions that the endpoints bind least.

    Along bare walls, and for turns in a round room, it is wrong by errors of the map, not by the endpoints' noise: by
    as much as ``keep_predictions`` has it.
    """
    seen = found.at(which)
    (ratio,), (along,) = least_informed(seen.information)
    variance = residual_variance(float(seen.likelihoods[0]), config)
    error = config.degenerate * variance / max(float(ratio), LEAST_RATIO)
    if error:
        known = information @ np.append(along, 0.0)
        information = information - np.outer(known, known) / (1 / error**2 + known[:2] @ along)
        (turn,), (bound,) = least_bound_turn(
            seen.information, seen.means, np.array([variance]), np.array([error]), config
        )
        known = information @ turn
        information = information - (1 - bound) * np.outer(known, known) / max(float(known @ turn), LEAST_INFORMATION)
    return np.asarray(information)
