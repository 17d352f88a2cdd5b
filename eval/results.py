"""The result folder: trajectories, map, figures, scores, and all that is needed to run it again."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.eval.diagnostics_table import localisation_summary, write_diagnostics
from moteslam.eval.environment import hardware
from moteslam.eval.loop_table import looks_for_loops, loop_counts, write_loops
from moteslam.eval.metrics.registry import Value, measure
from moteslam.eval.particle_table import write_particles
from moteslam.eval.report.maps import log_odds_arrays, write_map_png, write_map_server
from moteslam.eval.report.snapshots import Snapshot
from moteslam.eval.report.textures import draw_texture_over_time, texture_arrays, write_texture
from moteslam.eval.scores import Scores, evidence_of, score_estimate
from moteslam.robot.files import make_folder, write_atomically
from moteslam.robot.formats.map_arrays import write_map_arrays
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import Poses, between, compose
from moteslam.robot.trajectories.g2o import write_g2o
from moteslam.robot.trajectories.text import write_tum
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import expect_type
from moteslam.slam.estimate import Estimate
from moteslam.slam.texture.floor_map import TextureMap

GRAPH_COMMENTS = (
    "pose graph of moteslam: final poses, and the relative poses that were measured, with their information",
    "edges between consecutive ids are the chain, all others loops that were accepted",
)
"""What ``graph.g2o`` begins with."""


def write_results(
    folder: str | PathLike[str],
    estimate: Estimate,
    truth: Trajectory | None = None,
    *,
    recording: Recording | None = None,
    true_map: Raster | None = None,
    snapshots: Sequence[Snapshot] = (),
    stages: Sequence[tuple[float, TextureMap]] = (),
    figures: bool = True,
    run: Mapping[str, Any] | None = None,
) -> Scores | None:
    """Fill a result folder (its files: ``docs/reference/formats.md``).

    Args:
        folder: made if need be; files in it are replaced.
        estimate: what to write.
        truth: what to score it with, on the clock of the recording; it is written too.
        recording: whose scans are drawn along dead reckoning, and show which loops are possible and which walls seen.
        true_map: trinary, in the frame of the truth, to score the map with.
        snapshots: of the map over time, for the figure that shows it.
        stages: of the coloured floor over time, likewise.
        figures: draw them.
        run: more about the run for ``run.json``: the command, threads, times.

    Returns:
        the scores, None without truth.

    Raises:
        OutputError: a file cannot be written.
        InputError: the truth has no stamps in common with the run.
    """
    expect_type(estimate, Estimate, "estimate", "run_slam(recording) makes one")
    folder = Path(folder)
    make_folder(folder)
    scores = None if truth is None else score_estimate(estimate, truth, recording=recording, true_map=true_map)
    values = measure(evidence_of(estimate)) if scores is None else scores.values
    write_tum(folder / "trajectory.tum", estimate.trajectory)
    write_tum(folder / "trajectory_final.tum", estimate.trajectory_final)
    write_tum(folder / "dead_reckoning.tum", estimate.dead_reckoning)
    if truth is not None:
        write_tum(folder / "truth.tum", truth)
    write_diagnostics(folder / "diagnostics.csv", estimate)
    write_map_png(folder / "map.png", estimate.map)
    write_map_server(folder / "map.pgm", estimate.map)
    write_map_arrays(folder / "map.npz", log_odds_arrays(estimate.map))
    if estimate.texture is not None:
        write_texture(folder / "texture.png", estimate.texture)
        write_map_arrays(folder / "texture.npz", texture_arrays(estimate.texture))
    if len(estimate.particle_stamps):
        write_particles(folder / "particles.npz", estimate)
    looked = looks_for_loops(estimate.config)
    if looked:
        write_loops(folder / "loops.csv", estimate.loops)
    if estimate.graph is not None:
        write_g2o(folder / "graph.g2o", estimate.graph, comments=GRAPH_COMMENTS)
    write_json(folder / "metrics.json", _metrics(estimate, scores, values))
    write_atomically(folder / "config.toml", estimate.config.to_toml())
    if figures:
        draw_figures(folder, estimate, truth, scores, recording=recording, snapshots=snapshots)
        if stages:
            draw_texture_over_time(
                folder / "texture_over_time.png",
                stages,
                estimate.map,
                trajectory=estimate.trajectory_final,
                title=f"{estimate.name}: map and coloured floor over time",
            )
    issues = (*(() if recording is None else recording.warnings), *estimate.warnings)
    about = {
        "recording": estimate.name,
        "seed": estimate.seed,
        "filter_and_back_end_seconds": estimate.seconds,
        "warnings": [issue.as_dict() for issue in issues],
        "localisation": localisation_summary(estimate),
        **({"loops": loop_counts(estimate.loops)} if looked else {}),
    }
    versions = {"python": platform.python_version(), **estimate.versions}
    write_json(folder / "run.json", {**about, **(run or {}), "versions": versions, "hardware": hardware()})
    return scores


def draw_figures(
    folder: Path,
    estimate: Estimate,
    truth: Trajectory | None,
    scores: Scores | None,
    *,
    recording: Recording | None = None,
    snapshots: Sequence[Snapshot] = (),
) -> None:
    """Draw the figures of a run into a folder.

    Raises:
        OutputError: one cannot be written.
    """
    from moteslam.eval.report import curves, loops, particles, plans
    from moteslam.eval.report.cloud import Cloud

    name = estimate.name
    plans.draw_trajectories(
        folder / "trajectories.png",
        estimate.map,
        slam=estimate.trajectory_final,
        dead_reckoning=_begun_at(estimate.trajectory_final.poses[0], estimate.dead_reckoning),
        truth=None if truth is None else from_same_start(truth, estimate.trajectory_final),
        title=f"{name}: the map and the paths on it",
    )
    if snapshots:
        plans.draw_over_time(
            folder / "over_time.png",
            snapshots,
            trajectory=estimate.trajectory,
            title=f"{name}: trajectory and map over time",
        )
    plans.draw_dead_reckoning(
        folder / "dead_reckoning.png",
        estimate.dead_reckoning,
        recording=recording,
        truth=None if truth is None else from_same_start(truth, estimate.dead_reckoning),
        title=f"{name}: dead reckoning",
    )
    if estimate.loops:
        loops.draw_loops(
            folder / "loops.png",
            estimate.map,
            estimate.loops,
            trajectory=estimate.trajectory_final,
            title=f"{name}: loops on the map",
        )
    if len(estimate.particle_stamps):
        particles.draw_particles(folder / "particles.png", Cloud.of(estimate), title=f"{name}: particles")
        updated = estimate.diagnostics["updated"] > 0
        curves.draw_effective_particles(
            folder / "effective_particles.png",
            estimate.trajectory.stamps[updated],
            estimate.diagnostics["n_eff"][updated],
            estimate.diagnostics["resampled"][updated],
            particles=estimate.diagnostics["particles"][updated],
            title=f"{name}: effective number of particles",
        )
    if scores is not None:
        curves.draw_error(
            folder / "error.png",
            slam=scores.online.ate,
            final=scores.final.ate,
            dead_reckoning=scores.dead_reckoning.ate,
            title=f"{name}: error over time, after alignment",
        )


def from_same_start(truth: Trajectory, trajectory: Trajectory) -> Trajectory:
    """The truth over the time of a trajectory, moved so that both start at the same pose: how they part is drift."""
    first, last = trajectory.stamps[[0, -1]]
    within = (truth.stamps > first) & (truth.stamps < last)
    return _begun_at(trajectory.poses[0], truth.at(np.concatenate(([first], truth.stamps[within], [last]))))


def _begun_at(pose: Poses, trajectory: Trajectory) -> Trajectory:
    """A trajectory, moved so that it starts at a pose [3]."""
    return Trajectory(trajectory.stamps, compose(pose, between(trajectory.poses[0], trajectory.poses)))


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write JSON that any reader takes.

    Raises:
        OutputError: it cannot be written.
    """
    write_atomically(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def _metrics(estimate: Estimate, scores: Scores | None, values: Mapping[str, Value]) -> dict[str, Any]:
    stamps = estimate.trajectory.stamps
    return {
        "scans": len(stamps),
        "duration_s": float(stamps[-1] - stamps[0]),
        "distance_m": estimate.trajectory_final.length,
        "updates": int(estimate.diagnostics["updated"].sum()),
        "resampled": int(estimate.diagnostics["resampled"].sum()),
        "mean_particles": float(estimate.diagnostics["particles"].mean()),
        "mean_effective_particles": float(estimate.diagnostics["n_eff"].mean()),
        "localisation": localisation_summary(estimate),
        "scores": None if scores is None else scores.as_dict(),
        "metrics": {name: value.as_dict() for name, value in values.items()},
    }
