"""Gauss-Newton on one level of a signed-distance map: the step that registration repeats, inside kernels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.kernels.checks import as_finite
from moteslam.kernels.runtime import runtime, ti
from moteslam.kernels.tiles import STEPS, bilinear
from moteslam.kernels.types import F32, F64, F64_2D, I32, func, kernel, template

CONVERGED_SHIFT, CONVERGED_TURN = 3e-4, 1e-4
"""Gauss-Newton ends where a step is below both, or the steps still to come are together, |x| + |y| [m] and |theta|
[rad]: far less than a cell, which is all that interpolated distances can resolve."""
COARSE_STEP = 10.0
"""On the coarse level the bounds are this many times as large, since the fine level begins where it ended."""
LEAST_PIVOT = 1e-9
"""Keeps the square roots of the Cholesky factors real where rounding would not."""


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


LEAST_INFORMATION, LEAST_SHARE = 1e-9, 1e-12
"""What the information of a scan, and the share of it that a motion has, count as at least."""
MOST_NOISE = 4.0
"""The variance of residuals that is a lidar's noise, of 2 cm, in squares of standard ones; what is more is people."""
NOISE_SHARE = 0.016
"""The share that noise of the map's slopes alone makes, where residuals have the variance of standard ones.

In a round tank of 4 m and along a bare hall it is 0.004 to 0.013 times the residuals' variance, with three lidars of
0.5 to 3 cm of noise, to the filter's maps as between two scans. In rooms, corridors and on csail it is 0.08 to 0.4,
whatever that variance.
"""


class Kept(NamedTuple):
    """How a prediction is kept along degenerate directions.

    Attributes:
        deviation: standard deviation of the prediction [m].
        error: of the registration along a way whose share of the information is 1 [m].
    """

    deviation: float
    error: float


NOT_KEPT = Kept(0.0, 0.0)


@func
def least_eigenvalue(a: template):
    """Of a symmetric 3 x 3 matrix, a holds 00 01 02 11 12 22."""
    middle = (a[0] + a[3] + a[5]) / 3
    x, y, z = a[0] - middle, a[3] - middle, a[5] - middle
    off = a[1] * a[1] + a[2] * a[2] + a[4] * a[4]
    size = ti.sqrt(ti.max((x * x + y * y + z * z + 2 * off) / 6, 1e-36))
    determinant = x * (y * z - a[4] * a[4]) - a[1] * (a[1] * z - a[4] * a[2]) + a[2] * (a[1] * a[4] - y * a[2])
    third = ti.acos(ti.min(ti.max(0.5 * determinant / (size * size * size), -1.0), 1.0)) / 3
    return middle + 2 * size * ti.cos(third + 2 * np.pi / 3)


@func
def null_vector(a: template, value: F64):
    """The unit eigenvector of a symmetric 3 x 3 matrix, a holds 00 01 02 11 12 22, with this eigenvalue."""
    one = ti.Vector([a[0] - value, a[1], a[2]])
    two = ti.Vector([a[1], a[3] - value, a[4]])
    three = ti.Vector([a[2], a[4], a[5] - value])
    best = one.cross(two)
    for other in ti.static((one.cross(three), two.cross(three))):
        if other.norm_sqr() > best.norm_sqr():
            best = other
    return best / ti.sqrt(ti.max(best.norm_sqr(), 1e-36))


