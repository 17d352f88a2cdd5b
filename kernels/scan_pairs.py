"""Endpoints of scans held to surfaces of other scans: which lies on which, and the normal equations of all poses.

The residual of an endpoint is its distance to the line through the matched endpoint of another scan, along that one's
normal (point to line). Its derivatives by the pose of the endpoint's scan are summed a pair of scans at a time, each
pair by one thread, so that the sums do not depend on the number of threads; those by the other pose follow from them.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, passes_for, ti
from moteslam.kernels.types import F32, F32_2D, F64, F64_2D, I32, I32_1D, I32_2D, func, kernel

MAX_PARTNERS = 32  # Other scans that one scan's endpoints are held to; kept on the stack of each thread
MAX_CELLS = 1_000_000  # Of the grid that endpoints are looked up in; its cells grow where there would be more
PAIR = 12  # Numbers of a pair's sums


@kernel
def _match(
    points: F32_2D, normals: F32_2D, order: I32_1D, runs: I32_2D, begin: I32_1D, owners: I32_1D, partners: I32_2D,
    columns: I32, rows: I32, inverse: F32, reach: F32, agreement: F32, matches: I32_2D,
):  # fmt: skip
    """The nearest endpoint of every partner; points and normals are given in ``order``: cell by cell, scan by scan.

    Runs are what a cell holds of one scan: its first point, and the scan. ``begin`` are the cells' first runs. The
    scans of a cell rise as a scan's partners do, so both are gone through once.
    """
    slots = partners.shape[1]
    ti.loop_config(serialize=ti.static(one_thread()))
    for k in range(points.shape[0]):
        i = order[k]
        mine = owners[i]
        best = ti.Vector([0.0] * MAX_PARTNERS, dt=ti.f32)
        count = 0
        for s in range(slots):
            best[s] = reach * reach
            matches[i, s] = -1
            if partners[mine, s] >= 0:
                count = s + 1
        px, py, nx, ny = points[k, 0], points[k, 1], normals[k, 0], normals[k, 1]
        if count > 0 and nx * nx + ny * ny > 0.5:
            cx, cy = ti.cast(px * inverse, ti.i32), ti.cast(py * inverse, ti.i32)
            for row in range(ti.max(cy - 1, 0), ti.min(cy + 2, rows)):
                first, last = row * columns + ti.max(cx - 1, 0), row * columns + ti.min(cx + 1, columns - 1)
                owner, slot, partner = -1, 0, partners[mine, 0]
                for run in range(begin[first], begin[last + 1]):
                    if runs[run, 1] < owner:  # the next cell
                        slot, partner = 0, partners[mine, 0]
                    owner = runs[run, 1]
                    while partner < owner and slot + 1 < count:
                        slot += 1
                        partner = partners[mine, slot]
                    if partner == owner:
                        for e in range(runs[run, 0], runs[run + 1, 0]):
                            dx, dy = points[e, 0] - px, points[e, 1] - py
                            square = dx * dx + dy * dy
                            if square < best[slot] and nx * normals[e, 0] + ny * normals[e, 1] > agreement:
                                best[slot] = square
                                matches[i, slot] = order[e]


@func
def _turned(pose_cos: F64, pose_sin: F64, x: F32, y: F32):
    return ti.Vector([pose_cos * x - pose_sin * y, pose_sin * x + pose_cos * y], dt=ti.f64)


@kernel
def _accumulate(
    points: F32_2D, normals: F32_2D, starts: I32_1D, frames: F64_2D, partners: I32_2D, matches: I32_2D, scale: F64,
    pairs: F64_2D, costs: F64_2D, passes: I32,
):  # fmt: skip
    """The sums of ``accumulate``; frames are cos, sin, x, y."""
    slots = partners.shape[1]
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread()))
    for number in range(frames.shape[0] * passes):
        if number % passes:
            continue
        a = number // passes
        for c in range(slots * PAIR):
            pairs[a, c] = 0.0
        cost, total = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
        for i in range(starts[a], starts[a + 1]):
            count = 0
            for s in range(slots):
                if matches[i, s] >= 0:
                    count += 1
            share = 1.0 / ti.sqrt(ti.cast(ti.max(count, 1), ti.f64))
            arm = _turned(frames[a, 0], frames[a, 1], points[i, 0], points[i, 1])
            wx, wy = arm[0] + frames[a, 2], arm[1] + frames[a, 3]
            for s in range(slots):
                j = matches[i, s]
                if j >= 0:
                    b = partners[a, s]
                    other = _turned(frames[b, 0], frames[b, 1], points[j, 0], points[j, 1])
                    n = _turned(frames[b, 0], frames[b, 1], normals[j, 0], normals[j, 1])
                    bx, by = wx - frames[b, 2], wy - frames[b, 3]
                    r = n[0] * (bx - other[0]) + n[1] * (by - other[1])
                    square = r * r / (scale * scale)
                    w = share / ((1.0 + square) * (1.0 + square))
                    cost += 0.5 * share * scale * scale * square / (1.0 + square)
                    total += share
                    jacobian = ti.Vector([n[0], n[1], n[1] * arm[0] - n[0] * arm[1]], dt=ti.f64)
                    at = s * PAIR
                    for k in ti.static(range(6)):
                        p, q = ti.static((0, 0, 0, 1, 1, 2)[k]), ti.static((0, 1, 2, 1, 2, 2)[k])
                        pairs[a, at + k] += w * jacobian[p] * jacobian[q]
                    for p in ti.static(range(3)):
                        pairs[a, at + 6 + p] += w * jacobian[p] * r
                    pairs[a, at + 9] += w * arm[0]
                    pairs[a, at + 10] += w * arm[1]
                    pairs[a, at + 11] += w * (arm[0] * arm[0] + arm[1] * arm[1])
        costs[a, 0], costs[a, 1] = cost, total


def match_endpoints(
    points: ArrayLike,
    normals: ArrayLike,
    owners: ArrayLike,
    partners: ArrayLike,
    *,
    reach: float,
    agreement: float,
) -> NDArray[np.int32]:
    """For every endpoint the nearest endpoint of each of its scan's partners.

    Args:
        points: [p, 2] of n scans, scan by scan, in the map frame [m].
        normals: [p, 2] of their surfaces, in the map frame; points whose normal is zero match nothing.
        owners: int32 [p] the scan of each point.
        partners: int32 [n, k] the scans that each scan's endpoints are held to, rising, at most ``MAX_PARTNERS``; -1
            after them.
        reach: largest distance of a match [m].

    Returns int32 [p, k] indices of points, -1 without a match.
    """
    ends = as_finite("points", points, np.float64, (None, 2))
    across = as_finite("normals", normals, np.float32, (len(ends), 2))
    scans = as_finite("owners", owners, np.int32, (len(ends),))
    mates = _checked_partners(partners)
    if len(scans) and not (scans.min() >= 0 and scans.max() < len(mates)):
        raise InputError(f"a scan beyond the {len(mates)}", field="owners")
    matches = np.full((len(ends), mates.shape[1]), -1, np.int32)
    if not len(ends):
        return matches
    placed = (ends - ends.min(axis=0)).astype(np.float32)
    extent = placed.max(axis=0).astype(float)
    size = max(reach, math.sqrt((extent[0] + reach) * (extent[1] + reach) / MAX_CELLS))
    columns, rows = (int(length / size) + 2 for length in extent)
    inverse = np.float32(1 / size)
    cells = (placed * inverse).astype(np.int32) @ np.array((1, columns), np.int32)
    order = np.argsort(cells, kind="stable").astype(np.int32)
    cells, sources = cells[order], scans[order]
    starts = np.flatnonzero(np.r_[True, (np.diff(cells) != 0) | (np.diff(sources) != 0)])
    runs = np.column_stack((np.r_[starts, len(ends)], np.r_[sources[starts], len(mates)])).astype(np.int32)
    begin = np.zeros(columns * rows + 1, np.int32)  # the first run of each cell
    np.cumsum(np.bincount(cells[starts], minlength=columns * rows), out=begin[1:])
    _match(
        placed[order], across[order], order, runs, begin, scans, mates, columns, rows, float(inverse), reach,
        agreement, matches,
    )  # fmt: skip
    return matches


def accumulate(
    points: ArrayLike,
    normals: ArrayLike,
    starts: ArrayLike,
    poses: ArrayLike,
    partners: ArrayLike,
    matches: NDArray[np.int32],
    *,
    scale: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The sums of the normal equations over all matches of each pair of scans, and what they cost.

    A residual r weighs 1 / (1 + (r / scale)^2)^2 (Geman-McClure), divided by the root of how many matches its endpoint
    has: surfaces seen by many scans would outweigh the others.

    Args:
        points: [p, 2] of n scans, scan by scan, each in its robot's frame [m].
        normals: [p, 2] likewise.
        starts: int32 [n + 1] of each scan among the points, and p.
        poses: [n, 3] in the map frame.
        partners: int32 [n, k] as ``match_endpoints`` had them.
        matches: int32 [p, k] what it returned.
        scale: of the residuals' weights [m].

    Returns:
        pairs: [n, k, PAIR] of each scan with each partner, by the scan's own pose (x, y, theta): the upper triangle
            00 01 02 11 12 22 of J^T J, J^T r, and the weighted sums of x, y and x^2 + y^2 of the endpoints from the
            robot, in the axes of the map. By the pose of the partner J is -J A with A = (1, 0, -dy; 0, 1, dx;
            0, 0, 1), where (dx, dy) leads from the partner to the scan.
        costs: [n, 2] half the weighted squares of the residuals [m^2], and the sum of the weights without robustness.
    """
    ends = as_finite("points", points, np.float32, (None, 2))
    across = as_finite("normals", normals, np.float32, (len(ends), 2))
    mates = _checked_partners(partners)
    n, slots = mates.shape
    begin = as_finite("starts", starts, np.int32, (n + 1,))
    placed = as_finite("poses", poses, np.float64, (n, 3))
    check_array("matches", matches, np.int32, (len(ends), slots))
    if n and (begin[0] != 0 or begin[-1] != len(ends) or (np.diff(begin) < 0).any()):
        raise InputError(f"not rising from 0 to the {len(ends)} points", field="starts")
    if matches.size and not (matches.min() >= -1 and matches.max() < len(ends)):
        raise InputError(f"a point beyond the {len(ends)}", field="matches")
    frames = np.column_stack((np.cos(placed[:, 2]), np.sin(placed[:, 2]), placed[:, :2]))
    pairs, costs = np.zeros((n, slots * PAIR)), np.zeros((n, 2))
    if n and len(ends):
        _accumulate(ends, across, begin, frames, mates, matches, scale, pairs, costs, passes_for(len(frames)))
    return pairs.reshape(n, slots, PAIR), costs


def _checked_partners(partners: ArrayLike) -> NDArray[np.int32]:
    mates: NDArray[np.int32] = as_finite("partners", partners, np.int32, (None, None))
    n, slots = mates.shape
    if slots > MAX_PARTNERS:
        raise InputError(f"{slots} of them, expected at most {MAX_PARTNERS}", field="partners")
    if mates.size and not (mates.min() >= -1 and mates.max() < n):
        raise InputError(f"a scan beyond the {n}", field="partners")
    return mates
