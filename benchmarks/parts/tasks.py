"""The work that ``speed.py`` times: each kernel, and the same work in plain C, in Python or NumPy.

The twins in Python and NumPy are those of the tests; being slow, they do some of the work only.
"""

import ctypes
import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tile_pools import Pool, room_scan, thinned
from twins import grids, rays, tsdf

from moteslam.kernels.correlative import MAX_SEARCH_POINTS, search_scans
from moteslam.kernels.matching import match_poses
from moteslam.kernels.occupancy import update_grid
from moteslam.kernels.raycast import build_buckets, cast_rays
from moteslam.kernels.scans import ThinnedScan, thin_scans
from moteslam.kernels.tiles import MAX_WEIGHT, STEPS, WEIGHT_BITS
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.mapping.tsdf import TsdfMaps
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import register

Array = NDArray[np.float64]
Results = Mapping[str, Any]  # Arrays by name

BEAMS = 1081
ANGLES = np.linspace(math.radians(-135), math.radians(135), BEAMS)
CELL, CELLS = 0.05, 2000  # Of the grid: size [m], rows and columns
MAPS = TsdfConfig(cell_size=CELL, truncation=0.15, coarse_truncation=0.4)
MOVED = np.array((0.1, -0.1, 0.2))  # From where a particle is taken to be to where its scan was taken [m], [rad]
ON_EDGES = 0.01  # This share of sums over cells may differ: single precision puts a point near an edge on either side

SIZE, ROOM, DOOR, MAX_RANGE = 100.0, 4.0, 1.2, 30.0
SLIPPED = 1e-3  # This share of rays may pass a corner on its other side, in single precision


class Same(NamedTuple):
    """What a kernel computed, and when the result of another is the same."""

    ours: Any  # [n, ...]; another that does less of the work has the first rows
    tolerance: Any = 0.0  # numbers that differ by more are not the same
    most: float = 0.0  # the share of them that may not be the same

    def differing(self, theirs: Any) -> float:
        """The share of another's numbers that are not the same."""
        theirs = np.asarray(theirs, np.float64)
        return float((~(np.abs(theirs - self.ours[: len(theirs)]) <= self.tolerance)).mean())


class Contender(NamedTuple):
    """Who does the work."""

    call: Callable[[], Any]  # does it once
    work: int  # how many units that is
    # makes of what the call returned what is compared with the kernel's
    results: Callable[[Any], Results] = lambda found: {}
    serial: bool = False  # uses one thread, however many the kernel has


class Task(NamedTuple):
    """A kernel, and by name who is measured beside it."""

    unit: str
    kernel: Contender
    results: Mapping[str, Same]
    others: dict[str, Contender]


class Loops:
    """The functions of ``loops.c`` and ``maps.c``, in a library."""

    def __init__(self, library: Path) -> None:
        self.library = ctypes.CDLL(str(library))

    def bind(self, name: str, *arguments: Any) -> Callable[[], Any]:
        """A call of a function: C-contiguous arrays are handed over as pointers, floats in single precision."""
        given, function = [_given(argument) for argument in arguments], self.library[name]
        return lambda: function(*given)


def _given(argument: Any) -> Any:
    if isinstance(argument, np.ndarray):
        assert argument.flags.c_contiguous
        return argument.ctypes.data_as(ctypes.c_void_p)  # keeps the array alive
    return ctypes.c_float(argument) if isinstance(argument, float) else argument


def walls_and_scan() -> tuple[NDArray[np.uint8], Array]:
    """A grid of walls [CELLS, CELLS], and the points [BEAMS, 2] of a scan from its middle [m]."""
    grid = np.zeros((CELLS, CELLS), np.uint8)
    grid[600:1400:160, 400:1600] = 1
    grid[600:1400, 400:1600:200] = 1
    cos, sin = np.cos(ANGLES), np.sin(ANGLES)
    ranges = np.minimum(4.0 / np.maximum(np.abs(cos), 1e-3), 4.9 / np.maximum(np.abs(sin), 1e-3))
    ranges += np.random.default_rng(0).normal(0, 0.01, BEAMS)
    return grid, np.stack((ranges * cos, ranges * sin), axis=-1)


def thinning(loops: Loops, count: int = 64) -> Task:
    """Thin scans of 1081 beams to about 200 points, 64 in a call of the kernel."""
    gaps, (spacing, max_spacing), most = {"gap": 0.3, "gap_from_range": 0.03}, (0.02, 0.06), 200
    one = walls_and_scan()[1].astype(np.float32)
    ends, begins, counts = np.tile(one, (count, 1)), np.arange(count) * BEAMS, np.full(count, BEAMS)
    kernel = partial(
        thin_scans, ends, begins, counts, (0.0, 0.0), spacing=spacing, max_spacing=max_spacing, max_points=most, **gaps
    )
    ours, points, joined = kernel()[-1], np.empty((BEAMS, 2), np.float32), np.empty(BEAMS, np.int32)
    left = len(ours.points)
    c = loops.bind("thin", one, BEAMS, *gaps.values(), spacing, max_spacing, most, points, joined)
    results = {"number of points": Same(np.array([left])), "points": Same(ours.points, 1e-5)}
    by_c = Contender(c, 1, lambda found: {"number of points": [found], "points": points[:left]}, serial=True)
    return Task("scan", Contender(kernel, count), results, {"C": by_c})


