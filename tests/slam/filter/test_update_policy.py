"""When an update is due: by distance, by rotation or by time, of the odometry or the tracked motion."""

from __future__ import annotations

import pytest

from moteslam.slam.filter.update_policy import Travelled, UpdateConfig, update_due

POLICY = UpdateConfig(distance=0.1, rotation=0.2, interval=5.0)


@pytest.mark.parametrize(
    ("travelled", "due"),
    [
        (Travelled(0.09, 0.19, 4.9), False),
        (Travelled(0.1, 0.0, 0.0), True),
        (Travelled(0.0, 0.2, 0.0), True),
        (Travelled(0.0, 0.0, 5.0), True),
    ],
)
def test_each_of_distance_rotation_and_time_is_enough(travelled: Travelled, due: bool) -> None:
    assert update_due(POLICY, travelled) is due


def test_the_larger_of_odometry_and_tracked_motion_counts() -> None:
    assert update_due(POLICY, Travelled(0.0, 0.0, 0.0), (0.08, 0.08, 0.0))
    assert update_due(POLICY, Travelled(0.0, 0.0, 0.0), (0.0, 0.0, -0.2))
    assert update_due(POLICY, Travelled(0.1, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert not update_due(POLICY, Travelled(0.09, 0.19, 0.0), (0.05, 0.0, 0.19))


def test_what_was_travelled_adds_up() -> None:
    travelled = Travelled(0.0, 0.0, 0.0).plus(0.5, 0.1, 0.5).plus(0.0, 0.1, 0.5)
    assert travelled == pytest.approx((0.5, 0.2, 1.0))
