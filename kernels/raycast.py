"""Exact ray casting against the walls of a world, and against discs and lines that move.

Walls are sorted into square buckets. A ray is tested against those of one bucket after another along its path, until
its nearest hit lies within the bucket. Whether it hits a wall is decided by the sides of the ray on which the wall's
two ends lie; for two walls that share an end this is the very same number, so that no ray passes between them.

Coordinates are float32, relative to the world's corner. Their error, and that of each intermediate, is at most half of
2^-23 of the extent E; the error of a range is at most 4 E 2^-23 / |sin a| + 2^-21 r, a the angle between ray and wall:
0.05 mm in a world of 100 m at a right angle.

Movers are given at a constant rate and interpolated linearly, each where it is at the ray's time. Every ray tests all
of them: a scenario has a few dozen.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, ti
from moteslam.kernels.types import F32, F32_1D, F32_2D, F64, F64_1D, F64_2D, I32, I32_1D, func, kernel, template

MAX_BUCKETS = 2**20  # Largest number of buckets; in larger worlds the buckets are larger
SLACK = 4 * 2.0**-23
"""Share of the world's extent by which walls are lengthened at both ends: four times what rounding to float32 can move
a coordinate by, so that no ray passes between two walls that touch."""


@dataclass(frozen=True, eq=False)
class SegmentBuckets:
    """Segments in square buckets, those of a bucket contiguous in memory."""

    corner: NDArray[np.float64]  # (x, y) of the corner of bucket [0, 0] [m]; all other coordinates are relative to it
    size: float  # of a bucket's side [m]
    columns: int  # buckets along x
    rows: int  # buckets along y
    slack: float  # by which segments are lengthened at both ends [m]
    starts: NDArray[np.int32]  # int32 [rows * columns + 1]; bucket b holds walls[starts[b]:starts[b + 1]]
    walls: NDArray[np.float32]  # float32 [n, 4] (x0, y0, x1, y1) [m], relative to the corner
    segments: NDArray[np.int32]  # int32 [n] index of each wall among the world's segments


def build_buckets(segments: ArrayLike, *, size: float | None = None) -> SegmentBuckets:
    """Sort a world's segments [m, 4] (x0, y0, x1, y1) [m] into buckets of a side ``size`` [m].

    By default that is 0.5 to 4 m, smaller where walls are denser, and larger in a world that would have more than
    ``MAX_BUCKETS``.
    """
    ends = as_finite("segments", segments, np.float64, (None, 4)).reshape(-1, 2, 2)
    low, high = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
    extent = float((high - low).max())
    lengths = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    if size is None:  # about two buckets a segment, which measures best (benchmarks/)
        room = max(float(np.prod(high - low)), float(lengths.sum()))
        size = float(np.clip(0.7 * np.sqrt(room / len(lengths)), 0.5, 4.0))
    size = max(float(size), 1e-3 * extent, float(np.sqrt(np.prod(high - low) / (0.9 * MAX_BUCKETS))), 1e-6)
    slack = SLACK * max(extent, size)
    # error of a ray's path through the buckets: its sum of steps, one for each bucket, is rounded too
    margin = 1e-3 * size + 4 * slack + 2.0**-22 * extent * extent / size
    corner = low - 2 * margin
    columns, rows = (int(n) for n in np.floor((high - corner + 2 * margin) / size) + 1)
    relative = ends - corner
    segment, bucket = _crossed(relative, size, margin, columns, rows)
    order = np.argsort(bucket, kind="stable")
    starts = np.zeros(rows * columns + 1, np.int32)
    np.cumsum(np.bincount(bucket, minlength=rows * columns), out=starts[1:])
    walls = np.ascontiguousarray(relative.reshape(-1, 4)[segment[order]], np.float32)
    owners = np.ascontiguousarray(segment[order], np.int32)
    return SegmentBuckets(corner, size, columns, rows, slack, starts, walls, owners)


def _crossed(
    ends: NDArray[np.float64], size: float, margin: float, columns: int, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which segments cross which buckets, widened by a margin: (segment, bucket) pairs, in the order of columns."""
    ends = np.take_along_axis(ends, np.argsort(ends[:, :, :1], axis=1, kind="stable"), axis=1)  # from left to right
    (x0, y0), (x1, y1) = ends[:, 0].T, ends[:, 1].T
    first = np.clip(np.floor((x0 - margin) / size), 0, columns - 1).astype(np.int64)
    last = np.clip(np.floor((x1 + margin) / size), 0, columns - 1).astype(np.int64)
    segment, column = _ranges(first, last)
    # the part of the segment within the column's sides, widened; it rises or falls between its ends
    run = np.where(x1 > x0, x1 - x0, 1.0)
    left = np.clip((column * size - margin - x0[segment]) / run[segment], 0, 1)
    right = np.clip(((column + 1) * size + margin - x0[segment]) / run[segment], 0, 1)
    right = np.where((x1 > x0)[segment], right, 1.0)
    left = np.where((x1 > x0)[segment], left, 0.0)
    rise = (y1 - y0)[segment]
    a, b = y0[segment] + left * rise, y0[segment] + right * rise
    below = np.clip(np.floor((np.minimum(a, b) - margin) / size), 0, rows - 1).astype(np.int64)
    above = np.clip(np.floor((np.maximum(a, b) + margin) / size), 0, rows - 1).astype(np.int64)
    pair, row = _ranges(below, above)
    return segment[pair], row * columns + column[pair]


