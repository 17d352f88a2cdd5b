"""SE(2) is a group, and its functions agree with 3x3 matrices."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.platforms import UCSD
from moteslam.robot.wheel_odometry import arc_increment, wheel_motion
from moteslam.slam.inputs.odometry_path import euler_increment

ANGLES = st.floats(-1e3, 1e3, allow_subnormal=False)
POSES = st.tuples(
    st.floats(-1e3, 1e3, allow_subnormal=False),
    st.floats(-1e3, 1e3, allow_subnormal=False),
    st.floats(-7, 7, allow_subnormal=False),
).map(np.array)


def matrix(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, theta = pose
    return np.array([[np.cos(theta), -np.sin(theta), x], [np.sin(theta), np.cos(theta), y], [0, 0, 1]])


def same(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Equal as transformations: headings of pi and -pi are one."""
    return bool(np.allclose(matrix(a), matrix(b), rtol=1e-12, atol=1e-9))


@given(ANGLES)
def test_wrap_lies_in_the_half_open_circle_and_turns_the_same_way(angle: float) -> None:
    wrapped = float(se2.wrap(angle))
    assert -np.pi < wrapped <= np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-12)
    assert se2.wrap(wrapped) == wrapped


@pytest.mark.parametrize(
    ("angle", "wrapped"), [(np.pi, np.pi), (-np.pi, np.pi), (3 * np.pi, np.pi), (0.3, 0.3), (2 * np.pi, 0.0)]
)
def test_wrap_at_the_seam(angle: float, wrapped: float) -> None:
    assert se2.wrap(angle) == pytest.approx(wrapped, abs=1e-15)
    assert se2.wrap(np.nextafter(np.pi, 4)) > -np.pi


@given(POSES, POSES)
def test_compose_is_the_product_of_matrices(a: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    np.testing.assert_allclose(matrix(se2.compose(a, b)), matrix(a) @ matrix(b), rtol=1e-12, atol=1e-9)


@given(POSES)
def test_the_inverse_undoes(a: NDArray[np.float64]) -> None:
    assert same(se2.compose(a, se2.inverse(a)), se2.IDENTITY)
    assert same(se2.compose(se2.inverse(a), a), se2.IDENTITY)


@given(POSES, POSES)
def test_between_leads_from_one_to_the_other(a: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    assert same(se2.compose(a, se2.between(a, b)), b)


@given(
    POSES,
    st.lists(
        st.tuples(st.floats(-99, 99, allow_subnormal=False), st.floats(-99, 99, allow_subnormal=False)),
        min_size=1,
        max_size=5,
    ),
)
def test_points_are_moved_as_by_the_matrix(pose: NDArray[np.float64], points: list[tuple[float, float]]) -> None:
    there = np.column_stack((points, np.ones(len(points)))) @ matrix(pose).T
    np.testing.assert_allclose(se2.transform_points(pose, points), there[:, :2], rtol=1e-12, atol=1e-9)


@given(POSES, st.lists(POSES, min_size=1, max_size=20))
def test_accumulate_is_compose_after_compose(start: NDArray[np.float64], increments: list[NDArray[np.float64]]) -> None:
    pose = start
    path = se2.accumulate(np.array(increments), start)
    for reached, increment in zip(path, increments, strict=True):
        pose = se2.compose(pose, increment)
        assert same(reached, pose)


@given(POSES, POSES)
def test_single_poses_are_as_rows_of_arrays(a: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    assert same(se2.compose(a, b), se2.compose([a], [b])[0])
    assert same(se2.compose(a, b), se2.compose(a, [b])[0])
    assert same(se2.inverse(a), se2.inverse([a])[0])
    assert -np.pi < se2.inverse(a)[2] <= np.pi
    one, other = se2.as_pose(a), se2.as_pose(b)
    assert se2.compose_one(one, other) == tuple(se2.compose(a, b).tolist())
    assert se2.between_one(one, other) == tuple(se2.between(a, b).tolist())


def test_broadcasting() -> None:
    many = np.random.default_rng(0).normal(size=(4, 5, 3))
    assert se2.compose(many, se2.IDENTITY).shape == (4, 5, 3)
    assert se2.compose(se2.IDENTITY, many).shape == (4, 5, 3)
    assert se2.inverse(many).shape == (4, 5, 3)


def test_interpolation_takes_the_short_way_and_holds_the_ends() -> None:
    poses = np.array([[0.0, 0, 3.0], [2.0, 4.0, -3.0]])
    at = se2.interpolate([1.0, 2.0], poses, [0.0, 1.0, 1.5, 2.0, 9.0])
    np.testing.assert_allclose(at[[0, 1]], poses[[0, 0]])
    np.testing.assert_allclose(at[2], [1.0, 2.0, np.pi], atol=1e-12)
    np.testing.assert_allclose(at[[3, 4]], poses[[1, 1]])


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


def test_wheels_of_each_side_are_averaged_and_their_difference_turns() -> None:
    wheels = UCSD.wheels.model_copy(update={"metres_per_count": 0.01, "effective_track": 0.5})
    distance, turn = wheel_motion(np.array([(100, 110, 100, 90), (20, -10, 0, -10)]), wheels)
    np.testing.assert_allclose(distance, [1.0, 0.0])
    np.testing.assert_allclose(turn, [0.0, 0.4])
