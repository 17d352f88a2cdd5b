"""How sure the filters are: in a calm room, along a bare corridor, after being carried off, without odometry."""

import math

import numpy as np
import pytest
from slam_rooms import bare_corridor, carried_into_another_room, circled_room

from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import (
    FLOOR,
    NEIGHBOURHOOD,
    LocalisationState,
    state_of,
    wrong_by_spread,
)
from moteslam.slam.filter.covariance import as_array, largest_deviation, symmetric
from moteslam.slam.mapping.config import LOST_DISTANCE
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import prior_spread
from moteslam.slam.run import run_slam
from moteslam.slam.settings import resolve_config
from moteslam.slam.tsdf.doubt import ScanFit
from moteslam.slam.tsdf.motion import STILL, step_motion
from moteslam.slam.tsdf.pose_covariance import CORRELATION, Fit, PoseCovariance

SURE, DOUBTFUL, LOST = LocalisationState
FITS = ScanFit(1.0, 200.0, 180.0, 0.0, 0.0)
METHODS = {"default": ["particles=5"], "paper": ["particles=30"]}


def estimated(recording, preset: str = "default") -> Estimate:
    return run_slam(recording, resolve_config(preset, ["backend.method=none", *METHODS[preset]]), seed=0)


@pytest.mark.parametrize("preset", METHODS)
@pytest.mark.usefixtures("taichi")
def test_a_robot_in_a_calm_room_is_sure_and_its_covariances_are_positive(preset: str):
    recording, true = circled_room()
    estimate = estimated(recording, preset)
    paths = (estimate.trajectory, estimate.trajectory_final, estimate.dead_reckoning)
    online, final, drift = (np.hypot(*(path.poses - true)[:, :2].T).max() for path in paths)
    assert max(online, final) < 0.12 < 0.15 < drift
    assert (estimate.diagnostics["state"] == SURE).all()
    assert estimate.covariances.shape == (120, 3, 3)
    np.testing.assert_array_equal(estimate.covariances, estimate.covariances.transpose(0, 2, 1))
    assert (np.linalg.eigvalsh(estimate.covariances) > 0).all()
    assert np.sqrt(estimate.covariances[10:, [0, 1], [0, 1]]).max() < (0.02 if preset == "default" else 0.15)
    assert np.isnan(estimate.diagnostics["degenerate"]).all()


@pytest.mark.usefixtures("taichi")
def test_along_a_bare_corridor_the_variance_grows_and_the_direction_is_degenerate():
    estimate = estimated(bare_corridor())
    along, across = (np.sqrt(estimate.covariances[:, i, i]) for i in (0, 1))
    degenerate = estimate.diagnostics["degenerate"]
    assert np.isnan(degenerate[:20]).all()  # the cupboard is in sight
    np.testing.assert_allclose(degenerate[75:], 0.0, atol=0.02)
    assert along[:20].max() < 0.02
    assert (np.diff(along[75:100]) > 0).all()
    assert along[-1] > 4 * along[:20].max()
    assert across.max() < 0.02
    # where the map is drawn by the robot as it drives, it is no farther off than the odometry over what is around it
    bound = prior_spread(RegistrationConfig(), 1.0, 1.0)[0] * math.sqrt(NEIGHBOURHOOD / 3)
    assert along.max() < bound * 1.01


@pytest.mark.parametrize(("preset", "within"), [("default", 15), ("paper", 5)])
@pytest.mark.usefixtures("taichi")
def test_a_robot_that_is_carried_into_another_room_is_soon_lost(preset: str, within: int):
    states = estimated(carried_into_another_room(at=60), preset).diagnostics["state"]
    assert (states[:60] == SURE).all()
    assert (states[60 + within :] == LOST).all()
    if preset == "default":
        assert (states[60 : 60 + within] >= DOUBTFUL).all()


def test_without_scans_and_odometry_the_robot_is_soon_lost():
    covariance = PoseCovariance(RegistrationConfig())
    states = []
    for _ in range(400):
        step = (0.05, 0.0, 0.0)
        covariance.step(step_motion(step, step, 0.1, measured=False), step, None)
        value = covariance.value
        states.append(state_of(wrong_by_spread(largest_deviation(value), math.sqrt(value[5]))))
    assert states[0] is not LOST
    assert states == sorted(states)
    assert states[-1] is LOST
    assert math.sqrt(value[0]) > LOST_DISTANCE


def registered(covariance: PoseCovariance, information: np.ndarray, likelihood: float, spread: float) -> None:
    """A robot that stands registers a scan."""
    fit = Fit(symmetric(information), likelihood, (spread,) * 3, FITS)
    covariance.step(step_motion(STILL, STILL, 0.1, measured=True), STILL, fit)


def test_a_registration_leaves_the_error_of_its_weighted_mean():
    """After one registration the error is A e + (1 - A) r, with the prior's share A as ``register`` weighs it."""
    config = RegistrationConfig()
    covariance = PoseCovariance(config)
    step = (0.3, 0.1, 0.2)
    information = np.array([[4e4, 1e3, 5e3], [1e3, 2e3, -4e2], [5e3, -4e2, 6e4]])
    spread = 0.03
    covariance.step(step_motion(step, step, 0.1, measured=True), step, None)
    before = as_array(covariance._pose)
    registered(covariance, information, 0.8, spread)
    scale = config.likelihood_width**2 * (1 / 0.8**2 - 1) * CORRELATION
    prior = config.prior_weight * np.eye(3) / spread**2
    share = np.linalg.inv(information + prior) @ prior
    rest = np.eye(3) - share
    expected = share @ before @ share.T + rest @ (scale * np.linalg.inv(information)) @ rest.T
    np.testing.assert_allclose(as_array(covariance._pose), expected, rtol=1e-9)
    around = as_array(covariance._map)
    bounded = np.linalg.inv(np.linalg.inv(expected) + np.linalg.inv(around))
    floor = np.diag([FLOOR[0], FLOOR[0], FLOOR[1]])
    np.testing.assert_allclose(as_array(covariance.value), bounded + floor, rtol=1e-6)


def test_the_degenerate_direction_is_that_of_least_information():
    covariance = PoseCovariance(RegistrationConfig())
    for angle in (0.0, 0.3, -1.2, 1.5):
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        information = np.diag([0.0, 0.0, 1e6])
        information[:2, :2] = 10.0 * np.outer(along, along) + 1e6 * np.outer(across, across)
        registered(covariance, information, 0.9, 0.01)
        assert covariance.degenerate == pytest.approx(angle, abs=1e-6)
        registered(covariance, information + 1e6 * np.pad(np.outer(along, along), (0, 1)), 0.9, 0.01)
        assert math.isnan(covariance.degenerate)
