"""Covariances as six numbers against arrays."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.robot import se2
from moteslam.slam.filter import covariance as six


@pytest.fixture
def matrices() -> np.ndarray:
    """Positive definite ones [20, 3, 3], of very different variances."""
    random = np.random.default_rng(0)
    factors = random.normal(size=(20, 3, 3)) * np.array([0.3, 0.02, 0.1])[:, None]
    return factors @ factors.transpose(0, 2, 1) + 1e-6 * np.eye(3)


def test_inverses_sums_and_products_are_those_of_the_arrays(matrices: np.ndarray):
    for one, other in zip(matrices, matrices[::-1], strict=True):
        a, b = six.symmetric(one), six.symmetric(other)
        np.testing.assert_array_equal(six.as_array(a), one)
        np.testing.assert_allclose(six.as_array(six.inverse(a)), np.linalg.inv(one), rtol=1e-6)
        np.testing.assert_allclose(six.as_array(six.plus(a, b, 0.5)), one + other / 2)
        np.testing.assert_allclose(six.as_array(six.plus_diagonal(a, 1, 2, 3)), one + np.diag([1, 2, 3]))
        np.testing.assert_allclose(six.as_array(six.sandwiched(a, b)), one @ other @ one, atol=1e-12)
        largest = np.sqrt(np.linalg.eigvalsh(one[:2, :2])[1])
        assert six.largest_deviation(a) == pytest.approx(largest)


def test_errors_follow_a_motion_as_poses_do(matrices: np.ndarray):
    """Poses drawn about an estimate, all moved alike, are spread about the moved estimate by the moved covariance."""
    random = np.random.default_rng(1)
    small = matrices[0] * 1e-4
    drawn = random.multivariate_normal(np.zeros(3), small, size=50_000)
    motion = np.array([0.4, -0.2, 0.9])
    off = se2.between(motion, se2.compose(drawn, motion))
    expected = six.as_array(six.moved(six.symmetric(small), motion))
    deviations = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        np.cov(off.T) / np.outer(deviations, deviations), expected / np.outer(deviations, deviations), atol=0.03
    )
