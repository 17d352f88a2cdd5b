"""Scans thinned to what is matched and written: vertices a spacing apart, and where a surface runs between them."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite
from moteslam.kernels.runtime import runtime, ti
from moteslam.kernels.types import F32, F32_2D, I32, I32_1D, kernel

WIDER, LEAST = 1.2, 0.001
"""How much larger the spacing is at the next try, while there are too many vertices, and what it is at least [m]."""


class ThinScan(NamedTuple):
    """A scan as it is matched and written.

    Attributes:
        vertices: float32 [k, 2] in the robot's frame [m], each the mean of neighbouring endpoints.
        linked: int32 [k]; 1 where a surface runs from a vertex to the next.
    """

    vertices: NDArray[np.float32]
    linked: NDArray[np.int32]


@kernel
def _thin(
    points: F32_2D, joined: I32_1D, spacing: F32, widest: F32, most: I32, vertices: F32_2D, linked: I32_1D,
    count: I32_1D,
):  # fmt: skip
    """Endpoints within ``spacing`` of the first of a group, and joined to it, become one vertex.

    Anew with a larger spacing, up to ``widest``, while there are more than ``most``.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        n = points.shape[0]
        within = spacing
        again = 1
        while again == 1:
            out = 0
            first = 0
            while first < n:
                x0, y0 = points[first, 0], points[first, 1]
                sum_x, sum_y, members = x0, y0, 1
                k = first + 1
                surface = 0
                while k < n:
                    x, y = points[k, 0], points[k, 1]
                    if joined[k - 1] == 0:
                        break
                    if ti.sqrt((x - x0) ** 2 + (y - y0) ** 2) >= within:
                        surface = 1
                        break
                    sum_x += x
                    sum_y += y
                    members += 1
                    k += 1
                vertices[out, 0] = sum_x / members
                vertices[out, 1] = sum_y / members
                linked[out] = surface
                out += 1
                first = k
            count[0] = out
            again = 0
            if out > most and within < widest:
                again = 1
                within = ti.min(ti.max(within * WIDER, LEAST), widest)


def thin_scan(
    points: ArrayLike,
    origin: ArrayLike,
    *,
    spacing: float,
    widest: float = 0.0,
    most: int = 1,
    gap: float,
    gap_from_range: float = 0.0,
) -> ThinScan:
    """Average neighbouring endpoints of a scan, and tell which neighbours see the same surface.

    Args:
        points: [k, 2] endpoints in the order of their beams, in the robot's frame [m].
        origin: [2] where the rays start, in the same frame [m].
        spacing: endpoints nearer than this to the first of a vertex are averaged into it [m].
        widest, most: where there are more vertices than ``most`` the spacing is widened step by step, up to ``widest``
            [m] if that is more, until there are not.
        gap, gap_from_range: neighbours are of one surface up to ``gap + gap_from_range * range`` apart [m], [m/m],
            of the farther one's range.

    Raises:
        InputError: another shape, a number that is not finite, or an option out of bounds.
    """
    ends = as_finite("points", points, np.float32, (None, 2))
    start = as_finite("origin", origin, np.float64, (2,))
    options = {"spacing": spacing, "widest": widest, "gap": gap, "gap_from_range": gap_from_range}
    for name, value in options.items():
        if not (math.isfinite(value) and value >= 0):
            raise InputError(f"{value:g}, expected a finite number of 0 or more", field=name)
    n = len(ends)
    vertices, linked, count = np.empty((n, 2), np.float32), np.empty(n, np.int32), np.zeros(1, np.int32)
    if n:
        ranges = np.hypot(ends[:, 0] - np.float32(start[0]), ends[:, 1] - np.float32(start[1]))
        allowed = gap + gap_from_range * np.maximum(ranges[1:], ranges[:-1])
        joined = np.zeros(n, np.int32)
        joined[:-1] = np.hypot(*np.diff(ends, axis=0).T) <= allowed
        runtime()
        _thin(ends, joined, spacing, widest, most, vertices, linked, count)
    k = int(count[0])
    return ThinScan(vertices[:k].copy(), linked[:k].copy())
