"""The lidar's mount, clock and scale against odometry, from motions that both measured: hand-eye calibration.

The lidar's motion is X^-1 m X for a motion m of the robot and a mount X (Censi, Franchi, Marchionni and Oriolo 2013,
Simultaneous calibration of odometry and sensor parameters). Of lengths only the ratio of the two can be seen.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2

Array = NDArray[np.float64]
Path = Callable[[Array], Array]
"""Gives the odometry's poses [m, 3] at times [m] [s]."""

FLOOR = np.array([0.004, 0.004, 0.003, 0.007, 0.01, 0.01, 4e-5])
"""Standard deviations are no smaller: what the model leaves out, slip and the shape of walls."""
ODOMETRY = (0.005, 0.03, 0.01, 0.1)
"""Deviation of its lengths [m], per metre, of its turns [rad], per radian: those of `CalibrationConfig`."""
PRIOR = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 1.0, 0.01])
"""Standard deviations about where the fit begins, the mount about none."""
DEGENERATE = 0.2
"""A direction that scans measure by less than this share of the other they do not measure."""
UNMEASURED = 1.0
"""Variance from which on a length counts as not measured [m^2]."""
FEWEST = 15
"""Fewer pairs that measure a length give no ratio."""
BLOCKS = 25
"""Parts of a recording whose scatter gives the deviations."""
TAIL = 2.5
"""Weighted residuals beyond it lose weight (Cauchy)."""
LONGEST, STEP = 8.0, 0.05
"""Offsets of clocks up to this are looked for, in steps [s]."""
MOST_DRIFT = 0.012
"""Likewise their drift [s/s]."""


class Parameter(IntEnum):
    """Where each parameter of a fit is: mount [m], [rad]; ratios of lengths and turns; clocks [s], [s/s]."""

    X = 0
    Y = 1
    YAW = 2
    LENGTHS = 3
    TURNS = 4
    OFFSET = 5
    DRIFT = 6


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
    """A lidar against odometry.

    Attributes:
        values: [7] mount x, y [m], yaw [rad]; lengths by scans over those by odometry; turns likewise; the time that
            the odometry's stamps are late by [s], and how that changes [s/s].
        deviations: [7] their standard deviations.
        cost: mean robust cost of a pair; about 3 where the model holds.
        middle: the time that the drift counts from [s].
    """

    values: Array
    deviations: Array
    cost: float
    middle: float

    def expected(self, first: Array, last: Array, path: Path, turns: Array | None = None) -> Array:
        """The lidar's motions [k, 3] between times [k]; lengths go along turns [k], if these are given."""
        return _expected(self.values, first, last, self.middle, path, turns)


def covariances(information: Array, deviation: Array) -> Array:
    """Of motions [k, 3] by scans, from their information for unit variance; along what they do not measure, huge."""
    values, vectors = np.linalg.eigh(information[:, :2, :2])
    weak = values[:, 0] < DEGENERATE * values[:, 1]
    covariance = np.linalg.inv(information + 1e-6 * np.eye(3)) * np.maximum(deviation, 0.005)[:, None, None] ** 2
    covariance += 1e-6 * np.eye(3)
    along = vectors[:, :, 0] * np.where(weak, 10.0, 0.0)[:, None]
    covariance[:, :2, :2] += along[:, :, None] * along[:, None, :]
    return np.asarray(covariance)


def clock(pairs: Pairs, stamps: Array, headings: Array) -> tuple[float, float, float]:
    """Offset [s] and drift [s/s] at which the turns of both agree best, and their correlation there, of either sign.

    Args:
        stamps: [n] of the odometry [s].
        headings: [n] its headings, unwrapped [rad].
    """
    turns = pairs.motions[:, 2]
    limit = 3 * np.median(np.abs(turns)) + 0.05
    turns_by_scans = np.clip(turns, -limit, limit)
    turns_by_scans = turns_by_scans - turns_by_scans.mean()
    lags = np.arange(-LONGEST, LONGEST + STEP / 2, STEP)
    span = max(float(np.ptp(pairs.first)), 1.0)
    steps = int(min(MOST_DRIFT * span / 0.4, 25))
    best, found = -np.inf, (0.0, 0.0, 0.0)
    for drift in np.linspace(-steps, steps, 2 * steps + 1) * 0.4 / span:
        shift = drift * (pairs.first - pairs.middle) + lags[:, None]
        began, ended = (np.interp(times + shift, stamps, headings) for times in (pairs.first, pairs.last))
        turns_by_odometry = np.clip(ended - began, -limit, limit)
        turns_by_odometry = turns_by_odometry - turns_by_odometry.mean(axis=1, keepdims=True)
        scale = np.sqrt((turns_by_scans**2).sum() * (turns_by_odometry**2).sum(axis=1))
        correlation = (turns_by_scans * turns_by_odometry).sum(axis=1) / np.maximum(scale, 1e-9)
        score = np.abs(correlation) - 0.004 * np.abs(lags) - abs(drift)  # of equals, the one that says least
        k = int(score.argmax())
        if score[k] > best:
            best, found = float(score[k]), (float(lags[k]), float(drift), float(correlation[k]))
    return found


