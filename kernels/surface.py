"""Writing scans into signed-distance maps, one map a particle, and thinning scans to what is written and matched.

The surface is the polyline between neighbouring endpoints; every cell near it averages its distance to it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.runtime import runtime, ti
from moteslam.kernels.tiles import address, claim, pack
from moteslam.kernels.types import F32, F32_2D, F64_2D, I16_1D, I32, I32_1D, func, kernel, template


@kernel
def _thin(points: F32_2D, joined_to_next: I32_1D, spacing: F32, vertices: F32_2D, linked: I32_1D, count: I32_1D):
    ti.loop_config(serialize=True)
    for _ in range(1):
        n = points.shape[0]
        out = 0
        j = 0
        while j < n:
            x0, y0 = points[j, 0], points[j, 1]
            sx, sy, members = x0, y0, 1
            k = j + 1
            joined = 0
            while k < n:
                x, y = points[k, 0], points[k, 1]
                if joined_to_next[k - 1] == 0:
                    break
                if ti.sqrt((x - x0) ** 2 + (y - y0) ** 2) >= spacing:
                    joined = 1
                    break
                sx += x
                sy += y
                members += 1
                k += 1
            vertices[out, 0] = sx / members
            vertices[out, 1] = sy / members
            linked[out] = joined
            out += 1
            j = k
        count[0] = out


class ThinScan(NamedTuple):
    """A scan as it is matched and written.

    Attributes:
        vertices: float32 [k, 2] in the robot's frame [m], each the mean of neighbouring endpoints.
        linked: int32 [k]; 1 where a surface runs from a vertex to the next.
    """

    vertices: NDArray[np.float32]
    linked: NDArray[np.int32]


def thin_scan(points, origin, *, spacing, gap, gap_from_range, straight_gap, straightness):
    runtime()
    n = len(points)
    vertices, linked, count = np.empty((n, 2), np.float32), np.empty(n, np.int32), np.zeros(1, np.int32)
    if n:
        _thin(
            points,
            neighbours(points, origin, gap, gap_from_range, straight_gap, straightness),
            spacing,
            vertices,
            linked,
            count,
        )
    k = int(count[0])
    return ThinScan(vertices[:k].copy(), linked[:k].copy())


def neighbours(points, origin, gap, gap_share, far, straight):
    n = len(points)
    joined = np.zeros(n, np.int32)
    if n < 2:
        return joined
    ranges = np.hypot(points[:, 0] - np.float32(origin[0]), points[:, 1] - np.float32(origin[1]))
    step = np.diff(points, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    allowed = gap + gap_share * np.maximum(ranges[1:], ranges[:-1])
    close = length <= allowed
    if far > 1 and n > 3:
        unit = step / np.maximum(length, 1e-6)[:, None]
        back = points[:-3] - points[1:-2]
        ahead = points[3:] - points[2:-1]
        u = unit[1:-1]

        def off(v):
            return np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])

        def along(v):
            return u[:, 0] * v[:, 0] + u[:, 1] * v[:, 1]

        ok = (off(back) < straight) & (off(ahead) < straight) & (along(back) < 0) & (along(ahead) > 0)
        close[1:-1] |= ok & (length[1:-1] <= far * allowed[1:-1])
    joined[:-1] = close
    return joined


@func
def _draw(
    pool: template,
    table: template,
    base: I32,
    columns: I32,
    ax: F32,
    ay: F32,
    bx: F32,
    by: F32,
    reach: F32,
    cap: I32,
    sharp: F32,
    boost: I32,
    level: template,
):
    """Average the distances of one stretch of surface, from a to b [cells of the level], into the cells around it."""
    dx, dy = bx - ax, by - ay
    length = ti.sqrt(dx * dx + dy * dy)
    ux, uy = dx / length, dy / length
    x0 = ti.cast(ti.floor(ti.min(ax, bx) - reach), ti.i32)
    x1 = ti.cast(ti.floor(ti.max(ax, bx) + reach), ti.i32)
    y0 = ti.cast(ti.floor(ti.min(ay, by) - reach), ti.i32)
    y1 = ti.cast(ti.floor(ti.max(ay, by) + reach), ti.i32)
    for iy in range(y0, y1 + 1):
        for ix in range(x0, x1 + 1):
            px, py = ti.cast(ix, ti.f32) + 0.5 - ax, ti.cast(iy, ti.f32) + 0.5 - ay
            along = px * ux + py * uy
            distance = (ux * py - uy * px) / reach
            if along >= -0.25 and along <= length + 0.25 and distance > -1.0 and distance < 1.0:
                at = address(table, base, columns, ix, iy, level)
                word = ti.cast(pool[at], ti.i32)
                weight = word & 31
                old = ti.cast(word >> 5, ti.f32) / 1023.0
                w = ti.cast(weight, ti.f32)
                gain = 1
                if ti.abs(distance) * reach < sharp:
                    gain = boost
                g = ti.cast(gain, ti.f32)
                pool[at] = pack((old * w + distance * g) / (w + g), ti.min(weight + gain, cap))


@kernel
def _add(
    pool: I16_1D, table: I32_1D, shares: I32_1D, free: I32_1D, counters: I32_1D, columns: I32, tiles: I32,
    frames: F64_2D, scan: F32_2D, linked: I32_1D, reach: F32, coarse_reach: F32, cap: I32, sharp: F32, boost: I32,
):  # fmt: skip
    """Claim, then write. Frames are cos, sin, x, y of each particle; all lengths in fine cells."""
    for i in range(frames.shape[0]):
        c, s = ti.cast(frames[i, 0], ti.f32), ti.cast(frames[i, 1], ti.f32)
        x, y = ti.cast(frames[i, 2], ti.f32), ti.cast(frames[i, 3], ti.f32)
        margin = ti.max(reach, 2 * coarse_reach) + 1
        for j in range(scan.shape[1] - 1):
            if linked[j] == 1:
                ax, ay = c * scan[0, j] - s * scan[1, j] + x, s * scan[0, j] + c * scan[1, j] + y
                bx, by = c * scan[0, j + 1] - s * scan[1, j + 1] + x, s * scan[0, j + 1] + c * scan[1, j + 1] + y
                x0 = ti.cast(ti.floor(ti.min(ax, bx) - margin), ti.i32) >> 5
                x1 = ti.cast(ti.floor(ti.max(ax, bx) + margin), ti.i32) >> 5
                y0 = ti.cast(ti.floor(ti.min(ay, by) - margin), ti.i32) >> 5
                y1 = ti.cast(ti.floor(ti.max(ay, by) + margin), ti.i32) >> 5
                for ty in range(y0, y1 + 1):
                    for tx in range(x0, x1 + 1):
                        claim(pool, table, shares, free, counters, i * tiles + ty * columns + tx)
    for i in range(frames.shape[0]):
        if counters[1] == 0:
            c, s = ti.cast(frames[i, 0], ti.f32), ti.cast(frames[i, 1], ti.f32)
            x, y = ti.cast(frames[i, 2], ti.f32), ti.cast(frames[i, 3], ti.f32)
            for j in range(scan.shape[1] - 1):
                if linked[j] == 1:
                    ax, ay = c * scan[0, j] - s * scan[1, j] + x, s * scan[0, j] + c * scan[1, j] + y
                    bx, by = c * scan[0, j + 1] - s * scan[1, j + 1] + x, s * scan[0, j + 1] + c * scan[1, j + 1] + y
                    _draw(pool, table, i * tiles, columns, ax, ay, bx, by, reach, cap, sharp, boost, 0)
                    _draw(
                        pool,
                        table,
                        i * tiles,
                        columns,
                        0.5 * ax,
                        0.5 * ay,
                        0.5 * bx,
                        0.5 * by,
                        coarse_reach,
                        cap,
                        0.5 * sharp,
                        boost,
                        1,
                    )


def add_scans(
    pool,
    tables,
    shares,
    free,
    frames,
    scan,
    *,
    cell_size,
    truncation,
    coarse_truncation,
    sharp,
    sharp_weight,
    max_weight,
):
    runtime()
    n, rows, columns = tables.shape
    frames = frames.copy()
    frames[:, 2:] /= cell_size
    counters = np.array([len(free), 0], np.int32)
    if not len(free):
        return None
    _add(
        pool,
        tables.reshape(-1),
        shares,
        free,
        counters,
        columns,
        rows * columns,
        frames,
        np.ascontiguousarray(scan.vertices.T / np.float32(cell_size)),
        scan.linked,
        truncation / cell_size,
        coarse_truncation / (2 * cell_size),
        max_weight,
        sharp / cell_size,
        sharp_weight,
    )
    return None if counters[1] else int(counters[0])
