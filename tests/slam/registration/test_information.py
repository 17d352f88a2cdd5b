"""The information of a registration: along bare walls it is that of errors of the map."""

import numpy as np
import pytest

from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.information import (
    less_along_bare_walls,
    measured_information,
    residual_variance,
)
from moteslam.slam.registration.registrar import Registration

CONFIG = RegistrationConfig()


def registration(heading: float, ratio: float, likelihood: float) -> Registration:
    """Of one scan between walls at this heading, with ``ratio`` of the information along them to that across."""
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    information = turn @ np.diag((ratio * 1e6, 1e6, 1e6)) @ turn.T
    none = np.zeros(1)
    offset = np.zeros((1, 3))
    return Registration(offset, information[None], none, none + 100, none + likelihood, none, offset, none)


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.0])
@pytest.mark.parametrize("ratio", [0.001, 0.03, 0.5])
@pytest.mark.parametrize("likelihood", [0.3, 0.9])
def test_along_bare_walls_a_step_is_as_uncertain_as_the_errors_of_the_map_make_it(
    heading: float, ratio: float, likelihood: float
):
    found = registration(heading, ratio, likelihood)
    measured = measured_information(found, 0, CONFIG, 10.0)
    less = less_along_bare_walls(measured, found, 0, CONFIG)
    error = CONFIG.degenerate * residual_variance(likelihood, CONFIG) / ratio
    along = np.array((np.cos(heading), np.sin(heading), 0.0))
    expected = np.linalg.inv(measured) + error**2 * np.outer(along, along)
    np.testing.assert_allclose(np.linalg.inv(less), expected, rtol=1e-6, atol=1e-12)


def test_it_can_be_switched_off():
    found = registration(0.3, 0.01, 0.5)
    config = CONFIG.model_copy(update={"degenerate": 0.0})
    measured = measured_information(found, 0, config, 10.0)
    np.testing.assert_array_equal(less_along_bare_walls(measured, found, 0, config), measured)
