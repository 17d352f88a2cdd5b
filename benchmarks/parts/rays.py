"""The task of casting rays, beside pymunk, which does it, too."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from twins import rays

from moteslam.kernels.raycast import build_buckets, cast_rays
from parts.tasks import ANGLES, BEAMS, Array, Contender, Loops, Results, Same, Task

SIZE, ROOM, DOOR, MAX_RANGE = 100.0, 4.0, 1.2, 30.0
SLIPPED = 1e-3
"""This share of rays may pass a corner on its other side, in single precision."""


def office() -> Array:
    """Segments [m, 4] [m]: rooms of 4 m with a door in each wall, and a box in every other; mean range 3 m."""
    generator, count, rows = np.random.default_rng(1), round(SIZE / ROOM), []
    for i in range(count + 1):
        for j in range(count):
            at, low, high = i * ROOM, j * ROOM, (j + 1) * ROOM
            for across in (False, True):
                door = low + generator.uniform(0.4, ROOM - DOOR - 0.4)
                pieces = [(low, high)] if i in (0, count) else [(low, door), (door + DOOR, high)]
                rows += [(a, at, b, at) if across else (at, a, at, b) for a, b in pieces]
    for i in range(count):
        for j in range(i % 2, count, 2):
            centre = (np.array((i, j)) + generator.uniform(0.25, 0.75, 2)) * ROOM
            size, angle = generator.uniform(0.2, 0.6, 2), generator.uniform(0, np.pi)
            turn = np.array([(np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))])
            corners = centre + (np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * size) @ turn
            rows += [(*a, *b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return np.array(rows, np.float64)


def raycasting(loops: Loops, count: int = 200) -> Task:
    """Cast 200 scans of 1081 beams in an office of 3752 segments; C and NumPy try every segment."""
    walls, generator = office(), np.random.default_rng(3)
    poses = np.column_stack((generator.uniform(1, SIZE - 1, (count, 2)), generator.uniform(-np.pi, np.pi, count)))
    origins, angles = np.repeat(poses[:, :2], BEAMS, axis=0), (poses[:, 2:] + ANGLES).reshape(-1)
    given, flat = np.column_stack((origins, angles)).astype(np.float32), walls.astype(np.float32)
    every, few = len(given), min(count, 10) * BEAMS

    def twin() -> Any:
        return rays.cast_rays(walls, origins[:BEAMS], angles[:BEAMS], max_range=MAX_RANGE)[0]

    def ranges(found: Any) -> Results:
        return {"ranges": np.minimum(found, MAX_RANGE)}

    out = np.empty(few, np.float32)
    kernel = partial(cast_rays, build_buckets(walls), origins, angles, max_range=MAX_RANGE)
    c = loops.bind("cast_all", flat, len(flat), given, few, MAX_RANGE, out)
    others = {
        "C": Contender(c, few, lambda _: ranges(out)),
        "NumPy": Contender(twin, BEAMS, ranges, serial=True),
        "pymunk": Contender(pymunk_queries(walls, given[:few]), few, ranges, serial=True),
    }
    ours = np.minimum(kernel(), MAX_RANGE)
    return Task("ray", Contender(kernel, every), {"ranges": Same(ours, 1e-3, SLIPPED)}, others)


def pymunk_queries(walls: Array, given: Any) -> Callable[[], list[float]]:
    """The physics engine's query for the first segment along each ray (x, y, angle), from Python; exact."""
    import pymunk

    space, anything = pymunk.Space(), pymunk.ShapeFilter()
    for x0, y0, x1, y1 in walls.tolist():
        space.add(pymunk.Segment(space.static_body, (x0, y0), (x1, y1), 0.0))
    reach = MAX_RANGE * np.column_stack((np.cos(given[:, 2]), np.sin(given[:, 2])))
    ends = list(zip(given[:, :2].tolist(), (given[:, :2] + reach).tolist(), strict=True))

    def queries() -> list[float]:
        hits = [space.segment_query_first(start, end, 0.0, anything) for start, end in ends]
        return [MAX_RANGE * hit.alpha if hit is not None else MAX_RANGE for hit in hits]

    return queries
