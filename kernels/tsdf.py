"""Integrating scans into truncated signed-distance maps (TSDF), one map a particle.

A scan's neighbouring points are joined by segments. Every cell near a segment averages its signed distance to it
(Curless and Levoy 1996, A volumetric method for building complex models from range images, in the plane).
"""

from collections.abc import Sequence
from functools import lru_cache
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, passes_for, ti
from moteslam.kernels.scans import ThinnedScan
from moteslam.kernels.tiles import (
    SIDE,
    STEPS,
    TileStore,
    address,
    copy_on_write,
    pack,
    steps_of,
    tile_along,
    weight_of,
)
from moteslam.kernels.types import F32, F32_1D, F32_2D, F64_2D, I16_1D, I32, I32_1D, func, kernel, template

FAR = 1e6  # Cells; farther than any map
ALONG_AXIS = 1e-3  # Sine of the angle to an axis below which a segment is parallel to it: its reciprocal stays small
OVERLAP = 0.25  # A segment is integrated so far beyond its ends [cells]: where two meet at an angle none is left out
SLACK = 0.01  # A row of cells is so much longer at each end [cells]: rounding moves its ends; each is tested again


class IntegrationOptions(NamedTuple):
    """Of ``integrate_scans``."""

    cell_size: float  # of the fine level [m]
    truncation: float  # up to this distance from a segment fine cells are updated [m]
    coarse_truncation: float  # and coarse ones [m]
    coarse_chord: float  # on the coarse level segments are joined until their chord is this long [coarse cells]
    near: float  # distances below it weigh `near_weight` in a cell's average, the others 1 [m]
    near_weight: int  # 1 to ``tiles.MAX_WEIGHT``.
    max_weight: int  # of the average itself, 1 to ``tiles.MAX_WEIGHT``.

    @lru_cache(maxsize=64)  # noqa: B019 - a tuple of numbers
    def numbers(self) -> NDArray[np.float32]:
        """As the kernel reads them, lengths in cells: of the coarse level the coarse truncation, else fine ones."""
        cell = self.cell_size
        lengths = self.truncation / cell, self.coarse_truncation / (2 * cell), 2 * self.coarse_chord, self.near / cell
        return np.array((*lengths, self.near_weight, self.max_weight), np.float32)


@func
def _segment(frame: template, scan: template, j: I32, k: I32):
    """The ends (ax, ay, bx, by) [fine cells] of the segment from point j to point k, seen from a frame."""
    c, s, x, y = frame[0], frame[1], frame[2], frame[3]
    ax, ay = c * scan[0, j] - s * scan[1, j] + x, s * scan[0, j] + c * scan[1, j] + y
    bx, by = c * scan[0, k] - s * scan[1, k] + x, s * scan[0, k] + c * scan[1, k] + y
    return ti.Vector([ax, ay, bx, by], dt=ti.f32)