def fit(pairs: Pairs, path: Path, clocks: tuple[float, float], *, shared: bool) -> Fit:
    """Fit a lidar to odometry: iterated weighted least squares, with the deviations of a clustered sandwich.

    Args:
        shared: the two are on one clock; then these are not estimated.
    """

    def residuals(p: Array) -> Array:
        expected = _expected(p, pairs.first, pairs.last, pairs.middle, path, pairs.motions[:, 2])
        apart = pairs.motions - expected
        apart[:, 2] = se2.wrap(apart[:, 2])
        return apart

    p = np.array([0.0, 0.0, 0.0, 1.0, 1.0, *clocks])
    stated = _expected(p, pairs.first, pairs.last, pairs.middle, path)
    p[Parameter.YAW], p[Parameter.LENGTHS] = _direction(pairs, stated)
    per_length, per_turn = np.hypot(stated[:, 0], stated[:, 1]), np.abs(stated[:, 2])
    noise = np.stack((ODOMETRY[0] + ODOMETRY[1] * per_length,) * 2 + (ODOMETRY[2] + ODOMETRY[3] * per_turn,), axis=1)
    weights = np.linalg.inv(pairs.covariances + noise[:, :, None] ** 2 * np.eye(3))
    steps = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 0.02, 0.02 / max(float(np.ptp(pairs.first)), 1.0)])
    free = np.ones(7, bool)
    free[CLOCKS] = not shared
    prior, begin = np.diag(np.where(free, 1 / PRIOR**2, 1e12)), p
    for _ in range(12):
        apart = residuals(p)
        each = [(residuals(p - h) - residuals(p + h)) / (2 * s) for h, s in zip(np.diag(steps), steps, strict=True)]
        jacobian = np.stack(each, axis=-1) * free
        square = np.einsum("ki,kij,kj->k", apart, weights, apart)
        robust = 1 / (1 + square / TAIL**2)
        normal = np.einsum("kip,kij,kjq,k->pq", jacobian, weights, jacobian, robust) + prior
        gradient = np.einsum("kip,kij,kj,k->kp", jacobian, weights, apart, robust)
        p = p + np.linalg.solve(normal, gradient.sum(axis=0) - prior @ (p - begin))
    inverse = np.linalg.inv(normal)
    parts = _parts(gradient)
    spread = inverse @ (parts.T @ parts) @ inverse
    deviations = np.hypot(np.sqrt(np.maximum(np.diag(spread), np.diag(inverse))), FLOOR)
    expected = _expected(p, pairs.first, pairs.last, pairs.middle, path, pairs.motions[:, 2])
    for k, (ratio, deviation) in enumerate(_ratios(pairs, expected, robust), start=Parameter.LENGTHS):
        p[k], deviations[k] = p[k] * ratio, np.hypot(p[k] * deviation, FLOOR[k])
    p[Parameter.YAW] = se2.wrap(p[Parameter.YAW])
    return Fit(p, deviations, float((TAIL**2 * np.log1p(square / TAIL**2)).mean()), pairs.middle)


