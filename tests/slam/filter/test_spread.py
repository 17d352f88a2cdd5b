"""The spread of particles, and which of them descend from which."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.robot import se2
from moteslam.slam.filter.certainty import spread
from moteslam.slam.filter.history import History


@pytest.mark.parametrize("heading", [0.0, 2.0, np.pi])
def test_spread_is_along_and_across_the_mean_heading(heading: float) -> None:
    rng = np.random.default_rng(0)
    deviations = rng.normal(0.0, (0.4, 0.1, 0.05), (20_000, 3))
    poses = se2.compose(np.array((3.0, -7.0, heading)), deviations)
    np.testing.assert_allclose(spread(poses, np.full(len(poses), 1 / len(poses))), (0.4, 0.1, 0.05), rtol=0.02)


def test_weights_count() -> None:
    poses = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (9.0, 9.0, 3.0)])
    np.testing.assert_allclose(spread(poses, np.array((0.5, 0.5, 0.0))), (0.5, 0.0, 0.0), atol=1e-12)


def test_ancestors_are_followed_through_resampling() -> None:
    history = History()
    poses = np.arange(12.0).reshape(4, 3)
    history.append(poses, np.array((0, 0, 2, 2)))
    history.append(poses + 100)
    history.append(poses + 200, np.array((3, 3, 3, 3)))  # after the last update: in nobody's past yet
    ancestors = history.ancestors(np.arange(4))
    np.testing.assert_array_equal(ancestors.T, [(0, 0, 2, 2), (0, 1, 2, 3), (0, 1, 2, 3)])
    paths = history.paths(np.arange(4))
    np.testing.assert_array_equal(paths[:, 0], poses[[0, 0, 2, 2]])
    np.testing.assert_array_equal(paths[:, 2], poses + 200)
