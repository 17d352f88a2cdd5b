"""Which key scans become nodes, what the odometry's errors are, and how a step is registered."""

from itertools import pairwise

import numpy as np
import pytest
from graph_cases import WALL, key_scan
from slam_rooms import seen_from

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.slam.backend.graph.chain import Chain
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.nodes import MAX_RANGE, Nodes
from moteslam.slam.backend.graph.odometry_model import SAFETY, fit_odometry, turned_aside
from moteslam.slam.backend.graph.step_registration import Prediction, RegisteredStep, StepRegistration
from moteslam.slam.inputs.lapses import CLOSED
from moteslam.slam.inputs.step import thin

CONFIG = GraphConfig()


def nodes_of(steps: np.ndarray) -> Nodes:
    """The nodes of a run by these steps, the last key scan among them."""
    points = np.vstack((WALL, np.float32((50.0, 0.0))))
    nodes = Nodes(CONFIG)
    for k, motion in enumerate(np.vstack((np.zeros(3), steps))):
        nodes.add(key_scan(10 * k, motion, points))
    nodes.close()
    return nodes


def test_close_key_scans_become_a_node_every_half_metre():
    nodes = nodes_of(np.tile((0.1, 0.0, 0.0), (50, 1)))
    assert nodes.updates[0] == 0
    assert nodes.updates[-1] == 50
    assert set(np.diff(nodes.updates)[:-1].tolist()) <= {4, 5}
    np.testing.assert_allclose(np.array(nodes.odometry)[1:, 0], 0.1 * np.diff(nodes.updates))
    np.testing.assert_array_equal(nodes.indices, 10 * np.array(nodes.updates))


def test_turns_make_nodes_too_and_so_do_all_key_scans_that_are_far_apart():
    """Also one close to its neighbour before a long step: what the filter did in that step decides nothing."""
    assert len(nodes_of(np.tile((0.0, 0.0, 0.1), (30, 1)))) == 7
    steps = np.tile((1.0, 0.0, 0.0), (10, 1))
    steps[4, 0] = 0.1
    nodes = nodes_of(steps)
    assert len(nodes) == 11
    assert all(np.hypot(*scan.points.T).max() < MAX_RANGE for scan in nodes.scans)


def test_no_node_where_there_are_enough_and_the_next_one_elsewhere():
    crowded = False
    nodes = Nodes(CONFIG)
    for k in range(120):
        crowded = 20 <= k < 110
        nodes.add(key_scan(k, (0.4, 0.0, 0.0), WALL), lambda: crowded)  # noqa: B023
    assert not {*range(20, 109)} & {*nodes.updates}
    after = next(number for number, update in enumerate(nodes.updates) if update >= 109)
    assert not nodes.measured[after]  # by 35 m of odometry and more
    np.testing.assert_allclose(nodes.odometry[after][0], 0.4 * (nodes.updates[after] - nodes.updates[after - 1]))
    assert all(nodes.measured[after + 1 :])
    chain = Chain(nodes, CONFIG)
    for _ in range(after):
        chain.add()
    np.testing.assert_allclose(chain.steps[-1], nodes.filtered[after], atol=1e-6)
    assert np.sqrt(np.diag(chain.covariance[-1]))[:2].max() < 0.1  # the filter knows both ends in its map


def test_systematic_errors_are_taken_out_and_the_rest_is_measured():
    rng = np.random.default_rng(1)
    n = 400
    true = np.column_stack((rng.uniform(0.3, 1.0, n), rng.normal(0, 0.02, n), rng.normal(0, 0.3, n)))
    wrong = true * (1.04, 1.0, 0.95) + rng.normal(0, 1, true.shape) * (0.01, 0.002, 0.004)
    slips = rng.choice(n, 12, replace=False)
    wrong[slips, 0] += 0.6
    covariance = np.tile(np.diag((1e-6, 1e-6, 1e-7)), (n, 1, 1))
    model = fit_odometry(wrong, true, covariance)
    straight = np.delete(np.arange(n), slips)
    off = (model.corrected(wrong) - true)[straight]
    spread = model.spread(wrong)[straight]
    assert abs(off[:, 0].mean()) < 0.002
    assert off[:, 0].std() < 0.014
    assert 0.7 < spread[:, 0].mean() / (SAFETY * off[:, 0].std()) < 1.4
    assert 0.7 < spread[:, 2].mean() / (SAFETY * off[:, 2].std()) < 1.4


def test_where_walls_measure_no_step_the_noise_is_that_of_the_other_axes():
    """In a bare hall registration knows nothing of how far the robot came."""
    rng = np.random.default_rng(2)
    n = 200
    true = np.column_stack((rng.uniform(0.3, 0.5, n), np.zeros(n), rng.normal(0, 0.1, n)))
    wrong = true + rng.normal(0, 1, true.shape) * (0.004, 0.002, 0.004)
    registered = true + rng.normal(0, 0.15, (n, 1)) * (1, 0, 0)
    model = fit_odometry(wrong, registered, np.tile(np.diag((0.15**2, 1e-6, 1e-7)), (n, 1, 1)))
    assert model.scales[0] == model.scales[1:].max() < 0.5
    nothing = fit_odometry(wrong, registered, np.tile(np.eye(3), (n, 1, 1)))
    np.testing.assert_array_equal(nothing.scales, np.ones(3))
    # nor whether the wheels are off: bare walls pull every step back
    pulled = fit_odometry(wrong, true * (0.98, 1, 1), np.tile(np.diag((0.5**2, 1e-6, 1e-7)), (n, 1, 1)))
    assert abs(pulled.gains[0, 0]) < 0.006


