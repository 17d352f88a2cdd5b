"""How the limit of a laser is found from its readings."""

import numpy as np
import pytest
from numpy.typing import NDArray

from moteslam.robot.formats.streams import SICK_REACH, no_return_limit


def readings(n: int = 20_000, longest: float = 7.0, seed: int = 0) -> NDArray[np.float32]:
    """Centimetre readings of a room, long ones rare."""
    ranges = np.random.default_rng(seed).beta(1.5, 3.0, n) * longest
    return ranges.round(2).astype(np.float32)


@pytest.mark.parametrize("code", [81.83, 81.91, 81.87, 100.0, 1000.0])
def test_a_sick_reaches_80_metres(code: float) -> None:
    ranges = readings()
    ranges[7] = code
    assert no_return_limit(ranges, None) == SICK_REACH


@pytest.mark.parametrize("limit", [8.0, 29.99, 32.0, 50.0])
@pytest.mark.parametrize("share", [0.01, 0.1, 0.9])
def test_a_spike_at_the_longest_range_is_the_limit(limit: float, share: float) -> None:
    ranges = readings()
    ranges[: int(share * len(ranges))] = limit
    assert no_return_limit(ranges, None) == np.float32(limit)


def test_of_several_codes_the_most_frequent_is_the_limit() -> None:
    ranges = readings()
    ranges[:1500], ranges[1500:1540], ranges[1540:1545] = 8.183, 8.187, 8.191
    assert no_return_limit(ranges, None) == np.float32(8.183)
    ranges[:200] = np.nextafter(np.float32(8.183), np.float32(9))  # as some logs are rounded
    assert no_return_limit(ranges, None) == np.float32(8.183)
    ranges[:700] = 8.187  # as a wall, at two values
    assert no_return_limit(ranges, None) == SICK_REACH
    ranges[:1500] = 8.12  # a wall, too far below the longest
    assert no_return_limit(ranges, None) == SICK_REACH


def test_without_a_spike_every_range_is_an_endpoint() -> None:
    ranges = readings()
    assert no_return_limit(ranges, None) == SICK_REACH
    ranges[:30] = 8.0  # 0.15 %: some wall
    assert no_return_limit(ranges, None) == SICK_REACH


@pytest.mark.parametrize(
    "ranges",
    [
        np.full(1000, 5.0),
        np.tile([1.0, 2.0, 3.0], 500),
        np.append(np.full(500, 5.0), np.zeros(100)),
        np.arange(1.0, 20.0),
        np.array([]),
        np.array([np.nan, np.inf]),
    ],
)
def test_a_robot_that_sees_the_same_wall_has_no_limit(ranges: NDArray[np.float64]) -> None:
    assert no_return_limit(ranges.astype(np.float32), None) == SICK_REACH


@pytest.mark.parametrize(("stated", "limit"), [(30.0, 30.0), (80.0, 80.0), (81.9, 80.0), (81.92, 80.0), (120.0, 120.0)])
def test_what_the_log_states_goes_first(stated: float, limit: float) -> None:
    ranges = readings()
    ranges[:1000] = 81.83
    assert no_return_limit(ranges, stated) == limit
