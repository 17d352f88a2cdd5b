"""Finding scans in maps: what the registrar believes, and where it looks."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from tile_pools import room_scan, thinned

from moteslam.robot import se2
from moteslam.slam.registration import Registrar, Registration, weakest
from moteslam.slam.surface_config import ProposalConfig, RegistrationConfig, SurfaceConfig
from moteslam.slam.surface_maps import MapView, SurfaceMaps

Array = NDArray[np.float64]
SPREAD = np.array([0.02, 0.02, 0.02])
NO_GUESS = np.zeros((1, 3))


def found(offset: tuple[float, float, float], along: float, across: float, heading: float) -> Registration:
    """One registration whose scan says so much along a corridor of that heading, and so much across it."""
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, -s], [s, c]])
    information = np.zeros((1, 3, 3))
    information[0, :2, :2] = turn @ np.diag([along, across]) @ turn.T
    information[0, 2, 2] = 1e6
    ones = np.ones(1)
    return Registration(np.array([offset]), information, ones, ones, ones, ones)


def registrar(**keys: float) -> Registrar:
    return Registrar(RegistrationConfig(**keys), ProposalConfig())  # type: ignore[arg-type]


@pytest.mark.parametrize("heading", [0.0, 0.4, 1.6, -2.9])
def test_the_weakest_direction_and_its_share(heading: float) -> None:
    share, along = weakest(found((0, 0, 0), 2e3, 1e6, heading).information)
    assert share[0] == pytest.approx(0.002)
    assert abs(along[0] @ (np.cos(heading), np.sin(heading))) == pytest.approx(1.0)


def test_along_bare_walls_the_odometry_is_believed_and_across_them_the_scan() -> None:
    heading = 0.4
    along, across = np.array((np.cos(heading), np.sin(heading))), np.array((-np.sin(heading), np.cos(heading)))
    offset = (*(0.03 * along + 0.02 * across), 0.01)
    seen = found(offset, 2e3, 1e6, heading)
    kept = registrar().trusted(seen, SPREAD)
    assert abs(kept.offsets[0, :2] @ along) < 0.001
    assert kept.offsets[0, :2] @ across == pytest.approx(0.02)
    assert kept.offsets[0, 2] == 0.01
    assert along @ kept.information[0, :2, :2] @ along < 0.02 * 2e3
    assert across @ kept.information[0, :2, :2] @ across == pytest.approx(1e6)
    np.testing.assert_array_equal(registrar(degenerate=0.0).trusted(seen, SPREAD).offsets, seen.offsets)


def test_where_there_is_much_to_see_the_scan_is_believed() -> None:
    seen = found((0.03, -0.02, 0.01), 5e5, 1e6, 0.4)
    np.testing.assert_allclose(registrar().trusted(seen, SPREAD).offsets, seen.offsets, atol=1e-3)


def test_odometry_that_failed_is_not_believed_between_bare_walls_either() -> None:
    seen = found((0.5, 0.0, 0.0), 2e3, 1e6, 0.0)
    np.testing.assert_array_equal(registrar().trusted(seen, SPREAD).offsets, seen.offsets)


@pytest.fixture(scope="module")
def room(taichi: None) -> MapView:
    """The map of one scan from the middle of a room."""
    maps = SurfaceMaps(SurfaceConfig())
    maps.add(np.zeros((1, 3)), thinned(room_scan(beams=720)))
    return maps.of(0)


def follow(room: MapView, at: tuple[float, float, float], predicted: Array, guesses: Array = NO_GUESS) -> Array:
    """Where a scan taken there is found to be, from where the odometry puts it."""
    points = thinned(room_scan(at)).points
    result = registrar().follow(room, predicted, SPREAD, points, np.zeros(2), guesses)
    return se2.compose(predicted, result.offsets[0])


def test_a_scan_near_its_prediction_is_found_without_a_search(room: MapView, monkeypatch: pytest.MonkeyPatch) -> None:
    def search(*_: object) -> None:
        raise AssertionError("a search")

    monkeypatch.setattr(Registrar, "_search", search)
    at = (0.3, -0.2, 0.1)
    assert np.abs(follow(room, at, np.add(at, (0.03, -0.02, 0.02))) - at).max() < 0.003
    with pytest.raises(AssertionError, match="a search"):
        follow(room, at, np.add(at, (0.9, -0.6, 0.8)))


def test_a_scan_is_found_where_the_same_velocity_would_put_it(room: MapView) -> None:
    """Odometry that says nothing of 0.9 m and half a radian, and no wide window to look in."""
    at, stood = (0.7, 0.5, 0.5), np.zeros(3)
    points = thinned(room_scan(at)).points
    narrow = registrar(wide_distance=0.0, wide_rotation=0.0)
    guesses = np.stack((np.zeros(3), se2.between(stood, np.array(at) + 0.02)))
    (with_guess,) = narrow.follow(room, stood, SPREAD, points, np.zeros(2), guesses).offsets
    (without,) = narrow.follow(room, stood, SPREAD, points, np.zeros(2), NO_GUESS).offsets
    assert np.abs(with_guess - at).max() < 0.005
    assert np.abs(without - at).max() > 0.1
