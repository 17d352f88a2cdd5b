"""Matching scans to signed-distance maps, every particle to its own: a search over a lattice, then Gauss-Newton."""


import numpy as np

from moteslam.kernels.runtime import runtime, ti
from moteslam.kernels.tiles import SIDE, STEPS, address, bilinear
from moteslam.kernels.types import F32, F32_1D, F32_2D, F64_2D, I16_1D, I32, I32_1D, I32_2D, func, kernel, template

MAX_SEARCH_POINTS = 96


@kernel
def _search(
    pool: I16_1D, table: I32_1D, columns: I32, rows: I32, frames: F64_2D, scan: F32_2D, turns: F32_1D,
    turn_costs: I32_1D, shifts: F32_2D, shift_costs: I32_1D, blocks: I32, sharp: I32, scores: I32_2D, chosen: I32_2D,
):  # fmt: skip
    """The best shift of every block, for every particle and turn.

    Frames are cos, sin, x, y [coarse cells], shifts in the robot's frame. Points near a surface count for a pose,
    points that the map knows to be elsewhere half as much against it, others nothing.
    """
    n_turns = turns.shape[0]
    tiles = columns * rows
    size = shifts.shape[0] // blocks
    last_x, last_y = ti.cast(columns * (SIDE // 2) - 1, ti.f32), ti.cast(rows * (SIDE // 2) - 1, ti.f32)
    points = ti.min(scan.shape[1], MAX_SEARCH_POINTS)
    for k in range(frames.shape[0] * n_turns * blocks):
        i, t, block = k // (n_turns * blocks), k // blocks % n_turns, k % blocks
        c0, s0 = ti.cast(frames[i, 0], ti.f32), ti.cast(frames[i, 1], ti.f32)
        x0, y0 = ti.cast(frames[i, 2], ti.f32), ti.cast(frames[i, 3], ti.f32)
        ct, st = ti.cos(turns[t]), ti.sin(turns[t])
        c, s = c0 * ct - s0 * st, s0 * ct + c0 * st
        xs = ti.Vector([0.0] * MAX_SEARCH_POINTS, dt=ti.f32)
        ys = ti.Vector([0.0] * MAX_SEARCH_POINTS, dt=ti.f32)
        for j in range(points):
            xs[j] = c * scan[0, j] - s * scan[1, j] + x0
            ys[j] = s * scan[0, j] + c * scan[1, j] + y0
        best, at = -(1 << 30), 0
        for v in range(block * size, (block + 1) * size):
            dx, dy = c0 * shifts[v, 0] - s0 * shifts[v, 1], s0 * shifts[v, 0] + c0 * shifts[v, 1]
            total = -turn_costs[t] - shift_costs[v]
            for j in range(points):
                ix = ti.cast(ti.min(ti.max(xs[j] + dx, 0.0), last_x), ti.i32)
                iy = ti.cast(ti.min(ti.max(ys[j] + dy, 0.0), last_y), ti.i32)
                word = ti.cast(pool[address(table, i * tiles, columns, ix, iy, 1)], ti.i32)
                near = ti.max(sharp - ti.abs(word >> 5), -(sharp // 2))
                total += ti.select((word & 31) > 0, near, 0)
            if total > best:
                best, at = total, v
        scores[i, t * blocks + block], chosen[i, t * blocks + block] = best, at


@func
def _solve(h: template, b: template):
    """The solution of a symmetric positive 3 x 3 system; h holds 00 01 02 11 12 22."""
    l00 = ti.sqrt(h[0])
    l10, l20 = h[1] / l00, h[2] / l00
    l11 = ti.sqrt(ti.max(h[3] - l10 * l10, 1e-9))
    l21 = (h[4] - l20 * l10) / l11
    l22 = ti.sqrt(ti.max(h[5] - l20 * l20 - l21 * l21, 1e-9))
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    x2 = y2 / l22
    x1 = (y1 - l21 * x2) / l11
    x0 = (y0 - l10 * x1 - l20 * x2) / l00
    return ti.Vector([x0, x1, x2], dt=ti.f32)


@func
def _descend(
    pool: template,
    table: template,
    base: I32,
    columns: I32,
    last_x: F32,
    last_y: F32,
    frame: template,
    scan: template,
    start: template,
    prior: template,
    cell: F32,
    truncation: F32,
    sd: F32,
    iterations: I32,
    level: template,
):
    """Gauss-Newton on one level. Returns the offset from the frame (x, y [m], theta), in the frame."""
    d = ti.Vector([start[0], start[1], start[2]], dt=ti.f32)
    inverse = 1.0 / cell
    running = 1
    for _ in range(iterations):
        if running == 1:
            ct, st = ti.cos(d[2]), ti.sin(d[2])
            h = ti.Vector([prior[0], 0.0, 0.0, prior[1], 0.0, prior[2]], dt=ti.f32)
            b = ti.Vector(
                [-prior[0] * (d[0] - prior[3]), -prior[1] * (d[1] - prior[4]), -prior[2] * (d[2] - prior[5])], dt=ti.f32
            )
            for j in range(scan.shape[1]):
                rx, ry = ct * scan[0, j] - st * scan[1, j], st * scan[0, j] + ct * scan[1, j]
                qx, qy = rx + d[0], ry + d[1]
                gx = (frame[0] * qx - frame[1] * qy) * inverse + frame[2] * inverse
                gy = (frame[1] * qx + frame[0] * qy) * inverse + frame[3] * inverse
                gx = ti.min(ti.max(gx, 1.0), last_x)
                gy = ti.min(ti.max(gy, 1.0), last_y)
                f = bilinear(pool, table, base, columns, gx, gy, level)
                if f[3] > 0:
                    scale = truncation / sd
                    r = f[0] * scale
                    wx, wy = f[1] * scale * inverse, f[2] * scale * inverse
                    jx, jy = frame[0] * wx + frame[1] * wy, -frame[1] * wx + frame[0] * wy
                    jt = jy * rx - jx * ry
                    h[0] += jx * jx
                    h[1] += jx * jy
                    h[2] += jx * jt
                    h[3] += jy * jy
                    h[4] += jy * jt
                    h[5] += jt * jt
                    b[0] -= jx * r
                    b[1] -= jy * r
                    b[2] -= jt * r
            step = _solve(h, b)
            d += step
            if ti.abs(step[0]) + ti.abs(step[1]) < 2e-4 and ti.abs(step[2]) < 5e-5:
                running = 0
    return d


@kernel
def _register(
    pool: I16_1D, table: I32_1D, stride: I32, columns: I32, rows: I32, frames: F64_2D, scan: F32_2D, starts: F32_2D,
    priors: F32_2D, settings: F32_1D, offsets: F32_2D, fits: F32_2D,
):  # fmt: skip
    """Frames: cos, sin, x, y [m] from the table's corner.

    Settings: cell, truncation, coarse truncation, sd, coarse sd, iterations, coarse iterations, unknown cost.
    Fits: information 00 01 02 11 12 22, cost, known share, mean likelihood.
    """
    fine_x, fine_y = ti.cast(columns * SIDE - 2, ti.f32), ti.cast(rows * SIDE - 2, ti.f32)
    coarse_x, coarse_y = ti.cast(columns * SIDE // 2 - 2, ti.f32), ti.cast(rows * SIDE // 2 - 2, ti.f32)
    ti.loop_config(block_dim=1)
    for i in range(frames.shape[0]):
        frame = ti.Vector(
            [
                ti.cast(frames[i, 0], ti.f32),
                ti.cast(frames[i, 1], ti.f32),
                ti.cast(frames[i, 2], ti.f32),
                ti.cast(frames[i, 3], ti.f32),
            ],
            dt=ti.f32,
        )
        prior = ti.Vector(
            [priors[i, 0], priors[i, 1], priors[i, 2], priors[i, 3], priors[i, 4], priors[i, 5]], dt=ti.f32
        )
        # three names: Taichi clears the variable that a function's result goes to before it reads the arguments
        start = ti.Vector([starts[i, 0], starts[i, 1], starts[i, 2]], dt=ti.f32)
        cell, truncation, coarse_truncation = settings[0], settings[1], settings[2]
        coarse = _descend(
            pool,
            table,
            i * stride,
            columns,
            coarse_x,
            coarse_y,
            frame,
            scan,
            start,
            prior,
            2 * cell,
            coarse_truncation,
            settings[4],
            ti.cast(settings[6], ti.i32),
            1,
        )
        d = _descend(
            pool,
            table,
            i * stride,
            columns,
            fine_x,
            fine_y,
            frame,
            scan,
            coarse,
            prior,
            cell,
            truncation,
            settings[3],
            ti.cast(settings[5], ti.i32),
            0,
        )
        # how well it fits, and how well that is determined
        ct, st = ti.cos(d[2]), ti.sin(d[2])
        h = ti.Vector([0.0] * 6, dt=ti.f32)
        cost, known, likely, crossed = 0.0, 0.0, 0.0, 0.0
        ox, oy = ct * settings[10] - st * settings[11] + d[0], st * settings[10] + ct * settings[11] + d[1]
        ox, oy = frame[0] * ox - frame[1] * oy + frame[2], frame[1] * ox + frame[0] * oy + frame[3]
        for j in range(scan.shape[1]):
            rx, ry = ct * scan[0, j] - st * scan[1, j], st * scan[0, j] + ct * scan[1, j]
            qx, qy = rx + d[0], ry + d[1]
            px, py = frame[0] * qx - frame[1] * qy + frame[2], frame[1] * qx + frame[0] * qy + frame[3]
            gx = ti.min(ti.max(px / cell, 1.0), fine_x)
            gy = ti.min(ti.max(py / cell, 1.0), fine_y)
            f = bilinear(pool, table, i * stride, columns, gx, gy, 0)
            if f[3] > 0:
                scale = truncation / settings[3]
                r = f[0] * scale
                wx, wy = f[1] * scale / cell, f[2] * scale / cell
                jx, jy = frame[0] * wx + frame[1] * wy, -frame[1] * wx + frame[0] * wy
                jt = jy * rx - jx * ry
                h[0] += jx * jx
                h[1] += jx * jy
                h[2] += jx * jt
                h[3] += jy * jy
                h[4] += jy * jt
                h[5] += jt * jt
                cost += 0.5 * ti.min(r * r, settings[8])
                known += 1
                likely += ti.exp(-0.5 * r * r / settings[9])
            else:
                gx = ti.min(ti.max(px / (2 * cell), 1.0), coarse_x)
                gy = ti.min(ti.max(py / (2 * cell), 1.0), coarse_y)
                f = bilinear(pool, table, i * stride, columns, gx, gy, 1)
                if f[3] > 0:
                    r = f[0] * coarse_truncation / settings[3]
                    cost += 0.5 * ti.min(r * r, settings[8])
                    known += 1
                    likely += ti.exp(-0.5 * r * r / settings[9])
                else:
                    cost += settings[7]
            hit = 0
            for k in ti.static(range(6)):
                share = ti.static((0.9, 0.75, 0.6, 0.45, 0.3, 0.15)[k])
                gx, gy = (ox + share * (px - ox)) / cell, (oy + share * (py - oy)) / cell
                ahead = (1 - share) * ti.sqrt((px - ox) ** 2 + (py - oy) ** 2)
                ix = ti.cast(ti.min(ti.max(gx, 1.0), fine_x), ti.i32)
                iy = ti.cast(ti.min(ti.max(gy, 1.0), fine_y), ti.i32)
                word = ti.cast(pool[address(table, i * stride, columns, ix, iy, 0)], ti.i32)
                if (word & 31) > 4 and ti.abs(word >> 5) < STEPS // 3 and ahead > 2 * truncation:
                    hit = 1
            crossed += ti.cast(hit, ti.f32)
        for j in ti.static(range(3)):
            offsets[i, j] = d[j]
        for j in ti.static(range(6)):
            fits[i, j] = h[j]
        fits[i, 6], fits[i, 7], fits[i, 8], fits[i, 9] = cost, known, likely, crossed


def search_scans(pool, tables, frames, points, turns, turn_costs, shifts, shift_costs, *, blocks, cell_size, sharp):
    runtime()
    n, rows, columns = tables.shape
    frames = frames.copy()
    frames[:, 2:] /= cell_size
    scores, chosen = np.empty((n, len(turns) * blocks), np.int32), np.empty((n, len(turns) * blocks), np.int32)
    _search(
        pool,
        np.ascontiguousarray(tables).reshape(-1),
        columns,
        rows,
        frames,
        np.ascontiguousarray(points.T / np.float32(cell_size)),
        turns.astype(np.float32),
        np.minimum(turn_costs, 1e8).astype(np.int32),
        (shifts / cell_size).astype(np.float32),
        np.minimum(shift_costs, 1e8).astype(np.int32),
        blocks,
        int(sharp * STEPS),
        scores,
        chosen,
    )
    return scores, chosen


def register_scans(
    pool,
    tables,
    frames,
    points,
    origin,
    starts,
    priors,
    *,
    cell_size,
    truncation,
    coarse_truncation,
    residual,
    iterations,
    unknown,
    outlier,
):
    runtime()
    maps, rows, columns = tables.shape
    n = len(frames)
    settings = np.array(
        [
            cell_size,
            truncation,
            coarse_truncation,
            residual,
            2 * residual,
            iterations,
            iterations,
            unknown,
            2 * outlier,
            4.0,
            *origin,
        ],
        np.float32,
    )
    offsets, fits = np.empty((n, 3), np.float32), np.empty((n, 10), np.float32)
    _register(
        pool,
        np.ascontiguousarray(tables).reshape(-1),
        columns * rows if maps > 1 else 0,
        columns,
        rows,
        frames,
        np.ascontiguousarray(points.T),
        starts.astype(np.float32),
        priors.astype(np.float32),
        settings,
        offsets,
        fits,
    )
    return offsets.astype(np.float64), fits.astype(np.float64)
