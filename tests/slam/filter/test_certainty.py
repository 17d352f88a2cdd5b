"""How sure a filter is: by standard deviations, by its particles, and by how the scans fit the map as before."""

import math

import numpy as np
import pytest

from moteslam.robot import se2
from moteslam.slam.filter import covariance as six
from moteslam.slam.filter.certainty import (
    DOUBTFUL_DROP,
    FLOOR,
    LEAST_SPREAD,
    LOST_DROP,
    NEIGHBOURHOOD,
    LocalisationState,
    Misfit,
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
    assert state_of(certainty_of(large, math.nan, 0.5).wrong) is LOST


def test_particles_give_their_covariance_in_the_frame_of_the_pose():
    """They are spread along the map's x; the robot looks along its y, so that this is to its sides."""
    poses = np.array([[-1.0, 0, np.pi / 2], [1.0, 0, np.pi / 2]])
    found = certainty_of_particles(poses, np.full(2, 0.5), np.array([0, 0, np.pi / 2]))
    np.testing.assert_allclose(found.covariance, np.diag([0, 1.0, 0]) + np.diag((FLOOR[0], *FLOOR)), atol=1e-12)
    assert math.isnan(found.degenerate)
    assert state_of(found.wrong) is LOST


@pytest.mark.parametrize("heading", [0.0, 2.0, np.pi])
def test_spread_is_along_and_across_the_mean_heading(heading: float) -> None:
    rng = np.random.default_rng(0)
    deviations = rng.normal(0.0, (0.4, 0.1, 0.05), (20_000, 3))
    poses = se2.compose(np.array((3.0, -7.0, heading)), deviations)
    np.testing.assert_allclose(spread(poses, np.full(len(poses), 1 / len(poses))), (0.4, 0.1, 0.05), rtol=0.02)
    of_weight = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (9.0, 9.0, 3.0)])
    np.testing.assert_allclose(spread(of_weight, np.array((0.5, 0.5, 0.0))), (0.5, 0.0, 0.0), atol=1e-12)


def test_errors_follow_a_motion_as_poses_do():
    """Poses drawn about an estimate, all moved alike, are spread about the moved estimate by the moved covariance."""
    random = np.random.default_rng(1)
    factor = 1e-2 * random.normal(size=(3, 3)) * np.array([0.3, 0.02, 0.1])[:, None]
    small = factor @ factor.T
    assert six.largest_deviation(six.symmetric(small)) == pytest.approx(np.linalg.eigvalsh(small[:2, :2])[1] ** 0.5)
    drawn = random.multivariate_normal(np.zeros(3), small, size=50_000)
    motion = np.array([0.4, -0.2, 0.9])
    off = se2.between(motion, se2.compose(drawn, motion))
    expected = six.as_array(six.moved(six.symmetric(small), motion))
    deviations = np.sqrt(np.diag(expected))
    scale = np.outer(deviations, deviations)
    np.testing.assert_allclose(np.cov(off.T) / scale, expected / scale, atol=0.03)


STEP = 0.25
DOUBTFUL_BELOW, LOST_BELOW = DOUBTFUL_DROP * LEAST_SPREAD, LOST_DROP * LEAST_SPREAD
"""Where the scores before were all the same."""


class Drive:
    """A robot that drives straight on, 0.25 m a scan; every scan is an update."""

    def __init__(self) -> None:
        self.misfit, self.x = Misfit(), 0.0

    def on(self, distance: float, score: float, *, back: bool = False) -> list[LocalisationState]:
        states = []
        for _ in range(round(distance / STEP)):
            self.x += -STEP if back else STEP
            self.misfit.observe(STEP, score)
            self.misfit.update((self.x, 0.0, 0.0))
            states.append(self.misfit.state)
        return states


FIT, DOUBTFUL_DROPPED, LOST_DROPPED = (10, 1.0), (STEP, 1.0 - 1.1 * DOUBTFUL_BELOW), (STEP, 1.0 - 1.1 * LOST_BELOW)
"""Distances [m], and the scores on them."""
NEAR, BEYOND = (NEIGHBOURHOOD - STEP, 0.85), (1 + STEP, 0.85)
"""While something around is from before the drop; and as far again as nothing is."""
VARIED = [(STEP, score) for _ in range(100) for score in (1.1, 0.9)]  # With a standard deviation of 0.1


@pytest.mark.parametrize(
    ("legs", "states"),
    [
        ([(8, 1.0), (8, 1.0 - 0.9 * DOUBTFUL_BELOW), (8, 1.1)], [SURE] * 3),
        ([(3, score) for score in np.arange(1.0, 0.3, -0.05)], [SURE] * 14),
        ([*VARIED, (STEP, 1.0 - 1.5 * LOST_BELOW), (STEP, 1.0 - 1.2 * LOST_DROP * 0.1)], [SURE, DOUBTFUL, LOST]),
        ([FIT, DOUBTFUL_DROPPED, (NEIGHBOURHOOD, 1.0), (1, 1.0)], [SURE, DOUBTFUL, DOUBTFUL, SURE]),
        ([FIT, LOST_DROPPED, NEAR, BEYOND], [SURE, LOST, LOST, SURE]),
        ([FIT, LOST_DROPPED, (-9, 0.85)], [SURE, LOST, LOST]),
        ([FIT, LOST_DROPPED, (-9, 1.0)], [SURE, LOST, SURE]),
    ],
    ids=[
        "hardly changed", "changed little by little", "varied before", "a small drop, until the map around is new",
        "a large one, until nothing around is from before", "and back among old scans", "which fit again",
    ],
)  # fmt: skip
def test_states_at_the_ends_of_the_last_legs(legs: list[tuple[float, float]], states: list[LocalisationState]):
    drive = Drive()
    found = [drive.on(abs(distance), score, back=distance < 0)[-1] for distance, score in legs]
    assert found[-len(states) :] == states


def test_corrected_poses_replace_those_before():
    """The back end moves the old part of the path far away: nothing around the robot is from before any more."""
    drive = Drive()
    drive.on(10, 1.0)
    drive.on(STEP, 1.0 - 1.1 * LOST_BELOW)
    drive.on(NEIGHBOURHOOD + 1, 0.85, back=True)
    assert drive.misfit.state is LOST
    updates = round((10 + STEP + NEIGHBOURHOOD + 1) / STEP)
    poses = np.zeros((updates, 3))
    poses[: round(10 / STEP), 0] = 100.0
    drive.misfit.revise(poses)
    assert drive.on(STEP, 0.85)[-1] is SURE
