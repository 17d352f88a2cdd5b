"""The increments of a differential drive."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from moteslam.robot import se2
from moteslam.robot.wheel_odometry import arc_increment, euler_increment, wheel_motion

DISTANCES = st.floats(-10, 10, allow_subnormal=False)
TURNS = st.floats(-6, 6, allow_subnormal=False)


def test_euler_is_equation_iii_1() -> None:
    """x + v tau cos(theta), y + v tau sin(theta), theta + omega tau."""
    pose, v, omega, tau = np.array([1.0, 2.0, 0.7]), 0.8, 0.5, 0.025
    moved = se2.compose(pose, euler_increment(v * tau, omega * tau))
    expected = [1 + v * tau * np.cos(0.7), 2 + v * tau * np.sin(0.7), 0.7 + omega * tau]
    np.testing.assert_allclose(moved, expected, rtol=1e-15)


@given(DISTANCES, TURNS)
def test_the_arc_is_the_limit_of_many_euler_steps(distance: float, turn: float) -> None:
    n = 2000
    steps = euler_increment(np.full(n, distance / n), np.full(n, turn / n))
    fine = se2.accumulate(steps)[-1]
    arc = arc_increment(distance, turn)
    np.testing.assert_allclose(arc[:2], fine[:2], atol=abs(distance * turn) / n + 1e-9)


@given(DISTANCES, TURNS, st.floats(0, 1, allow_subnormal=False))
def test_an_arc_in_two_parts_is_the_arc(distance: float, turn: float, part: float) -> None:
    two = se2.compose(
        arc_increment(part * distance, part * turn), arc_increment((1 - part) * distance, (1 - part) * turn)
    )
    np.testing.assert_allclose(two[:2], arc_increment(distance, turn)[:2], atol=1e-12)


def test_wheels() -> None:
    distance, turn = wheel_motion([1.0, -0.1], [1.0, 0.1], 0.5)
    np.testing.assert_allclose(distance, [1.0, 0.0])
    np.testing.assert_allclose(turn, [0.0, 0.4])


@given(DISTANCES, TURNS)
def test_wheels_undo_what_the_track_makes_of_a_turn(distance: float, turn: float) -> None:
    track = 0.73
    there = wheel_motion(distance - turn * track / 2, distance + turn * track / 2, track)
    np.testing.assert_allclose(there, (distance, turn), atol=1e-12)
