"""Many random buildings, each simulated whole and looked at: can they be driven, and is what is recorded true.

    python benchmarks/worlds.py [--count 200] [--first 0] [--jobs 2] [--out result.json]

Of each building: the robot arrives; every true pose is in free space, by half the robot's width; each stream has the
readings that its rate and its span give, without a gap; and of a hundred beams, followed in exact arithmetic, none goes
through a wall, and each ends on one, to a millimetre.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import statistics
import time
from fractions import Fraction
from typing import Any

import numpy as np
from parts.machine import save, stamp
from parts.options import result_file

RAYS = 100
SHORT = 2e-3
"""By which a ray is cut before it is followed [m]: float32, and walls met aslant."""
BESIDE = 1e-3
"""So near to a wall a ray must end [m]: float32, and ends of walls that reach a few micrometres further (`buckets`)."""


def start() -> None:
    from moteslam.kernels import runtime

    runtime.init("cpu", 1)


def look_at(seed: int) -> dict[str, Any]:
    """Simulate the building of a seed and report what was found."""
    from moteslam.sim.scenario import parse_scenario
    from moteslam.sim.simulate import simulate
    from moteslam.sim.world.random_corridors import random_corridors

    began = time.perf_counter()
    scenario = parse_scenario(random_corridors(seed))
    built = time.perf_counter()
    simulation = simulate(scenario, seed)
    done = time.perf_counter()
    world, truth = simulation.world, simulation.truth
    return {
        "seed": seed,
        "end": simulation.end,
        "distance [m]": truth.length,
        "time [s]": float(np.ptp(truth.stamps)),
        "segments": len(world.segments),
        "truth is free": bool(world.is_free(truth.poses[:, :2], scenario.platform.width / 2).all()),
        "least clearance [m]": float(world.distance(truth.poses[:, :2]).min()),
        "complete": complete(simulation.recording),
        "rays through walls": rays_through_walls(world, truth.poses, seed),
        "built in [s]": built - began,
        "simulated in [s]": done - built,
    }


def complete(recording: Any) -> bool:
    """Whether every stream has its readings, none missing."""
    for stream, rate in ((recording.lidar, 40), (recording.encoders, 40), (recording.imu, 100)):
        span = float(np.ptp(stream.stamps))
        if abs(len(stream) - 1 - span * rate) > 0.01 * span * rate + 8 or np.diff(stream.stamps).max() > 0.15:
            return False
    return bool(np.isfinite(recording.lidar.ranges).mean() > 0.9)


def rays_through_walls(world: Any, poses: np.ndarray, seed: int) -> int:
    """How many of RAYS random rays along the path cross a wall before their end, exactly, or end beside every wall."""
    from moteslam.kernels.raycast import build_buckets, cast_rays

    segments = world.segments
    generator = np.random.default_rng(seed)
    origins = poses[generator.integers(0, len(poses), RAYS), :2]
    angles = generator.uniform(-np.pi, np.pi, RAYS)
    ranges = cast_rays(build_buckets(segments), origins, angles, max_range=30.0).astype(np.float64)
    ahead = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    seen = np.isfinite(ranges)
    ends = origins + np.where(seen, ranges, 30.0)[:, None] * ahead
    beside = seen & (world.distance(ends) > BESIDE)
    wrong = int(beside.sum())
    walls = [tuple(map(Fraction, wall)) for wall in segments.tolist()]
    corners = segments.reshape(-1, 2, 2)
    for origin, end, direction in zip(origins, ends, ahead, strict=True):
        low, high = np.minimum(origin, end) - 0.1, np.maximum(origin, end) + 0.1
        close = ((corners.max(1) >= low) & (corners.min(1) <= high)).all(1)
        a, b = (tuple(map(Fraction, point.tolist())) for point in (origin, end - SHORT * direction))
        wrong += any(crosses(a, b, walls[k]) for k in np.flatnonzero(close))
    return wrong


def crosses(a: tuple[Fraction, ...], b: tuple[Fraction, ...], wall: tuple[Fraction, ...]) -> bool:
    """Whether a-b crosses a wall properly, by the signs of exact areas."""
    c, d = wall[:2], wall[2:]
    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


def side(p: tuple[Fraction, ...], q: tuple[Fraction, ...], r: tuple[Fraction, ...]) -> int:
    area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
    return (area > 0) - (area < 0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=result_file)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.count)
    with multiprocessing.get_context("spawn").Pool(options.jobs, start) as pool:
        found = []
        for one in pool.imap_unordered(look_at, seeds):
            found.append(one)
            print(json.dumps(one), flush=True)
    found.sort(key=lambda one: one["seed"])
    result = {
        **stamp(),
        "buildings": len(found),
        "arrived": sum(one["end"] == "arrived" for one in found),
        "complete": sum(one["complete"] for one in found),
        "truth in free space at all times": sum(one["truth is free"] for one in found),
        "rays followed": RAYS * len(found),
        "rays through walls": sum(one["rays through walls"] for one in found),
        "least clearance [m]": min(one["least clearance [m]"] for one in found),
        "median time to simulate [s]": statistics.median(one["simulated in [s]"] for one in found),
        "each": found,
    }
    save(options.out, result)
    print({key: value for key, value in result.items() if key != "each"})


if __name__ == "__main__":
    main()