def _ranges(first: NDArray[np.int64], last: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Every number of every range first..last, last included: (which range, the number)."""
    lengths = last - first + 1
    which = np.repeat(np.arange(len(first)), lengths)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(lengths) - lengths, lengths) + first[which]


@func
def _wall_range(x0: F32, y0: F32, x1: F32, y1: F32, c: F32, s: F32, slack: F32):
    """Range along (c, s) from (0, 0) to the wall from (x0, y0) to (x1, y1) [m], infinity where it is not hit."""
    side0, side1 = c * y0 - s * x0, c * y1 - s * x1
    found = ti.f32(math.inf)
    # most walls end here: both ends lie on the same side, and neither on the ray
    if side0 * side1 <= slack * slack or abs(side0) <= slack or abs(side1) <= slack:
        along0, along1 = c * x0 + s * y0, c * x1 + s * y1
        if ti.max(along0, along1) >= ti.f32(0.0):
            apart = side0 - side1
            if ti.max(abs(side0), abs(side1)) <= slack:  # the ray runs along the wall
                found = ti.max(ti.min(along0, along1), ti.f32(0.0))
            else:
                share = ti.min(ti.max(side0 / apart, ti.f32(0.0)), ti.f32(1.0))
                distance = along0 + share * (along1 - along0)
                if distance >= ti.f32(0.0):
                    found = distance
    return found


@func
def _cast(
    starts: template, walls: template, size: F32, columns: I32, rows: I32, slack: F32, x: F64, y: F64, c: F32, s: F32,
    max_range: F32,
):  # fmt: skip
    """Range of a ray from (x, y), relative to the world's corner, along (c, s), and the index of its wall or -1."""
    tiny = ti.f32(1e-12)  # a ray along an axis crosses the other after 1e12 m
    inverse_x = ti.f32(1.0) / (c if abs(c) > tiny else tiny)
    inverse_y = ti.f32(1.0) / (s if abs(s) > tiny else tiny)
    width, height = size * ti.cast(columns, ti.f32), size * ti.cast(rows, ti.f32)
    skipped = ti.f64(0.0)
    inside = x >= 0.0 and y >= 0.0 and x <= ti.cast(width, ti.f64) and y <= ti.cast(height, ti.f64)
    if not inside:  # begin where the ray enters the world, in float64: from far away float32 would miss it
        wide, high = ti.cast(width, ti.f64), ti.cast(height, ti.f64)
        per_x, per_y = ti.cast(inverse_x, ti.f64), ti.cast(inverse_y, ti.f64)
        enter_x, leave_x = ti.min(-x * per_x, (wide - x) * per_x), ti.max(-x * per_x, (wide - x) * per_x)
        enter_y, leave_y = ti.min(-y * per_y, (high - y) * per_y), ti.max(-y * per_y, (high - y) * per_y)
        skipped = ti.max(ti.max(enter_x, enter_y), ti.f64(0.0))
        if skipped > ti.min(leave_x, leave_y) or skipped > ti.cast(max_range, ti.f64):
            skipped = ti.f64(math.inf)
    found = ti.f32(math.inf)
    nearest = -1
    if skipped < ti.f64(math.inf):
        ox = ti.cast(x + skipped * ti.cast(c, ti.f64), ti.f32)
        oy = ti.cast(y + skipped * ti.cast(s, ti.f64), ti.f32)
        col = ti.min(ti.max(ti.cast(ox / size, ti.i32), 0), columns - 1)
        row = ti.min(ti.max(ti.cast(oy / size, ti.i32), 0), rows - 1)
        step_col, step_row = (1 if c > 0 else -1), (1 if s > 0 else -1)
        next_x = (ti.cast(col + (1 if c > 0 else 0), ti.f32) * size - ox) * inverse_x
        next_y = (ti.cast(row + (1 if s > 0 else 0), ti.f32) * size - oy) * inverse_y
        if abs(c) <= tiny:
            next_x = ti.f32(math.inf)
        if abs(s) <= tiny:
            next_y = ti.f32(math.inf)
        across, up = abs(size * inverse_x), abs(size * inverse_y)
        reach = max_range - ti.cast(skipped, ti.f32)
        walking = True
        while walking:
            bucket = row * columns + col
            for w in range(starts[bucket], starts[bucket + 1]):
                distance = _wall_range(
                    walls[w, 0] - ox, walls[w, 1] - oy, walls[w, 2] - ox, walls[w, 3] - oy, c, s, slack
                )
                if distance < found:
                    found = distance
                    nearest = w
            leave = ti.min(next_x, next_y)
            if next_x < next_y:
                col += step_col
                next_x += across
            else:
                row += step_row
                next_y += up
            walking = found > leave and leave <= reach and 0 <= col and col < columns and 0 <= row and row < rows
    total = ti.cast(skipped, ti.f32) + found
    if not total <= max_range:
        total = ti.f32(math.inf)
        nearest = -1
    return total, nearest


@kernel
def _cast_all(
    starts: I32_1D, walls: F32_2D, size: F32, columns: I32, rows: I32, slack: F32, x0: F64, y0: F64,
    origins: F64_2D, angles: F64_1D, max_range: F32, directions: F32_2D, owners: I32_1D, out: F32_1D, hit: I32_1D,
):  # fmt: skip
    ti.loop_config(serialize=ti.static(one_thread()))
    for i in range(out.shape[0]):
        directions[0, i], directions[1, i] = ti.cast(ti.cos(angles[i]), ti.f32), ti.cast(ti.sin(angles[i]), ti.f32)
    ti.loop_config(serialize=ti.static(one_thread()))
    for i in range(out.shape[0]):
        distance, wall = _cast(
            starts, walls, size, columns, rows, slack, origins[i, 0] - x0, origins[i, 1] - y0,
            directions[0, i], directions[1, i], max_range,
        )  # fmt: skip
        out[i] = distance
        hit[i] = owners[wall] if wall >= 0 else -1


def cast_rays(
    buckets: SegmentBuckets, origins: ArrayLike, angles: ArrayLike, *, max_range: float
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """The range of each ray to its first wall, and which wall it is.

    Rays start at ``origins`` [n, 2] [m], inside the world or not, at angles [n] [rad]; walls beyond ``max_range``,
    below 1e30, are not seen [m]. Returns float32 [n] [m] and int32 [n] indices of segments, ``inf`` and -1 where no
    wall is within it.
    """
    origins = as_finite("origins", origins, np.float64, (None, 2))
    angles = as_finite("angles", angles, np.float64, (len(origins),))
    out, hit = np.empty(len(origins), np.float32), np.empty(len(origins), np.int32)
    if len(out):
        directions = np.empty((2, len(out)), np.float32)
        _cast_all(
            buckets.starts, buckets.walls, buckets.size, buckets.columns, buckets.rows, buckets.slack,
            *buckets.corner.tolist(), origins, angles, max_range, directions, buckets.segments, out, hit,
        )  # fmt: skip
    return out, hit


@kernel
def _cast_movers(
    discs: F32_2D, lines: F32_2D, last: I32, disc_count: I32, line_count: I32, rate: F32, origins: F64_2D,
    angles: F64_1D, times: F64_1D, out: F32_1D, hit: I32_1D,
):  # fmt: skip
    ti.loop_config(serialize=ti.static(one_thread()))
    for i in range(out.shape[0]):
        at = ti.min(ti.max(times[i] * ti.cast(rate, ti.f64), 0.0), ti.cast(last, ti.f64))
        row = ti.min(ti.cast(at, ti.i32), last - 1)
        share = ti.cast(at - ti.cast(row, ti.f64), ti.f32)
        ox, oy = ti.cast(origins[i, 0], ti.f32), ti.cast(origins[i, 1], ti.f32)
        c, s = ti.cast(ti.cos(angles[i]), ti.f32), ti.cast(ti.sin(angles[i]), ti.f32)
        found = out[i]
        nearest = -1
        for k in range(disc_count):
            a, b = row * disc_count + k, (row + 1) * disc_count + k
            x = discs[a, 0] + share * (discs[b, 0] - discs[a, 0]) - ox
            y = discs[a, 1] + share * (discs[b, 1] - discs[a, 1]) - oy
            radius = discs[a, 2]
            side, along = c * y - s * x, c * x + s * y
            if abs(side) <= radius:
                half = ti.sqrt(radius * radius - side * side)
                distance = along - half
                if distance < ti.f32(0.0) and along + half >= ti.f32(0.0):
                    distance = ti.f32(0.0)  # from inside
                if ti.f32(0.0) <= distance and distance < found:
                    found = distance
                    nearest = k
        for k in range(line_count):
            a, b = row * line_count + k, (row + 1) * line_count + k
            x0 = lines[a, 0] + share * (lines[b, 0] - lines[a, 0]) - ox
            y0 = lines[a, 1] + share * (lines[b, 1] - lines[a, 1]) - oy
            x1 = lines[a, 2] + share * (lines[b, 2] - lines[a, 2]) - ox
            y1 = lines[a, 3] + share * (lines[b, 3] - lines[a, 3]) - oy
            side0, side1 = c * y0 - s * x0, c * y1 - s * x1
            if side0 * side1 <= ti.f32(0.0) and side0 != side1:
                along0, along1 = c * x0 + s * y0, c * x1 + s * y1
                distance = along0 + side0 / (side0 - side1) * (along1 - along0)
                if ti.f32(0.0) <= distance and distance < found:
                    found = distance
                    nearest = disc_count + k
        out[i] = found
        hit[i] = nearest


def cast_movers(
    discs: NDArray[np.float32],
    lines: NDArray[np.float32],
    rate: float,
    origins: ArrayLike,
    angles: ArrayLike,
    times: ArrayLike,
    ranges: NDArray[np.float32],
) -> NDArray[np.int32]:
    """Shorten the rays that meet a mover before the wall.

    Coordinates are float32: keep the world within 1000 m of its origin, where a place is off by at most 0.03 mm.

    Args:
        discs: float32 [t, k, 3] x, y, radius of k discs [m].
        lines: float32 [t, m, 4] x0, y0, x1, y1 of m lines [m].
        rate: of the poses [Hz], the first at time 0.
        origins: [n, 2] of the rays [m].
        angles: [n] their directions [rad].
        times: [n] of the rays [s]; before the first pose and after the last the movers stand still.
        ranges: float32 [n] of the rays to the walls [m], shortened in place.

    Returns int32 [n]: index of the disc that each ray meets, or k + index of the line, or -1.
    """
    origins = as_finite("origins", origins, np.float64, (None, 2))
    angles = as_finite("angles", angles, np.float64, (len(origins),))
    times = as_finite("times", times, np.float64, (len(origins),))
    check_array("ranges", ranges, np.float32, (len(origins),), written=True)
    steps, count = discs.shape[:2]
    discs = as_finite("discs", discs.reshape(-1, 3), np.float32, (None, 3))
    if len(lines) != steps or steps < 2:
        raise InputError(
            f"{steps} poses of discs, {len(lines)} of lines, expected as many, two at least", field="lines"
        )
    leaves = lines.shape[1]
    lines = as_finite("lines", lines.reshape(-1, 4), np.float32, (None, 4))
    hit = np.full(len(origins), -1, np.int32)
    if len(origins) and count + leaves:
        one = np.zeros((1, 4), np.float32)  # Taichi takes no empty array
        _cast_movers(
            discs if count else one[:, :3].copy(), lines if leaves else one, steps - 1, count, leaves, float(rate),
            origins, angles, times, ranges, hit,
        )  # fmt: skip
    return hit
