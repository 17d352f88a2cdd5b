"""Covariances of a pose (x, y, theta) as six plain numbers, and how they follow the robot's motion.

One matrix of 3 x 3 a scan: what a scan asks of it takes 4 us, with arrays 58.
"""

import math

import numpy as np

from moteslam.robot.se2 import Array, Pose

Symmetric = tuple[float, float, float, float, float, float]  # xx, xy, xt, yy, yt, tt of a symmetric matrix; t is theta


def symmetric(matrix: Array) -> Symmetric:
    """Of a symmetric array [3, 3]."""
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = matrix.tolist()
    return xx, xy, xt, yy, yt, tt


def as_array(value: Symmetric) -> Array:
    """The array [3, 3]."""
    xx, xy, xt, yy, yt, tt = value
    return np.array(((xx, xy, xt), (xy, yy, yt), (xt, yt, tt)))


def inverse(value: Symmetric) -> Symmetric:
    """The inverse of a positive definite one, by cofactors."""
    xx, xy, xt, yy, yt, tt = value
    a, b, c = yy * tt - yt * yt, xt * yt - xy * tt, xy * yt - xt * yy
    scale = 1 / (xx * a + xy * b + xt * c)
    d, e, f = xx * tt - xt * xt, xy * xt - xx * yt, xx * yy - xy * xy
    return a * scale, b * scale, c * scale, d * scale, e * scale, f * scale


def sandwiched(outer: Symmetric, inner: Symmetric) -> Symmetric:
    """The product outer inner outer."""
    a, b, c, d, e, f = outer
    xx, xy, xt, yy, yt, tt = inner
    # the columns of inner outer
    px, py, pt = xx * a + xy * b + xt * c, xy * a + yy * b + yt * c, xt * a + yt * b + tt * c
    qx, qy, qt = xx * b + xy * d + xt * e, xy * b + yy * d + yt * e, xt * b + yt * d + tt * e
    rx, ry, rt = xx * c + xy * e + xt * f, xy * c + yy * e + yt * f, xt * c + yt * e + tt * f
    return (
        a * px + b * py + c * pt,
        a * qx + b * qy + c * qt,
        a * rx + b * ry + c * rt,
        b * qx + d * qy + e * qt,
        b * rx + d * ry + e * rt,
        c * rx + e * ry + f * rt,
    )


def plus(one: Symmetric, other: Symmetric, share: float = 1.0) -> Symmetric:
    """The sum, of the other one this share."""
    a, b, c, d, e, f = one
    g, h, i, j, k, m = other
    return a + share * g, b + share * h, c + share * i, d + share * j, e + share * k, f + share * m


def plus_diagonal(value: Symmetric, x: float, y: float, theta: float) -> Symmetric:
    """With these added to its diagonal."""
    xx, xy, xt, yy, yt, tt = value
    return xx + x, xy, xt, yy + y, yt, tt + theta


def moved(value: Symmetric, motion: Pose) -> Symmetric:
    """The covariance of a pose's error, in the frame of the pose, after a motion without an error of its own."""
    xx, xy, xt, yy, yt, tt = value
    x, y, theta = motion
    # an error of the heading turns the motion to the side; then all is seen from the new heading
    xx, xy, yy = xx + y * (y * tt - 2 * xt), xy + x * xt - y * (yt + x * tt), yy + x * (2 * yt + x * tt)
    xt, yt = xt - y * tt, yt + x * tt
    cos, sin = math.cos(theta), math.sin(theta)
    along, across = cos * xx + sin * xy, cos * xy + sin * yy
    back, over = cos * xy - sin * xx, cos * yy - sin * xy
    return (
        along * cos + across * sin,
        across * cos - along * sin,
        cos * xt + sin * yt,
        over * cos - back * sin,
        cos * yt - sin * xt,
        tt,
    )


def largest_deviation(value: Symmetric) -> float:
    """The largest standard deviation of the position in any direction [m]."""
    xx, xy, _, yy, _, _ = value
    return math.sqrt((xx + yy) / 2 + math.hypot((xx - yy) / 2, xy))
