"""The information of a registration: what bare walls and round rooms do not bind is as uncertain as the map."""

import numpy as np
import pytest
from numpy.typing import NDArray

from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.information import (
    keep_odometry,
    less_where_unbound,
    measured_information,
    residual_variance,
)
from moteslam.slam.registration.registrar import Registration

CONFIG = RegistrationConfig()
ANGLES = np.linspace(0, 2 * np.pi, 100, endpoint=False)
RING = np.column_stack((np.cos(ANGLES), np.sin(ANGLES)))
"""Points 1 m from the robot."""


def registration(
    information: NDArray[np.float64],
    likelihood: float,
    points: NDArray[np.float64] = RING,
    offset: tuple[float, ...] = (0, 0, 0),
) -> Registration:
    none, offsets = np.zeros(1), np.array([offset], float)
    means = np.array([[*points.mean(axis=0), np.square(points).sum(axis=1).mean()]])
    return Registration(offsets, information[None], none, none + 100, none + likelihood, none, offsets, none, means)


def between_walls(heading: float, ratio: float) -> NDArray[np.float64]:
    """Between walls at this heading, with ``ratio`` of the information along them to that across."""
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    return np.asarray(turn @ np.diag((ratio * 1e6, 1e6, 1e6)) @ turn.T)


def in_a_tank(centre: tuple[float, float], noise: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The information of 100 endpoints on a circle of 4 m about a centre, in the robot's frame, with ``noise`` of their
    normals; and the endpoints."""
    points = 4 * RING + centre
    slopes = np.random.default_rng(1).normal(0, noise, 100)
    normals = 1e2 * (RING + slopes[:, None] * RING[:, ::-1] * (-1, 1))
    rows = np.column_stack((normals, normals[:, 1] * points[:, 0] - normals[:, 0] * points[:, 1]))
    return np.asarray(rows.T @ rows), points


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.0])
@pytest.mark.parametrize(("ratio", "likelihood"), [(0.001, 0.9), (0.03, 0.5), (0.5, 0.9)])
def test_along_bare_walls_a_step_is_as_uncertain_as_the_errors_of_the_map_make_it(
    heading: float, ratio: float, likelihood: float
) -> None:
    found = registration(between_walls(heading, ratio), likelihood)
    measured = measured_information(found, 0, CONFIG, 10.0)
    less = less_where_unbound(measured, found, 0, CONFIG)
    variance = residual_variance(likelihood, CONFIG)
    error = CONFIG.degenerate * variance / (ratio / (1 + ratio))
    along = np.array((np.cos(heading), np.sin(heading), 0.0))
    expected = np.linalg.inv(measured) + error**2 * np.outer(along, along)
    np.testing.assert_allclose(np.linalg.inv(less), expected, rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize("centre", [(0.0, 0.0), (-2.0, 1.0)])
def test_in_a_round_room_a_turn_about_its_centre_is_not_measured(centre: tuple[float, float]) -> None:
    information, points = in_a_tank(centre, 0.05)
    found = keep_odometry(registration(information, 0.8, points), np.full(3, 0.02), CONFIG)
    less = less_where_unbound(measured_information(found, 0, CONFIG, 10.0), found, 0, CONFIG)
    about = np.array((centre[1], -centre[0], 1.0))
    values, vectors = np.linalg.eigh(less)
    assert abs(values[0]) < 1e-3
    assert abs(vectors[:, 0] @ about) > 0.99 * np.linalg.norm(about)
    assert values[1] > 1e3  # the distances to the wall are

    turned = 0.02 * about + (0.01, -0.01, 0.0)  # the odometry says that it did not turn
    kept = keep_odometry(registration(information, 0.8, points, tuple(turned)), np.full(3, 0.02), CONFIG)
    np.testing.assert_allclose(kept.offsets[0], (0.01, -0.01, 0.0), atol=2e-3)
    assert np.linalg.eigvalsh(kept.information[0])[0] > -1e-3


@pytest.mark.parametrize("heading", [0.0, 1.2])
def test_along_a_bare_hall_noise_of_the_walls_moves_nothing(heading: float) -> None:
    """What noise of the slopes says of the way is left out altogether, and of the turn nothing with it."""
    rng = np.random.default_rng(3)
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array(((c, -s), (s, c)))
    points = np.column_stack((rng.uniform(-3, 3, 200), np.repeat((1.5, -1.5), 100))) @ turn.T
    normals = 1e2 * np.column_stack((rng.normal(0, 0.05, 200), np.ones(200))) @ turn.T
    rows = np.column_stack((normals, normals[:, 1] * points[:, 0] - normals[:, 0] * points[:, 1]))
    offset = (*(turn @ (-0.04, 0.01)), 0.005)
    kept = keep_odometry(registration(rows.T @ rows, 0.8, points, offset), np.full(3, 0.02), CONFIG).offsets[0]
    np.testing.assert_allclose(turn.T @ kept[:2], (0, 0.01), atol=1e-3)
    assert kept[2] == pytest.approx(0.005, abs=1e-3)


def test_it_can_be_switched_off() -> None:
    found = registration(between_walls(0.3, 0.01), 0.5)
    config = CONFIG.model_copy(update={"degenerate": 0.0})
    measured = measured_information(found, 0, config, 10.0)
    np.testing.assert_array_equal(less_where_unbound(measured, found, 0, config), measured)
