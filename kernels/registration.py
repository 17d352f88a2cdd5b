"""Registering scans to signed-distance maps, every particle to its own: Gauss-Newton from coarse to fine.

An endpoint's residual is its distance in the map, in standard deviations: on the fine level or, where that was never
seen, on the coarse one. To the residuals comes a prior on the offset from the predicted pose.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import check_array
from moteslam.kernels.gauss_newton import NOT_KEPT, Kept, by_offset, descend, keep_prediction, place_in_cells, square
from moteslam.kernels.runtime import one_thread, passes_for, ti
from moteslam.kernels.tiles import SIDE, STEPS, Tiles, bilinear, read, steps_of, weight_of
from moteslam.kernels.types import F32, F32_1D, F32_2D, F64, F64_2D, I16_1D, I32, I32_1D, func, kernel, template

RAY_SHARES = (0.9, 0.75, 0.6, 0.45, 0.3, 0.15)
"""Where along each ray the map is looked up, as shares of the distance from sensor to endpoint: at 6 places."""

FRAME, START, PRIOR = slice(0, 4), slice(4, 7), slice(7, 13)
"""The columns of a query: the pose as cos, sin, x, y from the tables' corner [m]; the offset from it, in its frame, to
begin at (x, y [m], theta); and of the prior on the offset the inverse variances of x, y and theta, then its mean."""
QUERY = 13
PRIOR_MEAN = slice(10, 13)

LIKELIHOODS = (0.2, 0.98)  # Mean likelihoods that residuals are estimated from: beyond these they say nothing

OFFSET = slice(0, 3)
INFORMATION = slice(3, 9)
COST, KNOWN, LIKELIHOOD, CROSSED = range(9, 13)
FREE = slice(13, 16)
FAR = 16
MEANS = slice(17, 20)
FOUND = 20  # The columns of what `register_scans` returns


class RegistrationOptions(NamedTuple):
    """Of ``register_scans``."""

    cell_size: float  # of the fine level [m]
    truncation: float  # of the fine level [m]
    coarse_truncation: float  # [m]
    residual: float  # standard deviation of the distances on the fine level [m]
    coarse_residual_factor: float  # by what it is multiplied on the coarse level
    iterations: int  # at most, on each level
    unknown_cost: float  # cost of an endpoint where neither level was seen
    outlier_cost: float  # largest cost of an endpoint where one was; below it the cost is half the squared residual
    likelihood_width: float  # standard deviation of a residual r in an endpoint's likelihood, exp(-(r / width)^2 / 2)
    ray_clearance: float  # a ray crosses a surface if it meets one so far from its endpoint [truncations], ...
    ray_weight: int  # ... in a cell that weighs more than this, ...
    ray_distance: float  # ... nearer to the surface than this [truncations], and leaves it again.
    # an endpoint at least this far from the surface on the coarse level is far [m]; at most three quarters of its
    # truncation count.
    far: float

    @lru_cache(maxsize=64)  # noqa: B019 - a tuple of numbers
    def numbers(self) -> NDArray[np.float32]:
        """As the kernel reads them: lengths in m, what concerns rays and what is far in steps of distance."""
        coarse_residual, exponent = self.coarse_residual_factor * self.residual, -0.5 / self.likelihood_width**2
        far = round(min(self.far / self.coarse_truncation, 0.75) * STEPS)
        of_rays = self.ray_clearance * self.truncation, self.ray_weight, round(self.ray_distance * STEPS)
        costs = self.unknown_cost, self.outlier_cost, exponent
        return np.array((*self[:4], coarse_residual, self.iterations, *costs, *of_rays, far), np.float32)


@func
def _crosses_surface(
    pool: template, table: template, base: I32, columns: I32, last_x: F32, last_y: F32, ox: F32, oy: F32, px: F32,
    py: F32, clearance: F32, min_weight: I32, max_steps: I32,
):  # fmt: skip
    """Whether the ray from (ox, oy) to (px, py) meets a surface of the map ``clearance`` before its end; all [cells].

    It does where a cell weighs more than ``min_weight`` and is nearer to the surface than ``max_steps``, and the one
    half way from there to the end is not: a ray along a wall that it ends on crosses nothing.
    """
    hit = 0
    length = ti.sqrt((px - ox) ** 2 + (py - oy) ** 2)
    for k in ti.static(range(len(RAY_SHARES))):
        share = ti.static(RAY_SHARES[k])
        if (1 - share) * length > clearance:
            gx, gy = ox + share * (px - ox), oy + share * (py - oy)
            word = read(pool, table, base, columns, gx, gy, last_x, last_y, 0)
            if weight_of(word) > min_weight and ti.abs(steps_of(word)) < max_steps:
                gx, gy = 0.5 * (gx + px), 0.5 * (gy + py)
                word = read(pool, table, base, columns, gx, gy, last_x, last_y, 0)
                if weight_of(word) <= min_weight or ti.abs(steps_of(word)) >= max_steps:
                    hit = 1
    return hit


@kernel
def _register(
    pool: I16_1D, table: I32_1D, begin: I32, stride: I32, columns: I32, rows: I32, queries: F64_2D, scan: F32_2D,
    points: I32, origin_x: F32, origin_y: F32, settings: F32_1D, coarse: I32, deviation: F64, error: F64,
    found: F64_2D, passes: I32, alone: template,
):  # fmt: skip
    """Coarse level, fine level, then the fit: see ``register_scans``.

    ``stride`` is from one particle's table to the next; 0 where all use one. The first ``points`` columns of ``scan``
    are x and y of its points. ``settings`` are those of ``settings_of``. With a ``deviation`` above 0 the prediction
    is kept along degenerate directions, whose ``error`` is that of standard residuals, and in turns that are not bound.
    A query that is ``alone`` wakes no other thread; of others there are ``passes`` each, see ``passes_for``.
    """
    fine_x, fine_y = ti.cast(columns * SIDE - 2, ti.f32), ti.cast(rows * SIDE - 2, ti.f32)
    coarse_x, coarse_y = ti.cast(columns * SIDE // 2 - 2, ti.f32), ti.cast(rows * SIDE // 2 - 2, ti.f32)
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread() or alone))
    for k in range(queries.shape[0] * passes):
        if k % passes:
            continue
        i = k // passes
        # read here: before the loop they would be a task of their own
        cell, truncation, coarse_truncation = settings[0], settings[1], settings[2]
        sd, coarse_sd, iterations = settings[3], settings[4], ti.cast(settings[5], ti.i32)
        unknown, outlier, exponent = settings[6], settings[7], settings[8]
        clearance, ray_weight, ray_steps = settings[9], ti.cast(settings[10], ti.i32), ti.cast(settings[11], ti.i32)
        far_steps = ti.cast(settings[12], ti.i32)
        base = begin + i * stride
        frame = ti.Vector([ti.cast(queries[i, m], ti.f32) for m in ti.static(range(4))], dt=ti.f32)
        prior = ti.Vector(
            [ti.cast(queries[i, ti.static(PRIOR.start) + m], ti.f32) for m in ti.static(range(6))], dt=ti.f32
        )
        # three names: Taichi clears the variable that a function's result goes to before it reads the arguments, so
        # that in `d = descend(..., d, ...)` with a template argument the function would see zeros
        start = ti.Vector(
            [ti.cast(queries[i, ti.static(START.start) + m], ti.f32) for m in ti.static(range(3))], dt=ti.f32
        )
        rough = descend(
            pool, table, base, columns, coarse_x, coarse_y, frame, scan, points, start, prior, 2 * cell,
            coarse_truncation, coarse_sd, coarse * iterations, 1,
        )  # fmt: skip
        d = descend(
            pool, table, base, columns, fine_x, fine_y, frame, scan, points, rough, prior, cell, truncation, sd,
            iterations, 0,
        )  # fmt: skip
        inverse, per_step = 1.0 / cell, truncation / (sd * STEPS)
        per_cell, coarse_per_step = per_step * inverse, coarse_truncation / (sd * STEPS)
        h = ti.Vector([0.0] * 6, dt=ti.f32)
        cost, known, likely, crossed, far = 0.0, 0.0, 0.0, 0.0, 0.0
        mx, my, mm, fine = 0.0, 0.0, 0.0, 0.0
        place = place_in_cells(frame, d, inverse)
        ox = place[0] * origin_x - place[1] * origin_y + place[2]
        oy = place[1] * origin_x + place[0] * origin_y + place[3]
        for j in range(points):
            rx, ry = place[0] * scan[0, j] - place[1] * scan[1, j], place[1] * scan[0, j] + place[0] * scan[1, j]
            px, py = rx + place[2], ry + place[3]
            gx, gy = ti.min(ti.max(px, 1.0), fine_x), ti.min(ti.max(py, 1.0), fine_y)
            f = bilinear(pool, table, base, columns, gx, gy, 0)
            r, seen = 0.0, f[3]
            if seen == 0 or ti.abs(f[0]) > ti.static(STEPS / 2):  # else it lies at a surface
                word = read(pool, table, base, columns, 0.5 * px, 0.5 * py, coarse_x, coarse_y, 1)
                far += ti.cast(weight_of(word) > 0 and ti.abs(steps_of(word)) >= far_steps, ti.f32)
            if seen > 0:
                r = f[0] * per_step
                h += square(f[1], f[2], f[2] * rx - f[1] * ry)
                mx += scan[0, j]
                my += scan[1, j]
                mm += scan[0, j] * scan[0, j] + scan[1, j] * scan[1, j]
                fine += 1
            else:
                gx, gy = ti.min(ti.max(0.5 * px, 1.0), coarse_x), ti.min(ti.max(0.5 * py, 1.0), coarse_y)
                g = bilinear(pool, table, base, columns, gx, gy, 1)
                r, seen = g[0] * coarse_per_step, g[3]
            if seen > 0:
                cost += ti.min(0.5 * r * r, outlier)
                known += 1
                likely += ti.exp(exponent * r * r)
            else:
                cost += unknown
            hit = _crosses_surface(
                pool, table, base, columns, fine_x, fine_y, ox, oy, px, py, clearance * inverse, ray_weight, ray_steps
            )
            crossed += ti.cast(hit, ti.f32)
        information = by_offset(h, frame, per_cell, per_step)
        for j in ti.static(range(3)):
            found[i, j] = d[j]
            found[i, ti.static(FREE.start) + j] = d[j]
        for j in ti.static(range(6)):
            found[i, ti.static(INFORMATION.start) + j] = information[j]
        found[i, COST], found[i, KNOWN], found[i, LIKELIHOOD], found[i, CROSSED] = cost, known, likely, crossed
        found[i, FAR] = far
        n, c, z = ti.max(fine, 1.0), ti.cos(d[2]), ti.sin(d[2])
        means = ti.Vector([(c * mx - z * my) / n, (z * mx + c * my) / n, mm / n])
        for j in ti.static(range(3)):
            found[i, ti.static(MEANS.start) + j] = means[j]
        if deviation > 0:
            mean = ti.min(ti.max(likely / ti.max(known, 1.0), ti.static(LIKELIHOODS[0])), ti.static(LIKELIHOODS[1]))
            variance = 0.5 * (1.0 - 1.0 / (mean * mean)) / exponent  # of the residuals, by their mean likelihood
            keep_prediction(found, i, deviation, error, variance, means[0], means[1], means[2])


def register_scans(
    tiles: Tiles,
    queries: NDArray[np.float64],
    points: ArrayLike,
    origin: Sequence[float],
    *,
    options: RegistrationOptions,
    coarse: bool = True,
    kept: Kept | None = None,
) -> NDArray[np.float64]:
    """Move each pose to where the scan fits its map best: Gauss-Newton on the coarse level, then on the fine one.

    Minimised is the sum of the endpoints' squared distances to the surface, in standard deviations, and of the prior's
    ``inverse variance * (offset - mean)^2``. Endpoints over cells of the level that were never seen are left out.

    Args:
        tiles: the maps of n particles, or one map for all poses.
        queries: float64 [n, QUERY] the poses, where to begin and the priors: ``FRAME``, ``START``, ``PRIOR``.
        points: [k, 2] of the scan in the robot's frame, all finite [m].
        origin: [2] where its rays start, in the same frame [m].
        coarse: whether to begin on the coarse level; not needed where the start is good to a cell.
        kept: how the predicted pose is kept along degenerate directions: ``keep_predictions``, with the error times
            the variance of the residuals in standard ones; not at all if None.

    Returns:
        [n, FOUND]: ``OFFSET`` from the poses, in their frames (x, y [m], theta); there ``INFORMATION`` of the endpoints
        on the fine level about the offset, the elements 00 01 02 11 12 22 [1/m^2, 1/m, 1]; ``COST``, the endpoints'
        negative log-likelihood; ``KNOWN``, how many of them have a distance; ``LIKELIHOOD``, the sum of the
        likelihoods of those; ``CROSSED``, how many rays cross a surface of the map; ``FREE``, the offset before the
        prediction was kept along a degenerate direction; ``FAR``, how many endpoints are far from the surface by the
        coarse level; ``MEANS`` of the endpoints on the fine level, x, y and x^2 + y^2 from the robot, in the axes of
        the offset [m, m^2].
    """
    check_array("queries", queries, np.float64, (None, QUERY))
    pool, table, rows, columns, maps, begin = tiles
    n = len(queries)
    if maps not in (1, n):
        raise InputError(f"of {maps} particles, expected 1 or one for each of {n} queries", field="tiles")
    scan, found = np.ascontiguousarray(np.asarray(points, np.float32).T), np.empty((n, FOUND))
    if n:
        _register(
            pool, table, begin, columns * rows if maps > 1 else 0, columns, rows, queries, scan, scan.shape[1],
            *origin, options.numbers(), int(coarse), *(kept or NOT_KEPT), found, passes_for(n),
            n == 1 and not one_thread(),
        )  # fmt: skip
    return found
