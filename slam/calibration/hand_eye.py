"""The lidar's mount, clock and scale against odometry, from motions that both measured: hand-eye calibration.

The lidar's motion is X^-1 m X for a motion m of the robot and a mount X (Censi, Franchi, Marchionni and Oriolo 2013,
Simultaneous calibration of odometry and sensor parameters). Of lengths only the ratio of the two can be seen.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.platform import Wheels
from moteslam.robot.se2 import Array
from moteslam.robot.sensor_reports import agreement
from moteslam.slam.calibration.parts import FEWEST, Change, clearest_change, parts_of, robust_mean

Path = Callable[[Array], Array]
"""Gives the odometry's poses [m, 3] at times [m] [s]."""

FLOOR = np.array([0.004, 0.004, 0.003, 0.007, 0.01, 0.0, 0.01, 0.0])
"""Standard deviations are no smaller: what the model leaves out, slip and the shape of walls."""
ODOMETRY = (0.005, 0.03, 0.01, 0.1)
"""Deviation of its lengths [m], per metre, of its turns [rad], per radian: those of `CalibrationConfig`."""
SLIP = (0.0, 0.03)
"""How far wheels of which nothing is known slip outwards in a turn, over speed and turn, and its deviation [s]."""
PRIOR = np.array([1.0, 1.0, 1.0, 0.3, 0.3, SLIP[1], 1.0, 0.01])
"""Standard deviations about where the fit begins, the mount about none."""
UNMEASURED = 1.0
"""Variance from which on a length counts as not measured [m^2]."""
LONG_ENOUGH = 0.1
"""A ratio of a pair alone is of lengths from this on [m]."""
NEARLY = 0.2
"""A pair that turns by less is nearly straight [rad]."""
ASIDE, CURLS = 0.05, 0.1
"""Directions of pairs that scatter by more [rad], and turns over lengths [rad/m], count less."""
FAR_OFF = 0.2
"""Lengths of a part that differ by more, as the logarithm, are no outliers of the whole."""
SCATTER = 0.75
"""A mount has turned by more than its pairs scatter: this much of their median counts as deviation."""
STANDS = 0.05
"""A lidar stands whose lengths are known to a larger share of them alone; those by odometry in other units are known to
a percent."""
RATE = 0.1  # The rate of a turn is taken over this time [s]
SHARPENING = 6
"""Steps by the noise of lengths and turns that the residuals show."""
STRAIGHT = 0.07
"""A pair that turns by this much counts half of a straight one for the ratio of lengths [rad]: in turns wheels slip
lengthways, too, of a robot that is steered by skidding by 1 %."""
MEDIAN = 0.6745
"""Of the size of a normal variate of unit variance."""
MEDIAN_OF_3 = 2.366
"""Of the sum of the squares of three."""
TAIL = 2.5
"""Weighted residuals beyond it lose weight (Cauchy)."""
LONGEST, STEP = 8.0, 0.05
"""Offsets of clocks up to this are looked for, in steps [s]."""
MOST_DRIFT = 0.012
"""Likewise their drift [s/s]."""
SKID = 0.15
"""Turns by wheels are off by less where a robot is steered by skidding: that is no other track."""


class Parameter(IntEnum):
    """Where each parameter of a fit is.

    The mount [m], [rad]; the ratio of lengths by scans to those by odometry, and that of turns by odometry to those by
    scans; how far wheels slip outwards in a turn, over speed and turn [s]; clocks [s], [s/s].
    """

    X = 0
    Y = 1
    YAW = 2
    LENGTHS = 3
    TURNS = 4
    SLIP = 5
    OFFSET = 6
    DRIFT = 7


MOUNT, CLOCKS = slice(Parameter.X, Parameter.LENGTHS), slice(Parameter.OFFSET, None)
"""Those of the mount, and of the difference of the clocks."""


class Pairs(NamedTuple):
    """Motions of the lidar between times first and last [k] [s]: [k, 3], and their covariances [k, 3, 3]."""

    first: Array
    last: Array
    motions: Array
    covariances: Array

    @property
    def middle(self) -> float:
        """The time that a drift counts from [s]."""
        return float(self.first.min() + np.ptp(self.first) / 2)