@func
def keep_prediction(
    found: template, i: I32, deviation: F64, error: F64, variance: F64, mx: F64, my: F64, square: F64
):  # fmt: skip
    """Row i of ``found``, an offset (x, y, theta) and its information 00 01 02 11 12 22, as ``keep_predictions``.

    ``variance`` is of the residuals; ``mx``, ``my`` and ``square`` are the endpoints' means of x, y and x^2 + y^2 from
    the robot, in the axes of the offset [m, m^2].
    """
    xx, xy, xt, yy, yt, tt = found[i, 3], found[i, 4], found[i, 5], found[i, 6], found[i, 7], found[i, 8]
    total = ti.max(xx + yy, LEAST_INFORMATION)
    lever = ti.sqrt(ti.max(square - mx * mx - my * my, LEAST_INFORMATION))
    # about the endpoints' mean, the turn in metres that they move by
    about_x, about_y = xx * my - xy * mx + xt, xy * my - yy * mx + yt
    about = my * about_x - mx * about_y + my * xt - mx * yt + tt
    shares = ti.Vector([xx, xy, about_x / lever, yy, about_y / lever, about / (lever * lever)]) / total
    share = ti.max(least_eigenvalue(shares), LEAST_SHARE)
    motion = null_vector(shares, share)
    noise = NOISE_SHARE * ti.min(variance, MOST_NOISE)
    weight = ti.min(ti.max(2 * share / noise - 2, 0.0), 1.0)
    # of the robot: a turn about a centre among the endpoints, or else a way
    turn = motion[2] / lever
    x, y = motion[0] + turn * my, motion[1] - turn * mx
    shift = found[i, 2]
    if turn * turn * square > x * x + y * y:
        x, y, turn = x / turn, y / turn, 1.0
    else:
        most = ti.atan2(2 * xy, xx - yy) / 2  # heading of the most informed direction
        x, y, turn = -ti.sin(most), ti.cos(most), 0.0
        shift = x * found[i, 0] + y * found[i, 1]
        weight *= deviation * deviation / (deviation * deviation + (error * variance / share) ** 2)
    if error == 0:
        weight = 1.0
    back = (1 - weight) * shift
    found[i, 0] -= back * x
    found[i, 1] -= back * y
    found[i, 2] -= back * turn
    by_x, by_y, by_turn = xx * x + xy * y + xt * turn, xy * x + yy * y + yt * turn, xt * x + yt * y + tt * turn
    less = (1 - weight) / ti.max(by_x * x + by_y * y + by_turn * turn, LEAST_INFORMATION)
    found[i, 3] -= less * by_x * by_x
    found[i, 4] -= less * by_x * by_y
    found[i, 5] -= less * by_x * by_turn
    found[i, 6] -= less * by_y * by_y
    found[i, 7] -= less * by_y * by_turn
    found[i, 8] -= less * by_turn * by_turn


@kernel
def _keep_all(found: F64_2D, means: F64_2D, deviation: F64, error: F64):
    ti.loop_config(serialize=True)
    for i in range(found.shape[0]):
        keep_prediction(found, i, deviation, error, 1.0, means[i, 0], means[i, 1], means[i, 2])


def keep_predictions(
    offsets: ArrayLike, information: ArrayLike, means: ArrayLike, kept: Kept
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Keep the predicted poses along the motion that the endpoints bind least.

    Its share is the information about it over what endpoints that bound every direction would have about a motion that
    moves them as far. It is a turn about a centre among the endpoints, or else a way. What is found of it is multiplied
    by w, and the information about it, too: w grows from 0 to 1 as the share s grows from what noise of slopes makes at
    most to half as much again; for a way it is multiplied by d^2 / (d^2 + (e / s)^2), with the prediction's deviation d
    and the registration's error e.

    Args:
        offsets: [n, 3] from the predicted poses.
        information: [n, 6] of the endpoints, 00 01 02 11 12 22.
        means: [n, 3] of the endpoints' x, y, x^2 + y^2 from the robot, in the axes of the offsets.
        kept: how, where residuals have the variance of standard ones.

    Returns:
        offsets and information likewise.

    Raises:
        InputError: arrays that do not fit together, or numbers that are not finite.
    """
    shifts = as_finite("offsets", offsets, np.float64, (None, 3))
    found = np.hstack((shifts, as_finite("information", information, np.float64, (len(shifts), 6))))
    about = as_finite("means", means, np.float64, (len(shifts), 3))
    runtime()
    if len(found):
        _keep_all(found, about, *kept)
    return found[:, :3], found[:, 3:]
