"""Exact rays a second in an office of mean range 3 m, beside what else can be installed; a dated result file.

    python benchmarks/raycast.py [--out result.json]

The world is 100 m by 100 m, as a map of 2000 x 2000 cells of 0.05 m: offices of 4 m with a door of 1.2 m in each wall
and a piece of furniture in every other, as segments. Scans of 1081 beams over 270 degrees, up to 30 m, from 200
places in free space. range_libc's CDDT casts 15.6 million approximate rays a second a core in such a world. Contenders
take turns; the median of all turns counts, in wall time and in processor time, which a busy machine disturbs less.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from parts.machine import save, stamp
from parts.options import result_file

from moteslam.eval.bench.contest import Contender
from moteslam.eval.bench.timing import in_turns, medians

BEAMS, POSES, SIZE, ROOM, DOOR = 1081, 200, 100.0, 4.0, 1.2
REPEATS = 15
BUCKETS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0)


def office(seed: int = 1) -> np.ndarray:
    """The segments [m, 4] [m]: walls with doors, and a box in every other room."""
    generator = np.random.default_rng(seed)
    count, rows = round(SIZE / ROOM), []
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
            cos, sin = np.cos(angle), np.sin(angle)
            corners = centre + (np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * size) @ np.array(
                [(cos, sin), (-sin, cos)]
            )
            rows += [(*a, *b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return np.array(rows, np.float64)


def measure(threads: int) -> dict[str, Any]:
    """The rates on a number of threads; of the others on one."""
    from moteslam.kernels import runtime

    runtime.init("cpu", threads)
    from moteslam.kernels.raycast import build_buckets, cast_rays

    segments = office()
    generator = np.random.default_rng(3)
    poses = np.column_stack((generator.uniform(1, SIZE - 1, (POSES, 2)), generator.uniform(-np.pi, np.pi, POSES)))
    beams = np.radians(-135 + 0.25 * np.arange(BEAMS))
    origins, angles = np.repeat(poses[:, :2], BEAMS, axis=0), (poses[:, 2:] + beams).reshape(-1)
    rays = len(angles)
    worlds = {"moteslam": build_buckets(segments)}
    worlds |= {f"moteslam, buckets of {size:g} m": build_buckets(segments, size=size) for size in BUCKETS}
    contenders = {
        name: Contender(partial(cast_rays, buckets, origins, angles, max_range=30.0), rays)
        for name, buckets in worlds.items()
    }
    found = medians(in_turns(contenders, seconds=0.0, least=REPEATS))
    rates = {name: [1e-6 / wall, 1e-6 / spent] for name, (wall, spent) in found.items()}
    exact = contenders["moteslam"].call()
    hit = np.isfinite(exact)
    result: dict[str, Any] = {
        "rates [M rays/s: by wall time, by processor time]": rates,
        "default bucket [m]": worlds["moteslam"].size,
        "segments": len(segments),
        "mean range [m]": float(exact[hit].mean()),
        "median range [m]": float(np.median(exact[hit])),
        "hits": float(hit.mean()),
    }
    if threads == 1:
        result["others [M rays/s]"] = others(segments, poses, beams, exact)
    return result


def others(segments: np.ndarray, poses: np.ndarray, beams: np.ndarray, exact: np.ndarray) -> dict[str, float]:
    """What a physics engine's ray query and NumPy give, on fewer rays, which must agree with ours."""
    import pymunk

    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from twins.rays import cast_rays

    space = pymunk.Space()
    for x0, y0, x1, y1 in segments.tolist():
        space.add(pymunk.Segment(space.static_body, (x0, y0), (x1, y1), 0.0))
    anything = pymunk.ShapeFilter()
    some = [(x, y, theta + beam) for x, y, theta in poses[:4].tolist() for beam in beams.tolist()]
    ends = [((x, y), (x + 30 * np.cos(a), y + 30 * np.sin(a))) for x, y, a in some]
    angles, origins = np.array([a for _, _, a in some]), np.array([(x, y) for x, y, _ in some])

    def physics() -> list[float]:
        hits = [space.segment_query_first(start, end, 0.0, anything) for start, end in ends]
        return [30.0 * hit.alpha if hit is not None else np.inf for hit in hits]

    def twin() -> np.ndarray:
        return np.asarray(cast_rays(segments, origins, angles, max_range=30.0)[0])

    for call in (physics, twin):
        close = np.isclose(np.asarray(call()), exact[: len(some)], atol=1e-3)
        assert close.mean() > 0.999, close.mean()  # a ray through a corner may slip past it in float32
    calls = {"pymunk segment_query_first, Python loop": physics, "numpy, every segment": twin}
    contenders = {name: Contender(call, len(some)) for name, call in calls.items()}
    return {name: 1e-6 / wall for name, (wall, _) in medians(in_turns(contenders, seconds=0.0, least=3)).items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=result_file)
    parser.add_argument("--threads", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.threads is not None:
        print(json.dumps(measure(options.threads)))
        return
    result: dict[str, Any] = {
        **stamp(),
        "world": f"{SIZE:g} m x {SIZE:g} m, offices of {ROOM:g} m, a box in every other; {POSES} scans, {BEAMS} beams",
    }
    for threads in (1, 2):  # fixed for a process
        command = [sys.executable, __file__, "--threads", str(threads)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        result[f"{threads} threads"] = json.loads(done.stdout.splitlines()[-1])
    save(options.out, result)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
