"""Correlative search: the best places of a lattice, by the coarse level of one map.

For scans whose predicted place is too uncertain to start Gauss-Newton from (Olson, "Real-time correlative scan
matching", 2009): ``registration`` starts at the places found here. The scores of all cells that a search may look up
are laid out before it: then a lookup takes a third of the time.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite
from moteslam.kernels.runtime import one_thread, passes_for, ti
from moteslam.kernels.tiles import SIDE, STEPS, Tiles, address, steps_of, weight_of
from moteslam.kernels.types import F32, F32_1D, F32_2D, I16_1D, I32, I32_1D, I32_2D, I64_1D, func, kernel

MAX_SEARCH_POINTS = 64  # Points of a scan that a search looks up: kept in registers and on the stack of each thread
MAX_SEARCH_COST = 1e8  # Costs of turns and shifts are at most this [steps]: totals must fit 32 bits
LANE = 16  # Bits of the total of each of the four places of a square: half a step each time, at most 767 of 64 points


@func
def _within(x: F32, last: F32):
    """As min and max do, but for numbers that are not one: these take three instructions each."""
    x = ti.select(x > 0.0, x, 0.0)
    return ti.select(x < last, x, last)


@kernel
def _lay_out(
    pool: I16_1D, table: I32_1D, begin: I32, columns: I32, left: I32, below: I32, near: I32, laid: I32_2D
):  # fmt: skip
    """What a point over each cell of a box counts [steps], see ``search_scans``: [H, W] from a cell of the table on."""
    ti.loop_config(serialize=ti.static(one_thread()))
    for row in range(laid.shape[0]):
        x, end = left, left + laid.shape[1]
        while x < end:  # the cells of one tile, which lie side by side
            at = address(table, begin, columns, x, below + row, 1)
            count = ti.min((x | (SIDE // 2 - 1)) + 1, end) - x
            for c in range(count):
                word = ti.cast(pool[at + c], ti.i32)
                score = ti.max(near - ti.abs(steps_of(word)), -(near // 2))
                laid[row, x - left + c] = ti.select(weight_of(word) > 0, score, 0)
            x += count


def _scores(tiles: Tiles, near: float, first: NDArray[np.int64], last: NDArray[np.int64]) -> NDArray[np.int32]:
    """The box [H, W] of scores from a first cell (column, row) to a last one, both of the table."""
    (left, below), (wide, high) = first.tolist(), (last - first + 1).tolist()
    laid = np.empty((high, wide), np.int32)
    _lay_out(tiles.pool, tiles.table, tiles.first, tiles.columns, left, below, int(near * STEPS), laid)
    return laid


@kernel
def _search(
    laid: I32_2D, left: I32, below: I32, last_x: F32, last_y: F32, c0: F32, s0: F32, x0: F32, y0: F32, scan: F32_2D,
    turns: F32_1D, turn_costs: I32_1D, shifts: F32_2D, shift_costs: I32_1D, drifts: F32_2D, blocks: I32,
    scores: I32_2D, chosen: I32_2D, passes: I32,
):  # fmt: skip
    """The best shift of every block, the first of equal ones, for every turn; lengths in coarse cells.

    The pose is cos, sin, x, y, and shifts and drifts are in its frame.
    """
    size = shifts.shape[0] // blocks
    points = ti.min(scan.shape[1], MAX_SEARCH_POINTS)
    ti.loop_config(serialize=ti.static(one_thread()))
    for p in range(turns.shape[0] * blocks * passes):
        if p % passes:
            continue
        t, block = p // passes // blocks, p // passes % blocks
        ct, st = ti.cos(turns[t]), ti.sin(turns[t])
        c, s = c0 * ct - s0 * st, s0 * ct + c0 * st
        xs = ti.Vector([0.0] * MAX_SEARCH_POINTS, dt=ti.f32)
        ys = ti.Vector([0.0] * MAX_SEARCH_POINTS, dt=ti.f32)
        for j in range(points):
            xs[j] = c * scan[0, j] - s * scan[1, j] + x0
            ys[j] = s * scan[0, j] + c * scan[1, j] + y0
        best, at = -(1 << 30), 0
        for v in range(block * size, (block + 1) * size):
            u, w = shifts[v, 0] + drifts[t, 0], shifts[v, 1] + drifts[t, 1]
            dx, dy = c0 * u - s0 * w, s0 * u + c0 * w
            total = -turn_costs[t] - shift_costs[v]
            for j in range(points):
                gx, gy = _within(xs[j] + dx, last_x), _within(ys[j] + dy, last_y)
                total += laid[ti.cast(gy, ti.i32) - below, ti.cast(gx, ti.i32) - left]
            if total > best:
                best, at = total, v
        scores[t, block], chosen[t, block] = best, at


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
    """What a point over each coarse cell of a map counts for the four places of a square of a lattice."""

    fours: NDArray[np.int64]  # int64 [rows, columns], four times `LANE` bits
    cell_size: float  # of the coarse level [m]

    @classmethod
    def of(cls, tiles: Tiles, *, apart: int, cell_size: float, near: float) -> "SquareScores":
        """Of one map, of a lattice whose places are so many cells ``apart``.

        See ``search_scans`` for the score, of which this is half, without its negative part.
        """
        laid = _scores(tiles, near, np.zeros(2, np.int64), _last_cell(tiles))
        scores = ((laid + int(near * STEPS) // 2) // 2).astype(np.int64)
        padded = np.pad(scores, ((0, apart), (0, apart)), mode="edge")
        lanes = [padded[y : y + len(laid), x : x + laid.shape[1]] for y in (0, apart) for x in (0, apart)]
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
    frame: Sequence[float],
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
    """The best places of a lattice around a pose, by the coarse level (correlative matching, Olson 2009).

    A place scores, for each point over a cell that was seen, ``near`` minus the cell's distance to the surface, but at
    least ``-near / 2``; from the sum the costs of its turn and its shift are subtracted. All are in steps, of which
    ``STEPS`` are a truncation.

    Args:
        tiles: one map.
        frame: cos, sin, x, y of the pose, from the tables' corner [m].
        points: [k, 2] of the scan in the robot's frame, at most ``MAX_SEARCH_POINTS`` [m].
        turns: [a] added to the heading [rad].
        turn_costs: [a] 0 or more [steps].
        shifts: [b, 2] added to the place, in the frame of the pose as it is [m].
        shift_costs: [b] 0 or more [steps].
        blocks: number of equal blocks of consecutive shifts; the best shift of each is returned.
        cell_size: of the fine level [m].
        near: how near to a surface a point must lie to count for a place [truncations].
        drift: by this the shifts of a turn are moved besides [m/rad]: errors of heading and place go together.

    Returns:
        int32 [a, blocks] the scores of the best shift of each block, and which shifts these are, the first of equal
        ones.
    """
    size = 2 * cell_size
    pose = as_finite("frame", frame, np.float64, (4,))
    scan = as_finite("points", points, np.float32, (None, 2))
    angles = as_finite("turns", turns, np.float32, (None,))
    drifts = angles[:, None] * as_finite("drift", np.asarray(drift) / size, np.float32, (2,))
    across = as_finite("shifts", np.asarray(shifts, np.float64) / size, np.float32, (None, 2))
    if tiles.maps != 1:
        raise InputError(f"{tiles.maps} maps, expected one", field="tiles")
    if len(scan) > MAX_SEARCH_POINTS:
        raise InputError(f"{len(scan)}, expected at most {MAX_SEARCH_POINTS}", field="points")
    scores, chosen = (np.empty((len(angles), blocks), np.int32) for _ in range(2))
    costs = [
        np.minimum(as_finite(name, given, np.float64, (count,)), MAX_SEARCH_COST).astype(np.int32)  # whole steps
        for name, given, count in (("turn_costs", turn_costs, len(angles)), ("shift_costs", shift_costs, len(across)))
    ]
    if len(angles):
        ends = np.ascontiguousarray(scan.T / np.float32(size), np.float32)
        place = pose[2:] / size
        # of the cells that a search looks into those of the table: points beyond it count as over its edge
        reach = sum(float(np.hypot(*each).max(initial=0.0)) for each in (ends, across.T, drifts.T)) + 2
        last = _last_cell(tiles)
        box = [np.clip(np.floor(place + side), 0, last).astype(np.int64) for side in (-reach, reach)]
        _search(
            _scores(tiles, near, *box), *box[0].tolist(), *last.astype(float).tolist(), *pose[:2].tolist(),
            *place.tolist(), ends, angles, costs[0], across, costs[1], drifts, blocks, scores, chosen,
            passes_for(scores.size),
        )  # fmt: skip
    return scores, chosen


def _last_cell(tiles: Tiles) -> NDArray[np.int64]:
    """Column and row of a table's last coarse cell."""
    return np.array((tiles.columns, tiles.rows)) * (SIDE // 2) - 1
