"""The joint registration: scans held to each other, bare corridors, and which step is its prior."""

from itertools import pairwise
from typing import cast

import numpy as np
import pytest
from graph_cases import key_scan
from numpy.typing import NDArray

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.slam.backend.graph import pose_graph
from moteslam.slam.backend.graph.chain import Chain
from moteslam.slam.backend.graph.config import GraphConfig, JointConfig
from moteslam.slam.backend.graph.joint import Endpoints, choose_partners, register_jointly
from moteslam.slam.backend.graph.loop_search import LoopSearch, Submaps
from moteslam.slam.backend.graph.nodes import Nodes
from moteslam.slam.backend.graph.pose_graph import BlockSystem, MeasuredChain
from moteslam.slam.inputs.step import thin
from moteslam.slam.registration.config import RegistrationConfig

pytestmark = pytest.mark.usefixtures("taichi")

Array = NDArray[np.float64]
REGISTRATION = RegistrationConfig()
FIRST, LAST = JointConfig().first_reach, JointConfig().last_reach
BEAMS = np.radians(np.arange(-90, 91, 1.0))
FREE = GraphConfig(registration=RegistrationConfig(degenerate=0.0))
"""Without offsets along the least informed directions."""


class Given:
    """A chain of which all steps are known alike."""

    def __init__(self, steps: Array, deviation: tuple[float, float, float]) -> None:
        self._steps, self._covariance = steps, np.diag(np.square(deviation))

    def prior(self, start: Array, config: RegistrationConfig) -> tuple[Array, Array, NDArray[np.bool_]]:
        n = len(self._steps)
        return self._steps, np.repeat(self._covariance[None], n, axis=0), np.zeros(n, bool)


def scan_between_walls(rng: np.random.Generator) -> ThinnedScan:
    """A scan forwards between walls at y = +-1 m, of 4 m range and 1 cm noise."""
    ranges = 1.0 / np.maximum(np.abs(np.sin(BEAMS)), 1e-9)
    seen = ranges < 4.0
    ranges = ranges[seen] + rng.normal(0, 0.01, int(seen.sum()))
    points = ranges[:, None] * np.column_stack((np.cos(BEAMS[seen]), np.sin(BEAMS[seen])))
    return thin(points.astype(np.float32), np.zeros(2), GraphConfig().thinning)


def moved_along(config: GraphConfig, deviation: float = 0.05) -> float:
    """How much longer or shorter a joint registration makes a path of 15 m [m]; ``deviation`` is a step's [m]."""
    rng = np.random.default_rng(7)
    poses = np.column_stack((0.5 * np.arange(31), np.zeros((31, 2))))
    scans = [scan_between_walls(rng) for _ in poses]
    chain = cast(MeasuredChain, Given(np.asarray(se2.between(poses[:-1], poses[1:])), (deviation, 0.005, 0.002)))
    return float(register_jointly(Endpoints.of(scans), poses, chain, config, FIRST)[-1, 0] - poses[-1, 0])


def room() -> Array:
    """Endpoints [n, 2] on the walls of a room of 12 m by 8 m."""
    share = np.linspace(0, 1, 80, endpoint=False)[:, None]
    corners = np.array([[-6.0, -4.0], [6.0, -4.0], [6.0, 4.0], [-6.0, 4.0], [-6.0, -4.0]])
    return np.vstack([a + share * (b - a) for a, b in pairwise(corners)])


def scans_of_the_room(poses: Array) -> list[ThinnedScan]:
    """All its endpoints, seen from poses [n, 3]."""
    ends = [se2.transform_points(se2.between(pose, np.zeros(3)), room()).astype(np.float32) for pose in poses]
    return [thin(points, np.zeros(2), GraphConfig().thinning) for points in ends]


