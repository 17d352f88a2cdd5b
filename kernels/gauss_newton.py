"""Gauss-Newton on one level of a signed-distance map: the step that registration repeats, inside kernels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.kernels.checks import as_finite
from moteslam.kernels.runtime import ti
from moteslam.kernels.tiles import STEPS, bilinear
from moteslam.kernels.types import F32, F64, F64_2D, I32, func, kernel, template

CONVERGED_SHIFT, CONVERGED_TURN = 3e-4, 1e-4
"""Gauss-Newton ends where a step is below both, or the steps still to come are together, |x| + |y| [m] and |theta|
[rad]: far less than a cell, which is all that interpolated distances can resolve."""
COARSE_STEP = 10.0  # On the coarse level the bounds are so many times as large: the fine level begins where it ended
LEAST_PIVOT = 1e-9  # Keeps the square roots of the Cholesky factors real where rounding would not


@func
def solve(h: template, b: template):
    """The solution of a symmetric positive 3 x 3 system by Cholesky; h holds 00 01 02 11 12 22."""
    l00 = ti.sqrt(h[0])
    l10, l20 = h[1] / l00, h[2] / l00
    l11 = ti.sqrt(ti.max(h[3] - l10 * l10, LEAST_PIVOT))
    l21 = (h[4] - l20 * l10) / l11
    l22 = ti.sqrt(ti.max(h[5] - l20 * l20 - l21 * l21, LEAST_PIVOT))
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    x2 = y2 / l22
    x1 = (y1 - l21 * x2) / l11
    x0 = (y0 - l10 * x1 - l20 * x2) / l00
    return ti.Vector([x0, x1, x2], dt=ti.f32)


@func
def place_in_cells(frame: template, d: template, inverse: F32):
    """The robot's pose in the map: cos and sin of its heading [cells/m], then x and y [cells].

    ``frame`` is cos, sin, x, y [m] of a pose, ``d`` the offset from it, in its frame; ``inverse`` is cells in a metre.
    """
    c, s = ti.cos(d[2]), ti.sin(d[2])
    x, y = frame[0] * d[0] - frame[1] * d[1] + frame[2], frame[1] * d[0] + frame[0] * d[1] + frame[3]
    cs, sn = frame[0] * c - frame[1] * s, frame[1] * c + frame[0] * s
    return ti.Vector([cs, sn, x, y], dt=ti.f32) * inverse


@func
def square(jx: F32, jy: F32, jt: F32):
    """The outer product of a Jacobian with itself: 00 01 02 11 12 22."""
    return ti.Vector([jx * jx, jx * jy, jx * jt, jy * jy, jy * jt, jt * jt], dt=ti.f32)


@func
def by_offset(h: template, frame: template, per_cell: F32, per_step: F32):
    """Information about the robot's pose in the map, as information about its offset from ``frame``.

    The first is of residuals in steps of distance, about x, y [cells] and theta; the second of residuals in standard
    deviations, ``per_step`` to a step, about x, y [m] and theta in the frame. ``per_cell`` is ``per_step`` times cells
    in a metre.
    """
    c, s = frame[0] * per_cell, frame[1] * per_cell
    both = 2 * c * s * h[1]
    return ti.Vector(
        [
            c * c * h[0] + both + s * s * h[3],
            c * s * (h[3] - h[0]) + (c * c - s * s) * h[1],
            (c * h[2] + s * h[4]) * per_step,
            s * s * h[0] - both + c * c * h[3],
            (c * h[4] - s * h[2]) * per_step,
            h[5] * per_step * per_step,
        ],
        dt=ti.f32,
    )


@func
def length_of(step: template):
    """Of a step, as a multiple of the bounds of convergence."""
    return ti.max((ti.abs(step[0]) + ti.abs(step[1])) / CONVERGED_SHIFT, ti.abs(step[2]) / CONVERGED_TURN)


@func
def descend(
    pool: template, table: template, base: I32, columns: I32, last_x: F32, last_y: F32, frame: template,
    scan: template, points: I32, start: template, prior: template, cell: F32, truncation: F32, sd: F32, iterations: I32,
    level: template,
):  # fmt: skip
    """Gauss-Newton on one level. Returns the offset from the frame (x, y [m], theta), in the frame.

    It ends where the steps still to come are short: if each is q times the one before, together they are q / (1 - q)
    times the last one (Hairer and Wanner 1996, Solving Ordinary Differential Equations II, section IV.8). Where a step
    undoes the one before, it would go to and fro until the iterations are used up, between two poses whose endpoints
    lie in other cells, or over cells known to one of them alone: it ends halfway.

    The sums over the endpoints are about the pose in the map, in cells and steps of distance: turned into the frame are
    the sums, not the endpoints.
    """
    d = ti.Vector([start[0], start[1], start[2]], dt=ti.f32)
    inverse, per_step = 1.0 / cell, truncation / (sd * STEPS)
    per_cell = per_step * inverse
    running, last, last_length = 1, ti.Vector([0.0] * 3, dt=ti.f32), 0.0
    for _ in range(iterations):
        if running == 1:
            place = place_in_cells(frame, d, inverse)
            h = ti.Vector([0.0] * 6, dt=ti.f32)
            bx, by, bt = 0.0, 0.0, 0.0
            for j in range(points):
                rx, ry = place[0] * scan[0, j] - place[1] * scan[1, j], place[1] * scan[0, j] + place[0] * scan[1, j]
                gx, gy = ti.min(ti.max(rx + place[2], 1.0), last_x), ti.min(ti.max(ry + place[3], 1.0), last_y)
                f = bilinear(pool, table, base, columns, gx, gy, level)
                if f[3] > 0:
                    turn = f[2] * rx - f[1] * ry
                    h += square(f[1], f[2], turn)
                    bx += f[1] * f[0]
                    by += f[2] * f[0]
                    bt += turn * f[0]
            a = by_offset(h, frame, per_cell, per_step) + ti.Vector(
                [prior[0], 0.0, 0.0, prior[1], 0.0, prior[2]], dt=ti.f32
            )
            b = ti.Vector(
                [
                    -prior[0] * (d[0] - prior[3]) - (frame[0] * bx + frame[1] * by) * per_cell * per_step,
                    -prior[1] * (d[1] - prior[4]) - (frame[0] * by - frame[1] * bx) * per_cell * per_step,
                    -prior[2] * (d[2] - prior[5]) - bt * per_step * per_step,
                ],
                dt=ti.f32,
            )
            step = solve(a, b)
            bound = ti.static(COARSE_STEP if level == 1 else 1.0)
            length = length_of(step)
            undone = step + last
            if length < bound or length * length < bound * (last_length - length):
                running = 0
            elif length_of(undone) < bound:
                step *= 0.5
                running = 0
            d += step
            last, last_length = step, length
    return d


LEAST_INFORMATION, LEAST_RATIO = 1e-9, 1e-12
"""What the information of a scan, and the ratio of that along a degenerate direction, count as at least."""
RIDGE = 1e-3  # Added to the information about the position before it is inverted, as a share of that both ways
MOST_NOISE = 4.0  # The variance of residuals that is a lidar's noise, of 2 cm, in standard ones; more is people
NOISE_RATIO = 0.016
"""The ratio that noise of the map's slopes alone makes for turns, where residuals have the variance of standard ones.

