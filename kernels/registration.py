"""Registering scans to signed-distance maps, every particle to its own: Gauss-Newton from coarse to fine.

An endpoint's residual is its distance in the map, in standard deviations: on the fine level or, where that was never
seen, on the coarse one. To the residuals comes a prior on the offset from the predicted pose.
"""

import math
import threading
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.degeneracy import NOT_KEPT, Kept, keep_prediction
from moteslam.kernels.gauss_newton import descend, jacobian_of, square
from moteslam.kernels.registration_options import RegistrationOptions, checked
from moteslam.kernels.runtime import one_thread, runtime, ti
from moteslam.kernels.tiles import (
    SIDE,
    STEPS,
    bilinear,
    check_tiles,
    read,
    steps_of,
    weight_of,
)
from moteslam.kernels.types import F32, F32_2D, F64, F64_2D, I16_1D, I32, I32_1D, func, kernel, template

RAY_SHARES = (0.9, 0.75, 0.6, 0.45, 0.3, 0.15)
"""Where along each ray the map is looked up, as shares of the distance from sensor to endpoint: at 6 places."""

INFORMATION = slice(0, 6)
COST, KNOWN, LIKELIHOOD, CROSSED = range(6, 10)
FITS = 10
"""The columns of the fits that ``register_scans`` returns."""

QUERY_WIDTHS = (4, 3, 6)
"""Columns of a frame, a start and a prior in a query; ..."""
PRIOR_WEIGHTS = slice(7, 10)
"""... and of the prior's inverse variances."""


@func
def _crosses_surface(
    pool: template, table: template, base: I32, columns: I32, last_x: F32, last_y: F32, ox: F32, oy: F32, px: F32,
    py: F32, inverse: F32, clearance: F32, min_weight: I32, max_steps: I32,
):  # fmt: skip
    """Whether the ray from (ox, oy) to (px, py) [m] meets a surface of the map ``clearance`` [m] before its end.

    It does where a cell weighs more than ``min_weight`` and is nearer to the surface than ``max_steps``.
    """
    hit = 0
    length = ti.sqrt((px - ox) ** 2 + (py - oy) ** 2)
    for k in ti.static(range(len(RAY_SHARES))):
        share = ti.static(RAY_SHARES[k])
        if (1 - share) * length > clearance:
            gx, gy = (ox + share * (px - ox)) * inverse, (oy + share * (py - oy)) * inverse
            word = read(pool, table, base, columns, gx, gy, last_x, last_y, 0)
            if weight_of(word) > min_weight and ti.abs(steps_of(word)) < max_steps:
                hit = 1
    return hit


