"""The pose graph: exact where edges agree, derivatives, and loops that the others contradict."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from loop_candidates import candidate

from moteslam.robot import se2
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.loop_closing import LoopClosing
from moteslam.slam.backend.graph.loop_graph import LoopGraph, Uncertainty
from moteslam.slam.backend.graph.loop_search import Loop
from moteslam.slam.backend.graph.pose_graph import Edges, relative_jacobians, solve

STEP_NOISE = np.array([0.02, 0.01, 0.01])


def laps() -> np.ndarray:
    """True poses along a circle of 40 m, three times round."""
    angle = np.arange(120) * 2 * np.pi / 40
    radius = 40 / (2 * np.pi)
    return np.column_stack((radius * np.sin(angle), radius * (1 - np.cos(angle)), se2.wrap(angle)))


def edges_between(first: np.ndarray, second: np.ndarray, true: np.ndarray, noise: np.ndarray, *, robust: bool) -> Edges:
    relative = np.asarray(se2.compose(se2.between(true[first], true[second]), noise))
    sd = STEP_NOISE if not robust else np.array([0.03, 0.03, 0.01])
    information = np.tile(np.diag(1 / sd**2), (len(first), 1, 1))
    return Edges(first, second, relative, information, np.full(len(first), robust))


def case(seed: int, false: int = 0) -> tuple[np.ndarray, np.ndarray, Edges]:
    """True poses, those of the chain, and a chain with true loops and clusters of five false ones."""
    rng = np.random.default_rng(seed)
    true = laps()
    n = len(true)
    noise = rng.normal(0, 1, (n - 1, 3)) * STEP_NOISE
    chain = edges_between(np.arange(n - 1), np.arange(1, n), true, noise, robust=False)
    first = rng.integers(0, 80, 60)
    loops = edges_between(first, first + 40, true, rng.normal(0, 1, (60, 3)) * (0.03, 0.03, 0.01), robust=True)
    edges = chain.plus(loops)
    for _ in range(false // 5):
        at = rng.integers(0, 60) + np.arange(5)
        wrong = np.append(rng.uniform(-3, 3, 2), rng.uniform(-0.3, 0.3))
        edges = edges.plus(edges_between(at, at + 50, true, np.tile(wrong, (5, 1)), robust=True))
    start = np.vstack((true[:1], se2.accumulate(chain.relative, true[0])))
    return true, start, edges


def rmse(poses: np.ndarray, true: np.ndarray) -> float:
    return float(np.sqrt(np.square(poses[:, :2] - true[:, :2]).sum(axis=1).mean()))


def test_edges_without_errors_are_met_exactly():
    true = laps()
    n = len(true)
    first, second = np.r_[np.arange(n - 1), 0, 90], np.r_[np.arange(1, n), 80, 10]
    edges = edges_between(first, second, true, np.zeros((n + 1, 3)), robust=False)
    start = true + np.random.default_rng(1).normal(0, 0.1, true.shape) * (np.arange(n) > 0)[:, None]
    poses, weights = solve(start, edges, graduated=False)
    np.testing.assert_allclose(poses[:, :2], true[:, :2], atol=1e-5)
    np.testing.assert_allclose(se2.wrap(poses[:, 2] - true[:, 2]), 0, atol=1e-6)
    assert (weights == 1).all()


def test_loops_spread_the_error_of_the_chain():
    true, start, edges = case(2)
    poses, weights = solve(start, edges)
    assert rmse(poses, true) < 0.25 * rmse(start, true)
    assert (weights > 0.25).mean() > 0.97
    np.testing.assert_allclose(poses[0], start[0], atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_false_loops_in_clusters_move_hardly_anything(seed: int):
    _, start, edges = case(seed)
    alone, _ = solve(start, edges)
    true, start, edges = case(seed, false=10)
    poses, weights = solve(start, edges)
    assert (weights[-10:] < 0.25).all()
    assert (weights[:-10] > 0.25).mean() > 0.95
    assert np.hypot(*(poses - alone)[:, :2].T).max() < 0.1 * rmse(alone, true) + 0.02


def test_the_jacobians_are_derivatives():
    rng = np.random.default_rng(5)
    first, second, heading = rng.normal(0, 2, (20, 3)), rng.normal(0, 2, (20, 3)), rng.uniform(-3, 3, 20)

    def error(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        off = np.asarray(se2.between(a, b))
        c, s = np.cos(heading), np.sin(heading)
        return np.column_stack((c * off[:, 0] + s * off[:, 1], -s * off[:, 0] + c * off[:, 1], off[:, 2]))

    by_first, by_second = relative_jacobians(first, second, heading)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-6
        for jacobian, forth, back in (
            (by_first, error(first + step, second), error(first - step, second)),
            (by_second, error(first, second + step), error(first, second - step)),
        ):
            numeric = forth - back
            numeric[:, 2] = se2.wrap(numeric[:, 2])
            np.testing.assert_allclose(jacobian[:, :, axis], numeric / 2e-6, atol=1e-6)


def uncertainty(poses: np.ndarray, edges: Edges) -> Uncertainty:
    return Uncertainty(poses, edges.first, edges.second, np.linalg.inv(edges.information))


@pytest.mark.parametrize("seen_from", [0, 12])
def test_the_uncertainty_of_a_chain_is_its_marginal(seen_from: int):
    """Along a chain the bound is exact, and place and heading err together: out and back, they hardly err apart."""
    rng = np.random.default_rng(6)
    n = 30
    turns = np.where(np.arange(n - 1) == 14, np.pi, rng.normal(0, 0.2, n - 1))
    steps = np.column_stack((rng.uniform(0.5, 1.5, n - 1), rng.normal(0, 0.1, n - 1), turns))
    poses = np.vstack((np.zeros(3), se2.accumulate(steps)))
    # as far along the path as to the side, and headings that go with it
    shape = np.array([[4e-4, 1e-4, 0.0], [1e-4, 1e-4, 2e-5], [0.0, 2e-5, 1e-4]])
    information = np.tile(np.linalg.inv(shape), (n - 1, 1, 1))
    edges = Edges(np.arange(n - 1), np.arange(1, n), steps, information, np.zeros(n - 1, bool))
    for last in (n - 1, 3):
        covariance = uncertainty(poses, edges).of(last)[seen_from]
        first, end = sorted((seen_from, last))
        noise = rng.multivariate_normal(np.zeros(3), shape, (20000, end - first))
        found = np.broadcast_to(np.zeros(3), (20000, 3))
        for k in range(first, end):
            found = np.asarray(se2.compose(found, se2.compose(steps[k], noise[:, k - first])))
        if seen_from > last:
            found = np.asarray(se2.between(found, np.zeros(3)))
        sampled = np.cov(np.asarray(se2.between(se2.between(poses[seen_from], poses[last]), found)).T)
        scale = np.sqrt(np.outer(sampled.diagonal(), sampled.diagonal()))
        np.testing.assert_allclose(covariance / scale, sampled / scale, atol=0.03)
    np.testing.assert_array_equal(uncertainty(poses, edges).of(4)[4], 0.0)


def test_a_loop_makes_both_its_ends_surer():
    _, start, edges = case(7)
    chain = Edges(*(getattr(edges, name)[:119] for name in ("first", "second", "relative", "information", "robust")))
    before, after = (np.linalg.det(uncertainty(start, some).of(119)[:119]) for some in (chain, edges))
    assert (after <= before * (1 + 1e-9)).all()
    assert after[5] < 0.1 * before[5]


NODES = 80


def closing_of(covariance: np.ndarray, poses: np.ndarray) -> LoopClosing:
    """Of a graph of nodes at these poses [n, 3], half a metre of path apart, with one relative covariance [3, 3]."""
    loops: dict[tuple[int, int], Loop] = {}
    graph = SimpleNamespace(
        nodes=None, loops=loops, submaps=SimpleNamespace(path=0.5 * np.arange(NODES)), poses=poses, driven=0.5 * NODES,
        relative=lambda *_: np.tile(covariance, (NODES, 1, 1)), enter=loops.__setitem__, solve=lambda: None,
        misfit=lambda *_: 0.0,
    )  # fmt: skip
    return LoopClosing(cast(LoopGraph, graph), GraphConfig())


@pytest.mark.parametrize(("heading", "half"), [(0.01, np.hypot(0.03, 0.06)), (0.4, np.hypot(1.2, 0.06)), (2.0, np.pi)])
def test_a_loop_is_searched_for_in_all_headings_that_the_covariance_allows(
    heading: float, half: float, monkeypatch: pytest.MonkeyPatch
):
    """After a step whose turn is doubtful the true place may be turned by a radian."""
    closing = closing_of(np.diag((0.09, 0.09, heading**2)), np.zeros((NODES, 3)))
    windows: list[np.ndarray] = []

    def match(submap: int, query: int, predicted: np.ndarray, covariance: np.ndarray) -> None:
        windows.append(closing._search.window(covariance).half)

    monkeypatch.setattr(closing._search, "match", match)
    closing._look_for(NODES - 1)
    np.testing.assert_allclose(windows[0], (np.hypot(0.9, 0.5), np.hypot(0.9, 0.5), half))


@pytest.mark.parametrize(
    ("x", "y", "searched"), [(0.0, 12.0, False), (0.0, 3.0, True), (11.0, 0.0, True), (13.0, 0.0, False)]
)
def test_a_loop_is_searched_for_where_the_covariance_reaches(
    x: float, y: float, searched: bool, monkeypatch: pytest.MonkeyPatch
):
    """Known to a metre across, and to four along: not on the leg beside, and not beyond the end of what is open."""
    poses = np.zeros((NODES, 3))
    poses[-1] = x, y, np.pi / 2
    # in the frame of the node that is looked for, which is turned by a right angle
    closing, tried = closing_of(np.diag((1.0, 16.0, 0.01)), poses), []
    monkeypatch.setattr(closing, "_try", lambda submap, *_: tried.append(submap) or [])
    closing._look_for(NODES - 1)
    assert bool(tried) == searched


@pytest.mark.parametrize(
    ("share", "known", "x", "deviation", "verdict"),
    [
        (0.85, 1.0, 2.6, 0.1, "ambiguous"),
        (0.6, 1.0, 2.6, 0.1, "accepted"),
        (0.6, 0.7, 2.6, 0.1, "ambiguous"),  # it knows less of the endpoints, and explains as much of these
        (0.85, 1.0, 0.3, 0.1, "accepted"),  # the same place
        (0.85, 1.0, 2.6, 2.0, "accepted"),  # the same place for all that is known
    ],
)
def test_a_place_in_another_submap_is_a_rival(share: float, known: float, x: float, deviation: float, verdict: str):
    """Two equal corridors, each driven once: in the submap of one the other is no rival."""
    one, other = 0, 30
    poses = np.zeros((NODES, 3))
    poses[1:-1, 1] = 50.0
    poses[other, 1] = 0.0
    closing = closing_of(np.diag((deviation**2, deviation**2, 1e-4)), poses)

    def match(submap: int, query: int, predicted: np.ndarray, covariance: np.ndarray) -> Loop:
        there, (part, seen) = (x, (share, known)) if submap == other else (0.0, (0.8, 1.0))
        fits = candidate(submap, query, found=(there, 0.0, 0.0), predicted=predicted)
        return Loop(replace(fits, share=part, known=seen, runner_up=0.0), np.eye(3))

    closing._search.match = match  # type: ignore[method-assign]
    closing._look_for(NODES - 1)
    assert closing.graph.loops[one, NODES - 1].candidate.verdict == verdict


def test_a_wider_window_is_searched_in_coarser_steps():
    search = closing_of(np.eye(3), np.zeros((NODES, 3)))._search
    places = [search.window(np.diag((d * d, d * d, 0.01))).places for d in (1.0, 3.0, 10.0)]
    assert places[0] < places[1] < 500_000
    assert places[2] < 50 * places[0]  # for a hundred times the area