class Driven:
    """Nodes and their chain, as key scans come in."""

    def __init__(self, points: NDArray[np.float32]) -> None:
        self.nodes, self.keys = Nodes(GraphConfig()), 0
        self.nodes.add(key_scan(0, np.zeros(3), points))
        self.chain = Chain(self.nodes, GraphConfig())

    def on(self, odometry: float, points: NDArray[np.float32], *, filtered: float | None = None) -> None:
        """As far ahead by the odometry and by the filter."""
        self.keys += 1
        ahead = odometry if filtered is None else filtered
        if self.nodes.add(key_scan(self.keys, (odometry, 0.0, 0.0), points, motion=(ahead, 0.0, 0.0))):
            self.chain.add()


def test_between_bare_walls_the_chain_says_how_far_the_robot_came():
    """The errors of the normals pull along the walls; that pull has an unknown offset, and the chain none."""
    assert abs(moved_along(GraphConfig())) < 0.03
    # of a poor odometry: the same offset is counted once for all pairs of scans
    assert abs(moved_along(GraphConfig(), 0.2)) < 0.2
    assert abs(moved_along(FREE)) > 0.25


def test_where_scans_share_nothing_the_chain_decides():
    """On a path that turns, of scans out of each other's sight, from poses that are far off."""
    true = np.asarray(se2.accumulate(np.tile((40.0, 10.0, 1.1), (6, 1))))
    steps = np.asarray(se2.between(true[:-1], true[1:]))
    scans = [scan_between_walls(np.random.default_rng(k)) for k in range(6)]
    off = true + np.random.default_rng(1).normal(0, (1.0, 1.0, 0.2), true.shape) * (np.arange(6) > 0)[:, None]
    found = register_jointly(
        Endpoints.of(scans), off, cast(MeasuredChain, Given(steps, (0.1, 0.05, 0.02))), GraphConfig(), FIRST
    )
    np.testing.assert_allclose(found[:, :2], true[:, :2], atol=1e-3)
    np.testing.assert_allclose(se2.wrap(found[:, 2] - true[:, 2]), 0.0, atol=1e-4)


def test_a_round_comes_next_to_the_place_that_a_scan_fits():
    """It would not with a wrong derivative by where the scans stand, and come there in many rounds all the same."""
    true = np.array([(0.0, 0.0, 0.0), (2.0, 2.5, 0.4)])
    chain = cast(MeasuredChain, Given(np.asarray(se2.between(true[:-1], true[1:])), (1.0, 1.0, 1.0)))
    off = true + np.array([(0.0, 0.0, 0.0), (0.05, -0.05, 0.04)])
    found = register_jointly(Endpoints.of(scans_of_the_room(true)), off, chain, GraphConfig(), FIRST, rounds=1)
    np.testing.assert_allclose(found, true, atol=3e-3)


def test_scans_that_are_not_free_stay_where_they_are():
    """Three scans of a path through a room are off; one of them is free, then all three, then none."""
    rng = np.random.default_rng(3)
    true = np.column_stack((np.linspace(0, 3, 7), np.zeros((7, 2))))
    true[1:, 2] = rng.uniform(-0.2, 0.2, 6)
    scans = scans_of_the_room(true)
    chain = cast(MeasuredChain, Given(np.asarray(se2.between(true[:-1], true[1:])), (0.1, 0.1, 0.1)))
    off = true.copy()
    off[[2, 3, 5], 0] += 0.02
    for free in ([3], [2, 3, 5], []):
        which = np.isin(np.arange(7), free)
        found = register_jointly(Endpoints.of(scans), off, chain, GraphConfig(), LAST, which)
        np.testing.assert_array_equal(found[~which], off[~which])
        np.testing.assert_allclose(found[which], true[which], atol=0.012 if free == [3] else 0.005)