In a round tank of 4 m it is 0.004 to 0.013 times the residuals' variance, with three lidars of 0.5 to 3 cm of
noise, to the filter's maps as between two scans. In rooms, corridors and on csail it is 0.08 to 0.4, whatever that
variance.
"""


class Kept(NamedTuple):
    """How a prediction is kept along degenerate directions."""

    deviation: float  # standard deviation of the prediction [m]
    error: float  # of the registration along a direction that is informed as well as the one across [m]


NOT_KEPT = Kept(0.0, 0.0)


@func
def keep_prediction(
    found: template, i: I32, deviation: F64, error: F64, variance: F64, mx: F64, my: F64, square: F64
):  # fmt: skip
    """Row i of ``found``, an offset (x, y, theta) and its information 00 01 02 11 12 22, as ``keep_predictions``.

    ``variance`` is of the residuals; ``mx``, ``my`` and ``square`` are the endpoints' means of x, y and x^2 + y^2 from
    the robot, in the axes of the offset [m, m^2].
    """
    xx, xy, xt, yy, yt, tt = found[i, 3], found[i, 4], found[i, 5], found[i, 6], found[i, 7], found[i, 8]
    middle, half = (xx + yy) / 2, ti.sqrt(((xx - yy) / 2) ** 2 + xy * xy)
    most, total = ti.max(middle + half, LEAST_INFORMATION), ti.max(2 * middle, LEAST_INFORMATION)
    heading = ti.atan2(2 * xy, xx - yy) / 2  # of the most informed direction
    ax, ay = -ti.sin(heading), ti.cos(heading)
    ratio = ti.max((middle - half) / most, LEAST_RATIO)
    weight = deviation * deviation / (deviation * deviation + (error * variance / ratio) ** 2)
    # the turn about the centre that changes the endpoints' distances least: the robot moves by (vx, vy) a radian, but
    # along a direction that is not bound it does not
    across = (ax * yt - ay * xt) / (most + RIDGE * total)
    along = -weight * (ax * xt + ay * yt) / (ti.max(middle - half, 0.0) + RIDGE * total)
    vx, vy = along * ax + across * ay, along * ay - across * ax
    bound = ti.max(vx * (xx * vx + 2 * xy * vy + 2 * xt) + vy * (yy * vy + 2 * yt) + tt, 0.0)
    lever = ti.max(square + vx * vx + vy * vy + 2 * (vy * mx - vx * my), LEAST_INFORMATION)
    noise = NOISE_RATIO * ti.min(variance, MOST_NOISE)
    turn_weight = ti.min(ti.max(2 * bound / (total * lever) / noise - 2, 0.0), 1.0)
    if error == 0:
        turn_weight = 1.0
    shift = ax * found[i, 0] + ay * found[i, 1]
    found[i, 0] -= ax * (1 - weight) * shift
    found[i, 1] -= ay * (1 - weight) * shift
    less = 1 - ti.sqrt(weight)
    k00, k01, k11 = 1 - less * ax * ax, -less * ax * ay, 1 - less * ay * ay
    p00, p01 = k00 * xx + k01 * xy, k00 * xy + k01 * yy
    p10, p11 = k01 * xx + k11 * xy, k01 * xy + k11 * yy
    found[i, 3], found[i, 4], found[i, 6] = p00 * k00 + p01 * k01, p00 * k01 + p01 * k11, p10 * k01 + p11 * k11
    found[i, 5], found[i, 7] = k00 * xt + k01 * yt, k01 * xt + k11 * yt
    if turn_weight < 1:
        back, left = (1 - turn_weight) * found[i, 2], 1 - ti.sqrt(turn_weight)
        found[i, 0] -= vx * back
        found[i, 1] -= vy * back
        found[i, 2] -= back
        rx = found[i, 3] * vx + found[i, 4] * vy + found[i, 5]
        ry = found[i, 4] * vx + found[i, 6] * vy + found[i, 7]
        rt = found[i, 5] * vx + found[i, 7] * vy + tt
        found[i, 5] -= left * rx
        found[i, 7] -= left * ry
        found[i, 8] += left * (left * (vx * rx + vy * ry + rt) - 2 * rt)


@kernel
def _keep_all(found: F64_2D, means: F64_2D, deviation: F64, error: F64):
    ti.loop_config(serialize=True)
    for i in range(found.shape[0]):
        keep_prediction(found, i, deviation, error, 1.0, means[i, 0], means[i, 1], means[i, 2])


def keep_predictions(
    offsets: ArrayLike, information: ArrayLike, means: ArrayLike, kept: Kept
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Keep the predicted poses where endpoints carry least information: along a direction, and for a turn.

    Along the least informed direction in the plane the offset is multiplied by w = d^2 / (d^2 + (e / r)^2), with the
    prediction's deviation d, the registration's error e, and the ratio r of the information along the direction to that
    across it. The information along it is multiplied by w, too. Then the turn about the centre that changes the
    endpoints' distances least, with the rest of the offset that belongs to it: there w grows from 0 to 1 as the ratio,
    of what is known of it to what endpoints that bound all directions would know of as large a motion, grows from what
    the noise of slopes makes at most to half as much again.

    Args:
        offsets: [n, 3] from the predicted poses.
        information: [n, 6] of the endpoints, 00 01 02 11 12 22.
        means: [n, 3] of the endpoints' x, y, x^2 + y^2 from the robot, in the axes of the offsets.
        kept: how, where residuals have the variance of standard ones.

    Returns offsets and information likewise.

    Raises ``InputError``: arrays that do not fit together, or numbers that are not finite.
    """
    shifts = as_finite("offsets", offsets, np.float64, (None, 3))
    found = np.hstack((shifts, as_finite("information", information, np.float64, (len(shifts), 6))))
    about = as_finite("means", means, np.float64, (len(shifts), 3))
    if len(found):
        _keep_all(found, about, *kept)
    return found[:, :3], found[:, 3:]