def test_noise_that_some_steps_measure_is_not_that_of_the_turns():
    """In half of a drive walls measure the way, to a fifth of what odometry that turns badly would leave open."""
    random = np.random.default_rng(0)
    odometry = np.tile((0.42, 0.0, 0.0), (40, 1))
    registered = odometry + random.normal(0, (0.008, 0.01, 0.1), (40, 3))
    variance = np.tile(np.square((0.018, 0.005, 0.005)), (40, 1))
    variance[:20, 0] = 0.09
    model = fit_odometry(odometry, registered, variance[:, None] * np.eye(3))
    assert model.scales[2] > 4
    assert model.scales[0] < 0.6


@pytest.mark.parametrize(("wheels", "scans"), [(0.08, 0.002), (0.05, 0.05), (0.0, 0.0)])
def test_noise_of_the_turns_does_not_dilute_their_gain(wheels: float, scans: float):
    """On a path that is straight but for one turn in twelve most of what noisy wheels say of a turn is noise."""
    rng = np.random.default_rng(2)
    n = 1500
    true = np.column_stack((np.full(n, 0.6), np.zeros(n), np.where(np.arange(n) % 12 == 0, 0.3, 0.0)))
    true[::24, 2] *= -1
    noise = rng.normal(0, 1, (2, n, 3)) * (0.003, 0.001, 0.0)
    noise[:, :, 2] = rng.normal(0, 1, (2, n)) * [[wheels], [scans]]
    counted, found = true * (1.0, 1.0, 1 / 1.03) + noise[0], true + noise[1]
    model = fit_odometry(counted, found, np.tile(np.diag((1e-5, 1e-6, max(scans, 1e-3) ** 2)), (n, 1, 1)))
    turn = model.corrected(np.array([[0.6, 0.0, 0.5]]))[0, 2]
    assert turn == pytest.approx(0.515, abs=0.03)


def test_noise_of_the_turns_says_nothing_of_ways_to_the_left():
    """It turns the end of every step aside, so that most of what wheels say of short ways to the left is noise.

    After an outage round a corner the way to the left is more than a metre.
    """
    rng = np.random.default_rng(2)
    n = 250
    true = np.column_stack((rng.uniform(0.7, 0.9, n), rng.normal(0, 0.01, n), rng.normal(0, 0.04, n)))
    turned = rng.normal(0, 0.06, n)
    wrong = true + np.column_stack((rng.normal(0, 0.04, n), turned * true[:, 0] / 2, turned))
    model = fit_odometry(wrong, true, np.tile(np.diag((1e-4, 1e-5, 1e-6)), (n, 1, 1)))
    corner = np.array((0.5, -1.3, -1.8))
    np.testing.assert_allclose(model.corrected(corner[None])[0], corner, atol=0.2)


def test_errors_of_the_heading_on_a_long_step_move_its_end_aside():
    """As in a simulation, in which the heading errs evenly with the distance; and next to nothing on a short one."""
    rng = np.random.default_rng(5)
    spread, steps, length = np.array((0.1, 0.1, 0.2)), 200, 12.0
    heading = np.cumsum(rng.normal(0, spread[2] / np.sqrt(steps), (4000, steps)), axis=1)
    aside = (length / steps * heading).sum(axis=1).std()
    found = turned_aside(np.array(((length, 0.0, 0.0), (0.0, length, 0.0), (0.1, 0.0, 0.0))), np.tile(spread, (3, 1)))
    np.testing.assert_allclose(found[0], (0.1, np.hypot(0.1, aside), 0.2), rtol=0.05)
    np.testing.assert_allclose(found[1], (np.hypot(0.1, aside), 0.1, 0.2), rtol=0.05)
    np.testing.assert_allclose(found[2], spread, rtol=0.01)


pytestmark = pytest.mark.usefixtures("taichi")

CORNERS = [(-9, -2), (-9, 1), (-4, 1), (-4, 6), (7, 6), (7, 3.5), (4, 3.5), (4, -3), (-1, -3), (-1, -2), (-9, -2)]
WALLS = list(pairwise(CORNERS))
TRUE_STEP = np.array([0.6, 0.1, -0.4])


def scan(pose: np.ndarray) -> ThinnedScan:
    """180 beams all around from a place in a room of many corners."""
    bearings = np.radians(np.arange(0, 360, 2))
    ranges = seen_from(pose[None], WALLS, bearings)[0]
    points = ranges[:, None] * np.column_stack((np.cos(bearings), np.sin(bearings)))
    return thin(points.astype(np.float32), np.zeros(2), GraphConfig().thinning)