class Fit(NamedTuple):
    # [8] by ``Parameter``; clocks as the time that the odometry's stamps are late by [s], and how that changes [s/s]
    values: Array
    deviations: Array  # [8] their standard deviations
    cost: float  # mean robust cost of a pair; about 3 where the model holds
    middle: float  # the time that the drift counts from [s]
    change: Change  # of the logarithm of lengths by the scans over those by the odometry, where it is clearest
    turned: Change  # likewise of the yaw of the mount [rad]
    curl: tuple[float, float]  # by how much more the odometry turns than the scans [rad/m], and its deviation
    scatter: float  # median deviation of directions by the scans from those by the odometry [rad]; 0 of few pairs

    @property
    def stands(self) -> bool:
        """Whether the lidar does not move by its scans, as one that sees the floor: lengths of 0 are no scale."""
        lengths, about, floor = (float(of[Parameter.LENGTHS]) for of in (self.values, self.deviations, FLOOR))
        about = float(np.sqrt(max(about * about - floor * floor, 0.0)))
        return lengths < about / STANDS and about < STANDS / 2  # odometry in millimetres has a scale

    def wheels(self, stated: Wheels, *, gyro: bool) -> dict[str, float]:
        """Wheels whose lengths scans measure: where a ``gyro`` turns, or turns are as wrong, their size alone is."""
        scale = float(self.values[Parameter.LENGTHS])
        right = 1.0 if gyro else scale * float(self.values[Parameter.TURNS])  # of the track, over the stated
        wider = min((1.0, scale), key=lambda each: abs(np.log(each / right)))
        wider = wider if abs(wider / right - 1) < SKID else right
        return {"metres_per_count": scale * stated.metres_per_count, "effective_track": wider * stated.effective_track}


def clock(pairs: Pairs, stamps: Array, headings: Array, *, shared: bool) -> tuple[float, float, float]:
    """Offset [s] and drift [s/s] at which the turns of both agree best, and their correlation there, of either sign.

    The odometry has headings [n], unwrapped [rad], at stamps [n] [s]. On a ``shared`` clock offset and drift are 0.
    """
    lags = np.zeros(1) if shared else np.arange(-LONGEST, LONGEST + STEP / 2, STEP)
    span = max(float(np.ptp(pairs.first)), 1.0)
    steps = 0 if shared else int(min(MOST_DRIFT * span / 0.4, 25))
    drifts = np.linspace(-steps, steps, 2 * steps + 1) * 0.4 / span
    turns = pairs.motions[:, 2]
    return agreement(pairs.first, pairs.last, turns, stamps, headings, lags, drifts, lag_costs=0.004)


