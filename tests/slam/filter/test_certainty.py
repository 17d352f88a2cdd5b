"""States by standard deviations, and the certainty of particles."""

import math

import numpy as np
import pytest

from moteslam.robot import se2
from moteslam.slam.filter import covariance as six
from moteslam.slam.filter.certainty import (
    FLOOR,
    LocalisationState,
    certainty_of,
    certainty_of_particles,
    spread,
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


@pytest.mark.parametrize("heading", [0.0, 2.0, np.pi])
def test_spread_is_along_and_across_the_mean_heading(heading: float) -> None:
    rng = np.random.default_rng(0)
    deviations = rng.normal(0.0, (0.4, 0.1, 0.05), (20_000, 3))
    poses = se2.compose(np.array((3.0, -7.0, heading)), deviations)
    np.testing.assert_allclose(spread(poses, np.full(len(poses), 1 / len(poses))), (0.4, 0.1, 0.05), rtol=0.02)
    of_weight = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (9.0, 9.0, 3.0)])
    np.testing.assert_allclose(spread(of_weight, np.array((0.5, 0.5, 0.0))), (0.5, 0.0, 0.0), atol=1e-12)


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
