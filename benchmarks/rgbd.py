"""The camera and the coloured floor against their bars; a dated result file.

    python benchmarks/rgbd.py --out result.json

Time: the `corridor` scenario, cut at 120 s, with RGB-D at 30 Hz and no frame lost, simulated and written. Colours: the
same drive with the real robot's lost frames, its floor coloured along the true trajectory and along SLAM's, against the
true floor. Wall times count everything, compiling the kernels too, and say nothing on a machine that does other work:
the load of the machine and the processor time are given beside them.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import tempfile
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from parts.machine import save, stamp
from parts.options import count, folder, result_file

CELL = 0.05
MATERIAL = "tiles"


def processor_seconds() -> float:
    """Processor time of this process since its start [s]."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def speed(folder: Path, seconds: float) -> dict[str, Any]:
    """Simulate and write with every frame at 30 Hz."""
    from moteslam.sim.output import write_simulation
    from moteslam.sim.scenario import load_scenario, with_camera
    from moteslam.sim.simulate import simulate

    scenario = with_camera(load_scenario("corridor"))
    assert scenario.camera is not None
    settings = scenario.camera.model_copy(update={"gap": 0.0})
    scenario = scenario.model_copy(update={"camera": settings, "duration": min(seconds, scenario.duration)})
    load, used, began = os.getloadavg()[0], processor_seconds(), time.perf_counter()
    simulation = simulate(scenario, 0)
    driven = time.perf_counter()
    announced: list[str] = []
    write_simulation(folder, simulation, announce=announced.append)
    ended = time.perf_counter()
    assert simulation.frames is not None
    images = sorted((folder / "dataRGBD").rglob("*.png"))
    return {
        "simulated_s": float(simulation.truth.stamps[-1] - simulation.truth.stamps[0]),
        "images": len(images),
        "bytes": sum(path.stat().st_size for path in images),
        "announced": announced[0],
        "wall_s": ended - began,
        "of_it_drive_and_lidar_s": driven - began,
        "processor_s": processor_seconds() - used,
        "load_before": load,
    }


def colours(folder: Path, preset: str, seed: int) -> dict[str, Any]:
    """Colour the floor along the truth and along SLAM's trajectory, and score both."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.robot.formats import open_recording
    from moteslam.robot.se2 import compose
    from moteslam.robot.trajectory import Trajectory
    from moteslam.sim.output import write_simulation
    from moteslam.sim.scenario import load_scenario, with_camera
    from moteslam.sim.simulate import simulate
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    simulation = simulate(with_camera(load_scenario("corridor")), seed)
    write_simulation(folder, simulation)
    recording = open_recording(folder)
    config = resolve_config(preset, ["texture.enabled=false"])  # coloured below, along two trajectories
    estimate = run_slam(recording, config, seed=seed)
    path = estimate.trajectory_final
    start = simulation.truth.at(path.stamps[:1]).poses[0]
    in_world = Trajectory(path.stamps, compose(start, path.poses))
    return {
        "seed": seed,
        "preset": preset,
        "warnings": list(map(str, recording.warnings)),
        "slam_ate_rmse_m": absolute_trajectory_error(path, simulation.truth).translation.rmse,
        "along_truth": scored(simulation, recording, simulation.truth),
        "along_slam": scored(simulation, recording, in_world),
    }


def scored(simulation: Any, recording: Any, trajectory: Any) -> dict[str, Any]:
    """Colour the floor along a trajectory in the world, and compare it with the true floor."""
    from parts.floor_colours import registration, score_texture
    from parts.visibility import seen_cells

    from moteslam.sim.world.floor import rasterise
    from moteslam.slam.texture.config import TextureConfig
    from moteslam.slam.texture.floor_map import map_texture

    began = time.perf_counter()
    texture = map_texture(recording, trajectory, TextureConfig(cell_size=CELL))
    seconds = time.perf_counter() - began
    rows, columns = texture.points.shape
    margin = 20
    (x, y, _), shape = texture.origin, (rows + 2 * margin, columns + 2 * margin)
    left, right, bottom, top = texture.extent
    floor = rasterise(simulation.scenario.floor, (left, bottom, right, top), CELL, samples=5).values
    seen = seen_cells(simulation.frames, (x - margin * CELL, y - margin * CELL), shape, CELL)
    coloured = np.zeros_like(seen)
    coloured[margin:-margin, margin:-margin] = texture.known
    moved = np.roll(floor, (2, 0), axis=(0, 1))
    return {
        **score_texture(texture.values, floor, texture.known).as_dict(),
        "registration_cells": list(registration(texture.values, floor, texture.known)),
        "share_if_the_floor_were_two_cells_off": score_texture(texture.values, moved, texture.known).share,
        "registration_cells_if_it_were": list(registration(texture.values, moved, texture.known)),
        "cells_seen": int(seen.sum()),
        "coloured_of_seen": float((coloured & seen).sum() / seen.sum()),
        "frames": texture.frames,
        "wall_s": seconds,
        "warnings": list(map(str, texture.warnings)),
    }


def main() -> None:
    """Run, print, and write the result file."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seconds", type=float, default=120.0, help="of the run that is timed")
    parser.add_argument("--seeds", type=count, default=1, help="of the colours, from 0 on")
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--skip-speed", action="store_true")
    parser.add_argument("--folder", type=folder, default=None, help="where the images go for a while; a temporary one")
    parser.add_argument("--out", type=result_file, default=None)
    arguments = parser.parse_args()

    from moteslam.kernels import runtime

    runtime.init("cpu")
    result: dict[str, Any] = {
        **stamp(),
        "opencv": version("opencv-python-headless"),
        "scenario": "corridor",
        "floor": MATERIAL,
        "cell_m": CELL,
    }
    work = Path(tempfile.mkdtemp(dir=arguments.folder))
    try:
        if not arguments.skip_speed:
            (work / "speed").mkdir()
            result["speed"] = speed(work / "speed", arguments.seconds)
            print(json.dumps(result["speed"], indent=2))
            shutil.rmtree(work / "speed")
        result["colours"] = []
        for seed in range(arguments.seeds):
            (work / str(seed)).mkdir()
            result["colours"].append(colours(work / str(seed), arguments.preset, seed))
            print(json.dumps(result["colours"][-1], indent=2))
            shutil.rmtree(work / str(seed))
    finally:
        shutil.rmtree(work, ignore_errors=True)
    save(arguments.out, result)


if __name__ == "__main__":
    main()
