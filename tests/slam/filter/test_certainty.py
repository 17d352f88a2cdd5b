"""States by standard deviations, and the certainty of particles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from moteslam.slam.filter.certainty import (
    FLOOR,
    LocalisationState,
    certainty_of,
    certainty_of_particles,
    state_of,
    wrong_by_spread,
)
from moteslam.slam.mapping.config import LOST_DISTANCE, LOST_ROTATION

SURE, DOUBTFUL, LOST = LocalisationState


@pytest.mark.parametrize(
    ("position", "heading", "state"),
    [
        (0.0, 0.0, SURE),
        (0.01, 0.002, SURE),
        (LOST_DISTANCE / 2.1, 0.002, SURE),  # beyond 2.1 standard deviations are 3.6 %
        (LOST_DISTANCE / 1.9, 0.002, DOUBTFUL),
        (LOST_DISTANCE / 0.7, 0.002, DOUBTFUL),
        (LOST_DISTANCE / 0.6, 0.002, LOST),  # beyond 0.6 standard deviations are 55 %
        (0.01, LOST_ROTATION / 1.9, DOUBTFUL),
        (0.01, LOST_ROTATION / 0.6, LOST),
    ],
)
def test_a_pose_is_doubted_by_the_probability_that_it_is_wrong(position: float, heading: float, state):
    assert state_of(wrong_by_spread(position, heading)) is state


def test_a_pose_is_wrong_by_its_spread_or_by_its_fit():
    small, large = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4), (0.09, 0.0, 0.0, 1e-4, 0.0, 1e-4)
    assert certainty_of(small, math.nan, 0.0).wrong == pytest.approx(0.0, abs=1e-6)
    assert certainty_of(small, math.nan, 0.2).wrong == pytest.approx(0.2)
    by_spread = math.erfc(1 / math.sqrt(2))  # beyond one standard deviation
    assert certainty_of(large, math.nan, 0.0).wrong == pytest.approx(by_spread, abs=1e-6)
    assert certainty_of(large, math.nan, 0.5).wrong == pytest.approx(1 - 0.5 * (1 - by_spread), abs=1e-6)
    assert certainty_of(large, math.nan, 0.5).state is LOST


def test_particles_give_their_covariance_in_the_frame_of_the_pose():
    """They are spread along the map's x; the robot looks along its y, so that this is to its sides."""
    poses = np.array([[-1.0, 0, np.pi / 2], [1.0, 0, np.pi / 2]])
    found = certainty_of_particles(poses, np.full(2, 0.5), np.array([0, 0, np.pi / 2]))
    np.testing.assert_allclose(found.covariance, np.diag([0, 1.0, 0]) + np.diag((FLOOR[0], *FLOOR)), atol=1e-12)
    assert math.isnan(found.degenerate)
    assert found.state is LOST