def fit(
    pairs: Pairs,
    path: Path,
    clocks: tuple[float, float],
    *,
    shared: bool,
    slip: tuple[float, float] = SLIP,
    lead: float = 0.0,
) -> Fit:
    """Fit a lidar to odometry: iterated weighted least squares, with the deviations of a clustered sandwich.

    Turns by odometry are regressed on those by scans, which are far better: the other way round their noise would pass
    for a scale (attenuation). How large it is the residuals say. A ``shared`` clock is not estimated, but by about a
    ``lead`` the wheels may turn before the robot does, all the same [s]; ``slip`` is expected, and its deviation [s]:
    where a drive is as fast in all turns, it passes for a lidar farther ahead.
    """

    def residuals(p: Array) -> Array:
        expected = expected_motions(p, pairs.first, pairs.last, pairs.middle, path, pairs.motions[:, 2])
        apart = pairs.motions - expected
        apart[:, 2] = p[Parameter.TURNS] * se2.wrap(apart[:, 2])  # of turns by odometry
        return apart

    p = np.array([0.0, 0.0, 0.0, 1.0, 1.0, slip[0], *clocks])
    stated = expected_motions(p, pairs.first, pairs.last, pairs.middle, path)
    p[Parameter.YAW], p[Parameter.LENGTHS] = _direction(pairs, stated)
    per_length, per_turn = np.hypot(stated[:, 0], stated[:, 1]), np.abs(pairs.motions[:, 2])
    of_turns = ODOMETRY[2] + ODOMETRY[3] * per_turn
    noise = np.stack((ODOMETRY[0] + ODOMETRY[1] * per_length,) * 2 + (of_turns,), axis=1)
    steps = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 0.02, 0.02 / max(float(np.ptp(pairs.first)), 1.0)])
    free = np.ones(len(Parameter), bool)
    free[CLOCKS] = not shared
    deviations = PRIOR.copy()
    deviations[Parameter.SLIP] = slip[1]
    if lead:
        free[Parameter.OFFSET], deviations[Parameter.OFFSET] = True, lead
    prior, begin = np.diag(np.where(free, 1 / deviations**2, 1e12)), p

    def step(p: Array, apart: Array, noise: Array) -> tuple[Array, Array, Array, Array, Array]:
        """The parameters after a step; of pairs the square, weight and gradient; the normal matrix."""
        weights = np.linalg.inv(pairs.covariances + noise[:, :, None] ** 2 * np.eye(3))
        each = [(residuals(p - h) - residuals(p + h)) / (2 * s) for h, s in zip(np.diag(steps), steps, strict=True)]
        jacobian = np.stack(each, axis=-1) * free
        square = np.einsum("ki,kij,kj->k", apart, weights, apart)
        less = min(max(float(np.median(square)) / MEDIAN_OF_3, 0.1), 1.0)
        weights = weights / less
        robust = 1 / (1 + square / less / TAIL**2)
        weighted = jacobian.swapaxes(1, 2) @ (weights * robust[:, None, None])
        normal, gradient = (weighted @ jacobian).sum(axis=0) + prior, (weighted @ apart[..., None])[..., 0]
        p = p + np.linalg.solve(normal, gradient.sum(axis=0) - prior @ (p - begin))
        return p, square, robust, gradient, normal

    for _ in range(12):
        apart = residuals(p)
        more = (np.median(np.abs(apart[:, 2])) / MEDIAN) ** 2 - np.median(of_turns) ** 2
        noise[:, 2] = np.sqrt(of_turns**2 + max(more, 0.0))
        p, square, robust, gradient, normal = step(p, apart, noise)
    spread, inverse = _sandwich(normal, gradient)
    if not shared:  # a drift is a matter of milliseconds: lengths and turns by what each of them is worth here
        sharp = p
        for _ in range(SHARPENING):
            apart = residuals(sharp)
            variance = np.einsum("kii->ki", pairs.covariances) + noise**2
            size = np.abs(apart) / np.sqrt(variance)
            worth = [np.median(each) / MEDIAN for each in (size[:, :2][variance[:, :2] < UNMEASURED], size[:, 2])]
            sharp, _, _, gradient, normal = step(sharp, apart, noise * np.maximum(np.take(worth, (0, 0, 1)), 0.02))
        by_turns, about = _drift_by_turns(pairs, sharp, path)
        by_both = float(_sandwich(normal, gradient)[0][Parameter.DRIFT, Parameter.DRIFT])
        share = about / (about + by_both)
        p[Parameter.DRIFT] = share * sharp[Parameter.DRIFT] + (1 - share) * by_turns
    deviations = np.hypot(np.sqrt(np.maximum(np.diag(spread), np.diag(inverse))), FLOOR)
    late = FLOOR[Parameter.OFFSET] / max(float(np.ptp(pairs.first)) / 2, 1.0)  # between the middle and the ends
    deviations[Parameter.DRIFT] = np.hypot(deviations[Parameter.DRIFT], late)
    deviations[Parameter.TURNS] = np.hypot(np.sqrt(spread[Parameter.TURNS, Parameter.TURNS]), FLOOR[Parameter.TURNS])
    expected = expected_motions(p, pairs.first, pairs.last, pairs.middle, path, pairs.motions[:, 2])
    ratio, deviation = _ratio_of_lengths(pairs, expected, robust)
    deviations[Parameter.LENGTHS] = np.hypot(p[Parameter.LENGTHS] * deviation, FLOOR[Parameter.LENGTHS])
    p[Parameter.LENGTHS] *= ratio
    p[Parameter.YAW] = se2.wrap(p[Parameter.YAW])
    mean = float((TAIL**2 * np.log1p(square / TAIL**2)).mean())

    scans, base = (each[:, 0] + 1j * each[:, 1] for each in (pairs.motions, expected))
    known: NDArray[np.bool_] = np.linalg.eigvalsh(pairs.covariances[:, :2, :2])[:, 1] < UNMEASURED
    known &= np.minimum(np.abs(scans), np.abs(base)) > LONG_ENOUGH

    def log_ratio(some: NDArray[np.bool_]) -> tuple[float, float]:
        of, by_odometry, weights, begin = Pairs(*(each[some] for each in pairs)), expected[some], robust[some], 1.0
        longer = np.abs(scans[some & known] / base[some & known])
        if len(longer) >= FEWEST and abs(np.log(np.median(longer))) > FAR_OFF:  # the fit made outliers of them
            begin, weights = float(np.median(longer)), np.ones_like(weights)
        ratio, deviation = _ratio_of_lengths(of, by_odometry * (begin, begin, 1.0), weights)
        return float(np.log(begin * ratio)), deviation / ratio

    aside, straight = np.angle(base / scans)[known], 1 / (1 + (pairs.motions[known, 2] / STRAIGHT) ** 2)

    def yaw(some: NDArray[np.bool_]) -> tuple[float, float]:
        values, weights = aside[some[known]], straight[some[known]]
        mean, deviation = robust_mean(values, weights, ASIDE, FLOOR[Parameter.YAW])
        return mean, float(np.hypot(deviation, SCATTER * np.median(abs(values - mean)))) if len(values) else deviation

    rates = se2.wrap(expected[:, 2] - pairs.motions[:, 2])[known] / np.abs(base[known])
    curl = robust_mean(rates, straight, CURLS, 0.0)
    change, turned = (clearest_change(pairs.first, of) for of in (log_ratio, yaw))
    scatter = float(np.median(abs(aside - np.median(aside)))) if len(aside) >= 2 * FEWEST else 0.0
    return Fit(p, deviations, mean, pairs.middle, change, turned, curl, scatter)