@func
def _integrate_segment(
    pool: template, table: template, base: I32, columns: I32, ends: template, truncation: F32, near: F32,
    near_weight: I32, max_weight: I32, level: template,
):  # fmt: skip
    """Average the distances to one segment into the cells around it; lengths in cells of the level."""
    ax, ay, bx, by = ends[0], ends[1], ends[2], ends[3]
    dx, dy = bx - ax, by - ay
    length = ti.sqrt(dx * dx + dy * dy)
    ux, uy = dx / length, dy / length
    per_truncation, per_step = 1.0 / truncation, ti.f32(1.0 / STEPS)
    near_share = near * per_truncation
    # lines of cells run across the segment rather than along it: few long ones; o is from line to line, i in the line
    flat = ti.abs(ux) > ti.abs(uy)
    ao, bo, uo = ti.select(flat, ax, ay), ti.select(flat, bx, by), ti.select(flat, ux, uy)
    ai, bi, ui = ti.select(flat, ay, ax), ti.select(flat, by, bx), ti.select(flat, uy, ux)
    # of the signed distance [truncations]
    vo, vi = ti.select(flat, -uy, ux) * per_truncation, ti.select(flat, ux, -uy) * per_truncation
    below, above = ti.floor(ti.min(ao, bo) - truncation), ti.floor(ti.max(ao, bo) + truncation)
    left, right = ti.floor(ti.min(ai, bi) - truncation), ti.floor(ti.max(ai, bi) + truncation)
    # of every line only the part in the band around the segment: within i = o * slope +- half for the distance, and
    # likewise for the place along it; and only the lines that the band meets
    slope, half = ui / uo, truncation / ti.abs(uo)
    along_slope, along_half, along_middle = 0.0, FAR, 0.0
    if ti.abs(ui) > ALONG_AXIS:
        along_slope, along_half, along_middle = -uo / ui, (0.5 * length + OVERLAP) / ti.abs(ui), 0.5 * length / ui
    mask = ti.static((SIDE >> level) - 1)
    stride = ti.select(flat, ti.static(SIDE >> level), 1)  # from cell to cell of a line
    beyond = OVERLAP * ti.abs(uo) + truncation * ti.abs(ui)
    # positive numbers: the cast is the floor
    begin = ti.cast(ti.max(ti.min(ao, bo) - beyond + (0.5 - SLACK), below), ti.i32)
    end = ti.cast(ti.min(ti.max(ao, bo) + beyond - (0.5 - SLACK), above), ti.i32)
    for o in range(begin, end + 1):
        line = ti.cast(o, ti.f32) + 0.5 - ao
        across, along_at = line * slope, line * along_slope + along_middle
        low, high = ti.max(across - half, along_at - along_half), ti.min(across + half, along_at + along_half)
        first = ti.cast(ti.max(low + ai + (0.5 - SLACK), left), ti.i32)
        last = ti.cast(ti.min(high + ai - (0.5 - SLACK), right), ti.i32)
        begin_of_tile = first
        while begin_of_tile <= last:  # the part of the line in one tile, where the next cell is a stride away
            end_of_tile = ti.min(begin_of_tile | mask, last)
            x, y = ti.select(flat, o, begin_of_tile), ti.select(flat, begin_of_tile, o)
            at = address(table, base, columns, x, y, level)
            for i in range(begin_of_tile, end_of_tile + 1):
                place = ti.cast(i, ti.f32) + 0.5 - ai
                along, distance = line * uo + place * ui, line * vo + place * vi
                if along >= -OVERLAP and along <= length + OVERLAP and distance > -1.0 and distance < 1.0:
                    word = ti.cast(pool[at], ti.i32)
                    old, weight = ti.cast(steps_of(word), ti.f32) * per_step, weight_of(word)
                    gain = ti.select(ti.abs(distance) < near_share, near_weight, 1)
                    w, g = ti.cast(weight, ti.f32), ti.cast(gain, ti.f32)
                    pool[at] = pack((old * w + distance * g) / (w + g), ti.min(weight + gain, max_weight))
                at += stride
            begin_of_tile = end_of_tile + 1


