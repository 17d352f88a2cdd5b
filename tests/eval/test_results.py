"""The result folder of a run in memory."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from moteslam.errors import InputError
from moteslam.eval.environment import hardware
from moteslam.eval.results import draw_figures, write_results
from moteslam.eval.scores import score_estimate
from moteslam.robot import se2
from moteslam.robot.formats.map_arrays import read_map_arrays
from moteslam.robot.trajectories.g2o import read_g2o
from moteslam.robot.trajectories.text import read_tum
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.settings import resolve_config


def test_what_is_written_is_what_was_estimated(run, simulation, tmp_path: Path) -> None:
    estimate, _ = run
    scores = write_results(tmp_path, estimate, simulation.truth, figures=False, run={"threads": 2})
    assert scores is not None
    for name, trajectory in (
        ("trajectory", estimate.trajectory),
        ("trajectory_final", estimate.trajectory_final),
        ("dead_reckoning", estimate.dead_reckoning),
        ("truth", simulation.truth),
    ):
        back = read_tum(tmp_path / f"{name}.tum")
        np.testing.assert_array_equal(back.stamps, trajectory.stamps)
        np.testing.assert_array_equal(back.poses[:, :2], trajectory.poses[:, :2])
    assert resolve_config(file=tmp_path / "config.toml") == estimate.config
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["scores"] == scores.as_dict()
    assert metrics["scans"] == len(estimate.trajectory)
    about = json.loads((tmp_path / "run.json").read_text())
    assert (about["seed"], about["threads"]) == (1, 2)
    assert not list(tmp_path.glob("*figure*"))
    assert {file.suffix for file in tmp_path.iterdir()} == {
        *(".tum", ".png", ".pgm", ".yaml", ".json", ".toml", ".csv", ".npz", ".g2o")
    }
    log_odds = read_map_arrays(tmp_path / "map.npz").raster("log_odds")
    assert log_odds.values.tobytes() == estimate.map.values.tobytes()
    assert (log_odds.cell_size, log_odds.origin) == (estimate.map.cell_size, estimate.map.origin)
    graph = read_g2o(tmp_path / "graph.g2o")
    np.testing.assert_array_equal(graph.poses, estimate.graph.poses)
    np.testing.assert_array_equal(graph.information, estimate.graph.information)
    np.testing.assert_array_equal(graph.loops, estimate.graph.loops)


def test_without_truth_there_are_no_scores(run, tmp_path: Path) -> None:
    assert write_results(tmp_path, run[0], figures=False) is None
    assert json.loads((tmp_path / "metrics.json").read_text())["scores"] is None
    assert not (tmp_path / "truth.tum").exists()


def test_a_truth_on_another_clock_writes_nothing(run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no stamps in common"):
        write_results(tmp_path, run[0], Trajectory(np.arange(3.0), np.zeros((3, 3))))
    assert not list(tmp_path.iterdir())


def test_scores_are_small_and_a_robot_at_rest_has_no_drift(run, simulation) -> None:
    estimate, _ = run
    scores = score_estimate(estimate, simulation.truth)
    assert 0 < scores.final.ate.rmse < 0.1
    assert scores.online.rpe_1m is not None
    start = simulation.truth.stamps[0]
    resting = Trajectory(start + np.arange(5) / 10, np.zeros((5, 3)))
    from moteslam.eval.scores import score_trajectory

    assert score_trajectory(resting, simulation.truth).rpe_1m is None


def test_hardware_is_told() -> None:
    found = hardware()
    assert found["cpu"]
    assert found["cores"] >= 1
    assert found["memory_gib"] > 0


def test_an_estimate_holds_the_particles_ancestry_and_spread(run) -> None:
    estimate, _ = run
    paths, ancestors, spread = estimate.particle_paths, estimate.particle_ancestors, estimate.particle_spread
    assert ancestors.shape == paths.shape[:2]
    assert spread.shape == paths.shape[1:]
    assert (spread[0] < 1e-9).all()  # all start at the origin
    assert (spread[-1] > 0).all()
    shared = ancestors == ancestors[0]
    assert (paths[shared] == np.broadcast_to(paths[0], paths.shape)[shared]).all()


def test_the_paths_of_the_picture_begin_at_one_pose(run, simulation, tmp_path: Path, drawn: list[Figure]) -> None:
    """Also where the back end has moved the first scan."""
    estimate, _ = run
    final = estimate.trajectory_final
    moved = Trajectory(final.stamps, np.asarray(se2.compose((0.8, 1.0, -0.1), final.poses)))
    draw_figures(tmp_path, replace(estimate, trajectory_final=moved), simulation.truth, None)
    lines = {str(line.get_label()): line.get_xydata() for line in drawn[0].axes[0].lines}
    for label in ("truth", "dead reckoning", "SLAM (final)"):
        np.testing.assert_allclose(lines[label][0], moved.poses[0, :2], atol=1e-9)
