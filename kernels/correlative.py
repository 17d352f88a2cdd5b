"""Correlative search: the best places of a lattice, by the coarse level of every particle's own map.

For scans whose predicted place is too uncertain to start Gauss-Newton from (Olson, "Real-time correlative scan
matching", 2009): ``registration`` starts at the places found here.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite
from moteslam.kernels.runtime import one_thread, passes_for, runtime, ti
from moteslam.kernels.tiles import SIDE, STEPS, Tiles, address, frames_in_cells, read, steps_of, weight_of
from moteslam.kernels.types import (
    F32,
    F32_1D,
    F32_2D,
    F64_2D,
    I16_1D,
    I32,
    I32_1D,
    I32_2D,
    I64_1D,
    func,
    kernel,
    template,
)

MAX_SEARCH_POINTS = 64
"""Points of a scan that a search can look up: they are kept in registers and on the stack of each thread."""
MAX_SEARCH_COST = 1e8
"""Costs of turns and shifts are at most this [steps]: totals must fit 32 bits."""
MAX_LAID = 2**24
"""Cells whose scores are laid out, at most: 64 MB."""
LANE = 16
"""Bits of the total of each of the four places of a square: half a step each time, at most 767 of 64 points."""
LOOKED_UP = 2
"""The scores of the cells around a particle are laid out before a search that looks up each of them more often than
this: then a lookup takes a third of the time."""


@func
def _within(x: F32, last: F32):
    """As min and max do, but for numbers that are not one: these take three instructions each."""
    x = ti.select(x > 0.0, x, 0.0)
    return ti.select(x < last, x, last)


@func
def _score(word: I32, near: I32):
    """What a point over a cell counts [steps]: see ``search_scans``."""
    score = ti.max(near - ti.abs(steps_of(word)), -(near // 2))
    return ti.select(weight_of(word) > 0, score, 0)


@kernel
def _lay_out(
    pool: I16_1D, table: I32_1D, begin: I32, columns: I32, rows: I32, corners: I32_2D, side: I32, near: I32,
    laid: I32_1D,
):  # fmt: skip
    """The scores of the cells of a square box around each particle; cells beyond the tables are left out."""
    ti.loop_config(serialize=ti.static(one_thread()))
    for k in range(corners.shape[0] * side):
        i = k // side
        y, x = corners[i, 1] + k % side, corners[i, 0]
        end = ti.min(x + side, columns * (SIDE // 2))
        out = k * side
        while x < end and y < rows * (SIDE // 2):  # the cells of one tile, which lie side by side
            at = address(table, begin + i * columns * rows, columns, x, y, 1)
            for c in range(ti.min((x | (SIDE // 2 - 1)) + 1, end) - x):
                laid[out + c] = _score(ti.cast(pool[at + c], ti.i32), near)
            done = ti.min((x | (SIDE // 2 - 1)) + 1, end) - x
            out += done
            x += done


@kernel
def _search(
    pool: I16_1D, table: I32_1D, begin: I32, columns: I32, rows: I32, frames: F64_2D, scan: F32_2D, turns: F32_1D,
    turn_costs: I32_1D, shifts: F32_2D, shift_costs: I32_1D, drifts: F32_2D, blocks: I32, near: I32, corners: I32_2D,
    side: I32, laid: I32_1D, scores: I32_2D, chosen: I32_2D, passes: I32, dense: template,
):  # fmt: skip
    """The best shift of every block, the first of equal ones, for every particle and turn.

    Frames are cos, sin, x, y [coarse cells], shifts and drifts in the frame. A ``dense`` search reads scores that were
    laid out.
    """
    n_turns = turns.shape[0]
    tiles = columns * rows
    size = shifts.shape[0] // blocks
    last_x, last_y = ti.cast(columns * (SIDE // 2) - 1, ti.f32), ti.cast(rows * (SIDE // 2) - 1, ti.f32)
    points = ti.min(scan.shape[1], MAX_SEARCH_POINTS)
    ti.loop_config(serialize=ti.static(one_thread()))
    for p in range(frames.shape[0] * n_turns * blocks * passes):
        if p % passes:
            continue
        k = p // passes
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
        corner = i * side * side - corners[i, 1] * side - corners[i, 0]  # of the box: where cell (0, 0) would be
        best, at = -(1 << 30), 0
        for v in range(block * size, (block + 1) * size):
            u, w = shifts[v, 0] + drifts[t, 0], shifts[v, 1] + drifts[t, 1]
            dx, dy = c0 * u - s0 * w, s0 * u + c0 * w
            total = -turn_costs[t] - shift_costs[v]
            for j in range(points):
                gx, gy = xs[j] + dx, ys[j] + dy
                if ti.static(dense):
                    gx, gy = _within(gx, last_x), _within(gy, last_y)
                    total += laid[corner + ti.cast(gy, ti.i32) * side + ti.cast(gx, ti.i32)]
                else:
                    word = read(pool, table, begin + i * tiles, columns, gx, gy, last_x, last_y, 1)
                    total += _score(word, near)
            if total > best:
                best, at = total, v
        scores[i, t * blocks + block], chosen[i, t * blocks + block] = best, at


@kernel
def _search_squares(
    fours: I64_1D, rows: I32, columns: I32, xs: F32_2D, ys: F32_2D, squares: F32_2D, free: I32_1D, blocks: I32,
    scores: I32_2D, chosen: I32_2D, passes: I32,
):  # fmt: skip
    """The best place of every block of squares, the first of equal ones, for every turned scan [coarse cells]."""
    size = squares.shape[0] // blocks
    last_x, last_y = ti.cast(columns - 1, ti.f32), ti.cast(rows - 1, ti.f32)
    ti.loop_config(serialize=ti.static(one_thread()))
    for p in range(xs.shape[0] * blocks * passes):
        if p % passes:
            continue
        t, block = p // passes // blocks, p // passes % blocks
        best, at = -1, 0
        for q in range(block * size, (block + 1) * size):
            totals = ti.cast(0, ti.i64)
            for j in range(xs.shape[1]):
                gx, gy = _within(xs[t, j] + squares[q, 0], last_x), _within(ys[t, j] + squares[q, 1], last_y)
                totals += fours[ti.cast(gy, ti.i32) * columns + ti.cast(gx, ti.i32)]
            for lane in ti.static(range(4)):
                total = ti.cast((totals >> (LANE * lane)) & ((1 << LANE) - 1), ti.i32)
                if total > best and (free[q] >> lane) & 1:
                    best, at = total, 4 * q + lane
        scores[t, block], chosen[t, block] = best, at


class SquareScores(NamedTuple):
    """What a point over each coarse cell of a map counts for the four places of a square of a lattice.

    Attributes:
        fours: int64 [rows, columns], four times ``LANE`` bits.
        cell_size: of the coarse level [m].
    """

    fours: NDArray[np.int64]
    cell_size: float

    @classmethod
    def of(cls, tiles: Tiles, *, apart: int, cell_size: float, near: float) -> "SquareScores":
        """Of one map, of a lattice whose places are so many cells ``apart``.

        See ``search_scans`` for the score, of which this is half, without its negative part.
        """
        shape = tiles.rows * (SIDE // 2), tiles.columns * (SIDE // 2)
        side, least = max(shape), int(near * STEPS)
        laid = np.zeros((side, side), np.int32)
        runtime()
        grid = tiles.pool, tiles.table, tiles.first, tiles.columns, tiles.rows
        _lay_out(*grid, np.zeros((1, 2), np.int32), side, least, laid.reshape(-1))
        scores = ((laid + least // 2) // 2).astype(np.int64)
        padded = np.pad(scores[: shape[0], : shape[1]], ((0, apart), (0, apart)), mode="edge")
        lanes = [padded[y : y + shape[0], x : x + shape[1]] for y in (0, apart) for x in (0, apart)]
        return cls(sum(lane << (LANE * k) for k, lane in enumerate(lanes)), cell_size)  # type: ignore[arg-type]

    def best_of(
        self, points: ArrayLike, turns: ArrayLike, squares: ArrayLike, free: ArrayLike, *, blocks: int
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """The best places of squares: all are scored, four with each lookup (Olson 2009, correlative matching).

        Args:
            points: [k, 2] of the scan in the robot's frame, at most ``MAX_SEARCH_POINTS`` [m].
            turns: [a] headings [rad].
            squares: [m, 2] the lowest place of each, from the tables' corner [m].
            free: bool [m, 4] which of its places count, x fastest.
            blocks: number of equal blocks of consecutive squares; the best place of each is returned.

        Returns:
            int32 [a, blocks] their scores, -1 without a free place, and 4 times the square plus the place, the first of
            equal ones.
        """
        ends = as_finite("points", points, np.float32, (None, 2))
        if len(ends) > MAX_SEARCH_POINTS:
            raise InputError(f"{len(ends)}, expected at most {MAX_SEARCH_POINTS}", field="points")
        angles = as_finite("turns", turns, np.float64, (None,))[:, None]
        c, s = np.cos(angles), np.sin(angles)
        xs, ys = c * ends[:, 0] - s * ends[:, 1], s * ends[:, 0] + c * ends[:, 1]
        corners = as_finite("squares", np.asarray(squares, np.float64) / self.cell_size, np.float32, (None, 2))
        masks = (np.asarray(free, bool) @ (1 << np.arange(4))).astype(np.int32)
        scores, chosen = (np.empty((len(angles), blocks), np.int32) for _ in range(2))
        _search_squares(
            self.fours.reshape(-1), *self.fours.shape,
            *(np.ascontiguousarray(of / self.cell_size, np.float32) for of in (xs, ys)),
            corners, masks, blocks, scores, chosen, passes_for(scores.size),
        )  # fmt: skip
        return scores, chosen


def search_scans(
    tiles: Tiles,
    frames: ArrayLike,
    points: ArrayLike,
    turns: ArrayLike,
    turn_costs: ArrayLike,
    shifts: ArrayLike,
    shift_costs: ArrayLike,
    *,
    blocks: int,
    cell_size: float,
    near: float,
    drift: tuple[float, float] = (0.0, 0.0),
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The best places of a lattice around each pose, by the coarse level (correlative matching, Olson 2009).

    A place scores, for each point over a cell that was seen, ``near`` minus the cell's distance to the surface, but at
    least ``-near / 2``; from the sum the costs of its turn and its shift are subtracted. All are in steps, of which
    ``STEPS`` are a truncation.

    Args:
        frames: [n, 4] cos, sin, x, y of the poses, from the tables' corner [m].
        points: [k, 2] of the scan in the robot's frame, at most ``MAX_SEARCH_POINTS`` [m].
        turns: [a] added to the headings [rad].
        turn_costs: [a] 0 or more [steps].
        shifts: [b, 2] added to the places, in the frames of the poses as they are [m].
        shift_costs: [b] 0 or more [steps].
        blocks: number of equal blocks of consecutive shifts; the best shift of each is returned.
        cell_size: of the fine level [m].
        near: how near to a surface a point must lie to count for a place [truncations].
        drift: by this the shifts of a turn are moved besides [m/rad]: errors of heading and place go together.

    Returns:
        int32 [n, a * blocks] the scores of the best shift of each block, turn by turn, and which shifts these are,
        the first of equal ones.
    """
    n = tiles.maps
    places = frames_in_cells(frames, 2 * cell_size)
    scan = as_finite("points", points, np.float32, (None, 2))
    angles = as_finite("turns", turns, np.float32, (None,))
    drifts = angles[:, None] * as_finite("drift", np.asarray(drift) / (2 * cell_size), np.float32, (2,))
    across = as_finite("shifts", np.asarray(shifts, np.float64) / (2 * cell_size), np.float32, (None, 2))
    if len(places) != n:
        raise InputError(f"{len(places)}, expected one for each of {n} maps", field="frames")
    if len(scan) > MAX_SEARCH_POINTS:
        raise InputError(f"{len(scan)}, expected at most {MAX_SEARCH_POINTS}", field="points")
    scores, chosen = (np.empty((n, len(angles) * blocks), np.int32) for _ in range(2))
    runtime()
    if len(angles):
        grid = tiles.pool, tiles.table, tiles.first, tiles.columns, tiles.rows
        ends = np.ascontiguousarray(scan.T / np.float32(2 * cell_size), np.float32)
        farthest = float(np.hypot(*across.T).max(initial=0.0) + np.hypot(*drifts.T).max(initial=0.0))
        corners, side = _boxes(places, ends, farthest, columns=tiles.columns, rows=tiles.rows)
        dense = n * side**2 < min(MAX_LAID, len(angles) * len(across) * len(scan) * n / LOOKED_UP)
        laid = np.empty(n * side**2 if dense else 1, np.int32)
        if dense:
            _lay_out(*grid, corners, side, int(near * STEPS), laid)
        _search(
            *grid, places, ends, angles, _costs("turn_costs", turn_costs, len(angles)), across,
            _costs("shift_costs", shift_costs, len(across)), drifts, blocks, int(near * STEPS), corners, side, laid,
            scores, chosen, passes_for(n * len(angles) * blocks), dense,
        )  # fmt: skip
    return scores, chosen


def _boxes(
    places: NDArray[np.float64], ends: NDArray[np.float32], farthest: float, *, columns: int, rows: int
) -> tuple[NDArray[np.int32], int]:
    """The square boxes of coarse cells that searches look into.

    Args:
        places: [n, 4] frames [coarse cells].
        ends: [2, k] of the scan [coarse cells].
        farthest: that a search shifts them [coarse cells].
        columns, rows: of the tables [tiles].

    Returns:
        [n, 2] column and row of each box's first cell, within the tables; and the cells along a side.
    """
    reach = float(np.hypot(*ends).max(initial=0.0)) + farthest + 2
    last = np.array((columns, rows)) * (SIDE // 2) - 1
    corners = np.clip(np.floor(places[:, 2:] - reach), 0, last).astype(np.int32)
    return corners, 2 * math.ceil(reach) + 2


def _costs(name: str, costs: ArrayLike, count: int) -> NDArray[np.int32]:
    """As whole steps that add up within 32 bits."""
    given: NDArray[np.float64] = as_finite(name, costs, np.float64, (count,))
    return np.minimum(given, MAX_SEARCH_COST).astype(np.int32)
