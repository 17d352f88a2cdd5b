"""Scans thinned to what is registered and integrated: points a spacing apart, and the segments between them."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite
from moteslam.kernels.runtime import runtime, ti
from moteslam.kernels.types import F32, F32_2D, I32, I32_1D, kernel

SPACING_GROWTH, LEAST_SPACING = 1.2, 0.001
"""While there are too many points, the spacing is multiplied by the first and is at least the second [m]."""


class ThinnedScan(NamedTuple):
    """A scan as it is registered and integrated.

    Attributes:
        points: float32 [k, 2] in the robot's frame [m], each the mean of neighbouring endpoints.
        joined: int32 [k]; 1 where a point and the next lie on the same surface, so that a segment joins them.
    """

    points: NDArray[np.float32]
    joined: NDArray[np.int32]


@kernel
def _thin(
    ends: F32_2D, ends_joined: I32_1D, spacing: F32, max_spacing: F32, max_points: I32, points: F32_2D, joined: I32_1D,
    count: I32_1D,
):  # fmt: skip
    """Endpoints within the spacing of the first of a group, and joined to it, become one point.

    Repeated with a larger spacing, up to ``max_spacing``, while there are more than ``max_points``.
    """
    ti.loop_config(serialize=True)  # a group begins where the one before it ends
    for _ in range(1):
        n = ends.shape[0]
        within = spacing
        again = 1
        while again == 1:
            out = 0
            first = 0
            while first < n:
                x0, y0 = ends[first, 0], ends[first, 1]
                sum_x, sum_y, members = x0, y0, 1
                k = first + 1
                same_surface = 0
                while k < n:
                    x, y = ends[k, 0], ends[k, 1]
                    if ends_joined[k - 1] == 0:
                        break
                    if ti.sqrt((x - x0) ** 2 + (y - y0) ** 2) >= within:
                        same_surface = 1
                        break
                    sum_x += x
                    sum_y += y
                    members += 1
                    k += 1
                points[out, 0] = sum_x / members
                points[out, 1] = sum_y / members
                joined[out] = same_surface
                out += 1
                first = k
            count[0] = out
            again = 0
            if out > max_points and within < max_spacing:
                again = 1
                within = ti.min(ti.max(within * SPACING_GROWTH, LEAST_SPACING), max_spacing)


def thin_scan(
    points: ArrayLike,
    origin: ArrayLike,
    *,
    spacing: float,
    max_spacing: float = 0.0,
    max_points: int = 1,
    gap: float,
    gap_from_range: float = 0.0,
) -> ThinnedScan:
    """Average neighbouring endpoints of a scan, and decide which neighbours lie on the same surface.

    Args:
        points: [k, 2] endpoints in the order of their beams, in the robot's frame [m].
        origin: [2] where the rays start, in the same frame [m].
        spacing: endpoints nearer than this to the first of a group are averaged to one point [m].
        max_spacing, max_points: while there are more than ``max_points`` points, the spacing is widened step by step,
            up to ``max_spacing`` if that is larger [m].
        gap, gap_from_range: neighbours up to ``gap + gap_from_range * range`` apart lie on the same surface [m], [m/m];
            the range is that of the farther one.

    Raises:
        InputError: another shape, a number that is not finite, or an option out of bounds.
    """
    ends = as_finite("points", points, np.float32, (None, 2))
    start = as_finite("origin", origin, np.float64, (2,))
    options = {"spacing": spacing, "max_spacing": max_spacing, "gap": gap, "gap_from_range": gap_from_range}
    for name, value in options.items():
        if not (math.isfinite(value) and value >= 0):
            raise InputError(f"{value:g}, expected a finite number of 0 or more", field=name)
    n = len(ends)
    thinned, joined, count = np.empty((n, 2), np.float32), np.empty(n, np.int32), np.zeros(1, np.int32)
    if n:
        ranges = np.hypot(ends[:, 0] - np.float32(start[0]), ends[:, 1] - np.float32(start[1]))
        allowed = gap + gap_from_range * np.maximum(ranges[1:], ranges[:-1])
        ends_joined = np.zeros(n, np.int32)
        ends_joined[:-1] = np.hypot(*np.diff(ends, axis=0).T) <= allowed
        runtime()
        _thin(ends, ends_joined, spacing, max_spacing, max_points, thinned, joined, count)
    k = int(count[0])
    return ThinnedScan(thinned[:k].copy(), joined[:k].copy())
