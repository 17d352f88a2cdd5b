"""The result folder of a run, its figures, and reading them back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from moteslam.errors import InputError
from moteslam.eval.results import draw_figures, write_results
from moteslam.eval.runs import read_result_folder
from moteslam.eval.scores import evidence_of, number, score_estimate
from moteslam.robot import se2
from moteslam.robot.raster import read_map_arrays
from moteslam.robot.trajectories.text import read_g2o, read_tum
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.settings import resolve_config


def test_what_is_written_is_what_was_estimated(run, simulation, tmp_path: Path) -> None:
    estimate, _ = run
    figures = write_results(tmp_path, estimate, simulation.truth, figures=False, run={"threads": 2})
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
    assert json.loads((tmp_path / "metrics.json").read_text()) == figures
    assert figures["scans"] == len(estimate.trajectory)
    about = json.loads((tmp_path / "run.json").read_text())
    assert (about["seed"], about["threads"]) == (1, 2)
    assert not list(tmp_path.glob("*figure*"))
    assert {file.suffix for file in tmp_path.iterdir()} == {
        *(".tum", ".png", ".pgm", ".yaml", ".json", ".toml", ".csv", ".npz", ".g2o")
    }
    log_odds = read_map_arrays(tmp_path / "map.npz")
    assert log_odds.values.tobytes() == estimate.map.values.tobytes()
    assert (log_odds.cell_size, log_odds.origin) == (estimate.map.cell_size, estimate.map.origin)
    graph = read_g2o(tmp_path / "graph.g2o")
    np.testing.assert_array_equal(graph.poses, estimate.graph.poses)
    np.testing.assert_array_equal(graph.information, estimate.graph.information)
    np.testing.assert_array_equal(graph.loops, estimate.graph.loops)
    read = read_result_folder(tmp_path)
    assert read.known["final.ate"] == number(figures, "final.ate")
    assert read.scores["final.ate"]["unit"] == "m"
    assert read.scores["map_f1"] == {"absent": "no true map"}
    assert (read.run.scenario, read.run.seed) == (estimate.name, 1)


def test_without_truth_what_needs_it_is_absent(run, tmp_path: Path) -> None:
    figures = write_results(tmp_path, run[0], figures=False)
    assert figures["metrics"]["final.ate"] == {"absent": "no truth"}
    assert number(figures, "effective_particles") > 1
    assert figures["localisation"]["compared"] is None
    assert not (tmp_path / "truth.tum").exists()


def test_a_truth_on_another_clock_writes_nothing(run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no stamps in common"):
        write_results(tmp_path, run[0], Trajectory(np.arange(3.0), np.zeros((3, 3))))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("metrics", "field"),
    [("[", None), ("[]", None), ("{}", "metrics"), ('{"metrics": {"ate": 1}}', "metrics.ate"), (None, None)],
)
def test_a_broken_result_folder_is_refused(tmp_path: Path, metrics: str | None, field: str | None) -> None:
    (tmp_path / "run.json").write_text("{}")
    if metrics is not None:
        (tmp_path / "metrics.json").write_text(metrics)
    with pytest.raises(InputError) as caught:
        read_result_folder(tmp_path)
    assert (caught.value.file, caught.value.field) == (str(tmp_path / "metrics.json"), field)


def test_each_figure_stands_in_one_place_and_is_of_its_trajectory(run, simulation) -> None:
    estimate, _ = run
    true = simulation.truth.at(estimate.trajectory.stamps)
    rng = np.random.default_rng(0)

    def astray(deviation: float) -> Trajectory:
        return Trajectory(true.stamps, true.poses + deviation * rng.normal(size=(len(true), 3)) * (1.0, 1.0, 0.1))

    apart = replace(estimate, trajectory=astray(0.2), trajectory_final=astray(0.05), dead_reckoning=astray(0.8))
    figures = score_estimate(apart, simulation.truth)
    errors = [number(figures, f"{name}.ate") for name in ("online", "final", "dead_reckoning")]
    assert errors == pytest.approx(np.sqrt(2) * np.array([0.2, 0.05, 0.8]), rel=0.1)
    ate = evidence_of(apart, simulation.truth).track("final").ate.translation.as_dict()
    found = figures["metrics"]["final.ate"] | {"rmse": errors[1], "max": number(figures, "final.ate_max")}
    assert all(found[name] == ate[name] for name in ("rmse", "mean", "std", "min", "max", "count"))
    values = [value for value in _leaves(figures) if isinstance(value, float) and not value.is_integer()]
    assert len(values) == len(set(values))


def _leaves(value: object) -> list[object]:
    if isinstance(value, dict):
        return [leaf for below in value.values() for leaf in _leaves(below)]
    return [leaf for below in value for leaf in _leaves(below)] if isinstance(value, list) else [value]


def test_the_paths_of_the_picture_begin_at_one_pose(run, simulation, tmp_path: Path, drawn: list[Figure]) -> None:
    """Also where the back end has moved the first scan."""
    estimate, _ = run
    final = estimate.trajectory_final
    moved = Trajectory(final.stamps, np.asarray(se2.compose((0.8, 1.0, -0.1), final.poses)))
    apart = replace(estimate, trajectory_final=moved)
    draw_figures(tmp_path, apart, evidence_of(apart, simulation.truth))
    lines = {str(line.get_label()): line.get_xydata() for line in drawn[0].axes[0].lines}
    for label in ("truth", "dead reckoning", "SLAM (final)"):
        np.testing.assert_allclose(lines[label][0], moved.poses[0, :2], atol=1e-9)
