"""The figure of the loops: which are drawn, between which poses, and what its legend counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from figures import legend_of
from loop_candidates import candidate
from matplotlib.figure import Figure

from moteslam.eval.report.maps import ACCEPTED, REJECTED, draw_loops
from moteslam.robot.raster import Raster
from moteslam.robot.trajectory import Trajectory

LOOPS = (
    candidate(0, 6),
    candidate(1, 7),
    candidate(2, 8, verdict="ambiguous"),
    candidate(2, 9, verdict="weak"),
    candidate(3, 9, verdict="weak"),
)
PATH = Trajectory(np.arange(10.0), np.stack((np.arange(10.0), np.arange(10.0) % 3, np.zeros(10)), axis=-1))
MAP = Raster(np.ones((30, 40), np.float32), 0.25, (0.0, -1.0, 0.0))


def ends(figure: Figure, colour: str) -> np.ndarray:
    """Both ends [n, 2, 2] of every line of a colour."""
    line = next(line for line in figure.axes[0].lines if line.get_color() == colour)
    points = np.asarray(line.get_xydata()).reshape(-1, 3, 2)
    assert np.isnan(points[:, 2]).all()
    return points[:, :2]


def test_loops_join_the_final_poses_of_their_scans(tmp_path: Path, drawn: list[Figure]) -> None:
    draw_loops(tmp_path / "loops.png", MAP, LOOPS, trajectory=PATH, title="$x_")
    figure = drawn[0]
    assert ends(figure, ACCEPTED).tolist() == [[[0, 0], [6, 0]], [[1, 1], [7, 1]]]
    assert ends(figure, REJECTED).tolist() == [[[2, 2], [8, 2]]]
    assert figure.axes[0].get_aspect() == 1.0
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("x [m]", "y [m]")
    assert legend_of(figure) == [
        *(
            "SLAM (final)",
            "accepted: 2",
            "rejected: 0 overruled, 0 contradicted, 1 ambiguous",
            "not drawn: 2 weak",
            "start",
            "end",
        ),
    ]


@pytest.mark.parametrize("verdict", ["accepted", "weak"])
def test_a_single_candidate_can_be_drawn(tmp_path: Path, drawn: list[Figure], verdict) -> None:
    draw_loops(tmp_path / "loops.png", MAP, [candidate(0, 6, verdict=verdict)], trajectory=PATH)
    assert len(ends(drawn[0], ACCEPTED)) == (verdict == "accepted")
    assert (tmp_path / "loops.png").stat().st_size > 1000
