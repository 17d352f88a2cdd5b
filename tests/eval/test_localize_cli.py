"""`moteslam localize`: a map in, a result folder in its frame out; what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_lines import printed, refused

from moteslam.eval.cli.simulate import scenario_of
from moteslam.robot.formats.map_server import write_map
from moteslam.robot.trajectories.text import read_tum
from moteslam.sim.output import write_simulation
from moteslam.sim.simulate import Simulation, simulate


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive with its truth, and the true map beside it."""
    folder = tmp_path_factory.mktemp("drive")
    simulation: Simulation = simulate(scenario_of("corridor", 200, platform="turtlebot3", duration=15.0), 200)
    write_simulation(folder / "log", simulation)
    write_map(folder / "map.pgm", simulation.true_map(0.05))
    return folder


@pytest.mark.slow
def test_poses_are_in_the_frame_of_the_map_which_does_not_change(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found"
    printed(capsys, "localize", drive / "log", "--map", drive / "map.yaml", "--out", out)
    found, truth = read_tum(out / "trajectory.tum"), read_tum(drive / "log" / "truth.tum")
    at = np.searchsorted(truth.stamps, found.stamps).clip(max=len(truth) - 1)
    assert np.abs(found.poses[:, :2] - truth.poses[at, :2]).max() < 0.1
    assert (out / "map.pgm").read_bytes() == (drive / "map.pgm").read_bytes()
    assert json.loads((out / "metrics.json").read_text())["localisation"]["states"]["lost"] == 0
    # a result folder is a map, too
    printed(capsys, "localize", drive / "log", "--map", out, "--out", tmp_path / "again", "--no-figures")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--map", "nowhere.yaml"), "nowhere.yaml"),
        (("--map", "map.pgm"), "map.pgm"),
        (("--map", "map.yaml", "--preset", "default"), "--set known_map"),
        (("--map", "map.yaml", "--near", "0", "0", "0", "x"), "--near"),
    ],
)
def test_bad_input_is_one_line(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], says: str
) -> None:
    words = [drive / word if word.startswith(("nowhere", "map.")) else word for word in arguments]
    assert says in refused(capsys, "localize", drive / "log", *words, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