def room(particles: int) -> tuple[TsdfMaps, ThinnedScan, Array]:
    """A map of a room for every particle, in tiles of its own; the scan integrated last; where the particles are."""
    poses = np.random.default_rng(10).normal(0, (0.05, 0.05, 0.02), (particles, 3))
    maps, scan = TsdfMaps(MAPS), thinned(room_scan(MOVED, beams=180))
    maps.integrate(np.zeros((1, 3)), thinned(room_scan()))
    maps.resample(np.zeros(particles, np.int64))
    maps.integrate(poses + MOVED, scan)  # each copies the tiles that it writes to
    return maps, scan, poses


def registration(loops: Loops, count: int = 1000) -> Task:
    """Register a scan of 180 points to each of 1000 maps, coarse to fine."""
    maps, scan, poses = room(count)
    view, config, weight = maps.all(), RegistrationConfig(), 1e4  # the prior's inverse variance [1/m^2, 1/rad^2]
    starts, spread = np.zeros((count, 3)), np.full(3, math.sqrt(config.prior_weight / weight))
    kernel = partial(register, view, poses, spread, scan.points, np.zeros(2), starts, config)
    ours, out, (pool, table, rows, columns, *_) = kernel(), np.empty((count, 13)), view.tiles
    c = loops.bind(
        "register_all", pool, table, rows, columns, view.frames(poses), count, np.ascontiguousarray(scan.points.T),
        len(scan.points), np.full(3, weight, np.float32), CELL, MAPS.truncation, MAPS.coarse_truncation,
        config.residual, config.iterations, out,
    )  # fmt: skip
    results = {"offsets": Same(ours.offsets, 1e-4), "costs": Same(ours.costs, 1e-2 * ours.costs, 0.01)}
    by_c = Contender(c, count, lambda _: {"offsets": out[:, :3], "costs": out[:, 9]})
    return Task("particle", Contender(kernel, count), results, {"C": by_c})


def integration(loops: Loops, count: int = 1000) -> Task:
    """Integrate a scan of 180 points into each of 1000 maps whose tiles are the particles' own."""
    maps, scan, poses = room(count)
    view, frames = maps.all(), maps.all().frames(poses + MOVED) / (1, 1, CELL, CELL)
    pool, (_, table, rows, columns, *_) = view.tiles.pool.copy(), view.tiles
    c = loops.bind(
        "integrate_all", pool, table, rows, columns, frames, count,
        np.ascontiguousarray(scan.points.T / np.float32(CELL)), scan.joined, len(scan.points), MAPS.truncation / CELL,
        MAPS.coarse_truncation / (2 * CELL), 2 * MAPS.coarse_chord, MAPS.near / CELL, MAPS.near_weight,
        MAPS.max_weight,
    )  # fmt: skip
    kernel = partial(maps.integrate, poses + MOVED, scan)
    kernel()
    ours = maps.all().tiles.pool
    seen = ours != 0
    steps, weights = (ours >> WEIGHT_BITS)[seen], (ours & MAX_WEIGHT)[seen]
    stray = 1e-4  # of the cells have their centre on the edge of a band
    results = {
        "cells": Same(steps, 0, 1e-3),
        "cells to a step": Same(steps, 1, stray),
        "weights": Same(weights, 0, stray),
        "cells never seen": Same(np.zeros(1), stray),
    }

    def found(_: int) -> Results:
        steps, weights = pool[seen] >> WEIGHT_BITS, pool[seen] & MAX_WEIGHT
        beside = [(pool[~seen] != 0).mean()]
        return {"cells": steps, "cells to a step": steps, "weights": weights, "cells never seen": beside}

    by_c = Contender(c, count, found)
    return Task("particle", Contender(kernel, count), results, {"C": by_c})


