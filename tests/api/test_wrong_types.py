"""A value of the wrong type is refused in one line at the public functions, not deep in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import moteslam
from moteslam import MoteslamError, Platform, Recording, Trajectory

PATH = Trajectory(np.arange(3.0), np.zeros((3, 3)))
EMPTY = Recording("empty", Platform())


@pytest.mark.parametrize(
    ("call", "parameter"),
    [
        (lambda: moteslam.run_slam("log"), "recording"),
        (lambda: moteslam.run_slam(EMPTY, seed=1.5), "seed"),
        (lambda: moteslam.run_slam(EMPTY, "paper"), "config"),
        (lambda: moteslam.write_carmen("x.log", PATH), "recording"),
        (lambda: moteslam.simulate("corridor"), "scenario"),
        (lambda: moteslam.write_simulation("x", PATH), "simulation"),
        (lambda: moteslam.write_results("x", PATH), "estimate"),
        (lambda: moteslam.score_estimate(PATH, PATH), "estimate"),
        (lambda: moteslam.absolute_trajectory_error("a.tum", PATH), "estimate"),
        (lambda: moteslam.relative_pose_error(PATH, np.zeros((3, 3))), "reference"),
        (lambda: moteslam.write_tum("x.tum", np.zeros((3, 3))), "trajectory"),
        (lambda: moteslam.resolve_config("paper", "particles=3"), "settings"),
        (lambda: Recording("x", Platform(), lidar="l"), "lidar"),
        (lambda: Trajectory([1.0, 0.0], np.zeros((2, 3))), "stamps"),
        (lambda: Trajectory([0.0, 1.0], [[0, 0], [0]]), None),
    ],
)
def test_the_line_names_the_parameter(
    call: Callable[[], Any], parameter: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MoteslamError) as caught:
        call()
    assert caught.value.field == parameter
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_results_and_simulations_make_their_folder(tmp_path: Path, taichi: None):
    scenario = moteslam.load_scenario("corridor").model_copy(update={"duration": 12.0})
    simulation = moteslam.simulate(scenario)
    moteslam.write_simulation(tmp_path / "a" / "recording", simulation)
    estimate = moteslam.run_slam(simulation.recording, moteslam.resolve_config("paper", ["particles=3"]))
    moteslam.write_results(tmp_path / "b" / "result", estimate, simulation.truth, figures=False)
    assert moteslam.read_tum(tmp_path / "b" / "result" / "truth.tum").poses.shape == simulation.truth.poses.shape
    assert moteslam.open_recording(tmp_path / "a" / "recording").lidar is not None
