"""Every kernel on inputs that are always the same, to compare what comes out on other threads and other backends.

``run_cases`` computes them in a process of its own, since Taichi can be set up once a process; run as a script this
file is that process: ``kernel_cases.py ARCH THREADS RESULTS.npz``. The inputs are so large that each kernel that is
parallel works for 10 ms or so: in less, one thread is done before another has woken.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

CELL = 0.05
ORIGIN = (-2.0, -1.0)
ROOM = (12.0, 9.0)
MAX_RANGE = 7.0
Results = dict[str, NDArray[np.generic]]


def run_cases(folder: Path, *, arch: str = "cpu", threads: int = 1) -> Results:
    """The arrays that each kernel computes, by name, through a file in a folder."""
    out = folder / f"{arch}-{threads}.npz"
    done = subprocess.run(
        [sys.executable, __file__, arch, str(threads), str(out)],
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    with np.load(out) as arrays:
        return dict(arrays)


def compute() -> Results:
    """All of them, with Taichi as it is set up in this process."""
    groups = [motion, random_words, endpoints, occupancy, matching, raycasting, distance_maps, floors]
    return {name: array for group in groups for name, array in group().items()}


def motion() -> Results:
    from moteslam.kernels.motion import sample_motion

    poses = np.random.default_rng(1).uniform((-100, -100, -3.1), (100, 100, 3.1), (50_000, 3))
    for step in range(3):
        sample_motion(poses, (0.3, 0.01, 0.2), (0.05, 0.02, 0.03), seed=2**40 + 7, step=step)
    return {"sample_motion": poses}


def random_words() -> Results:
    from random_words import philox_words

    words = np.random.default_rng(2).integers(0, 2**32, (200_000, 6), np.uint32)
    return {"philox_words": philox_words(words[:, :4], words[:, 4:])}


def endpoints() -> Results:
    """Of 200 scans of 1081 beams, de-skewed and thinned."""
    from moteslam.kernels.scans import project_scans, thin_scans

    generator = np.random.default_rng(11)
    ranges = generator.uniform(0.1, 20, (200, 1081)).astype(np.float32)
    ranges[generator.random(ranges.shape) < 0.1] = np.inf
    angles = np.linspace(-2.3, 2.3, 1081)
    sweeps = generator.uniform(-0.1, 0.1, (200, 3))
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    points, counts = project_scans(ranges, directions, (0.1, 0.0), sweeps=sweeps, max_range=18.0)
    begins = 1081 * np.arange(200)
    scans = thin_scans(points, begins, counts, (0.1, 0.0), spacing=0.02, max_spacing=0.3, max_points=200, gap=5.0)
    ends = [points[begin : begin + count] for begin, count in zip(begins, counts, strict=True)]
    return {
        "project_scans": np.vstack(ends),
        "thin_scans: points": np.vstack([scan.points for scan in scans]),
        "thin_scans: joined": np.concatenate([scan.joined for scan in scans]),
    }


def occupancy() -> Results:
    from moteslam.kernels.occupancy import update_grid

    results: Results = {}
    for name, options in (("once", {"guard": 1}), ("per ray", {"per_ray": True})):
        grid, flags, seen = (np.zeros((200, 256), t) for t in (np.int16, np.uint8, np.int32))
        generator = np.random.default_rng(3)
        for scan in range(1, 6):
            ends = generator.integers((1, 1), (255, 199), (300, 2))
            update_grid(
                grid, flags, seen, generator.integers((100, 80), (130, 120)), ends,
                hit=60, miss=25, limit=100, threshold=40, scan=scan, **options,
            )  # fmt: skip
        results |= {f"update_grid, {name}: log-odds": grid, f"update_grid, {name}: flags": flags}
    return results


def room_and_scan(seed: int) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]:
    """A grid of walls and clutter, poses near the middle, and a scan of which some points leave the grid."""
    generator = np.random.default_rng(seed)
    grid = np.zeros((200, 256), np.uint8)
    grid[20, 20:236] = grid[180, 20:236] = grid[20:181, 20] = grid[20:181, 235] = 1
    grid[21:180, 21:235] = generator.random((159, 214)) < 0.08
    angles = np.linspace(-2.3, 2.3, 181)
    ranges = generator.uniform(1.0, 7.0, len(angles))
    poses = np.array((4.0, 4.0, 0.0)) + generator.normal(0, (0.6, 0.6, 0.8), (50_000, 3))
    return grid, poses, np.stack((ranges * np.cos(angles), ranges * np.sin(angles)), axis=-1)


def matching() -> Results:
    from moteslam.kernels.matching import match_poses

    grid, poses, points = room_and_scan(5)
    weights = grid * np.random.default_rng(6).integers(1, 200, grid.shape, np.uint8)
    lattice, general = CELL * np.arange(-2, 3), np.array((-0.083, -0.031, 0.0, 0.031, 0.083))
    results: Results = {}
    for name, cells, offsets, count in (
        ("windows", grid, lattice, 3000),
        ("lattice of weights", weights, lattice, 500),
        ("general offsets", grid, general, 500),
    ):
        match = match_poses(
            cells, ORIGIN, CELL, poses[:count], points, offsets_xy=offsets, offsets_theta=np.linspace(-0.05, 0.05, 5)
        )
        results |= {f"match_poses, {name}: {field}": array for field, array in match._asdict().items()}
    return results


def boxes() -> NDArray[np.float64]:
    """The inside of a room, then pillars in it: [n, 4] (x0, y0, x1, y1) [m], on whole cells."""
    pillars = [(x, y, x + 0.4, y + 0.4) for x in (2.2, 5.3, 8.7) for y in (1.7, 6.1)]
    return np.array([(0.0, 0.0, *ROOM), *pillars])


def beams_of_scans() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Poses [1200, 3] between the pillars, 30 again and again, and beam angles [181].

    No beam passes a corner by less than 0.01 mm.
    """
    poses = np.random.default_rng(9).uniform((3.0, 2.3, -3.1), (8.0, 5.9, 3.1), (30, 3))
    return np.tile(poses, (40, 1)), np.linspace(-2.3, 2.3, 181)