@kernel
def _register(
    pool: I16_1D, table: I32_1D, stride: I32, columns: I32, rows: I32, queries: F64_2D, scan: F32_2D, origin_x: F32,
    origin_y: F32, cell: F32, truncation: F32, coarse_truncation: F32, sd: F32, coarse_sd: F32, coarse_iterations: I32,
    iterations: I32, unknown: F32, outlier: F32, exponent: F32, clearance: F32, ray_weight: I32, ray_steps: I32,
    deviation: F64, error: F64, gate: F64, found: F64_2D,
):  # fmt: skip
    """Coarse level, fine level, then the fit.

    A query is a frame (cos, sin, x, y [m]), a start and a prior; what is found of it an offset and the fits, as
    ``register_scans`` returns them. ``stride`` is from one particle's table to the next; 0 where all use one. ``sd``
    is the standard deviation of the distances [m], ``unknown`` and ``outlier`` are costs; an endpoint's likelihood is
    exp(exponent * residual^2). With a ``deviation`` above 0 the prediction is kept along degenerate directions.
    """
    fine_x, fine_y = ti.cast(columns * SIDE - 2, ti.f32), ti.cast(rows * SIDE - 2, ti.f32)
    coarse_x, coarse_y = ti.cast(columns * SIDE // 2 - 2, ti.f32), ti.cast(rows * SIDE // 2 - 2, ti.f32)
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread()))
    for i in range(queries.shape[0]):
        base = i * stride
        frame = ti.Vector([ti.cast(queries[i, k], ti.f32) for k in ti.static(range(4))], dt=ti.f32)
        prior = ti.Vector([ti.cast(queries[i, 7 + k], ti.f32) for k in ti.static(range(6))], dt=ti.f32)
        # three names: Taichi clears the variable that a function's result goes to before it reads the arguments, so
        # that in `d = descend(..., d, ...)` with a template argument the function would see zeros
        start = ti.Vector([ti.cast(queries[i, 4 + k], ti.f32) for k in ti.static(range(3))], dt=ti.f32)
        coarse = descend(
            pool, table, base, columns, coarse_x, coarse_y, frame, scan, start, prior, 2 * cell, coarse_truncation,
            coarse_sd, coarse_iterations, 1,
        )  # fmt: skip
        d = descend(
            pool, table, base, columns, fine_x, fine_y, frame, scan, coarse, prior, cell, truncation, sd, iterations, 0
        )
        ct, st = ti.cos(d[2]), ti.sin(d[2])
        inverse, scale = 1.0 / cell, truncation / sd
        slope, coarse_scale = scale * inverse, coarse_truncation / sd
        h = ti.Vector([0.0] * 6, dt=ti.f32)
        cost, known, likely, crossed = 0.0, 0.0, 0.0, 0.0
        ox, oy = ct * origin_x - st * origin_y + d[0], st * origin_x + ct * origin_y + d[1]
        ox, oy = frame[0] * ox - frame[1] * oy + frame[2], frame[1] * ox + frame[0] * oy + frame[3]
        for j in range(scan.shape[1]):
            rx, ry = ct * scan[0, j] - st * scan[1, j], st * scan[0, j] + ct * scan[1, j]
            qx, qy = rx + d[0], ry + d[1]
            px, py = frame[0] * qx - frame[1] * qy + frame[2], frame[1] * qx + frame[0] * qy + frame[3]
            gx, gy = ti.min(ti.max(px * inverse, 1.0), fine_x), ti.min(ti.max(py * inverse, 1.0), fine_y)
            f = bilinear(pool, table, base, columns, gx, gy, 0)
            r, seen = 0.0, f[3]
            if seen > 0:
                r = f[0] * scale
                jacobian = jacobian_of(frame, f[1] * slope, f[2] * slope, rx, ry)
                h += square(jacobian)
            else:
                gx = ti.min(ti.max(0.5 * px * inverse, 1.0), coarse_x)
                gy = ti.min(ti.max(0.5 * py * inverse, 1.0), coarse_y)
                g = bilinear(pool, table, base, columns, gx, gy, 1)
                r, seen = g[0] * coarse_scale, g[3]
            if seen > 0:
                cost += ti.min(0.5 * r * r, outlier)
                known += 1
                likely += ti.exp(exponent * r * r)
            else:
                cost += unknown
            hit = _crosses_surface(
                pool, table, base, columns, fine_x, fine_y, ox, oy, px, py, inverse, clearance, ray_weight, ray_steps
            )
            crossed += ti.cast(hit, ti.f32)
        for j in ti.static(range(3)):
            found[i, j] = d[j]
        for j in ti.static(range(6)):
            found[i, 3 + j] = h[j]
        found[i, 3 + COST], found[i, 3 + KNOWN] = cost, known
        found[i, 3 + LIKELIHOOD], found[i, 3 + CROSSED] = likely, crossed
        if deviation > 0:
            keep_prediction(found, i, deviation, error, gate)


