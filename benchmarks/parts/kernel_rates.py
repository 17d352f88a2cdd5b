"""How fast each kernel is, beside its twin and a plain C loop that does the same: work a second, taken in turns."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from parts.timing import in_turns, pointers

BEAMS = 1081
CELLS, CELL = 2000, 0.05
REPEATS = 9
SPENT = "processor [ms a call]"


def rates(contenders: dict[str, Callable[[], Any]], work: float, repeats: int = REPEATS) -> dict[str, float]:
    """Work a second of each contender's calls by wall time, and the processor time of the first's [ms]."""
    found = in_turns(contenders, repeats)
    first = next(iter(contenders))
    return {name: work / seconds.wall for name, seconds in found.items()} | {SPENT: 1e3 * found[first].processor}


def world(segments: int = 500, *, size: float = 90.0, seed: int = 1) -> np.ndarray:
    """Rooms on a grid with gaps for doors, as ``segments`` walls [m, 4] [m]: an office."""
    generator = np.random.default_rng(seed)
    room, rows = 6.0, []
    for i in range(int(size / room) + 1):
        for j in range(int(size / room)):
            a, b = sorted(generator.uniform(0.5, room - 0.5, 2))
            at, low = i * room, j * room
            rows += [(at, low, at, low + a), (at, low + b, at, low + room)]
            rows += [(low, at, low + a, at), (low + b, at, low + room, at)]
    return np.array(rows)[generator.permutation(len(rows))[:segments]]


def scan_and_map(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A grid of walls [CELLS, CELLS] uint8 with a border of zeros, and a scan's points [BEAMS, 2] [m] on them."""
    grid = np.zeros((CELLS, CELLS), np.uint8)
    grid[600:1400:160, 400:1600] = 1
    grid[600:1400, 400:1600:200] = 1
    angles = np.linspace(np.radians(-135), np.radians(135), BEAMS)
    ranges = np.minimum(4.0 / np.maximum(np.abs(np.cos(angles)), 1e-3), 4.9 / np.maximum(np.abs(np.sin(angles)), 1e-3))
    ranges += np.random.default_rng(seed).normal(0, 0.01, BEAMS)
    return grid, np.stack((ranges * np.cos(angles), ranges * np.sin(angles)), axis=-1)


def arithmetic(loops: ctypes.CDLL | None) -> dict[str, Any]:
    """Chains of arithmetic in C, on the same number of threads: what the machine gives."""
    if loops is None:
        return {}
    out = np.empty(2000, np.float32)
    return {
        "arithmetic alone [M steps/s]": rates(
            {"c": lambda: loops.arithmetic(out.size, 1000, *pointers(out))}, out.size / 1e3
        )
    }


def memory(loops: ctypes.CDLL | None) -> dict[str, Any]:
    """Floats of an array larger than any cache added up in C: what can be read from memory."""
    if loops is None:
        return {}
    values = np.ones(2**26, np.float32)
    return {
        "memory alone [GB/s]": rates(
            {"c": lambda: loops.sum(*pointers(values), ctypes.c_long(values.size))}, values.nbytes / 1e9
        )
    }


