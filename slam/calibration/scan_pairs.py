"""Pairs of scans registered to each other, all at once, without odometry: the motion of the lidar between them.

Endpoints are held to the lines through the other scan's endpoints (point to line). Which endpoint belongs to which line
is found by bearing, as in polar scan matching, so that every step is an operation on arrays [pairs, beams].
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.se2 import Array
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import least_bound_turn

Flags = NDArray[np.bool_]

LINE = 0.15
"""Endpoints this near, plus `LINE_SHARE` of the range, make up the line at an endpoint [m]."""
LINE_SHARE = 0.06
LINE_BEAMS = 6
"""At most this many beams to either side make up a line."""
REACH = (1.0, 0.5, 0.3, 0.2)
"""Residuals beyond this are left out, step by step; the last one holds from there on [m]."""
STEPS, REFINING = 12, 5
SCALE = 0.05
"""Of the weights of residuals, Geman-McClure [m]."""
SECTORS = 4
"""Of a fan, whose angles are scaled each by itself."""
AGREEMENT = 0.8
"""Least cosine between the normals of two surfaces that are held to each other."""
NEARER = 0.3
"""What a lidar has come nearer to by this much, half of it for errors, is no longer seen if it is not there [m]."""
LEAST_FIT = 0.6
"""A pair is registered where this share of the endpoints fits."""
LEAST_BEAMS = 25
"""And at least this many."""
DEGENERATE = 0.2
"""A direction that scans measure by less than this share of the other they do not measure."""


class Beams(NamedTuple):
    angles: Array  # [b] in the lidar's frame [rad]
    shares: Array  # [b] of the sweep at which each is measured, 0 to 1
    sweep: float  # how long a sweep takes [s]


@dataclass(frozen=True, eq=False)
class Motions:
    """What the registration of k pairs found."""

    motions: Array  # [k, 3] of the lidar from the former scan to the latter, in its frame there
    information: Array  # [k, 3, 3] of them, for residuals of unit variance
    deviation: Array  # [k] of a residual [m]
    fit: Array  # [k] share of the endpoints that fit
    good: Flags  # [k] which pairs are registered
    # [k, w] of half the squared residuals of each pair by what all pairs have in common, an offset of all ranges [m], a
    # scale of the angles in each of `SECTORS` sectors, and, last, by how much more the lidar turns in the latter's
    # sweep than in the former's [rad]; its motion is eliminated
    gradients: Array
    about_warps: Array  # [k, w, w] the information of these, for residuals of unit variance

    @property
    def covariances(self) -> Array:
        """[k, 3, 3] of the motions; along what the scans do not measure, huge."""
        values, vectors = np.linalg.eigh(self.information[:, :2, :2])
        weak = values[:, 0] < DEGENERATE * values[:, 1]
        covariance = np.linalg.inv(self.information + 1e-6 * np.eye(3))
        covariance = covariance * np.maximum(self.deviation, 0.005)[:, None, None] ** 2 + 1e-6 * np.eye(3)
        along = vectors[:, :, 0] * np.where(weak, 10.0, 0.0)[:, None]
        covariance[:, :2, :2] += along[:, :, None] * along[:, None, :]
        return np.asarray(covariance)

    def take(self, at: NDArray[Any], other: Self, where: NDArray[Any]) -> None:
        """At pairs what another registration found where."""
        for mine, others in zip(vars(self).values(), vars(other).values(), strict=True):
            mine[at] = others[where]


def register(former: Array, latter: Array, beams: Beams, seconds: Array, turns: Sequence[float]) -> Motions:
    """Register pairs of scans, of ranges [k, b] [m], not finite where there is no endpoint, so many seconds [k] apart.

    The lidar is taken to move evenly between them and during a sweep. All begin with a turn [rad]; a pair that one does
    not register begins with the next.
    """
    starts = np.zeros((len(turns), len(former), 3))
    starts[..., 2] = np.reshape(turns, (-1, 1))
    found = _register(former, latter, beams, seconds, starts[0], STEPS)
    for start in starts[1:]:
        again = np.flatnonzero(~found.good)
        if len(again):
            other = _register(former[again], latter[again], beams, seconds[again], start[again], STEPS)
            found.take(again[other.good], other, other.good)
    return found


def refine(
    former: Array,
    latter: Array,
    beams: Beams,
    seconds: Array,
    motions: Array,
    other: Motions | None = None,
    *,
    rates: tuple[Array, Array] | None = None,
) -> Motions:
    """The same from motions [k, 3] that are nearly right; where another registration fits better, that one.

    ``rates``: [k] at which the lidar turns during the former sweeps and during the latter ones [rad/s].
    """
    found = _register(former, latter, beams, seconds, motions, REFINING, rates)
    if other is not None:
        worse = other.good & ~(found.good & (cost(found) <= cost(other)))
        found.take(worse, other, worse)
    return found


def cost(found: Motions) -> Array:
    """[k] Of pairs: the less, the better they fit."""
    return np.asarray(found.deviation / np.maximum(found.fit, 0.05))


def _register(
    former: Array,
    latter: Array,
    beams: Beams,
    seconds: Array,
    start: Array,
    steps: int,
    rates: tuple[Array, Array] | None = None,
) -> Motions:
    motion = start.astype(np.float64).copy()
    pairs = np.arange(len(motion))[:, None]
    lines = None
    for k in range(STEPS - steps, STEPS):
        reach = REACH[min(k // 2, len(REACH) - 1)]
        if lines is None or (beams.sweep > 0 and k in (4, 9)):
            velocity = motion / np.maximum(seconds, 1e-3)[:, None]
            turning = rates or (velocity[:, 2], velocity[:, 2])
            ends = _points(former, beams, velocity, turning[0])
            lines = _lines(ends, former)
            own, facing, faced = _lines(_points(latter, beams, velocity, turning[1]), latter)
        ends, normals, known = lines
        arm = _turned(own, motion[:, 2])
        placed = arm + motion[:, None, :2]
        index, inside = _towards(placed, beams)
        normal, end = normals[pairs, index], ends[pairs, index]
        apart = placed - end
        residual = (normal * apart).sum(axis=-1)
        near = np.hypot(apart[..., 0], apart[..., 1]) < reach + 0.1 * np.abs(former[pairs, index])
        alike = faced & (np.abs((_turned(facing, motion[:, 2]) * normal).sum(axis=-1)) > AGREEMENT)
        seen = inside & known[pairs, index] & np.isfinite(residual)
        near &= alike
        held = seen & near & (np.abs(residual) < reach)
        residual = np.where(held, residual, 0.0)
        weight = np.where(held, 1 / (1 + (residual / SCALE) ** 2) ** 2, 0.0)
        jacobian = np.stack(
            (normal[..., 0], normal[..., 1], normal[..., 1] * arm[..., 0] - normal[..., 0] * arm[..., 1]), axis=-1
        )
        jacobian = np.where(held[..., None], jacobian, 0.0)
        weighted = jacobian.swapaxes(1, 2) * weight[:, None]
        information, gradient = weighted @ jacobian, (weighted @ residual[..., None])[..., 0]
        damped = information + np.eye(3) * (1e-3 * np.trace(information, axis1=1, axis2=2)[:, None, None] / 3 + 1e-6)
        if k < STEPS - 1:
            motion -= np.clip(np.linalg.solve(damped, gradient[..., None])[..., 0], -0.3, 0.3)
    fits = held & (np.abs(residual) < 2 * SCALE)
    count = seen.sum(axis=1)
    fit = fits.sum(axis=1) / np.maximum(count, 1)
    total = np.maximum(weight.sum(axis=1), 1e-9)
    deviation = np.sqrt((weight * residual**2).sum(axis=1) / total)
    good = (fits.sum(axis=1) >= LEAST_BEAMS) & (fit > LEAST_FIT) & (count > 0.3 * np.isfinite(latter).sum(axis=1))
    good &= _turns_known(information, np.where(held[..., None], arm, 0.0), weight, deviation)
    bend = np.where(held[..., None], _warps(arm, end, normal, beams, index), 0.0)
    across = weighted @ bend
    solved = np.linalg.solve(damped, np.concatenate((across, gradient[..., None]), axis=-1))
    by_warp = np.einsum("kbw,kb->kw", bend, weight * residual) - np.einsum("kiw,ki->kw", across, solved[..., -1])
    about = (bend.swapaxes(1, 2) * weight[:, None]) @ bend - np.einsum("kiv,kiw->kvw", across, solved[..., :-1])
    return Motions(motion, information, deviation, fit, good, by_warp, about)


def seen_through(former: Array, latter: Array, beams: Beams, seconds: Array, motions: Array) -> tuple[Flags, Flags]:
    """[k, b] To which endpoints of latter scans the lidar is nearer in the former ones, at motions [k, 3], where it has
    endpoints in that direction, too; and which of them lie before these.
    """
    velocity = motions / np.maximum(seconds, 1e-3)[:, None]
    placed = _turned(_points(latter, beams, velocity, velocity[:, 2]), motions[:, 2]) + motions[:, None, :2]
    near, (index, inside) = np.hypot(placed[..., 0], placed[..., 1]), _towards(placed, beams)
    there = np.fmin(np.fmin(_beside(former, 1), _beside(former, -1)), former)[np.arange(len(near))[:, None], index]
    nearer = inside & np.isfinite(there) & (latter - near > NEARER)
    return nearer, nearer & (near < there - NEARER / 2)


def _towards(points: Array, beams: Beams) -> tuple[NDArray[np.intp], Flags]:
    """[k, b] The beam towards each of points [k, b, 2], and whether there is one."""
    step = (beams.angles[-1] - beams.angles[0]) / (len(beams.angles) - 1)
    bearing = np.arctan2(points[..., 1], points[..., 0])
    at = np.mod((bearing - beams.angles[0]) / step + 0.5, 2 * np.pi / abs(step)) - 0.5
    inside = at < len(beams.angles) - 0.5
    return np.where(inside & np.isfinite(at), np.rint(at), 0).astype(np.intp), inside


def _turns_known(information: Array, arm: Array, weight: Array, deviation: Array) -> Flags:
    """[k] whether endpoints ``arm`` [k, b, 2] bind turns by more than the noise of the normals: in a round room, no."""
    total = np.maximum(weight.sum(axis=1), 1e-9)
    means = np.column_stack((np.einsum("kbi,kb->ki", arm, weight), np.einsum("kbi,kbi,kb->k", arm, arm, weight)))
    variances = np.square(deviation / RegistrationConfig().residual)
    _, bound = least_bound_turn(
        information, means / total[:, None], variances, np.zeros(len(total)), RegistrationConfig()
    )
    return np.asarray(bound > 0.5)


def _warps(arm: Array, end: Array, normal: Array, beams: Beams, index: NDArray[np.intp]) -> Array:
    """The derivatives of residuals [k, b, w] by what all pairs have in common, as of `Motions`."""
    edges = np.linspace(beams.angles[0], beams.angles[-1], SECTORS + 1)
    wide = np.abs(edges[1] - edges[0])
    sign = np.sign(edges[1] - edges[0])
    angles = sign * np.clip(sign * (beams.angles[:, None] - edges[:-1]), 0.0, wide)  # [b, s]
    times = beams.shares[:, None] - 0.5
    both, nx, ny = (arm, end), normal[..., 0, None], normal[..., 1, None]
    sizes = (np.maximum(np.hypot(each[..., 0], each[..., 1]), 1e-6) for each in both)
    facing, faced = ((normal * each).sum(axis=-1) / size for each, size in zip(both, sizes, strict=True))
    mine, their = (ny * each[..., 0, None] - nx * each[..., 1, None] for each in both)
    bent = (mine * times + their * times[index]) / 2
    return np.concatenate(((facing - faced)[..., None], mine * angles - their * angles[index], bent), axis=-1)


def _turned(points: Array, turns: Array) -> Array:
    """Points [k, b, 2] turned by as many angles [k], or one each [k, b] [rad]."""
    turns = turns.reshape(len(turns), -1)
    cos, sin = np.cos(turns), np.sin(turns)
    x, y = points[..., 0], points[..., 1]
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=-1)


def _points(ranges: Array, beams: Beams, velocity: Array, rate: Array) -> Array:
    """Endpoints [k, b, 2] in the lidar's frame in the middle of the sweep, in which it turns at a rate [k] [rad/s]."""
    points: Array = ranges[..., None] * np.stack((np.cos(beams.angles), np.sin(beams.angles)), axis=-1)
    if not beams.sweep > 0:
        return points
    time = beams.sweep * (beams.shares - 0.5)
    return _turned(points, rate[:, None] * time) + velocity[:, None, :2] * time[:, None]