def register_scans(
    pool: NDArray[np.int16],
    tables: NDArray[np.int32],
    frames: ArrayLike,
    points: ArrayLike,
    origin: ArrayLike,
    starts: ArrayLike,
    priors: ArrayLike,
    *,
    options: RegistrationOptions,
    coarse: bool = True,
    kept: Kept | None = None,
    trusted: bool = False,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Move each pose to where the scan fits its map best: Gauss-Newton on the coarse level, then on the fine one.

    Minimised is the sum of the endpoints' squared distances to the surface, in standard deviations, and of the prior's
    ``inverse variance * (offset - mean)^2``. Endpoints over cells of the level that were never seen are left out.

    Args:
        pool: int16 [t * CELLS] of all tiles.
        tables: int32 [n, rows, columns] each particle's tiles, or [1, rows, columns] one map for all poses.
        frames: [n, 4] cos, sin, x, y of the poses, from the tables' corner [m].
        points: [k, 2] of the scan in the robot's frame [m].
        origin: [2] where its rays start, in the same frame [m].
        starts: [n, 3] offsets from the poses, in their frames, to begin at (x, y [m], theta).
        priors: [n, 6] inverse variances of an offset's x, y and theta, above 0, then its mean.
        options: of the maps and of the costs.
        coarse: whether to begin on the coarse level; not needed where the start is good to a cell.
        kept: how the predicted pose is kept along degenerate directions: ``keep_predictions``; not at all if None.
        trusted: maps and points were made by kernels: they are not searched for tiles beyond the pool, nor for numbers
            that are not finite.

    Returns:
        offsets: [n, 3] from the poses, in their frames (x, y [m], theta).
        fits: [n, FITS] there: ``INFORMATION`` of the endpoints on the fine level about the offset, the elements 00 01
            02 11 12 22 [1/m^2, 1/m, 1]; ``COST``, the endpoints' negative log-likelihood; ``KNOWN``, how many of them
            have a distance; ``LIKELIHOOD``, the sum of the likelihoods of those; ``CROSSED``, how many rays cross a
            surface of the map.

    Raises:
        InputError: arrays that do not fit together, or numbers that are not finite or out of bounds.
    """
    start_x, start_y = as_finite("origin", origin, np.float64, (2,)).tolist()
    queries = _packed(frames=frames, starts=starts, priors=priors)
    if len(queries) and queries[:, PRIOR_WEIGHTS].min() <= 0:
        raise InputError("an inverse variance that is not above 0", field="priors")
    found = np.empty((len(queries), 3 + FITS))
    _registered(
        pool, tables, queries, found, points, (start_x, start_y), options, coarse=coarse, kept=kept, trusted=trusted
    )
    return found[:, :3], found[:, 3:]


class _Room(threading.local):
    """Arrays of one query, for each thread its own: what stays in its place need not be set at every launch."""

    def __init__(self) -> None:
        self.query, self.found = np.empty((1, sum(QUERY_WIDTHS))), np.empty((1, 3 + FITS))


_room = _Room()


def register_scan(
    pool: NDArray[np.int16],
    tables: NDArray[np.int32],
    query: Sequence[float],
    points: ArrayLike,
    origin: tuple[float, float],
    *,
    options: RegistrationOptions,
    kept: Kept | None = None,
    trusted: bool = False,
) -> list[float]:
    """``register_scans`` of one pose in plain numbers, for which arrays take longer than the registration.

    Args:
        query: frame, start and prior, 13 numbers.
        pool, tables, points, origin, options, kept, trusted: as of ``register_scans``.

    Returns:
        the offset and the fits, 3 + ``FITS`` numbers.

    Raises:
        InputError: as ``register_scans``.
    """
    if len(query) != sum(QUERY_WIDTHS) or not math.isfinite(sum(query)) or min(query[PRIOR_WEIGHTS]) <= 0:
        raise InputError(
            f"{query}, expected a frame, a start, and a prior whose first three are above 0", field="query"
        )
    if not math.isfinite(sum(origin)):
        raise InputError(f"{origin}, expected finite numbers", field="origin")
    _room.query[0] = query
    _registered(
        pool, tables, _room.query, _room.found, points, origin, options, coarse=True, kept=kept, trusted=trusted
    )
    numbers: list[float] = _room.found[0].tolist()
    return numbers


def _registered(
    pool: NDArray[np.int16],
    tables: NDArray[np.int32],
    queries: NDArray[np.float64],
    found: NDArray[np.float64],
    points: ArrayLike,
    origin: tuple[float, float],
    options: RegistrationOptions,
    *,
    coarse: bool,
    kept: Kept | None,
    trusted: bool,
) -> None:
    """Write the offsets and fits [n, 3 + FITS] of checked queries [n, 13] to ``found``."""
    o = checked(options)
    maps, rows, columns = check_tiles(pool, tables, trusted=trusted)
    if trusted:
        scan = check_array("points", points, np.float32, (None, 2))
    else:
        scan = as_finite("points", points, np.float32, (None, 2))
    n = len(queries)
    if maps not in (1, n):
        raise InputError(f"{maps} of them, expected 1 or one for each of {n} frames", field="tables")
    runtime()
    if n:
        _register(
            pool, tables.reshape(-1), columns * rows if maps > 1 else 0, columns, rows, queries,
            np.ascontiguousarray(scan.T), *origin, o.cell_size, o.truncation, o.coarse_truncation,
            o.residual, o.coarse_residual_factor * o.residual, o.iterations if coarse else 0, o.iterations, o.unknown,
            o.outlier, -0.5 / o.likelihood_width**2, o.ray_clearance * o.truncation, o.ray_weight,
            round(o.ray_distance * STEPS), *(kept or NOT_KEPT), found,
        )  # fmt: skip


def _packed(**arrays: ArrayLike) -> NDArray[np.float64]:
    """Frames, starts and priors side by side, [n, 13], checked together."""
    rows = None
    queries = np.empty((0, 0))
    column = 0
    for (name, values), width in zip(arrays.items(), QUERY_WIDTHS, strict=True):
        given = np.asarray(values, np.float64)
        if rows is None and given.ndim == 2:
            rows = len(given)
            queries = np.empty((rows, sum(QUERY_WIDTHS)))
        if given.shape != (rows, width):
            expected = f"[{'*' if rows is None else rows}, {width}]"
            raise InputError(f"{list(given.shape)}, expected an array {expected}", field=name)
        queries[:, column : column + width] = given
        column += width
    if not np.isfinite(queries).all():
        column = 0
        for name, width in zip(arrays, QUERY_WIDTHS, strict=True):
            as_finite(name, queries[:, column : column + width], np.float64, (rows, width))
            column += width
    return queries
