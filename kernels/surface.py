"""Writing scans into signed-distance maps, one map a particle.

The surface is the polyline between neighbouring vertices of a scan; every cell near it averages its distance to it
(Curless and Levoy 1996, A volumetric method for building complex models from range images, in the plane).
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, runtime, ti
from moteslam.kernels.thinning import ThinScan, thin_scan
from moteslam.kernels.tiles import (
    CELLS,
    MAX_WEIGHT,
    SIDE,
    STEPS,
    address,
    check_tiles,
    claim,
    frames_in_cells,
    pack,
    steps_of,
    tile_along,
    weight_of,
)
from moteslam.kernels.types import F32, F32_2D, F64_2D, I16_1D, I32, I32_1D, func, kernel, template

__all__ = ["ThinScan", "add_scans", "thin_scan"]

FAR = 1e6
"""Cells; farther than any map."""
ALONG_AXIS = 1e-3
"""Sine of the angle to an axis below which a stretch counts as parallel to it."""
OVERLAP = 0.25
"""A stretch of surface is written so far beyond its ends [cells], so that bends leave no cell out."""
SLACK = 0.01
"""What rounding may move the ends of a row of cells by [cells]."""
CHORD = 0.5
"""On the coarse level stretches are joined until their chord is so long [cells]."""


@func
def _stretch(frames: template, i: I32, scan: template, j: I32, k: I32):
    """The ends (ax, ay, bx, by) [fine cells] of the surface between vertices j and k, in the map of particle i."""
    c, s = ti.cast(frames[i, 0], ti.f32), ti.cast(frames[i, 1], ti.f32)
    x, y = ti.cast(frames[i, 2], ti.f32), ti.cast(frames[i, 3], ti.f32)
    ax, ay = c * scan[0, j] - s * scan[1, j] + x, s * scan[0, j] + c * scan[1, j] + y
    bx, by = c * scan[0, k] - s * scan[1, k] + x, s * scan[0, k] + c * scan[1, k] + y
    return ti.Vector([ax, ay, bx, by], dt=ti.f32)


@func
def _draw(
    pool: template, table: template, base: I32, columns: I32, ends: template, reach: F32, cap: I32, sharp: F32,
    boost: I32, level: template,
):  # fmt: skip
    """Average the distances of one stretch of surface into the cells around it; lengths in cells of the level."""
    ax, ay, bx, by = ends[0], ends[1], ends[2], ends[3]
    dx, dy = bx - ax, by - ay
    length = ti.sqrt(dx * dx + dy * dy)
    ux, uy = dx / length, dy / length
    per_reach, per_step = 1.0 / reach, ti.f32(1.0 / STEPS)
    vx, vy = ux * per_reach, uy * per_reach
    near = sharp * per_reach
    # lines of cells run across the stretch rather than along it: few long ones; o is from line to line, i in the line
    flat = ti.abs(ux) > ti.abs(uy)
    ao, bo, uo = ti.select(flat, ax, ay), ti.select(flat, bx, by), ti.select(flat, ux, uy)
    ai, bi, ui = ti.select(flat, ay, ax), ti.select(flat, by, bx), ti.select(flat, uy, ux)
    below, above = ti.floor(ti.min(ao, bo) - reach), ti.floor(ti.max(ao, bo) + reach)
    left, right = ti.floor(ti.min(ai, bi) - reach), ti.floor(ti.max(ai, bi) + reach)
    # of every line only the part in the band around the stretch: within i = o * slope +- half for the distance, and
    # likewise for the place along it; and only the lines that the band meets
    slope, half = ui / uo, reach / ti.abs(uo)
    along_slope, along_half, along_middle = 0.0, FAR, 0.0
    if ti.abs(ui) > ALONG_AXIS:
        along_slope, along_half, along_middle = -uo / ui, (0.5 * length + OVERLAP) / ti.abs(ui), 0.5 * length / ui
    beyond = OVERLAP * ti.abs(uo) + reach * ti.abs(ui)
    # positive numbers: the cast is the floor
    begin = ti.cast(ti.max(ti.min(ao, bo) - beyond + (0.5 - SLACK), below), ti.i32)
    end = ti.cast(ti.min(ti.max(ao, bo) + beyond - (0.5 - SLACK), above), ti.i32)
    for o in range(begin, end + 1):
        line = ti.cast(o, ti.f32) + 0.5 - ao
        across, along_at = line * slope, line * along_slope + along_middle
        low, high = ti.max(across - half, along_at - along_half), ti.min(across + half, along_at + along_half)
        first = ti.cast(ti.max(low + ai + (0.5 - SLACK), left), ti.i32)
        last = ti.cast(ti.min(high + ai - (0.5 - SLACK), right), ti.i32)
        for i in range(first, last + 1):
            place = ti.cast(i, ti.f32) + 0.5 - ai
            px, py = ti.select(flat, line, place), ti.select(flat, place, line)
            along = px * ux + py * uy
            distance = vx * py - vy * px  # in truncations
            if along >= -OVERLAP and along <= length + OVERLAP and distance > -1.0 and distance < 1.0:
                at = address(table, base, columns, ti.select(flat, o, i), ti.select(flat, i, o), level)
                word = ti.cast(pool[at], ti.i32)
                old, weight = ti.cast(steps_of(word), ti.f32) * per_step, weight_of(word)
                gain = ti.select(ti.abs(distance) < near, boost, 1)
                w, g = ti.cast(weight, ti.f32), ti.cast(gain, ti.f32)
                pool[at] = pack((old * w + distance * g) / (w + g), ti.min(weight + gain, cap))


@kernel
def _add(
    pool: I16_1D, table: I32_1D, shares: I32_1D, free: I32_1D, counters: I32_1D, columns: I32, tiles: I32,
    frames: F64_2D, scan: F32_2D, linked: I32_1D, reach: F32, coarse_reach: F32, cap: I32, sharp: F32, boost: I32,
):  # fmt: skip
    """All claim, then all write: where a claim failed nobody writes.

    Frames are cos, sin, x, y of each particle. Lengths are in fine cells, ``coarse_reach`` in coarse ones.
    """
    ti.loop_config(serialize=ti.static(one_thread()))
    for i in range(frames.shape[0]):
        margin = ti.max(reach, 2 * coarse_reach) + 2 * CHORD  # so far a chord strays from the stretches that it joins
        done = ti.Vector([-1, -1, -1, -1], dt=ti.i32)  # the tiles that were claimed last: columns and rows
        for j in range(scan.shape[1] - 1):
            if linked[j] == 1:
                ends = _stretch(frames, i, scan, j, j + 1)
                x0, x1 = tile_along(ti.min(ends[0], ends[2]) - margin), tile_along(ti.max(ends[0], ends[2]) + margin)
                y0, y1 = tile_along(ti.min(ends[1], ends[3]) - margin), tile_along(ti.max(ends[1], ends[3]) + margin)
                if x0 != done[0] or x1 != done[1] or y0 != done[2] or y1 != done[3]:
                    done = ti.Vector([x0, x1, y0, y1], dt=ti.i32)
                    for ty in range(y0, y1 + 1):
                        for tx in range(x0, x1 + 1):
                            claim(pool, table, shares, free, counters, i * tiles + ty * columns + tx)
    ti.loop_config(serialize=ti.static(one_thread()))
    for i in range(frames.shape[0]):
        if counters[1] == 0:
            first = 0  # the vertex where the coarse level's stretch begins
            for j in range(scan.shape[1] - 1):
                if linked[j] == 0:
                    first = j + 1
                else:
                    ends = _stretch(frames, i, scan, j, j + 1)
                    _draw(pool, table, i * tiles, columns, ends, reach, cap, sharp, boost, 0)
                    dx, dy = scan[0, j + 1] - scan[0, first], scan[1, j + 1] - scan[1, first]
                    if dx * dx + dy * dy >= 4 * CHORD * CHORD or linked[j + 1] == 0 or j == scan.shape[1] - 2:
                        half = 0.5 * _stretch(frames, i, scan, first, j + 1)
                        _draw(pool, table, i * tiles, columns, half, coarse_reach, cap, 0.5 * sharp, boost, 1)
                        first = j + 1


def add_scans(
    pool: NDArray[np.int16],
    tables: NDArray[np.int32],
    shares: NDArray[np.int32],
    free: NDArray[np.int32],
    frames: ArrayLike,
    scan: ThinScan,
    *,
    cell_size: float,
    truncation: float,
    coarse_truncation: float,
    sharp: float,
    sharp_weight: int,
    max_weight: int,
) -> int | None:
    """Write one scan into the maps of all particles, each from its own pose.

    Args:
        pool: int16 [t * CELLS] of all tiles; written to.
        tables: int32 [n, rows, columns] each particle's tiles; written to.
        shares: int32 [t] how many table entries name each tile, above 1 for tile 0; written to.
        free: int32 [f] the tiles that nobody has, taken from the end.
        frames: [n, 4] cos, sin, x, y of the particles, from the tables' corner [m].
        scan: of the robot.
        cell_size: of the fine level [m].
        truncation, coarse_truncation: how far from a surface cells are told their distance to it, on each level [m].
        sharp: distances below it ...
        sharp_weight: ... weigh so much in a cell's average, 1 to ``MAX_WEIGHT``, the others 1 [m].
        max_weight: the average itself weighs at most this, 1 to ``MAX_WEIGHT``.

    Returns:
        How many of the free tiles are left, or None where they did not suffice: then no cell was written, though
        some tables name tiles of their own now. Count the shares anew, make room, and call again.

    Raises:
        InputError: arrays that do not fit together, options out of bounds, or a scan that leaves the tables.
    """
    n, rows, columns = check_tiles(pool, tables, written=True)
    check_array("shares", shares, np.int32, (len(pool) // CELLS,), written=True)
    check_array("free", free, np.int32, (None,))
    places = frames_in_cells(frames, cell_size)
    vertices = as_finite("scan", scan.vertices, np.float32, (None, 2))
    check_array("scan", scan.linked, np.int32, (len(vertices),))
    if len(places) != n:
        raise InputError(f"{len(places)}, expected one for each of {n} tables", field="frames")
    lengths = {"truncation": truncation, "coarse_truncation": coarse_truncation, "sharp": sharp}
    for name, length in lengths.items():
        if not (math.isfinite(length) and length > 0):
            raise InputError(f"{length:g} m, expected above 0", field=name)
    for name, weight in {"sharp_weight": sharp_weight, "max_weight": max_weight}.items():
        if not 1 <= weight <= MAX_WEIGHT:
            raise InputError(f"{weight}, expected 1 to {MAX_WEIGHT}", field=name)
    margin = max(truncation, coarse_truncation) / cell_size + 2
    radius = float(np.hypot(vertices[:, 0], vertices[:, 1]).max(initial=0.0)) / cell_size
    around = np.hypot(places[:, :1], places[:, 1:2]) * radius + margin
    if (places[:, 2:] < around).any() or (places[:, 2:] + around > np.array((columns, rows)) * SIDE).any():
        raise InputError("a scan that may reach beyond the tables, expected larger ones", field="frames")
    if not len(free):
        return None
    runtime()
    counters = np.array([len(free), 0], np.int32)
    _add(
        pool, tables.reshape(-1), shares, free, counters, columns, rows * columns, places,
        np.ascontiguousarray(vertices.T / np.float32(cell_size)), scan.linked, truncation / cell_size,
        coarse_truncation / (2 * cell_size), max_weight, sharp / cell_size, sharp_weight,
    )  # fmt: skip
    return None if counters[1] else int(counters[0])
