"""Trajectories."""

import numpy as np
import pytest
from trajectory_cases import made

from moteslam.robot.trajectory import Trajectory


def test_length_and_interpolation() -> None:
    trajectory = Trajectory(np.arange(3.0), np.array([[0.0, 0, 0], [3, 4, 0], [3, 5, 1]]))
    assert trajectory.length == pytest.approx(6.0)
    assert len(trajectory) == 3
    np.testing.assert_allclose(trajectory.at(np.array([0.5, 7.0])).poses, [[1.5, 2, 0], [3, 5, 1]])


def test_arrays_are_frozen() -> None:
    with pytest.raises(ValueError, match="read-only"):
        made().poses[0, 0] = 1