def distance_maps(loops: ctypes.CDLL | None, threads: int) -> dict[str, Any]:
    """Integrating, registering and searching a scan of 180 beams, each of 1000 particles in a map of its own."""
    from tile_pools import MIDDLE, OPTIONS, Pool, frames, room_scan, thinned
    from twins import tsdf

    from moteslam.kernels.correlative import MAX_SEARCH_POINTS, search_scans
    from moteslam.kernels.registration import FRAME, OFFSET, PRIOR, QUERY, register_scans
    from moteslam.kernels.registration_options import RegistrationOptions
    from moteslam.kernels.tiles import STEPS

    n, offset = 1000, np.array((0.1, -0.1, 0.2))
    poses = MIDDLE + np.random.default_rng(10).normal(0, (0.05, 0.05, 0.02), (n, 3))
    pool = Pool.empty()
    pool.add([MIDDLE], thinned(room_scan()))
    pool = pool.resampled(np.zeros(n, int), more_tiles=40 * n)
    scan = thinned(room_scan(offset, beams=180))
    places, queries = frames(poses), np.zeros((n, QUERY))
    queries[:, FRAME], queries[:, PRIOR] = places, (1e4, 1e4, 1e4, 0.0, 0.0, 0.0)
    lengths = {name: OPTIONS[name] for name in ("cell_size", "truncation", "coarse_truncation")}

    options = RegistrationOptions(
        **lengths, residual=0.01, coarse_residual_factor=2.0, iterations=8, unknown=2.0, outlier=8.0,
        likelihood_width=2.0, ray_clearance=2.0, ray_weight=4, ray_distance=1 / 3,
    )  # fmt: skip

    def integrate() -> None:
        assert pool.add(poses + offset, scan) is not None

    def register() -> np.ndarray:
        return register_scans(tiles, queries, scan.points, (0.0, 0.0), options=options)[:, OFFSET]

    flat, prior = np.ascontiguousarray(scan.points.T), np.full(3, 1e4, np.float32)
    by_c = np.empty((n, 13))

    def plain() -> np.ndarray:
        assert loops is not None
        loops.register_all(
            *pointers(pool.pool, pool.tables), *pool.tables.shape[1:], *pointers(places), n, *pointers(flat),
            len(scan.points), *pointers(prior), *map(ctypes.c_float, (*lengths.values(), options.residual)),
            options.iterations, *pointers(by_c),
        )  # fmt: skip
        return by_c[:, :3]

    turns = np.linspace(-0.1, 0.1, 9)
    shifts = 0.06 * np.stack(np.divmod(np.arange(100), 10), axis=1) - 0.3
    few = scan.points[::3][:MAX_SEARCH_POINTS]

    def search() -> np.ndarray:
        return search_scans(
            tiles, places, few, turns, np.zeros(9), shifts, np.zeros(100), blocks=1, cell_size=CELL, near=0.5
        )[0]  # fmt: skip

    integrate()  # each particle copies the tiles that it writes to, once
    tiles = pool.tiles
    results: dict[str, Any] = {}
    task = f"integrating {len(scan.points)} points, {n} particles [thousand particles/s]"
    results[task] = rates({"moteslam": integrate}, n / 1e3)
    contenders: dict[str, Callable[[], Any]] = {"moteslam": register}
    if loops is not None:
        contenders["c"] = plain
        np.testing.assert_allclose(plain(), register(), rtol=0, atol=1e-4)  # the same work
    task = f"registering {len(scan.points)} points, {n} particles [thousand particles/s]"
    results[task] = rates(contenders, n / 1e3)
    if loops is not None:
        passes = float(by_c[:, -1].mean())
        each = 1e6 / (passes * len(scan.points))  # ns a lookup between four cells, of the seconds a thousand particles
        named = {name: each / results[task][name] for name in contenders}
        results["a lookup between four cells, with all that follows from it [ns]"] = named
        results["registering: times that a scan is gone through"] = {"mean": passes}
    found = rates({"moteslam": search}, n * len(turns) * len(shifts) / 1e6)
    if threads == 1:
        coarse = pool.tsdf(level=1)
        near = int(0.5 * STEPS)

        def by_twin() -> object:
            return tsdf.search(coarse, poses[0], few, turns[:1], shifts, cell_size=2 * CELL, near=near)

        twin = in_turns({"python": by_twin}, 3)
        found["python"] = len(shifts) / twin["python"].wall / 1e6
    return results | {f"searching with {len(few)} points, {n} particles [M places/s]": found}


def thinning(loops: ctypes.CDLL | None) -> dict[str, Any]:
    """Scans of 1081 beams thinned to about 200 points: 64 in a call, as in SLAM; one after the other in C."""
    from moteslam.kernels.thinning import thin_scans

    _, points = scan_and_map()
    scans = 64
    ends = np.tile(points.astype(np.float32), (scans, 1))
    begins, counts = np.arange(scans) * BEAMS, np.full(scans, BEAMS)
    options = {"spacing": 0.02, "max_spacing": 0.06, "max_points": 200, "gap": 0.3, "gap_from_range": 0.03}

    def kernel() -> list[Any]:
        return thin_scans(ends, begins, counts, (0.0, 0.0), **options)  # type: ignore[arg-type]

    found, joined = np.empty((BEAMS, 2), np.float32), np.empty(BEAMS, np.int32)
    lengths = [ctypes.c_float(options[name]) for name in ("gap", "gap_from_range", "spacing", "max_spacing")]

    def plain() -> int:
        assert loops is not None
        left = 0
        for begin in begins:
            (one,) = pointers(ends[begin:])
            left = loops.thin(one, BEAMS, *lengths, options["max_points"], *pointers(found, joined))
        return left

    contenders: dict[str, Callable[[], Any]] = {"moteslam": kernel}
    if loops is not None:
        contenders["c"] = plain
        thinned = kernel()[0].points
        np.testing.assert_allclose(found[: plain()], thinned, rtol=0, atol=1e-5)
    return {f"thinning {BEAMS} beams [thousand scans/s]": rates(contenders, scans / 1e3)}


