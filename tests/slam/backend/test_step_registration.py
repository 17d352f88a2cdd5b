"""The registration of one step: the headings it begins at, and what may overrule the odometry."""

import numpy as np
import pytest

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.slam.backend.graph import step_registration
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.step_registration import Prediction, StepRegistration
from moteslam.slam.inputs.step import thin
from moteslam.slam.registration.registrar import Registration

pytestmark = pytest.mark.usefixtures("taichi")

CORNERS = np.array(
    [(-9, -2), (-9, 1), (-4, 1), (-4, 6), (7, 6), (7, 3.5), (4, 3.5), (4, -3), (-1, -3), (-1, -2)], float
)
WALLS = np.stack((CORNERS, np.roll(CORNERS, -1, axis=0)), axis=1)
TRUE_STEP = np.array([0.6, 0.1, -0.4])


def scan(pose: np.ndarray) -> ThinnedScan:
    """180 beams all around from a place in a room of many corners."""
    bearings = np.radians(np.arange(0, 360, 2))
    beams = np.column_stack((np.cos(bearings + pose[2]), np.sin(bearings + pose[2])))
    first, along = WALLS[:, 0] - pose[:2], WALLS[:, 1] - WALLS[:, 0]
    across = beams[:, None, 0] * along[:, 1] - beams[:, None, 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = (first[:, 0] * along[:, 1] - first[:, 1] * along[:, 0]) / across
        share = (first[:, 0] * beams[:, None, 1] - first[:, 1] * beams[:, None, 0]) / across
    ranges = np.where((ranges > 0) & (share >= 0) & (share <= 1), ranges, np.inf).min(axis=1)
    points = ranges[:, None] * np.column_stack((np.cos(bearings), np.sin(bearings)))
    return thin(points.astype(np.float32), np.zeros(2), GraphConfig().thinning)


def registered(off: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The error [3] of a step whose odometry is off, registered after one scan."""
    steps = StepRegistration(scan(np.zeros(3)), np.zeros(2), GraphConfig(), proved=True)
    odometry = np.asarray(se2.compose(TRUE_STEP, off))
    found = steps.add(scan(TRUE_STEP), Prediction(odometry, spread, True, odometry))
    return np.asarray(se2.between(TRUE_STEP, found.step))


@pytest.mark.parametrize("turn", [-0.5, -0.3, 0.0, 0.3, 0.5])
def test_a_heading_is_found_as_far_off_as_the_odometry_may_be(turn: float):
    """Filter and odometry begin where Gauss-Newton does not reach the truth."""
    error = registered(np.array((0.05, -0.05, turn)), np.array((0.1, 0.1, 0.2)))
    np.testing.assert_array_less(np.abs(error), (0.02, 0.02, 0.005))


def test_where_several_places_are_open_the_filters_choice_stands():
    """The local map shows a part of them at most, and a registration to it is as sure of itself at a wrong one."""
    steps = StepRegistration(scan(np.zeros(3)), np.zeros(2), GraphConfig(), proved=True)
    chosen = np.asarray(se2.compose(TRUE_STEP, (0.1, -0.1, 0.05)))
    found = steps.add(scan(TRUE_STEP), Prediction(chosen, np.array((1.0, 1.0, 0.2)), False, chosen, open=True))
    np.testing.assert_array_equal(found.step, chosen)
    np.testing.assert_array_equal(found.information, 0.0)


def test_a_good_odometry_is_where_the_search_begins():
    np.testing.assert_array_equal(step_registration._turned(np.array((0.1, 0.1, 0.15))), np.zeros((1, 3)))
    np.testing.assert_allclose(step_registration._turned(np.full(3, 0.45))[:, 2], (-0.4, -0.2, 0, 0.2, 0.4))
    assert len(step_registration._turned(np.full(3, 50.0))) == 31


def test_what_is_far_is_compared_with_the_most_probable_that_is_near():
    """Round a corner the true place knows a third of the endpoints, as well; straight on all of the corridor fits."""
    spread, points, config = np.array((0.1, 0.1, 0.1)), 100, GraphConfig()
    offsets = np.array(((1.0, 0.0, 0.0), (0.3, 0.3, 0.2), (0.02, 0.0, 0.0), (0.2, 0.2, 0.0), (0.0, 0.2, 0.0)))
    known = np.array((90.0, 90.0, 40.0, 90.0, 90.0))
    costs = config.registration.unknown_cost * (points - known) + np.array((0.1, 0.5, 0.5, 0.5, 0.1)) * known
    likelihoods, none = np.full(5, 0.9), np.zeros(5)
    found = Registration(offsets, np.zeros((5, 3, 3)), costs, known, likelihoods, none, offsets, none, np.zeros((5, 3)))
    np.testing.assert_array_equal(step_registration._far(found, spread), (True, True, False, False, False))
    assert step_registration._better(found, spread) != 2
    some = Registration(*(values[:4] for values in found))
    assert step_registration._nearest(some, spread, points, config) == 2
    assert step_registration._nearest(found, 2 * spread, points, config) == 4
    assert step_registration._nearest(found, spread / 100, points, config) == 2