def rays_of(poses: NDArray[np.float64], beams: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Origins [n * b, 2] and angles [n * b] of the beams [b] of scans from poses [n, 3]."""
    return np.repeat(poses[:, :2], len(beams), axis=0), (poses[:, 2:] + beams).reshape(-1)


def raycasting() -> Results:
    """Every wall runs along an axis, so that the angle at which a beam meets it is known from the beam alone."""
    from moteslam.kernels.raycast import build_buckets, cast_rays

    walls = [
        side
        for x0, y0, x1, y1 in boxes()
        for side in ((x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0))
    ]
    buckets = build_buckets(walls)
    poses, beams = beams_of_scans()
    rays = rays_of(poses, beams)
    shape = len(poses), len(beams)
    ranges, segments = cast_rays(buckets, *rays, max_range=MAX_RANGE)
    return {"cast_rays": ranges.reshape(shape), "segments": segments}


def distance_maps() -> Results:
    """Maps of 200 particles with a common past, and scans found in them.

    What the cells hold and how places score comes from float32 places: as real numbers, to be compared as such.
    """
    from tile_pools import MIDDLE, OPTIONS, REGISTRATION, frames, room_scan, thinned

    from moteslam.kernels.correlative import MAX_SEARCH_POINTS, search_scans
    from moteslam.kernels.gauss_newton import Kept
    from moteslam.kernels.registration import FRAME, OFFSET, PRIOR, QUERY, RegistrationOptions, register_scans
    from moteslam.kernels.tiles import CELLS, tile_store
    from moteslam.kernels.tsdf import IntegrationOptions, integrate_scans

    generator = np.random.default_rng(10)
    particles = 200
    poses = MIDDLE + generator.normal(0, (0.05, 0.05, 0.02), (particles, 3))
    store, options = tile_store(9, 10, 100), IntegrationOptions(**OPTIONS)  # type: ignore[arg-type]
    integrate_scans(store, frames([MIDDLE]), [thinned(room_scan())], options=options)
    store.grow(9, 12, 0, 0)
    store.resample(np.zeros(particles, np.int64))
    scan, places = thinned(room_scan((0.1, -0.1, 0.2))), frames(poses + np.array((0.1, -0.1, 0.2)))
    while not integrate_scans(store, places, [scan], options=options):
        store.enlarge()
    tiles = store.tiles
    pool, table = (a if isinstance(a, np.ndarray) else a.to_numpy() for a in (tiles.pool, tiles.table))
    words = (
        pool.reshape(-1, CELLS)[table.reshape(particles, tiles.size)].reshape(particles, -1)[:, ::7].astype(np.int32)
    )
    queries = np.zeros((particles, QUERY))
    queries[:, FRAME], queries[:, PRIOR] = frames(poses), (1e4, 1e4, 1e4, 0.0, 0.0, 0.0)
    found = register_scans(
        tiles, queries, scan.points, (0.1, 0.0), kept=Kept(0.02, 1e-4),
        options=RegistrationOptions(**REGISTRATION),  # type: ignore[arg-type]
    )  # fmt: skip
    shifts = 0.012 * np.stack(np.divmod(np.arange(10_000), 100), axis=1) - 0.6
    scores, chosen = search_scans(
        tiles.of(3), frames(poses)[3], scan.points[::4][:MAX_SEARCH_POINTS], np.linspace(-0.1, 0.1, 25),
        np.zeros(25), shifts, np.zeros(10_000), blocks=16, cell_size=CELL, near=0.5,
    )  # fmt: skip
    return {
        "thin_scan": scan.points,
        "integrate_scans: steps": (words >> 5).astype(np.float64),
        "integrate_scans: weights": (words & 31).astype(np.float64),
        "register_scans: offsets": found[:, OFFSET],
        "register_scans: fits": found[:, OFFSET.stop :],
        "search_scans: scores": scores.astype(np.float64),
        "search_scans: shifts": chosen.astype(np.float64),
    }


def floors() -> Results:
    """What a camera sees of a floor in a square room, the floor gathered from it again, and looked for.

    Which cell a ray meets is decided in float32: levels and sums are real numbers, to be compared as such.
    """
    from ucsd_robot import CAMERA

    from moteslam.kernels.camera import depth_view_of, render_colour, render_disparity, view_of
    from moteslam.kernels.raycast import build_buckets, cast_rays
    from moteslam.kernels.texture import add_frame, match_colours
    from moteslam.robot import rgbd
    from moteslam.sim.sensors.rgbd import optical_rays
    from moteslam.slam.texture.floor_map import calibration

    generator, rotation = np.random.default_rng(11), rgbd.mount_rotation(CAMERA)
    rays = optical_rays(colour=False)
    seen = view_of(np.concatenate((rays @ rotation.T, rays[..., 2:]), axis=-1), height=0.36)
    depth = depth_view_of(
        seen, scale=1.03, offset=3.31, slope=-0.00304, nothing=2047, nearest=0.4, farthest=4.0, grazing=0.05
    )
    walls = build_buckets(np.array([(-3, -3, 3, -3), (3, -3, 3, 3), (3, 3, -3, 3), (-3, 3, -3, -3)], np.float64))
    poses = np.array([(0.0, 0.0, 0.1), (0.4, 0.3, 2.2), (1.0, -1.2, -0.7)])
    levels = generator.integers(0, 2**24, (160, 160)).astype(np.int32)
    pixels, starts = rgbd.WIDTH * rgbd.HEIGHT, np.array((0, 3, 9))
    noise = generator.normal(0, 2, pixels + 2 * rgbd.WIDTH + 9).astype(np.float32)
    square = {"corner": (-4.0, -4.0), "cell_size": CELL}
    fans = [
        cast_rays(walls, *rays_of(poses, bearings), max_range=9.0)[0].reshape(len(poses), -1)
        for bearings in (seen.bearings, depth.view.bearings)
    ]
    packed = render_colour(seen, poses, fans[0], levels, noise=noise, starts=starts, **square)
    disparity = render_disparity(depth, fans[1], noise=noise, starts=starts)
    images = np.ascontiguousarray(np.stack([packed >> shift & 255 for shift in (0, 8, 16)], axis=-1), np.uint8)
    sums = np.zeros((160, 160, 4), np.int64)
    for pose, rgb, raw in zip(poses, images, disparity, strict=True):
        add_frame(
            sums, raw.reshape(rgbd.HEIGHT, -1), rgb.reshape(rgbd.HEIGHT, -1, 3), pose, calibration=calibration(),
            mount=np.column_stack((rotation, (0.18, 0.0, 0.36))), height_limit=0.1, max_depth=5.0, nothing=2047,
            flat=True, **square,
        )  # fmt: skip
    patch = generator.uniform((0, -2), (3, 2), (3000, 2)).astype(np.float32)
    colours = generator.integers(0, 2**24, len(patch)).astype(np.int32)
    matched = match_colours(patch, colours, generator.uniform(-2, 2, (2000, 3)), levels, **square)
    return {
        "render_colour": images.astype(np.float64),
        "render_disparity": disparity.astype(np.float64),
        "add_frame": sums.astype(np.float64),
        "match_colours": matched.astype(np.float64),
    }


def main() -> None:
    arch, threads, out = sys.argv[1:]
    from moteslam.kernels import runtime

    runtime.init(arch, int(threads), debug=os.environ.get("MOTESLAM_TEST_DEBUG") == "1")
    results = compute()
    if threads == "1":
        before = switches()
        assert before, "Taichi has threads"
        compute()
        assert switches() == before, "on one thread a loop runs where it is launched"
    np.savez(out, **results)


def switches() -> dict[str, int] | bool:
    """How often each thread but the main one has run, by its number; Linux alone tells."""
    tasks = Path("/proc/self/task")
    if not tasks.is_dir():
        return True
    counts = {}
    for task in tasks.iterdir():
        if task.name != str(os.getpid()):
            lines = (task / "status").read_text().splitlines()
            counts[task.name] = sum(int(line.split()[1]) for line in lines if "ctxt_switches" in line)
    return counts


if __name__ == "__main__":
    main()
