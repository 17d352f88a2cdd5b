"""Normals of the surfaces at the points of scans: the direction across the line that fits the neighbours best.

At a corner the neighbours on both sides lie on no line. So three windows are fitted, the points around, before and
after, and the one with the surest direction is taken: corners and door frames keep their normals.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite
from moteslam.kernels.runtime import one_thread, passes_for, ti
from moteslam.kernels.types import F32, F32_2D, I32, I32_1D, func, kernel, template

UNKNOWN = 1e9  # The variance of a direction that too few points give


@func
def _line(points: template, first: I32, last: I32, noise: F32):
    """The line through points first to last: the variance of its direction, and its normal (v, nx, ny)."""
    count = ti.cast(last - first + 1, ti.f32)
    x0, y0 = points[first, 0], points[first, 1]
    sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(first, last + 1):
        x, y = points[j, 0] - x0, points[j, 1] - y0
        sx += x
        sy += y
        sxx += x * x
        sxy += x * y
        syy += y * y
    sxx -= sx * sx / count
    sxy -= sx * sy / count
    syy -= sy * sy / count
    middle, half = 0.5 * (sxx + syy), ti.sqrt(0.25 * (sxx - syy) ** 2 + sxy * sxy)
    across, along = ti.max(middle - half, 0.0), middle + half
    angle = 0.5 * ti.atan2(2.0 * sxy, sxx - syy)
    variance = ti.max(across / ti.max(count - 2.0, 1.0), noise * noise) / ti.max(along, 1e-9)
    if last - first < 2:
        variance = UNKNOWN
    return ti.Vector([variance, -ti.sin(angle), ti.cos(angle)], dt=ti.f32)


@func
def _until(points: template, joined: template, i: I32, step: I32, first: I32, last: I32, reach: F32, least: I32):
    """The farthest point from i, in steps of +-1 along joined points: within the reach, or of the first ``least``."""
    j = i
    going = 1
    while going == 1:
        going = 0
        k = j + step
        if k >= first and k <= last:
            dx, dy = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
            near = dx * dx + dy * dy < reach * reach or ti.abs(k - i) <= least
            if near and joined[ti.min(j, k)] == 1:
                j = k
                going = 1
    return j


@kernel
def _normals(
    points: F32_2D, joined: I32_1D, starts: I32_1D, reach: F32, noise: F32, largest: F32, normals: F32_2D,
    passes: I32,
):  # fmt: skip
    ti.loop_config(serialize=ti.static(one_thread()))
    for k in range((starts.shape[0] - 1) * passes):
        if k % passes:
            continue
        s = k // passes
        first, last = starts[s], starts[s + 1] - 1
        for i in range(first, last + 1):
            before = _until(points, joined, i, -1, first, last, 0.5 * reach, 1)
            after = _until(points, joined, i, 1, first, last, 0.5 * reach, 1)
            best = _line(points, before, after, noise)
            left = _line(points, _until(points, joined, i, -1, first, last, reach, 2), i, noise)
            if left[0] < best[0]:
                best = left
            right = _line(points, i, _until(points, joined, i, 1, first, last, reach, 2), noise)
            if right[0] < best[0]:
                best = right
            sign = 1.0
            if best[1] * points[i, 0] + best[2] * points[i, 1] > 0:
                sign = -1.0
            known = ti.cast(best[0] < largest * largest, ti.f32)
            normals[i, 0], normals[i, 1] = known * sign * best[1], known * sign * best[2]


def scan_normals(
    points: ArrayLike,
    joined: ArrayLike,
    starts: ArrayLike,
    *,
    reach: float,
    noise: float,
    largest: float,
) -> NDArray[np.float32]:
    """The unit normals at the points of n scans, towards the sensor.

    Args:
        points: [p, 2] of all scans, one after the other, each in its robot's frame [m].
        joined: int32 [p]; 1 where a point and the next lie on the same surface.
        starts: int32 [n + 1] of each scan among the points, and p.
        reach: length of the line that is fitted [m]; at least three points.
        noise: standard deviation of a point across the line, at least [m].
        largest: standard deviation of the normal's direction beyond which it is unknown [rad].

    Returns float32 [p, 2]; zeros where the direction is not known.
    """
    ends = as_finite("points", points, np.float32, (None, 2))
    linked = as_finite("joined", joined, np.int32, (len(ends),))
    begin = as_finite("starts", starts, np.int32, (None,))
    if not len(begin) or begin[0] != 0 or begin[-1] != len(ends) or (np.diff(begin) < 0).any():
        raise InputError(f"not rising from 0 to the {len(ends)} points", field="starts")
    normals = np.zeros_like(ends)
    if len(ends):
        _normals(ends, linked, begin, reach, noise, largest, normals, passes_for(len(begin) - 1))
    return normals
