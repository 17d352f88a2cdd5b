"""Degenerate directions: where endpoints carry next to no information, a predicted pose is kept.

Between two bare walls a few endpoints pull along them, by errors of the map rather than by where the robot is (Zhang,
Kaess and Singh 2016, On degeneracy of optimization-based state estimation problems).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.kernels.checks import as_finite
from moteslam.kernels.runtime import runtime, ti
from moteslam.kernels.types import F64, F64_2D, I32, func, kernel, template

LEAST_INFORMATION, LEAST_RATIO = 1e-9, 1e-12
"""What the information of a scan, and the ratio of that along a degenerate direction, count as at least."""


class Kept(NamedTuple):
    """How a prediction is kept along degenerate directions.

    Attributes:
        deviation: standard deviation of the prediction [m].
        error: of the registration along a direction that is informed as well as the one across [m].
    """

    deviation: float
    error: float


NOT_KEPT = Kept(0.0, 0.0)


@func
def keep_prediction(found: template, i: I32, deviation: F64, error: F64):
    """Row i of ``found``, an offset (x, y, theta) and its information 00 01 02 11 12 22, as ``keep_predictions``."""
    xx, xy, yy = found[i, 3], found[i, 4], found[i, 6]
    middle, half = (xx + yy) / 2, ti.sqrt(((xx - yy) / 2) ** 2 + xy * xy)
    heading = ti.atan2(2 * xy, xx - yy) / 2  # of the most informed direction
    ax, ay = -ti.sin(heading), ti.cos(heading)
    ratio = ti.max((middle - half) / ti.max(middle + half, LEAST_INFORMATION), LEAST_RATIO)
    shift = ax * found[i, 0] + ay * found[i, 1]
    weight = deviation * deviation / (deviation * deviation + (error / ratio) ** 2)
    found[i, 0] -= ax * (1 - weight) * shift
    found[i, 1] -= ay * (1 - weight) * shift
    less = 1 - ti.sqrt(weight)
    k00, k01, k11 = 1 - less * ax * ax, -less * ax * ay, 1 - less * ay * ay
    p00, p01 = k00 * xx + k01 * xy, k00 * xy + k01 * yy
    p10, p11 = k01 * xx + k11 * xy, k01 * xy + k11 * yy
    xt, yt = found[i, 5], found[i, 7]
    found[i, 3], found[i, 4], found[i, 6] = p00 * k00 + p01 * k01, p00 * k01 + p01 * k11, p10 * k01 + p11 * k11
    found[i, 5], found[i, 7] = k00 * xt + k01 * yt, k01 * xt + k11 * yt


@kernel
def _keep_all(found: F64_2D, deviation: F64, error: F64):
    ti.loop_config(serialize=True)
    for i in range(found.shape[0]):
        keep_prediction(found, i, deviation, error)


def keep_predictions(
    offsets: ArrayLike, information: ArrayLike, kept: Kept
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Keep the predicted poses along the direction in the plane that endpoints carry least information about.

    Along it the offset is multiplied by w = d^2 / (d^2 + (e / r)^2), with the prediction's deviation d, the
    registration's error e, and the ratio r of the information along the direction to that across it. The information
    along it is multiplied by w, too.

    Args:
        offsets: [n, 3] from the predicted poses.
        information: [n, 6] of the endpoints, 00 01 02 11 12 22.
        kept: how.

    Returns:
        offsets and information likewise.

    Raises:
        InputError: arrays that do not fit together, or numbers that are not finite.
    """
    shifts = as_finite("offsets", offsets, np.float64, (None, 3))
    found = np.hstack((shifts, as_finite("information", information, np.float64, (len(shifts), 6))))
    runtime()
    if len(found):
        _keep_all(found, *kept)
    return found[:, :3], found[:, 3:]
