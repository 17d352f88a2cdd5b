"""The walls of a world sorted into square buckets, so that a ray meets only those near its path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.kernels.checks import as_finite

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
