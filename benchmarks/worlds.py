"""Random buildings, each simulated whole: can they be driven, and is what is recorded true.

    python benchmarks/worlds.py --seeds 200 --out worlds.csv

Of each building: the robot arrives; every true pose is in free space, by half the robot's width; each stream has the
readings that its rate and its span give, without a gap; and of a hundred beams, followed in exact arithmetic, none goes
through a wall, and each ends on one, to a millimetre.
"""

from __future__ import annotations

import sys
import time
from fractions import Fraction
from typing import Any

import numpy as np
from parts.harness import Bar, Row, arguments, benchmark, status

RAYS = 100
SHORT = 2e-3
"""By which a ray is cut before it is followed [m]: float32, and walls met aslant."""
BESIDE = 1e-3
"""So near to a wall a ray must end [m]: float32, and ends of walls that reach a few micrometres further (`buckets`)."""
RUN = "random-corridors"
BARS = {
    RUN: (
        *(Bar(figure, "worst", 1.0, least=True) for figure in ("arrived", "complete", "truth_is_free")),
        Bar("rays_through_walls", "worst", 0.0),
        Bar("clearance_m", "worst", 0.3, least=True),
    )
}


def measure(seed: int) -> Row:
    """Simulate the building of a seed, and look at it."""
    from moteslam.kernels import runtime
    from moteslam.sim.scenario import parse_scenario
    from moteslam.sim.simulate import simulate
    from moteslam.sim.world.random_corridors import random_corridors

    runtime.init("cpu", 1)
    scenario = parse_scenario(random_corridors(seed))
    began = time.perf_counter()
    simulation = simulate(scenario, seed)
    seconds = time.perf_counter() - began
    world, truth = simulation.world, simulation.truth
    return {
        "arrived": simulation.end == "arrived",
        "complete": complete(simulation.recording),
        "truth_is_free": bool(world.is_free(truth.poses[:, :2], scenario.platform.width / 2).all()),
        "rays_through_walls": rays_through_walls(world, truth.poses, seed),
        "rays": RAYS,
        "clearance_m": float(world.distance(truth.poses[:, :2]).min()),
        "distance_m": truth.length,
        "time_s": float(np.ptp(truth.stamps)),
        "segments": len(world.segments),
        "simulated_in_s": seconds,
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
    wrong = int((seen & (world.distance(ends) > BESIDE)).sum())
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
    """The sign of the area of a triangle."""
    area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
    return (area > 0) - (area < 0)


def main() -> int:
    """Look at buildings, and print; 1 where a bar does not hold."""
    options = arguments(__doc__).parse_args()
    cases = [({"run": RUN, "seed": seed}, (seed,)) for seed in options.seeds or range(200)]
    return status(benchmark(measure, cases, options, bars=BARS), BARS)


if __name__ == "__main__":
    sys.exit(main())
