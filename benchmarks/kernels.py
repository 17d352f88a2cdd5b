"""The kernels beside their twins in NumPy and plain Python, on one thread; a dated result file.

    python benchmarks/kernels.py [--out result.json]

The twins are those that the tests compare the kernels with. Beside plain C, on several threads and in whole runs the
kernels are measured by `moteslam bench`, whose tasks these are.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from parts.machine import save, stamp
from parts.options import result_file

from moteslam.eval.bench.contest import OURS, Contender
from moteslam.eval.bench.tasks import grid, matching, raycasting, search
from moteslam.eval.bench.timing import in_turns, medians

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
TURNS = 3
SOME = 4
"""Particles, or scans, that a twin does: it takes long."""


def twins() -> dict[str, tuple[Any, Contender]]:
    """The task of a kernel, and its twin, doing some of the same work."""
    from twins import grids, rays, tsdf

    from moteslam.eval.bench import inputs

    maps, scan = inputs.room_maps()
    view, few = maps.of(0), scan.points[::3]
    pose = np.array((*(inputs.room_poses()[0, :2] - view.corner), inputs.room_poses()[0, 2]))
    coarse = coarse_level(view)
    occupied, points = inputs.scan_and_grid()
    poses = np.random.default_rng(5).normal((50.0, 48.0, 0.0), (0.1, 0.1, 0.05), (SOME, 3))
    offsets = {"offsets_xy": matching.OFFSETS, "offsets_theta": matching.OFFSETS}
    ends = np.ascontiguousarray(grid.START + np.floor(points / inputs.CELL), np.int32)
    empty, change = np.zeros(occupied.shape, np.int16), {"hit": grid.HIT, "miss": grid.MISS, "limit": grid.LIMIT}
    segments = inputs.offices()
    origins = np.tile(segments.mean(axis=0)[:2], (SOME * inputs.BEAMS, 1))
    angles = np.tile(np.linspace(np.radians(-135), np.radians(135), inputs.BEAMS), SOME)
    return {
        "searching 900 places, plain Python": (
            search.TASK,
            Contender(
                lambda: tsdf.search(coarse, pose, few, [0.0], search.SHIFTS, cell_size=0.1, near=511),
                1 / len(search.TURNS),
            ),
        ),
        "matching 5 x 5 x 5, NumPy": (
            matching.TASK,
            Contender(
                lambda: grids.match_poses(occupied, (0.0, 0.0), inputs.CELL, poses, points, **offsets), len(poses)
            ),
        ),
        "raycasting, NumPy": (
            raycasting.TASK,
            Contender(lambda: rays.cast_rays(segments, origins, angles, max_range=30.0), len(angles)),
        ),
        "grid update, plain Python": (
            grid.TASK,
            Contender(lambda: grids.update_grid(empty, grid.START, ends, per_ray=True, **change), 1),
        ),
    }


def coarse_level(view: Any) -> Any:
    """The coarse level of a map of tiles, for the twin."""
    from twins.tsdf import Tsdf

    from moteslam.kernels.tiles import CELLS, FINE_CELLS, MAX_WEIGHT, SIDE, WEIGHT_BITS

    side, (pool, table, rows, columns, _, first) = SIDE // 2, view.tiles
    cells = pool.reshape(-1, CELLS)[table[first : first + rows * columns], FINE_CELLS:]
    words = cells.reshape(rows, columns, side, side).swapaxes(1, 2).reshape(rows * side, columns * side).astype(int)
    return Tsdf(words >> WEIGHT_BITS, words & MAX_WEIGHT)


def main() -> None:
    """Measure, print, and write the result file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=result_file)
    options = parser.parse_args()
    from moteslam.kernels import runtime

    runtime.init("cpu", 1)
    result: dict[str, Any] = {}
    for name, (task, twin) in twins().items():
        ours = task.prepare(None, 1).contenders[OURS]
        found = medians(in_turns({OURS: ours, "twin": twin}, seconds=0.0, least=TURNS))
        times = {who: processor for who, (_, processor) in found.items()}
        ratio = times["twin"] / times[OURS]
        result[name] = {**{f"{who} [s a {task.unit}]": value for who, value in times.items()}, "ratio": ratio}
        print(f"{name}: {times['twin']:.3g} s a {task.unit}, the kernel {times[OURS]:.3g} s: {ratio:.0f} times as fast")
    save(options.out, {**stamp(), "kernels and twins": result})


if __name__ == "__main__":
    main()