def matching(threads: int) -> dict[str, Any]:
    """Particles a second of ``match_poses``, 2000 particles x 1081 beams x 5 x 5 x 5."""
    from twins import grids

    from moteslam.kernels.matching import match_poses

    grid, points = scan_and_map()
    poses = np.random.default_rng(5).normal((50.0, 48.0, 0.0), (0.1, 0.1, 0.05), (2000, 3))
    offsets = np.array((-0.1, -0.05, 0.0, 0.05, 0.1))
    options = {"offsets_xy": offsets, "offsets_theta": offsets}
    kernel = {"moteslam": lambda: match_poses(grid, (0.0, 0.0), CELL, poses, points, **options)}
    found = rates(kernel, len(poses) / 1e3)
    if threads == 1:
        few = poses[:4]
        twin = in_turns({"numpy": lambda: grids.match_poses(grid, (0.0, 0.0), CELL, few, points, **options)}, 3)
        found["numpy"] = len(few) / twin["numpy"].wall / 1e3
    return {f"matching 5x5x5, {BEAMS} beams [thousand particles/s]": found}


def raycasting(loops: ctypes.CDLL | None, threads: int) -> dict[str, Any]:
    """Exact rays a second in a world of 500 segments, from 200 poses of 1081 beams."""
    from moteslam.kernels.raycast import build_buckets, cast_rays

    segments = world()
    buckets = build_buckets(segments)
    generator = np.random.default_rng(3)
    poses = np.column_stack((generator.uniform(10, 80, (200, 2)), generator.uniform(-np.pi, np.pi, 200)))
    beams = np.linspace(np.radians(-135), np.radians(135), BEAMS)
    origins, angles = np.repeat(poses[:, :2], BEAMS, axis=0), (poses[:, 2:] + beams).reshape(-1)
    rays = np.column_stack((origins, angles)).astype(np.float32)
    flat = np.ascontiguousarray(segments, np.float32)
    out = np.empty(len(rays), np.float32)

    def kernel() -> np.ndarray:
        return cast_rays(buckets, origins, angles, max_range=30.0)

    def plain() -> np.ndarray:
        assert loops is not None
        loops.cast_all(*pointers(flat), len(flat), *pointers(rays), out.size, ctypes.c_float(30.0), *pointers(out))
        return out

    contenders: dict[str, Callable[[], np.ndarray]] = {"moteslam": kernel}
    if loops is not None and threads == 1:
        contenders["c, every segment"] = plain
    found = rates(contenders, out.size / 1e6, 5)
    exact = kernel()
    hit = np.isfinite(exact)
    if threads == 1:
        from twins import rays as twins

        some = np.s_[: 4 * BEAMS]

        def twin() -> np.ndarray:
            return np.asarray(twins.cast_rays(segments, origins[some], angles[some], max_range=30.0)[0])

        found["numpy"] = 4 * BEAMS / in_turns({"numpy": twin}, 3)["numpy"].wall / 1e6
        close = np.isclose(twin(), exact[some], rtol=0, atol=1e-3)
        assert close.mean() > 0.999, close.mean()  # the same work; a ray through a corner may slip past it in float32
    return {
        "raycasting, 500 segments [M rays/s]": found,
        "raycasting world": {"mean range of hits [m]": float(exact[hit].mean()), "hits": float(hit.mean())},
    }


def updating(loops: ctypes.CDLL | None, threads: int) -> dict[str, Any]:
    """Scans a second entered into a grid: by every ray, as in the C loop, and each cell once, as the presets do."""
    from twins import grids

    from moteslam.kernels.occupancy import update_grid

    occupied, points = scan_and_map()
    start = np.array((1000, 960))
    ends = np.ascontiguousarray(start + np.floor(points / CELL), np.int32)
    seen, scan = np.zeros(occupied.shape, np.int32), itertools.count(1)
    grid, once, plain_grid = (np.zeros(occupied.shape, np.int16) for _ in range(3))
    flags, flags_once = np.zeros_like(occupied), np.zeros_like(occupied)
    hit, miss, limit = 40, 10, 1000

    def per_ray(log_odds: np.ndarray = grid) -> None:
        update_grid(
            log_odds, flags, seen, start, ends, hit=hit, miss=miss, limit=limit, threshold=0, scan=1, per_ray=True
        )

    def each_once() -> None:
        update_grid(once, flags_once, seen, start, ends, hit=hit, miss=miss, limit=limit, threshold=0, scan=next(scan))

    def plain(log_odds: np.ndarray = plain_grid) -> None:
        assert loops is not None
        loops.update(*pointers(log_odds), CELLS, *start.tolist(), *pointers(ends), len(ends), hit, miss, limit)

    contenders: dict[str, Callable[[], Any]] = {"moteslam": per_ray, "moteslam, each cell once": each_once}
    if loops is not None:
        contenders["c"] = plain
    found = rates(contenders, 1)
    if loops is not None:
        assert (grid == plain_grid).all()
    if threads == 1:
        empty = np.zeros(occupied.shape, np.int16)

        def by_twin() -> object:
            return grids.update_grid(empty, start, ends, hit=hit, miss=miss, limit=limit, per_ray=True)

        twin = in_turns({"python": by_twin}, 1)
        found["python"] = 1 / twin["python"].wall
    return {f"grid update, {BEAMS} beams [scans/s]": found}