def search(loops: Loops) -> Task:
    """Try 900 places around a particle with 60 points, by the coarse level of its map."""
    maps, scan, poses = room(1)
    view, few, near, size = maps.all(), scan.points[::3][:MAX_SEARCH_POINTS], 0.5, 2 * CELL
    turns, shifts = np.linspace(-0.1, 0.1, 9), 0.06 * np.stack(np.divmod(np.arange(100), 10), axis=1) - 0.3
    frames, (pool, table, rows, columns, *_) = view.frames(poses), view.tiles
    none = np.empty(0, np.int32)
    coarse = Pool(pool, table.reshape(1, rows, columns), none, none).tsdf(0, level=1)
    kernel = partial(
        search_scans, view.tiles, frames[0], few, turns, np.zeros(9), shifts, np.zeros(100), blocks=1, cell_size=CELL,
        near=near,
    )  # fmt: skip
    pose = poses[0] - (*view.corner, 0.0)
    twin = partial(tsdf.search, coarse, pose, few, turns, shifts, cell_size=size, near=int(near * STEPS))
    (ours, places), (scores, chosen) = kernel(), (np.empty((9, 1), np.int32) for _ in range(2))
    c = loops.bind(
        "search_all", pool, table, rows, columns, frames / (1, 1, size, size), 1,
        np.ascontiguousarray(few.T / np.float32(size)), len(few), turns.astype(np.float32), np.zeros(9, np.int32), 9,
        (shifts / size).astype(np.float32), np.zeros(100, np.int32), 100, int(near * STEPS), scores, chosen,
    )  # fmt: skip
    results = {"scores": Same(ours, 0, ON_EDGES), "places": Same(places, 0, ON_EDGES)}
    others = {
        "C": Contender(c, 1, lambda _: {"scores": scores, "places": chosen}),
        "Python": Contender(twin, 1, lambda found: {"scores": found.max(axis=1)[:, None]}, serial=True),
    }
    return Task("particle", Contender(kernel, 1), results, others)


def matching(loops: Loops, count: int = 2000) -> Task:
    """Try 5 x 5 x 5 poses around each of 2000 particles with 1081 points on a grid."""
    grid, points = walls_and_scan()
    poses = np.random.default_rng(5).normal((50.0, 48.0, 0.0), (0.1, 0.1, 0.05), (count, 3))
    offsets = np.array((-0.1, -0.05, 0.0, 0.05, 0.1))  # in x, y and theta [m], [rad]
    given = {"offsets_xy": offsets, "offsets_theta": offsets}
    kernel = partial(match_poses, grid, (0.0, 0.0), CELL, poses, points, **given)
    twin = partial(grids.match_poses, grid, (0.0, 0.0), CELL, poses[:2], points, **given)
    turned = np.repeat(poses, 5, axis=0) + np.array([(0, 0, offset) for offset in offsets] * count)
    frames = np.column_stack((np.cos(turned[:, 2]), np.sin(turned[:, 2]), turned[:, :2] / CELL)).astype(np.float32)
    nearest_first = np.argsort(np.square(np.indices((5, 5, 5)) - 2).sum(axis=0).reshape(-1), kind="stable")
    ours, scores, best = kernel(), np.empty(count, np.int32), np.empty(count, np.int32)
    c = loops.bind(
        "match_all", grid, CELLS, CELLS, frames, count, 5, np.ascontiguousarray((points.T / CELL).astype(np.float32)),
        BEAMS, np.rint(offsets / CELL).astype(np.int32), 5, nearest_first.astype(np.int32), scores, best,
    )  # fmt: skip
    results = {"scores": Same(ours.scores, 0, ON_EDGES), "poses": Same(ours.indices, 0, ON_EDGES)}
    others = {
        "C": Contender(
            c, count, lambda _: {"scores": scores, "poses": np.stack(np.unravel_index(best, (5, 5, 5)), axis=-1)}
        ),
        "NumPy": Contender(twin, 2, lambda found: {"scores": found[0], "poses": found[1]}, serial=True),
    }
    return Task("particle", Contender(kernel, count), results, others)


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
    buckets = build_buckets(walls)

    def kernel() -> Any:
        return cast_rays(buckets, origins, angles, max_range=MAX_RANGE)[0]

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


def grid_update(loops: Loops) -> Task:
    """Enter a scan of 1081 beams into an occupancy grid, along every ray; the kernel is serial, too."""
    start, change = np.array((1000, 960)), {"hit": 40, "miss": 10, "limit": 1000}
    ends = np.ascontiguousarray(start + np.floor(walls_and_scan()[1] / CELL), np.int32)
    grid, by_c, empty = (np.zeros((CELLS, CELLS), np.int16) for _ in range(3))
    flags, seen = np.zeros((CELLS, CELLS), np.uint8), np.zeros((CELLS, CELLS), np.int32)
    kernel = partial(update_grid, grid, flags, seen, start, ends, **change, threshold=0, scan=1, per_ray=True)
    twin = partial(grids.update_grid, empty, start, ends, per_ray=True, **change)
    kernel()
    c = loops.bind("update", by_c, CELLS, *start.tolist(), ends, BEAMS, *change.values())
    others = {
        "C": Contender(c, 1, lambda _: {"cells": by_c}, serial=True),
        "Python": Contender(twin, 1, lambda found: {"cells": found}, serial=True),
    }
    return Task("scan", Contender(kernel, 1), {"cells": Same(grid.copy())}, others)
