"""Scans thinned to what is registered and integrated: points a spacing apart, and the segments between them."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, passes_for, ti
from moteslam.kernels.types import F32, F32_2D, F64, F64_2D, I32, I32_1D, func, kernel, template

NOT_FINITE = 0x7F800000
"""The bits of the exponent, all set in an infinite float32 and in NaN: compiled for speed, comparisons take every
number for a finite one."""


@kernel
def _project(
    ranges: F32_2D, directions: F64_2D, sweeps: F64_2D, origin_x: F64, origin_y: F64, max_range: F32, points: F32_2D,
    counts: I32_1D, alone: template,
):  # fmt: skip
    """The endpoints of scan i are ``counts[i]`` rows of ``points`` from row i * beams on.

    A scan that is ``alone`` wakes no other thread.
    """
    beams = ranges.shape[1]
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread() or alone))
    for i in range(ranges.shape[0]):
        # the robot's turn at a beam is that at the beam before, turned on by the same angle
        turn = sweeps[i, 2] / ti.max(beams - 1, 1)
        step_x, step_y = sweeps[i, 0] / ti.max(beams - 1, 1), sweeps[i, 1] / ti.max(beams - 1, 1)
        cos_step, sin_step = ti.cos(turn), ti.sin(turn)
        cos, sin = ti.cast(1.0, ti.f64), ti.cast(0.0, ti.f64)
        out = i * beams
        for k in range(beams):
            measured = ranges[i, k]
            if ti.bit_cast(measured, ti.i32) & NOT_FINITE != NOT_FINITE and measured <= max_range:
                x = origin_x + ti.cast(measured, ti.f64) * directions[k, 0]
                y = origin_y + ti.cast(measured, ti.f64) * directions[k, 1]
                points[out, 0] = ti.cast(cos * x - sin * y + k * step_x, ti.f32)
                points[out, 1] = ti.cast(sin * x + cos * y + k * step_y, ti.f32)
                out += 1
            cos, sin = cos * cos_step - sin * sin_step, sin * cos_step + cos * sin_step
        counts[i] = out - i * beams


def project_scans(
    ranges: ArrayLike,
    directions: ArrayLike,
    origin: ArrayLike,
    *,
    sweeps: ArrayLike | None = None,
    max_range: float = math.inf,
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """The finite endpoints of scans, in the robot's frame at the first beam of each.

    A beam is moved by its share of the motion during the sweep, in x, y and turn each, as ``Scans.points`` moves it.

    Args:
        ranges: float32 [m, b] [m]; what is infinite or NaN has no endpoint.
        directions: [b, 2] unit vectors of the beams in the robot's frame.
        origin: [2] where the rays start [m].
        sweeps: [m, 3] how the robot moves from the first beam to the last; None if unknown.
        max_range: endpoints beyond it are left out [m].

    Returns:
        points: float32 [m * b, 2] [m]; those of scan i begin in row i * b.
        counts: int32 [m] how many they are.
    """
    given = check_array("ranges", np.ascontiguousarray(ranges), np.float32, (None, None))
    scans, beams = given.shape
    along = as_finite("directions", directions, np.float64, (beams, 2))
    start_x, start_y = (float(v) for v in as_finite("origin", origin, np.float64, (2,)))
    moved = as_finite("sweeps", np.zeros((scans, 3)) if sweeps is None else sweeps, np.float64, (scans, 3))
    points, counts = np.empty((scans * beams, 2), np.float32), np.zeros(scans, np.int32)
    if given.size:
        reach = min(max_range, float(np.finfo(np.float32).max))
        _project(given, along, moved, start_x, start_y, reach, points, counts, scans == 1 and not one_thread())
    return points, counts


SPACING_GROWTH, LEAST_SPACING = 1.2, 0.001
"""While there are too many points, the spacing is multiplied by the first and is at least the second [m]."""


class ThinnedScan(NamedTuple):
    """A scan as it is registered and integrated."""

    points: NDArray[np.float32]  # float32 [k, 2] in the robot's frame [m], each the mean of neighbouring endpoints
    joined: NDArray[np.int32]  # [k]; 1 where a point and the next lie on the same surface, so that a segment joins them


@func
def _end_of_group(ends: template, linked: template, first: I32, end: I32, spacing: F32):
    """The endpoint after the last one of the group that begins at ``first``.

    It is not linked to those before, or ``spacing`` or more from the first.
    """
    x0, y0 = ends[first, 0], ends[first, 1]
    k = first + 1
    while k < end:
        if linked[k] == 0 or ti.sqrt((ends[k, 0] - x0) ** 2 + (ends[k, 1] - y0) ** 2) >= spacing:
            break
        k += 1
    return k


@kernel
def _thin(
    ends: F32_2D, begins: I32_1D, counts: I32_1D, origin_x: F32, origin_y: F32, gap: F32, gap_from_range: F32,
    spacing: F32, max_spacing: F32, max_points: I32, linked: I32_1D, points: F32_2D, joined: I32_1D, left: I32_1D,
    passes: I32, alone: template,
):  # fmt: skip
    """Of scan i, the ``counts[i]`` rows of ``ends`` from ``begins[i]`` on become ``left[i]`` rows of ``points``.

    Endpoints within the spacing of the first of a group, and linked to it by those between, become one point: their
    mean. The spacing is widened, up to ``max_spacing``, while there are more than ``max_points`` groups. ``linked`` is
    whether an endpoint lies on the same surface as the one before it, which no spacing changes. A scan that is
    ``alone`` wakes no other thread.
    """
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread() or alone))
    for p in range(begins.shape[0] * passes):
        if p % passes:
            continue
        i = p // passes
        begin = begins[i]
        end = begin + counts[i]
        before = ti.Vector([0.0, 0.0, 0.0], dt=ti.f32)  # x, y and range
        for k in range(begin, end):
            x, y = ends[k, 0], ends[k, 1]
            range_ = ti.sqrt((x - origin_x) ** 2 + (y - origin_y) ** 2)
            apart = ti.sqrt((x - before[0]) ** 2 + (y - before[1]) ** 2)
            linked[k] = ti.cast(apart <= gap + gap_from_range * ti.max(before[2], range_), ti.i32)
            before = ti.Vector([x, y, range_], dt=ti.f32)
        within = spacing
        widened = 1
        while widened == 1:
            widened = 0
            if within < max_spacing:
                groups, first = 0, begin
                while first < end and groups <= max_points:
                    first = _end_of_group(ends, linked, first, end, within)
                    groups += 1
                if groups > max_points:
                    widened = 1
                    within = ti.min(ti.max(within * SPACING_GROWTH, LEAST_SPACING), max_spacing)
        out, first = begin, begin
        while first < end:
            last = _end_of_group(ends, linked, first, end, within)
            sum_x, sum_y = ends[first, 0], ends[first, 1]
            for k in range(first + 1, last):
                sum_x += ends[k, 0]
                sum_y += ends[k, 1]
            points[out, 0], points[out, 1] = sum_x / (last - first), sum_y / (last - first)
            joined[out] = 0
            if last < end:
                joined[out] = linked[last]
            out += 1
            first = last
        left[i] = out - begin


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

    Returns the m scans, views of two arrays that they share.
    """
    ends = check_array("points", np.ascontiguousarray(points, np.float32), np.float32, (None, 2))
    firsts = check_array("begins", np.ascontiguousarray(begins, np.int32), np.int32, (None,))
    many = check_array("counts", np.ascontiguousarray(counts, np.int32), np.int32, (len(firsts),))
    start = as_finite("origin", origin, np.float64, (2,))
    lasts = firsts.astype(np.int64) + many
    if (firsts < 0).any() or (many < 0).any() or (lasts > len(ends)).any():
        raise InputError(f"a scan beyond the {len(ends)} points", field="counts")
    thinned, left = np.empty((len(ends), 2), np.float32), np.zeros_like(many)
    linked, joined = (np.empty(len(ends), np.int32) for _ in range(2))
    if len(ends) and len(firsts):
        _thin(
            ends, firsts, many, float(start[0]), float(start[1]), gap, gap_from_range, spacing, max_spacing,
            max_points, linked, thinned, joined, left, passes_for(len(firsts)), len(firsts) == 1 and not one_thread(),
        )  # fmt: skip
    spans = list(zip(firsts.tolist(), (firsts + left).tolist(), strict=True))
    return [ThinnedScan(thinned[first:last], joined[first:last]) for first, last in spans]


def thin_scan(points: ArrayLike, origin: ArrayLike, **options: float) -> ThinnedScan:
    """One scan of endpoints [k, 2] in the robot's frame, whose rays start at ``origin`` [2] [m], thinned: see
    ``thin_scans``.
    """
    ends = as_finite("points", points, np.float32, (None, 2))
    (found,) = thin_scans(ends, [0], [len(ends)], origin, **options)  # type: ignore[arg-type]
    return ThinnedScan(found.points.copy(), found.joined.copy())
