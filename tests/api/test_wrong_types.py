"""A value of the wrong type is refused in words at the public functions, not deep in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import moteslam
from moteslam import InputError, MoteslamError, Recording, Trajectory

PATH = moteslam.Trajectory(np.arange(3.0), np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: moteslam.run_slam("log"),
            "recording: str 'log', expected a Recording: open_recording(path) reads one",
        ),
        (lambda: moteslam.dead_reckon(3), "recording: int 3, expected a Recording"),
        (lambda: moteslam.inspect_recording("log"), "recording: str 'log', expected a Recording"),
        (lambda: moteslam.write_carmen("x.log", PATH), "recording: Trajectory, expected a Recording"),
        (lambda: moteslam.write_ucsd(".", PATH, sequence=1), "recording: Trajectory, expected a Recording"),
        (lambda: moteslam.simulate("corridor"), "scenario: str 'corridor', expected a Scenario: load_scenario(name)"),
        (lambda: moteslam.write_simulation("x", PATH), "simulation: Trajectory, expected a Simulation"),
        (lambda: moteslam.write_results("x", PATH), "estimate: Trajectory, expected an Estimate: run_slam(recording)"),
        (lambda: moteslam.score_estimate(PATH, PATH), "estimate: Trajectory, expected an Estimate"),
        (lambda: moteslam.absolute_trajectory_error("a.tum", PATH), "estimate: str 'a.tum', expected a Trajectory"),
        (lambda: moteslam.relative_pose_error(PATH, np.zeros((3, 3))), "reference: ndarray, expected a Trajectory"),
        (lambda: moteslam.evaluate_relations(PATH, PATH), "relations: Trajectory, expected a Relations"),
        (lambda: moteslam.write_tum("x.tum", np.zeros((3, 3))), "trajectory: ndarray, expected a Trajectory"),
        (lambda: moteslam.resolve_config(None), "preset: NoneType, expected a str: one of default, paper"),  # type: ignore[arg-type]
        (
            lambda: moteslam.resolve_config("paper", "particles=3"),
            "settings: 'particles=3', expected a list of key=value",
        ),
        (lambda: moteslam.simulate(moteslam.load_scenario("corridor"), seed="0"), "seed: '0', expected a whole number"),
        (
            lambda: moteslam.run_slam(Recording("x", moteslam.Platform()), seed=1.5),
            "seed: 1.5, expected a whole number",
        ),  # type: ignore[arg-type]
        (lambda: moteslam.load_scenario(3), "name_or_path: int 3, expected the path of a scenario"),  # type: ignore[arg-type]
        (lambda: moteslam.open_recording(3), "path: int 3, expected the path of a recording"),  # type: ignore[arg-type]
        (lambda: Recording("x", None), "platform: NoneType, expected a Platform"),  # type: ignore[arg-type]
        (lambda: Recording("x", moteslam.Platform(), lidar="l"), "lidar: str 'l', expected a LidarStream"),  # type: ignore[arg-type]
        (lambda: Trajectory([1.0, 0.0], np.zeros((2, 3))), "stamps: stamps go back, expected rising seconds"),  # type: ignore[arg-type]
        (lambda: Trajectory("now", [[0, 0, 0]]), "str 'now', expected an array of numbers"),  # type: ignore[arg-type]
        (lambda: Trajectory([0.0, 1.0], [[0, 0], [0]]), "list [[0, 0], [0]], expected an array of numbers"),  # type: ignore[arg-type]
    ],
)
def test_the_line_names_parameter_type_and_what_makes_one(
    call: Callable[[], Any], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MoteslamError) as caught:
        call()
    assert str(caught.value).startswith(words)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_configuration_is_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = Recording("empty", moteslam.Platform())
    with pytest.raises(InputError, match=r"config: str 'paper', expected a SlamConfig: load_preset\(\) gives one"):
        moteslam.run_slam(recording, "paper")  # type: ignore[arg-type]


def test_results_and_simulations_make_their_folder(tmp_path: Path, taichi: None) -> None:
    scenario = moteslam.load_scenario("corridor").model_copy(update={"duration": 12.0})
    simulation = moteslam.simulate(scenario)
    moteslam.write_simulation(tmp_path / "a" / "recording", simulation)
    estimate = moteslam.run_slam(simulation.recording, moteslam.resolve_config("paper", ["particles=3"]))
    moteslam.write_results(tmp_path / "b" / "result", estimate, simulation.truth, figures=False)
    assert moteslam.read_tum(tmp_path / "b" / "result" / "truth.tum").poses.shape == simulation.truth.poses.shape
    assert moteslam.open_recording(tmp_path / "a" / "recording").lidar is not None
