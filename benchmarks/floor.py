"""The coloured floor along the true path and along SLAM's, against the true floor.

    python benchmarks/floor.py --seeds 2 --out floor.csv

The scenario `corridor` is simulated with both cameras and the real robot's lost frames; no image is written: those that
are asked for are drawn. Cells that the depth camera had in view and range are to be coloured; `share` is the mean error
of a colour level over that of the best single colour, beside it that with the floor two cells off.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from parts.harness import Row, arguments, benchmark, status
from parts.runs import Case, simulate_case
from parts.visibility import seen_cells

if TYPE_CHECKING:
    from moteslam.robot.trajectory import Trajectory

CELL = 0.05
MARGIN = 20
"""Around the coloured map [cells]: cells may be seen there, and are not coloured."""


def measure(seed: int, preset: str) -> Row:
    """The figures of one drive."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.kernels import runtime
    from moteslam.robot.se2 import compose
    from moteslam.robot.trajectory import Trajectory
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    runtime.init("cpu", 1)
    case = simulate_case("corridor", seed, camera=True)
    truth = case.reference
    assert truth is not None
    config = resolve_config(preset, ["texture.enabled=false"])  # coloured below
    path = run_slam(case.recording, config, seed=seed).trajectory_final
    in_world = Trajectory(path.stamps, compose(truth.at(path.stamps[:1]).poses[0], path.poses))
    row: Row = {"ate_m": absolute_trajectory_error(path, truth).rmse}
    for which, trajectory in (("truth", truth), ("slam", in_world)):
        row |= {f"{key}_along_{which}": value for key, value in scored(case, trajectory).items()}
    return row


def scored(case: Case, trajectory: Trajectory) -> dict[str, Any]:
    """Colour the floor along a trajectory in the world, and compare it with the true floor."""
    from parts.floor_colours import registration, score_texture

    from moteslam.sim.world.floor import rasterise
    from moteslam.slam.texture.config import TextureConfig
    from moteslam.slam.texture.floor_map import map_texture

    assert case.simulation is not None
    assert case.simulation.frames is not None
    assert case.simulation.scenario.floor is not None
    texture = map_texture(case.recording, trajectory, TextureConfig(cell_size=CELL))
    rows, columns = texture.points.shape
    (x, y, _), shape = texture.origin, (rows + 2 * MARGIN, columns + 2 * MARGIN)
    left, right, bottom, top = texture.extent
    floor = rasterise(case.simulation.scenario.floor, (left, bottom, right, top), CELL, samples=5).values
    seen = seen_cells(case.simulation.frames, (x - MARGIN * CELL, y - MARGIN * CELL), shape, CELL)
    coloured = np.pad(texture.known, MARGIN)
    two_off = np.roll(floor, (2, 0), axis=(0, 1))
    return {
        "share": score_texture(texture.values, floor, texture.known).share,
        "share_two_cells_off": score_texture(texture.values, two_off, texture.known).share,
        "registration_cells": list(registration(texture.values, floor, texture.known)),
        "coloured_of_seen": float((coloured & seen).sum() / seen.sum()),
        "frames": texture.frames,
    }


def main() -> int:
    """Run, and print; 1 where a run crashed."""
    parser = arguments(__doc__)
    parser.add_argument("--preset", default="paper", choices=("paper", "default"))
    options = parser.parse_args()
    seeds = options.seeds or range(1)
    cases = [({"run": "corridor", "seed": seed, "preset": options.preset}, (seed, options.preset)) for seed in seeds]
    return status(benchmark(measure, cases, options))


if __name__ == "__main__":
    sys.exit(main())