def _lines(points: Array, ranges: Array) -> tuple[Array, Array, Flags]:
    """Endpoints [k, b, 2] laid on the lines through them and their neighbours, the normals of these [k, b, 2], and
    which endpoints have one [k, b].

    Noise of ranges would be taken for a scale of the angles: it is in a residual and in its derivative.
    """
    reach = LINE + LINE_SHARE * ranges
    known = np.isfinite(ranges)
    x, y = (np.where(known, points[..., axis], 0.0) for axis in (0, 1))
    count, sx, sy, xx, xy, yy = (np.zeros_like(ranges) for _ in range(6))
    joined = [known, known]
    for offset in range(1, LINE_BEAMS + 1):
        for side, sign in enumerate((1, -1)):
            dx, dy = _beside(x, sign * offset) - x, _beside(y, sign * offset) - y
            near = _beside(known, sign * offset) & (dx * dx + dy * dy < reach * reach) & joined[side]
            joined[side] = near
            dx *= near
            dy *= near
            count += near
            sx += dx
            sy += dy
            xx += dx * dx
            xy += dx * dy
            yy += dy * dy
    n = count + 1
    xx, xy, yy = xx - sx * sx / n, xy - sx * sy / n, yy - sy * sy / n
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    normals = np.stack((-np.sin(angle), np.cos(angle)), axis=-1)
    spread = np.hypot(xx - yy, 2 * xy)
    thin = (xx + yy - spread) < 0.15 * (xx + yy + spread)
    across = (normals[..., 0] * sx + normals[..., 1] * sy) / n
    return points + across[..., None] * normals, normals, known & (count >= 3) & thin


def _beside(values: Any, offset: int) -> Any:
    """The values of the beam that is ``offset`` farther; zeros beyond the ends."""
    wide = np.pad(values, ((0, 0), (LINE_BEAMS, LINE_BEAMS)))
    return wide[:, LINE_BEAMS + offset : wide.shape[1] - LINE_BEAMS + offset]