def registered(off: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The error [3] of a step whose odometry is off, registered after one scan."""
    steps = StepRegistration(scan(np.zeros(3)), np.zeros(2), CONFIG, proved=True)
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
    steps = StepRegistration(scan(np.zeros(3)), np.zeros(2), CONFIG, proved=True)
    chosen = np.asarray(se2.compose(TRUE_STEP, (0.1, -0.1, 0.05)))
    found = steps.add(scan(TRUE_STEP), Prediction(chosen, np.array((1.0, 1.0, 0.2)), False, chosen, open=True))
    np.testing.assert_array_equal(found.step, chosen)
    np.testing.assert_array_equal(found.information, 0.0)


@pytest.mark.parametrize("late", [0.3, 0.5, -0.5])
def test_where_a_pose_of_the_odometry_came_late_the_scan_chooses(late: float):
    """30 beams, which prove nothing alone; and a filter that is wrong, though odometry and scan know it."""
    whole, odometry = scan(TRUE_STEP), np.asarray(se2.compose(TRUE_STEP, (late, 0, 0)))
    few, spread = ThinnedScan(*(field[::6] for field in whole)), np.array((0.02, 0.02, 0.03))
    for step, filtered in ((odometry, TRUE_STEP), (TRUE_STEP, odometry)):
        steps = StepRegistration(scan(np.zeros(3)), np.zeros(2), CONFIG, proved=True)
        found = steps.add(few, Prediction(step, spread, True, filtered, late=True))
        np.testing.assert_allclose(found.step, TRUE_STEP, atol=0.005)
        assert found.by_filter == (step is odometry)


@pytest.mark.parametrize(
    ("odometry", "filtered", "late"),
    [
        ([0.6, 0.1, 1.1, 0.6, 0.6, 0.6], [0.6] * 6, [1, 2]),
        ([0.6, 0.1, 0.6, 1.1, 0.6, 0.6], [0.6] * 6, [1, 2, 3]),
        ([0.6, 0.1, 0.6, 0.6, 1.1, 0.6], [0.6] * 6, []),
        ([0.6, 0.1, 0.6, 0.6, 0.6, 0.6], [0.6] * 6, []),
        ([0.6] * 6, [0.6, -0.4, 0.6, 0.6, 0.6, 0.6], []),
    ],
    ids=["two steps", "three", "too late", "slip", "fooled filter"],
)
def test_a_pose_came_late_where_odometry_and_filter_agree_again_soon_after(
    odometry: list[float], filtered: list[float], late: list[int]
):
    """By a step too long for one that is too short; the steps since are registered anew, with 60 beams each."""
    nodes = Nodes(CONFIG)
    nodes.scans = [ThinnedScan(*(field[::3].copy() for field in scan(np.array((0.6 * k - 3, 0, 0))))) for k in range(7)]
    nodes.odometry, nodes.filtered = ([np.array((x, 0.0, 0.0)) for x in (0.0, *way)] for way in (odometry, filtered))
    nodes.updates, nodes.measured, nodes.left_open = list(range(7)), [True] * 7, [CLOSED] * 7
    nodes.through = [False] * 7
    chain = Chain(nodes, CONFIG)
    for _ in odometry:
        chain.add()
    if late:
        np.testing.assert_allclose(chain.steps, [(0.6, 0, 0)] * 6, atol=0.02)
    assert [k for k, step in enumerate(chain._predicted) if step.late] == late
    assert chain.fits == bool(late)
    assert len(chain.steps) == len(chain.covariance) == 6


@pytest.mark.parametrize(
    ("filtered", "measured", "deviation", "prior"),
    [
        (0.78, True, 0.08, 0.8),
        (0.5, True, 0.08, 0.65),
        (0.65, True, 0.08, 0.65),
        (0.8, False, 0.08, 0.65),
        (0.65, True, 0.03, 0.8),
        (0.5, True, 0.03, 0.65),
    ],
    ids=["odometry", "registration", "neither", "not measured", "overruled", "by the filter, too"],
)
def test_a_registration_that_alone_contradicts_odometry_and_filter_is_no_prior(
    filtered: float, *, measured: bool, deviation: float, prior: float
):
    odometry, registered, chain = (
        np.array((0.8, 0, 0)),
        np.array((0.5, 0, 0)),
        Chain(nodes_of(np.zeros((0, 3))), CONFIG),
    )
    spread = np.array((deviation, 0.08, 0.03))
    chain._predicted = [Prediction(odometry, spread, measured, np.array((filtered, 0, 0)))]
    chain._proved = [RegisteredStep(registered, 1e4 * np.eye(3), np.zeros(3), by_filter=filtered == 0.5)]
    chain._steps, chain._covariance = [np.array((0.65, 0, 0))], [np.eye(3)]
    assert chain.measured.prior_steps[0, 0] == pytest.approx(prior)
    assert chain.measured.doubted[0]