def test_a_registration_far_from_the_odometry_is_no_prior():
    """A room, seen every 0.6 m, where one registration found a place half a metre farther."""
    drive = Driven(room().astype(np.float32))
    for k in range(1, 7):
        drive.on(0.6, (room() - (0.6 * k, 0.0)).astype(np.float32))
    chain = drive.chain
    driven = np.column_stack((0.6 * np.arange(6), np.zeros((6, 2))))
    steps, covariance, _ = chain.measured.prior(driven, REGISTRATION)
    np.testing.assert_array_equal(steps, chain.steps)
    np.testing.assert_array_equal(covariance, chain.covariance)
    chain._proved[2] = chain._proved[2]._replace(step=np.array([1.1, 0.0, 0.0]))
    doubted, deviations, which = chain.measured.prior(driven, REGISTRATION)
    np.testing.assert_array_equal(doubted[[0, 1, 3, 4]], steps[[0, 1, 3, 4]])
    np.testing.assert_allclose(doubted[2], (0.6, 0.0, 0.0))
    assert deviations[2, 0, 0] > 2 * covariance[2, 0, 0]
    np.testing.assert_array_equal(which, [False, False, True, False, False])
    turned = np.array([0.6 * np.cos(0.2), 0.6 * np.sin(0.2), 0.4])  # as the odometry, but for the heading
    chain._proved[2] = chain._proved[2]._replace(step=turned)
    assert not chain.measured.prior(driven, REGISTRATION)[2].any()
    chain._proved[2] = chain._proved[2]._replace(step=turned + np.array((0.5, 0.0, 0.0)))
    bent = np.asarray(se2.accumulate(np.insert(np.delete(steps, 2, axis=0), 2, turned, axis=0)))
    doubted, _, which = chain.measured.prior(np.vstack((np.zeros(3), bent)), REGISTRATION)
    np.testing.assert_allclose(doubted[2], turned, atol=1e-9)
    assert which[2]


def test_where_wheels_slip_a_little_the_prior_is_as_wide_as_registration_and_odometry_are_apart():
    drive = Driven(room().astype(np.float32))
    for k in range(1, 7):
        drive.on(0.6 + 0.2 * (k == 3), (room() - (0.6 * k, 0.0)).astype(np.float32), filtered=0.6)
    chain = drive.chain.measured
    assert chain.doubted.tolist() == [False, False, True, False, False]
    np.testing.assert_array_equal(chain.prior_steps, chain.steps)
    assert chain.prior_covariance[2, 0, 0] > 0.19**2 > 100 * chain.covariance[2, 0, 0]


def test_a_path_that_contradicts_a_step_is_its_own_prior_there():
    """The wheels did not count on one step of seven; what the path has in its place is held loosely."""
    rng = np.random.default_rng(3)
    drive = Driven(scan_between_walls(rng).points)
    for k in range(1, 8):
        drive.on(0.0 if k == 4 else 0.6, scan_between_walls(rng).points)
    chain = drive.chain.measured
    counted = np.vstack((np.zeros(3), se2.accumulate(chain.steps)))
    steps, covariance, _ = chain.prior(counted, REGISTRATION)
    lacking = int(np.argmin(steps[:, 0]))
    assert steps[lacking, 0] < 0.01
    true = counted.copy()
    true[lacking + 1 :, 0] += 0.6
    held, loose, doubted = chain.prior(true, REGISTRATION)
    assert held[lacking, 0] == pytest.approx(steps[lacking, 0] + 0.6, abs=1e-3)
    assert doubted[lacking]
    assert loose[lacking, 0, 0] > 4 * covariance[lacking, 0, 0]
    others = np.arange(len(steps)) != lacking
    np.testing.assert_allclose(held[others], steps[others])
    np.testing.assert_allclose(loose[others], covariance[others])


def test_a_step_that_the_odometry_leaves_open_is_the_filters_and_scans_without_points_are_no_nodes():
    """After twelve metres without a point the filter's search decides, after half a metre the odometry."""
    rng = np.random.default_rng(3)
    drive = Driven(scan_between_walls(rng).points)
    drive.on(0.6, scan_between_walls(rng).points)
    for _ in range(23):
        drive.on(0.5, np.zeros((0, 2), np.float32))
    drive.on(0.5, scan_between_walls(rng).points, filtered=-1.5)
    for _ in range(2):
        drive.on(0.6, scan_between_walls(rng).points)
    chain = drive.chain.measured
    np.testing.assert_allclose(chain.steps[:, 0], (0.6, 10.0, 0.6), atol=0.05)
    assert chain.covariance[1, 0, 0] > 0.3
    path = np.vstack((np.zeros(3), se2.accumulate(chain.steps)))
    np.testing.assert_array_equal(chain.prior(path, REGISTRATION)[2], [False, True, False])