@kernel
def _integrate(
    pool: I16_1D, table: I32_1D, begin: I32, shares: I32_1D, free: I32_1D, counters: I32_1D, columns: I32, size: I32,
    frames: F64_2D, points: F32_2D, joined: I32_1D, begins: I32_1D, settings: F32_1D, passes: I32, alone: template,
):  # fmt: skip
    """First every particle makes the tiles it will write its own, then all write; if tiles ran out, nobody writes.

    Frames are cos, sin, x, y, of each particle as many as there are scans; scan s has the points from ``begins[s]``
    on. ``settings`` are ``IntegrationOptions.numbers``. A particle that is ``alone`` wakes no other thread; for others
    there are ``passes`` each, see ``passes_for``.
    """
    scans = begins.shape[0] - 1
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread() or alone))
    for k in range(frames.shape[0] // (begins.shape[0] - 1) * passes):
        if k % passes:
            continue
        i = k // passes
        base, chord = begin + i * size, settings[2]
        margin = ti.max(settings[0], 2 * settings[1]) + chord  # a chord strays from its segments by less than that
        done = ti.Vector([-1, -1, -1, -1], dt=ti.i32)  # the tiles last made the particle's own: columns and rows
        for s in range(scans):
            frame = ti.Vector([ti.cast(frames[i * scans + s, m], ti.f32) for m in ti.static(range(4))], dt=ti.f32)
            for j in range(begins[s], begins[s + 1] - 1):
                if joined[j] == 1:
                    ends = _segment(frame, points, j, j + 1)
                    x0 = tile_along(ti.min(ends[0], ends[2]) - margin)
                    x1 = tile_along(ti.max(ends[0], ends[2]) + margin)
                    y0 = tile_along(ti.min(ends[1], ends[3]) - margin)
                    y1 = tile_along(ti.max(ends[1], ends[3]) + margin)
                    if x0 != done[0] or x1 != done[1] or y0 != done[2] or y1 != done[3]:
                        done = ti.Vector([x0, x1, y0, y1], dt=ti.i32)
                        for ty in range(y0, y1 + 1):
                            for tx in range(x0, x1 + 1):
                                copy_on_write(pool, table, shares, free, counters, base + ty * columns + tx)
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread() or alone))
    for k in range(frames.shape[0] // (begins.shape[0] - 1) * passes):
        i = k // passes
        if k % passes == 0 and counters[1] == 0:
            base = begin + i * size
            truncation, coarse_truncation, chord, near = settings[0], settings[1], settings[2], settings[3]
            near_weight, max_weight = ti.cast(settings[4], ti.i32), ti.cast(settings[5], ti.i32)
            for s in range(scans):
                frame = ti.Vector([ti.cast(frames[i * scans + s, m], ti.f32) for m in ti.static(range(4))], dt=ti.f32)
                first, last = begins[s], begins[s + 1] - 1  # the point where the coarse level's segment begins
                for j in range(begins[s], begins[s + 1] - 1):
                    if joined[j] == 0:
                        first = j + 1
                    else:
                        ends = _segment(frame, points, j, j + 1)
                        _integrate_segment(
                            pool, table, base, columns, ends, truncation, near, near_weight, max_weight, 0
                        )
                        dx, dy = points[0, j + 1] - points[0, first], points[1, j + 1] - points[1, first]
                        if dx * dx + dy * dy >= chord * chord or joined[j + 1] == 0 or j == last - 1:
                            half = 0.5 * _segment(frame, points, first, j + 1)
                            _integrate_segment(
                                pool, table, base, columns, half, coarse_truncation, 0.5 * near, near_weight,
                                max_weight, 1,
                            )  # fmt: skip
                            first = j + 1


def integrate_scans(
    store: TileStore,
    frames: ArrayLike,
    scans: Sequence[ThinnedScan],
    *,
    options: IntegrationOptions,
    part: range | None = None,
) -> bool:
    """Integrate scans, one after the other, into the maps of n particles, each from its own poses.

    Args:
        store: of the maps, counted since they were resampled, with tables that the scans stay within; written to.
        frames: [n * m, 4] cos, sin, x, y of each particle at the m scans, from the tables' corner [m].
        part: of the store's particles, one after the other; all if None.

    Returns:
        Whether there were tiles enough. Where not, no cell was written, though some tables name tiles of their own now:
        count the shares again, make room, and call again.
    """
    tiles = store.tiles
    part = range(tiles.maps) if part is None else part
    places = as_finite("frames", frames, np.float64, (None, 4)) / (1, 1, options.cell_size, options.cell_size)
    if not scans or len(places) != len(part) * len(scans):
        problem = f"{len(places)}, expected one for each of {len(part)} maps at each of {len(scans)} scans"
        raise InputError(problem, field="frames")
    points, joined = scans[0]
    if len(scans) > 1:
        points, joined = np.vstack([scan.points for scan in scans]), np.concatenate([scan.joined for scan in scans])
    check_array("scan", joined, np.int32, (len(points),))
    if not store.left:
        return False
    counters = np.array([store.left, 0], np.int32)
    _integrate(
        *(tiles.pool, tiles.table, tiles.first + part.start * tiles.size, store.shares, store.free, counters),
        *(tiles.columns, tiles.size, places),
        np.ascontiguousarray(points.T / np.float32(options.cell_size)), joined,
        np.array([0, *accumulate(len(scan.points) for scan in scans)], np.int32), options.numbers(),
        *(passes_for(len(part)), len(part) == 1 and not one_thread()),
    )  # fmt: skip
    left, short = counters.tolist()
    if short:
        return False
    store.left = left
    return True