def expected_motions(
    p: Array, first: Array, last: Array, middle: float, path: Path, turns: Array | None = None
) -> Array:
    """The lidar's motions [k, 3] between times [k]; lengths go along turns [k], if these are given."""
    began, ended = (path(time + p[Parameter.OFFSET] + p[Parameter.DRIFT] * (time - middle)) for time in (first, last))
    motion = np.asarray(se2.between(began, ended))
    turn = motion[:, 2] / p[Parameter.TURNS]
    turned = turn if turns is None else turns  # those by the scans are the better ones
    bend = (turned - motion[:, 2]) / 2
    cos, sin = p[Parameter.LENGTHS] * np.cos(bend), p[Parameter.LENGTHS] * np.sin(bend)
    x, y = cos * motion[:, 0] - sin * motion[:, 1], sin * motion[:, 0] + cos * motion[:, 1]
    aside = p[Parameter.SLIP] * np.hypot(x, y) / np.maximum(last - first, 1e-3) * turned
    x, y = x + np.sin(turned / 2) * aside, y - np.cos(turned / 2) * aside
    moved = np.stack((x, y, turned), axis=1)
    lidar = np.asarray(se2.compose(se2.compose(se2.inverse(p[MOUNT]), moved), p[MOUNT]))
    lidar[:, 2] = turn
    return lidar


def _direction(pairs: Pairs, odometry: Array) -> tuple[float, float]:
    """The yaw of the mount and the ratio of lengths, by the pairs that are nearly straight: to begin with."""
    size = np.hypot(odometry[:, 0], odometry[:, 1])
    measured = np.linalg.eigvalsh(pairs.covariances[:, :2, :2])[:, 1] < UNMEASURED
    lengths = np.hypot(pairs.motions[:, 0], pairs.motions[:, 1])
    use = measured & (np.abs(pairs.motions[:, 2]) < NEARLY) & (size > 0.5 * np.percentile(size, 80)) & (lengths > 0.01)
    if use.sum() < FEWEST:
        return 0.0, 1.0
    scans, base = (each[use, 0] + 1j * each[use, 1] for each in (pairs.motions, odometry))
    ratio = base / scans * np.exp(0.5j * (pairs.motions[use, 2] - odometry[use, 2]))
    middle = complex(np.median(ratio.real), np.median(ratio.imag))
    return float(np.angle(middle)), float(np.clip(1 / max(abs(middle), 1e-3), 0.01, 100))