def test_a_loop_between_bare_walls_keeps_the_prediction_along_them_and_binds_less_there():
    """All nodes are where they say: what the endpoints find along the walls is the error of their normals."""
    rng = np.random.default_rng(3)
    drive = Driven(scan_between_walls(rng).points)
    for _ in range(13):
        drive.on(0.5, scan_between_walls(rng).points)
    nodes = drive.nodes
    submaps = Submaps(nodes, GraphConfig())
    submaps.follow(np.tile((0.5, 0.0, 0.0), (len(nodes) - 1, 1)))
    covariance = np.diag(np.square((0.5, 0.5, 0.06))) / 9

    def searched(config: GraphConfig, along: float) -> tuple[float, float]:
        """By how much the prediction is changed along the walls, and the information along them."""
        found = LoopSearch(nodes, submaps, config).match(4, 6, np.array((along, 0.06, 0.02)), covariance)
        np.testing.assert_allclose(found.candidate.found[1:], 0.0, atol=0.005)
        return abs(float(found.candidate.found[0]) - along), float(found.information[0, 0])

    for along in (1.0, 1.2):
        (kept, less), (moved, more) = searched(GraphConfig(), along), searched(FREE, along)
        assert kept < 0.5 * moved
        assert less < 0.5 * more


SCANS, EACH = 30, 40


def along_a_wall(rng: np.random.Generator) -> tuple[Endpoints, Array]:
    """Scans that each see ten metres of a wall, a metre on from one to the next; the last sees nothing."""
    counts = np.r_[np.full(SCANS - 1, EACH), 0]
    points = np.column_stack((rng.uniform(0, 10, counts.sum()), rng.uniform(1, 1.4, counts.sum()))).astype(np.float32)
    starts = np.r_[0, np.cumsum(counts)].astype(np.int32)
    owners = np.repeat(np.arange(SCANS), counts).astype(np.int32)
    poses = np.column_stack((np.arange(SCANS), np.zeros((SCANS, 2)))).astype(float)
    return Endpoints(points, np.zeros_like(points), starts, owners), poses


def test_partners_see_the_same_wall():
    endpoints, poses = along_a_wall(np.random.default_rng(0))
    held = np.arange(SCANS) % 5 != 3
    full = choose_partners(endpoints, poses, 8, held)
    assert (full[~held] == -1).all()
    assert (full[-1] == -1).all()
    for scan, row in enumerate(full):
        others = row[row >= 0]
        assert len(others) == len(set(others.tolist()) - {scan})
        assert (np.abs(others - scan) < 10).all()
    assert (full[10, :8] >= 0).all()


@pytest.mark.parametrize("n", [2, 20])
def test_full_and_sparse_systems_have_the_same_solution(n: int, monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(n)
    first = np.r_[np.arange(n - 1), rng.integers(0, n, 15)]
    second = np.r_[np.arange(1, n), rng.integers(0, n, 15)]
    apart = first != second
    first, second = first[apart], second[apart]
    jacobians = rng.normal(size=(2, len(first), 3, 3))
    one, other = jacobians
    system = BlockSystem(n, first, second)
    own = system.sums(np.swapaxes(one, 1, 2) @ one, np.swapaxes(other, 1, 2) @ other) + np.eye(3)
    pairs, right = np.swapaxes(one, 1, 2) @ other, rng.normal(size=(n, 3))
    full = system.solve(own, pairs, right)
    monkeypatch.setattr(pose_graph, "DENSE", 0)
    np.testing.assert_allclose(system.solve(own, pairs, right), full, rtol=1e-9, atol=1e-12)