def _expected(p: Array, first: Array, last: Array, middle: float, path: Path, turns: Array | None = None) -> Array:
    began, ended = (path(time + p[Parameter.OFFSET] + p[Parameter.DRIFT] * (time - middle)) for time in (first, last))
    motion = np.asarray(se2.between(began, ended))
    turn = p[Parameter.TURNS] * motion[:, 2]
    bend = ((turn if turns is None else turns) - motion[:, 2]) / 2  # turns by the scans are the better ones
    cos, sin = p[Parameter.LENGTHS] * np.cos(bend), p[Parameter.LENGTHS] * np.sin(bend)
    x, y = cos * motion[:, 0] - sin * motion[:, 1], sin * motion[:, 0] + cos * motion[:, 1]
    moved = np.stack((x, y, turn if turns is None else turns), axis=1)
    lidar = np.asarray(se2.compose(se2.compose(se2.inverse(p[MOUNT]), moved), p[MOUNT]))
    lidar[:, 2] = turn
    return lidar


def _direction(pairs: Pairs, odometry: Array) -> tuple[float, float]:
    """The yaw of the mount and the ratio of lengths, by the pairs that are nearly straight: to begin with."""
    size = np.hypot(odometry[:, 0], odometry[:, 1])
    measured = np.linalg.eigvalsh(pairs.covariances[:, :2, :2])[:, 1] < UNMEASURED
    lengths = np.hypot(pairs.motions[:, 0], pairs.motions[:, 1])
    use = measured & (np.abs(pairs.motions[:, 2]) < 0.2) & (size > 0.5 * np.percentile(size, 80)) & (lengths > 0.01)
    if use.sum() < FEWEST:
        return 0.0, 1.0
    scans, base = (each[use, 0] + 1j * each[use, 1] for each in (pairs.motions, odometry))
    ratio = base / scans * np.exp(0.5j * (pairs.motions[use, 2] - odometry[use, 2]))
    middle = complex(np.median(ratio.real), np.median(ratio.imag))
    return float(np.angle(middle)), float(np.clip(1 / max(abs(middle), 1e-3), 0.01, 100))


def _ratios(pairs: Pairs, expected: Array, robust: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """The ratios of lengths and of turns by the scans to expected ones, with their deviations.

    Both have errors, of stamps above all, and least squares would find too small a ratio: sums are compared, of lengths
    in the direction of the motion, and of turns by the direction that both have together. Lengths that registration
    stopped short of, and wheels that slip, lie on one side, and are cut off (Tukey).
    """
    ways = [each[:, :2] / np.maximum(np.hypot(*each[:, :2].T), 0.02)[:, None] for each in (pairs.motions, expected)]
    along = ways[0] + ways[1]
    along /= np.maximum(np.hypot(*along.T), 1e-6)[:, None]
    variance = np.einsum("ki,kij,kj->k", along, pairs.covariances[:, :2, :2], along)
    together = np.clip(pairs.motions[:, 2] + expected[:, 2], -0.5, 0.5)
    turns = _ratio(pairs.motions[:, 2], expected[:, 2], robust * together / (pairs.covariances[:, 2, 2] + 0.02**2))
    measured = variance < UNMEASURED
    if measured.sum() < FEWEST:
        return (1.0, 1.0), turns
    by_scans, by_odometry = ((each[:, :2] * along).sum(axis=1) for each in (pairs.motions, expected))
    weight = whole = np.where(measured, robust / (variance + 0.02**2), 0.0)
    counts = whole > 0.1 * np.percentile(whole[measured], 90)
    lengths = 1.0, 1.0
    for _ in range(8):
        lengths = _ratio(by_scans, by_odometry, weight)
        if not 0.5 < lengths[0] < 2:  # lengths are hardly measured
            return (1.0, 1.0), turns
        apart = np.abs(by_scans - lengths[0] * by_odometry) * np.sqrt(whole)
        weight = whole * np.maximum(1 - (apart / max(5 * float(np.median(apart[counts])), 1e-9)) ** 2, 0) ** 2
    return lengths, turns


def _ratio(by_scans: Array, by_odometry: Array, weight: Array) -> tuple[float, float]:
    total = float((weight * by_odometry).sum())
    if not total > 1e-9:
        return 1.0, 1.0
    ratio = float((weight * by_scans).sum()) / total
    return ratio, float(np.sqrt((_parts(weight * (by_scans - ratio * by_odometry)) ** 2).sum())) / total


def _parts(values: Array) -> Array:
    """The sums [BLOCKS, ...] over parts of a recording of values [k, ...]."""
    return np.array([part.sum(axis=0) for part in np.array_split(values, min(BLOCKS, len(values)))])
