"""The particles of the TSDF filter: whom a path descends from after resampling, and which mode the best one is of."""

from __future__ import annotations

import numpy as np
import pytest
from tile_pools import room_scan, thinned

from moteslam.slam.filter.weights import Weights
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.tsdf.particles import Particles

pytestmark = pytest.mark.usefixtures("taichi")


def test_paths_follow_the_parents_that_resampling_chose():
    particles = Particles(3, TsdfConfig())
    particles.start(thinned(room_scan()))
    first, second = np.array([(1.0, 0, 0), (2.0, 0, 0), (3.0, 0, 0)]), np.array([(4.0, 0, 0), (5.0, 0, 0), (6.0, 0, 0)])
    particles.move_to(first)
    particles.weights = Weights(np.log([0.1, 0.3, 0.6]))
    particles.resample(np.array([1, 2, 2]))
    np.testing.assert_array_equal(particles.poses, first[[1, 2, 2]])
    np.testing.assert_allclose(particles.weights.values, 1 / 3)
    assert particles.best in (1, 2)  # both descend from the heaviest
    particles.move_to(second)
    np.testing.assert_array_equal(
        particles.history.paths(np.arange(3))[..., 0], [(0.0, 2.0, 4.0), (0.0, 3.0, 5.0), (0.0, 3.0, 6.0)]
    )
