"""Measured positions: lines P t x y, what is wrong with them, and the error against them by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.metrics.ate import position_error
from moteslam.robot.trajectories.columns import is_positions, read_positions
from moteslam.robot.trajectory import Positions, Trajectory


def write(folder: Path, text: str) -> Path:
    path = folder / "reference.txt"
    path.write_text(text)
    return path


def test_milliseconds_and_millimetres(tmp_path: Path) -> None:
    positions = read_positions(write(tmp_path, "# a comment\nP 378 1850 1897\nM 400 1 2\nP 494 1853 -1897.5\n"))
    np.testing.assert_allclose(positions.stamps, [0.378, 0.494])
    np.testing.assert_allclose(positions.points, [[1.85, 1.897], [1.853, -1.8975]])


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("P 1 2\n", 1),
        ("P 1 2 3\nP 2 nan 3\n", 2),
        ("P 1 2 three\n", 1),
        ("P 5 1 1\nP 4 1 1\n", 2),
        ("M 1 2 3\n", None),
    ],
)
def test_what_is_broken_is_refused_with_its_line(tmp_path: Path, text: str, line: int | None) -> None:
    with pytest.raises(InputError) as caught:
        read_positions(write(tmp_path, text))
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("text", "known"),
    [
        ("P 1 2 3\n", True),
        ("\n# x\nP 1 2 3\n", True),
        ("PARAM 1 2 3\n", False),
        ("P 1 2 3 4\n", False),
        ("1 2 3 0 0 0 0 1\n", False),
        ("", False),
    ],
)
def test_they_are_known_by_the_first_line(tmp_path: Path, text: str, known: bool) -> None:
    assert is_positions(write(tmp_path, text)) is known


DRIVE = Trajectory(np.arange(5.0), np.stack((np.arange(5.0), np.zeros(5), np.full(5, np.pi / 2)), axis=-1))
"""One metre a second along x, looking to y."""


def test_the_estimate_is_interpolated_where_the_positions_were_measured() -> None:
    positions = Positions(np.array([-1.0, 0.5, 2.25]), np.array([[9, 9], [0.5, 0.2], [2.25, 0.0]]))
    result = position_error(DRIVE, positions, align=False)
    np.testing.assert_array_equal(result.stamps, [0.5, 2.25])
    np.testing.assert_allclose(result.errors, [0.2, 0.0], atol=1e-12)


def test_the_point_stands_where_the_mount_says() -> None:
    positions = Positions(np.arange(5.0), np.stack((np.arange(5.0), np.full(5, 0.3)), axis=-1))
    assert position_error(DRIVE, positions, mount=(0.3, 0, 1), align=False).rmse == pytest.approx(0, abs=1e-12)
    assert position_error(DRIVE, positions, align=False).rmse == pytest.approx(0.3)


def test_alignment_and_scale_of_least_squares() -> None:
    stamps = np.arange(5.0)
    bend = np.stack((stamps, stamps**2 / 8), axis=-1)
    drive = Trajectory(stamps, np.column_stack((bend, np.zeros(5))))
    positions = Positions(stamps, 2.0 * np.stack((-bend[:, 1], bend[:, 0]), axis=-1) + (5.0, 1.0))
    scaled = position_error(drive, positions, scale=True)
    assert scaled.rmse == pytest.approx(0, abs=1e-9)
    assert scaled.scale == pytest.approx(2.0)
    assert scaled.transform[2] == pytest.approx(np.pi / 2)
    assert position_error(drive, positions).rmse > 0.5


def test_another_clock_is_refused() -> None:
    positions = Positions(np.array([100.0]), np.zeros((1, 2)))
    with pytest.raises(InputError, match="100"):
        position_error(DRIVE, positions)
