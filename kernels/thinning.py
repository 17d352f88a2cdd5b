"""Scans thinned to what is registered and integrated: points a spacing apart, and the segments between them."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, runtime, ti
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
    ends: F32_2D, begins: I32_1D, counts: I32_1D, origin_x: F32, origin_y: F32, gap: F32, gap_from_range: F32,
    spacing: F32, max_spacing: F32, max_points: I32, points: F32_2D, joined: I32_1D, left: I32_1D,
):  # fmt: skip
    """Of scan i, the ``counts[i]`` rows of ``ends`` from ``begins[i]`` on become ``left[i]`` rows of ``points``.

    Endpoints within the spacing of the first of a group, and joined to it, become one point: their mean. Repeated with
    a larger spacing, up to ``max_spacing``, while there are more than ``max_points``.
    """
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread()))
    for i in range(begins.shape[0]):
        begin = begins[i]
        end = begin + counts[i]
        within = spacing
        again = 1
        while again == 1:
            out = begin
            first = begin
            while first < end:  # a group begins where the one before it ends
                x0, y0 = ends[first, 0], ends[first, 1]
                sum_x, sum_y, members = x0, y0, 1
                before_x, before_y = x0, y0
                far = ti.sqrt((x0 - origin_x) ** 2 + (y0 - origin_y) ** 2)
                k = first + 1
                same_surface = 0
                while k < end:
                    x, y = ends[k, 0], ends[k, 1]
                    range_ = ti.sqrt((x - origin_x) ** 2 + (y - origin_y) ** 2)
                    apart = ti.sqrt((x - before_x) ** 2 + (y - before_y) ** 2)
                    if apart > gap + gap_from_range * ti.max(far, range_):
                        break
                    if ti.sqrt((x - x0) ** 2 + (y - y0) ** 2) >= within:
                        same_surface = 1
                        break
                    sum_x += x
                    sum_y += y
                    members += 1
                    before_x, before_y, far = x, y, range_
                    k += 1
                points[out, 0] = sum_x / members
                points[out, 1] = sum_y / members
                joined[out] = same_surface
                out += 1
                first = k
                if out - begin > max_points and within < max_spacing:
                    first = end  # too many already: the rest is not looked at before the spacing is larger
            left[i] = out - begin
            again = 0
            if left[i] > max_points and within < max_spacing:
                again = 1
                within = ti.min(ti.max(within * SPACING_GROWTH, LEAST_SPACING), max_spacing)


def thin_scans(
    points: ArrayLike,
    begins: ArrayLike,
    counts: ArrayLike,
    origin: ArrayLike,
    *,
    spacing: float,
    max_spacing: float = 0.0,
    max_points: int = 1,
    gap: float,
    gap_from_range: float = 0.0,
) -> list[ThinnedScan]:
    """Average neighbouring endpoints of each scan, and decide which neighbours lie on the same surface.

    Args:
        points: [k, 2] endpoints in the order of their beams, in the robot's frame [m].
        begins, counts: [m] the first endpoint of each scan, and how many it has.
        origin: [2] where the rays start, in the same frame [m].
        spacing: endpoints nearer than this to the first of a group are averaged to one point [m].
        max_spacing, max_points: while there are more than ``max_points`` points, the spacing is widened step by step,
            up to ``max_spacing`` if that is larger [m].
        gap, gap_from_range: neighbours up to ``gap + gap_from_range * range`` apart lie on the same surface [m], [m/m];
            the range is that of the farther one.

    Returns:
        the m scans, views of two arrays that they share.

    Raises:
        InputError: another shape, scans beyond the points, or an option out of bounds.
    """
    ends = check_array("points", np.ascontiguousarray(points, np.float32), np.float32, (None, 2))
    firsts = check_array("begins", np.ascontiguousarray(begins, np.int32), np.int32, (None,))
    many = check_array("counts", np.ascontiguousarray(counts, np.int32), np.int32, (len(firsts),))
    start = as_finite("origin", origin, np.float64, (2,))
    options = {"spacing": spacing, "max_spacing": max_spacing, "gap": gap, "gap_from_range": gap_from_range}
    for name, value in options.items():
        if not (math.isfinite(value) and value >= 0):
            raise InputError(f"{value:g}, expected a finite number of 0 or more", field=name)
    lasts = firsts.astype(np.int64) + many
    if (firsts < 0).any() or (many < 0).any() or (lasts > len(ends)).any():
        raise InputError(f"a scan beyond the {len(ends)} points", field="counts")
    thinned, joined, left = np.empty((len(ends), 2), np.float32), np.empty(len(ends), np.int32), np.zeros_like(many)
    if len(ends) and len(firsts):
        runtime()
        _thin(
            ends, firsts, many, float(start[0]), float(start[1]), gap, gap_from_range, spacing, max_spacing,
            max_points, thinned, joined, left,
        )  # fmt: skip
    spans = list(zip(firsts.tolist(), (firsts + left).tolist(), strict=True))
    return [ThinnedScan(thinned[first:last], joined[first:last]) for first, last in spans]


def thin_scan(points: ArrayLike, origin: ArrayLike, **options: float) -> ThinnedScan:
    """One scan thinned: see ``thin_scans``.

    Args:
        points: [k, 2] endpoints in the order of their beams, in the robot's frame [m].
        origin: [2] where the rays start, in the same frame [m].
        options: of ``thin_scans``.
    """
    ends = as_finite("points", points, np.float32, (None, 2))
    (found,) = thin_scans(ends, [0], [len(ends)], origin, **options)  # type: ignore[arg-type]
    return ThinnedScan(found.points.copy(), found.joined.copy())
