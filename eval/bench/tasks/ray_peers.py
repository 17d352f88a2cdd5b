"""Programs of others that cast rays and are installed as Python modules: pymunk always is, range_libc may be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.bench.contest import Contender, Disagreement

Rays = NDArray[np.float32]
"""[n, 3]: place [m] and angle."""

FEW = 2000
"""Rays of those that are cast one by one from Python."""
CELL, ANGLES = 0.05, 108
"""Of the grid that range_libc casts in [m], and the directions that its compressed tables have."""
NEAR, LEAST = 0.2, 0.5
"""How near to ours a range of another is to be [m], and the share of them that must be, or it is other work."""


def contenders(
    segments: NDArray[np.float64], rays: Rays, exact: NDArray[np.float32], max_range: float
) -> tuple[dict[str, Contender], dict[str, float]]:
    """Those that are installed, by name, and of each the share of ranges that are near to ours.

    Args:
        segments: [m, 4] the world [m].
        rays: to cast.
        exact: [n] their ranges, ``max_range`` where nothing is met.
        max_range: [m].

    Raises:
        Disagreement: one finds other ranges.
    """
    found: dict[str, Contender] = {}
    near: dict[str, float] = {}
    calls: dict[str, tuple[Callable[[], Any], int]] = {
        "pymunk": (pymunk_queries(segments, rays[:FEW], max_range), FEW),
        **{name: (call, len(rays)) for name, call in range_libc_casters(segments, rays, max_range).items()},
    }
    for name, (call, count) in calls.items():
        off = np.abs(np.asarray(call(), np.float64) - exact[:count])
        near[f"{name} near"] = float((off < NEAR).mean())
        if near[f"{name} near"] < LEAST:
            problem = f"{near[f'{name} near']:.0%} of the ranges of {name} are within {NEAR:g} m of ours"
            raise Disagreement(f"{problem}, expected {LEAST:.0%}")
        found[name] = Contender(call, count)
    return found, near


def pymunk_queries(segments: NDArray[np.float64], rays: Rays, max_range: float) -> Callable[[], list[float]]:
    """Queries of the physics engine for the first segment along a ray, one by one from Python; exact."""
    import pymunk

    space = pymunk.Space()
    for x0, y0, x1, y1 in segments.tolist():
        space.add(pymunk.Segment(space.static_body, (x0, y0), (x1, y1), 0.0))
    anything = pymunk.ShapeFilter()
    ends = [((x, y), (x + max_range * cos(a), y + max_range * sin(a))) for x, y, a in rays.tolist()]

    def queries() -> list[float]:
        hits = [space.segment_query_first(start, end, 0.0, anything) for start, end in ends]
        return [max_range * hit.alpha if hit is not None else max_range for hit in hits]

    return queries


def range_libc_casters(
    segments: NDArray[np.float64], rays: Rays, max_range: float
) -> Mapping[str, Callable[[], NDArray[np.float32]]]:
    """The casters of range_libc in a grid of the same walls, if it is there: by compressed tables, and by marching.

    Walsh and Karaman, "CDDT: Fast Approximate 2D Ray Casting for Accelerated Localization", 2018.
    """
    if find_spec("range_libc") is None:
        return {}
    import range_libc

    size = int(segments.max() / CELL) + 2
    walls = np.zeros((size, size), bool)
    for x0, y0, x1, y1 in segments.tolist():
        steps = np.linspace(0, 1, int(np.hypot(x1 - x0, y1 - y0) / CELL * 4) + 2)
        walls[((y0 + (y1 - y0) * steps) / CELL).astype(int), ((x0 + (x1 - x0) * steps) / CELL).astype(int)] = True
    grid = range_libc.PyOMap(walls)
    tables = range_libc.PyCDDTCast(grid, max_range / CELL, ANGLES)
    tables.prune()
    casters = {"range_libc cddt": tables, "range_libc marching": range_libc.PyRayMarching(grid, max_range / CELL)}
    given, out = rays.copy(), np.empty(len(rays), np.float32)
    given[:, :2] /= CELL

    def casting(caster: Any) -> Callable[[], NDArray[np.float32]]:
        def cast() -> NDArray[np.float32]:
            caster.calc_range_many(given, out)
            return CELL * out

        return cast

    return {name: casting(caster) for name, caster in casters.items()}
