"""How sure the filters are, in simple rooms and by their mathematics; and when scans contradict the map."""

import json
import math
from copy import copy
from typing import Any

import numpy as np
import pytest
from slam_rooms import bare_corridor, carried_into_another_room, circled_room, run

from moteslam.robot.recording import Recording
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import (
    FLOOR,
    LEAST_SPREAD,
    LOST_DROP,
    NEIGHBOURHOOD,
    LocalisationState,
    state_of,
    wrong_by_spread,
)
from moteslam.slam.filter.covariance import as_array, largest_deviation, symmetric
from moteslam.slam.known_map.presence import Presence
from moteslam.slam.mapping.config import LOST_DISTANCE
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import prior_spread
from moteslam.slam.tsdf.doubt import APART, PRIOR, Doubt, ScanFit
from moteslam.slam.tsdf.motion import STILL, step_motion
from moteslam.slam.tsdf.pose_covariance import CORRELATION, Fit, PoseCovariance

pytestmark = pytest.mark.usefixtures("taichi")

SURE, DOUBTFUL, LOST = LocalisationState
FITS = ScanFit(1.0, 200.0, 180.0, 0.0, 0.0)
METHODS = {"default": ["particles=5"], "paper": ["particles=30"]}


def estimated(recording: Recording, preset: str = "default") -> Estimate:
    return run(recording, "backend.method=none", *METHODS[preset], preset=preset)


@pytest.mark.parametrize("preset", METHODS)
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
def test_a_robot_that_is_carried_into_another_room_is_soon_lost(preset: str, within: int):
    states = estimated(carried_into_another_room(at=60), preset).diagnostics["state"]
    assert (states[:60] == SURE).all()
    assert (states[60 + within :] == LOST).all()
    if preset == "default":
        assert (states[60 : 60 + within] >= DOUBTFUL).all()


def test_without_scans_and_odometry_the_robot_is_soon_lost():
    covariance = PoseCovariance(RegistrationConfig())
    states, step = [], (0.05, 0.0, 0.0)
    for _ in range(400):
        covariance.step(step_motion(step, step, 0.1, measured=False), step, None)
        value = covariance.value
        states.append(state_of(wrong_by_spread(largest_deviation(value), math.sqrt(value[5]))))
    assert states[0] is not LOST
    assert states == sorted(states)
    assert states[-1] is LOST
    assert math.sqrt(value[0]) > LOST_DISTANCE


def registered(covariance: PoseCovariance, information: np.ndarray, likelihood: float, spread: float) -> None:
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


LOW = 1.0 - 1.2 * LOST_DROP * LEAST_SPREAD
ELSEWHERE = ScanFit(LOW, 200.0, 150.0, 25.0, 10.0)  # A sixth of the known endpoints far from the surface
BENT = ScanFit(LOW, 200.0, 180.0, 0.0, 0.0)  # As low a score, but no endpoint far from the surface


def watched(*scans: ScanFit | None, driven: float = 0.1, calm: ScanFit = FITS, count: int = 100) -> list[Doubt]:
    """The doubt after each scan, of a robot that drove through a known place before."""
    doubt, found = Doubt(), []
    for seen in [*([calm] * count), *scans]:
        doubt.observe(driven, seen)
        found.append(copy(doubt))
    assert max(one.probability for one in found[:count]) == pytest.approx(1 / (1 + np.exp(-PRIOR)))
    return found[count:]


def probabilities(*scans: ScanFit | None, **more: Any) -> list[float]:
    return [doubt.probability for doubt in watched(*scans, **more)]


def states(*scans: ScanFit | None, **more: Any) -> list[LocalisationState]:
    return [doubt.state for doubt in watched(*scans, **more)]


def test_a_robot_that_sees_another_place_is_doubtful_at_once_and_lost_within_a_metre():
    found = states(*[ELSEWHERE] * 10)
    assert found[0] is DOUBTFUL
    assert found == sorted(found)
    assert APART / 0.1 < found.index(LOST) < 2 * APART / 0.1


def test_a_scan_of_which_far_more_is_new_than_the_robot_can_have_come_to_see_is_doubted():
    for driven, turned, state in ((0.1, 0.0, DOUBTFUL), (0.1, 1.5, SURE), (1.5, 0.0, SURE)):
        (doubt,) = watched(FITS)
        doubt.observe(driven, FITS._replace(known=70.0), turned=turned)
        assert doubt.state is state


def test_a_robot_may_drive_beyond_a_known_map():
    presence = Presence()
    for scan in [*[FITS] * 100, FITS._replace(known=70.0)]:
        presence.observe(0.1, scan)
    assert presence.state is SURE


def test_two_scans_make_no_robot_lost_nor_do_many_from_one_place():
    assert states(*[ELSEWHERE] * 3, driven=5.0) == [DOUBTFUL, DOUBTFUL, LOST]
    assert set(states(*[ELSEWHERE] * 500, driven=0.0)) == {DOUBTFUL}


def test_scans_that_fit_again_end_the_doubt():
    found = probabilities(*[ELSEWHERE] * 2, *[FITS] * 60)
    assert found[1] > 0.05
    assert found[-1] < 0.05
    assert (np.diff(found[1:]) <= 0).all()


def test_neither_a_map_that_bends_nor_what_changes_little_by_little_makes_a_robot_lost():
    assert set(states(*[BENT] * 50)) == {SURE}
    scores = np.arange(1.0, 0.2, -0.05).repeat(2)
    assert set(states(*[FITS._replace(score=score, crossed=60.0) for score in scores])) == {SURE}


def test_rays_through_surfaces_and_endpoints_far_from_them_count_beyond_what_is_usual():
    """Rays with a drop of the score alone."""
    hidden, crowded = BENT._replace(crossed=40.0), ELSEWHERE._replace(far=12.0)
    assert probabilities(hidden) > probabilities(BENT)
    assert probabilities(FITS._replace(crossed=190.0)) == probabilities(FITS)
    assert probabilities(hidden, calm=FITS._replace(crossed=40.0), count=1000) < probabilities(hidden)
    assert probabilities(crowded, calm=FITS._replace(far=12.0), count=300) < probabilities(crowded)


def test_a_scan_that_fits_where_next_to_nothing_is_known_and_one_that_is_not_matched_end_no_doubt():
    fits_here = FITS._replace(known=60.0)
    assert probabilities(ELSEWHERE, *[fits_here] * 5)[-1] > 0.1
    assert probabilities(ELSEWHERE, *[FITS] * 5)[-1] < 0.05
    assert len(set(probabilities(ELSEWHERE, None, None))) == 1


def test_a_robot_that_was_carried_is_found_where_scans_fit_as_usual_and_else_is_lost():
    for seen, state in ((FITS, SURE), (FITS._replace(score=0.9), LOST), (FITS._replace(known=100.0), LOST)):
        doubt = Doubt()
        for _ in range(100):
            doubt.observe(0.1, FITS)
        doubt.observe(0.0, seen, carried=True)
        assert doubt.state is DOUBTFUL
        for _ in range(12):
            doubt.observe(0.1, seen)
        assert doubt.state is state
        assert doubt.carried is (state is LOST)


def test_a_state_prints_its_name_and_stays_a_number():
    assert f"{LOST}" == str(LOST) == "LOST"
    assert json.dumps([LOST, float(SURE)]) == "[2, 0.0]"