def _drift_by_turns(pairs: Pairs, p: Array, path: Path) -> tuple[float, float]:
    """The drift of the clocks by turns alone [s/s], and its variance, from parameters that are nearly right.

    Wheels that lead the robot, or slip, move lengths against turns, which the gyro knows to milliradians.
    """
    which = [Parameter.OFFSET, Parameter.DRIFT, Parameter.TURNS]
    begin = q = p[which]
    prior, since, scans, h = np.diag(1 / PRIOR[which] ** 2), pairs.first - pairs.middle, pairs.motions[:, 2], RATE / 2
    for _ in range(SHARPENING):
        began, ended = (time + q[0] + q[1] * (time - pairs.middle) for time in (pairs.first, pairs.last))
        apart = se2.wrap(q[2] * scans - (path(ended) - path(began))[:, 2])
        faster = (path(ended + h) - path(ended - h) - path(began + h) + path(began - h))[:, 2] / RATE
        jacobian = np.stack((faster, faster * since, -scans), axis=1)
        usual = max(float(np.median(np.abs(apart))) / MEDIAN, 1e-5)
        weighted = jacobian / (usual**2 * (1 + (apart / usual / TAIL) ** 2))[:, None]
        normal, gradient = weighted.T @ jacobian + prior, weighted * apart[:, None]
        q = q + np.linalg.solve(normal, gradient.sum(axis=0) - prior @ (q - begin))
    return float(q[1]), max(float(each[1, 1]) for each in _sandwich(normal, gradient))


def _sandwich(normal: Array, gradient: Array) -> tuple[Array, Array]:
    """The covariance [p, p] of parameters as parts of a recording scatter, and as the normal matrix has it.

    Of a normal matrix [p, p] and gradients of pairs [k, p].
    """
    inverse, parts = np.asarray(np.linalg.inv(normal), np.float64), parts_of(gradient)
    return np.asarray(inverse @ (parts.T @ parts) @ inverse), inverse


def _ratio_of_lengths(pairs: Pairs, expected: Array, robust: Array) -> tuple[float, float]:
    """The ratio of lengths by the scans to expected ones, with its deviation.

    Both have errors, of stamps above all, and least squares would find too small a ratio: sums are compared, in the
    direction of the motion. Lengths that registration stopped short of, and wheels that slip, lie on one side, and are
    cut off (Tukey).
    """
    ways = [each[:, :2] / np.maximum(np.hypot(*each[:, :2].T), 0.02)[:, None] for each in (pairs.motions, expected)]
    along = ways[0] + ways[1]
    along /= np.maximum(np.hypot(*along.T), 1e-6)[:, None]
    variance = np.einsum("ki,kij,kj->k", along, pairs.covariances[:, :2, :2], along)
    measured = variance < UNMEASURED
    if measured.sum() < FEWEST:
        return 1.0, 1.0
    by_scans, by_odometry = ((each[:, :2] * along).sum(axis=1) for each in (pairs.motions, expected))
    turns = np.abs(pairs.motions[:, 2])
    weight = whole = np.where(measured, robust / (variance + 0.02**2 * (1 + (turns / STRAIGHT) ** 2)), 0.0)
    counts = whole > 0.1 * np.percentile(whole[measured], 90)
    ratio, deviation = 1.0, 1.0
    for _ in range(8):
        total = float((weight * by_odometry).sum())
        ratio = float((weight * by_scans).sum()) / max(total, 1e-9)
        if not 0.5 < ratio < 2:  # lengths are hardly measured
            return 1.0, 1.0
        apart = by_scans - ratio * by_odometry
        deviation = float(np.sqrt((parts_of(weight * apart) ** 2).sum())) / total
        size = np.abs(apart) * np.sqrt(whole)
        weight = whole * np.maximum(1 - (size / max(5 * float(np.median(size[counts])), 1e-9)) ** 2, 0) ** 2
    usual = measured & (np.abs(by_odometry) > LONG_ENOUGH) & (turns < NEARLY)
    middle = float(np.median(by_scans[usual] / by_odometry[usual])) if usual.sum() >= FEWEST else 1.0
    if abs(ratio - middle) > abs(ratio - 1) / 2:  # it is of a few pairs, along a corridor perhaps
        deviation = max(deviation, abs(ratio - middle))
    return ratio, deviation
