"""``moteslam convert`` on trajectories: TUM, KITTI, EuRoC and g2o."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from moteslam.eval.cli import main
from moteslam.robot.trajectories import WRITERS, read_trajectory, write_trajectory
from moteslam.robot.trajectories.text import write_g2o
from moteslam.robot.trajectory import PoseGraph, Trajectory

ENDINGS = {name: ending for name, (ending, _) in WRITERS.items()}
STAMPS = 1_300_000_000 + np.arange(40) / 8
PATH = Trajectory(STAMPS, np.column_stack((np.cos(STAMPS), np.sin(STAMPS), np.linspace(-3, 3, 40))))


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, ending in ENDINGS.items():
        write_trajectory(f"{name}{ending}", PATH)


def convert(*arguments: object) -> int:
    return main.run(["convert", *map(str, arguments)])


def test_a_format_that_is_named_and_json(capsys) -> None:
    assert convert("tum.tum", "path.txt", "--to", "euroc", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"out": "path.txt", "format": "euroc", "poses": 40, "distance_m": PATH.length, "warnings": []}
    assert Path("path.txt").read_text().startswith("#timestamp [ns]")


def test_edges_that_are_lost_are_printed(capsys) -> None:
    graph = PoseGraph(
        ids=np.arange(3),
        poses=PATH.poses[:3],
        first=np.array([0, 1]),
        second=np.array([1, 2]),
        relative=np.ones((2, 3)),
        information=np.tile(np.eye(3), (2, 1, 1)),
        stamps=PATH.stamps[:3],
        fixed=np.array([0]),
    )
    write_g2o("graph.g2o", graph)
    assert convert("graph.g2o", "a.tum") == 0
    assert capsys.readouterr().err == "moteslam: warning: graph.g2o: 2 edges not written, no part of a trajectory\n"
    assert convert("graph.g2o", "b.g2o", "--json") == 0
    [issue] = json.loads(capsys.readouterr().out)["warnings"]
    assert (issue["code"], issue["count"]) == ("not-written", 2)


def test_the_poses_are_in_the_plane() -> None:
    """Of a trajectory in space x, y and the heading are kept, as by every command."""
    Path("space.tum").write_text("0 1 2 3 0 0 1 0\n1 4 5 6 0 0 0 1\n")
    assert convert("space.tum", "flat.g2o") == 0
    np.testing.assert_allclose(read_trajectory("flat.g2o").poses, [[1, 2, math.pi], [4, 5, 0]])


def test_heights_that_are_lost_are_printed(capsys) -> None:
    Path("hill.tum").write_text("0 1 2 3 0 0 0 1\n1 4 5 3.5 0 0 0 1\n")
    assert convert("hill.tum", "hill.csv") == 0
    assert "hill.tum: z, which spans 0.50 m, roll and pitch not written" in capsys.readouterr().err
