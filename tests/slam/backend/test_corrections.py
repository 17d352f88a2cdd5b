"""Corrections while the robot drives: what holds the frame, which endpoints count, what a registration leaves."""

from types import SimpleNamespace

import numpy as np
import pytest
from graph_cases import key_scan, loop

from moteslam.robot import raster, se2
from moteslam.slam.backend.graph import backend
from moteslam.slam.backend.graph.backend import contradictions, laid_over, sharpest
from moteslam.slam.backend.graph.config import GraphConfig, JointConfig
from moteslam.slam.backend.graph.joint import Endpoints, sharpness
from moteslam.slam.backend.graph.loop_closing import LoopClosing
from moteslam.slam.backend.graph.loop_graph import LoopGraph
from moteslam.slam.backend.graph.nodes import Nodes

pytestmark = pytest.mark.usefixtures("taichi")


def graph_of(steps: int) -> LoopGraph:
    """A graph of one more node than steps of a metre."""
    config = GraphConfig()
    nodes = Nodes(config)
    nodes.add(key_scan(0, np.zeros(3)))
    graph = LoopGraph(nodes, config)
    for k in range(1, steps + 2):
        if nodes.add(key_scan(k, (1.0, 0.0, 0.0))):
            graph.extend()
    return graph


def enter(graph: LoopGraph, first: int, second: int, found: tuple[float, float, float]) -> None:
    graph.enter((first, second), loop(first, second, found, se2.between(graph.poses[first], graph.poses[second])))


def test_a_correction_leaves_the_known_map_where_it_was():
    rng = np.random.default_rng(3)
    before = np.column_stack((rng.uniform(0, 50, (20, 2)), rng.uniform(-3, 3, 20)))
    more = np.vstack((before, [[60.0, 5.0, 0.3]]))
    turned = np.asarray(se2.compose((0.4, -0.2, 0.003), more))
    np.testing.assert_allclose(laid_over(turned, before), more, atol=1e-9)
    spinning = np.column_stack((rng.normal(0, 1e-6, (20, 2)), rng.uniform(-3, 3, 20)))
    turned = np.asarray(se2.compose((0.4, -0.2, 0.3), spinning))
    np.testing.assert_allclose(se2.between(laid_over(turned, spinning), spinning), 0, atol=1e-5)


def test_endpoints_of_some_scans_are_numbered_anew_and_thinned_ones_are_every_third_of_a_scan():
    starts, owners = np.array([0, 4, 4, 6], np.int32), np.array([0, 0, 0, 0, 2, 2], np.int32)
    points = np.arange(12, dtype=np.float32).reshape(6, 2)
    scans = Endpoints(points, -points, starts, owners)
    for found, which, firsts, whose in (
        (scans.only(np.array([1, 2])), [4, 5], [0, 0, 2], [1, 1]),
        (scans.thinned(3), [0, 3, 4], [0, 2, 2, 3], [0, 0, 2]),
    ):
        for ours, expected in zip(found, (points[which], -points[which], firsts, whose), strict=True):
            np.testing.assert_array_equal(ours, expected)


def closing_of(nodes: int, found: tuple[float, float, float]) -> tuple[backend.GraphBackend, LoopClosing]:
    """A back end of as many nodes, a metre apart along x, and a new loop from node 0 to 18."""
    one = backend.GraphBackend(GraphConfig())
    for k in range(nodes + 1):
        one.add(key_scan(k, (1.0 if k else 0.0, 0.0, 0.0), pose=(k, 0.0, 0.0)))
    closing = one._closing
    enter(closing.graph, 0, 18, found)
    closing.news.add((0, 18))
    return one, closing


@pytest.mark.parametrize(("distance", "corrects"), [(0.1, True), (20.0, False)])
def test_a_correction_moves_no_node_much_farther_than_its_loops_are_off(
    monkeypatch: pytest.MonkeyPatch, distance: float, corrects: bool
):
    """Though its map may have fewer cells: one part of it may lie over another."""
    monkeypatch.setattr(backend, "sharpness", lambda endpoints, poses: -float(np.abs(poses).max()))
    one, closing = closing_of(21, (17.9, 0.0, 0.0))
    moved = np.eye(21, 3, k=-20) * distance
    monkeypatch.setattr(one, "_registered", lambda graph, endpoints, off: graph.poses + moved)
    assert (one._correction(closing) is not None) == corrects


def test_the_first_correction_leaves_the_map_in_its_frame(monkeypatch: pytest.MonkeyPatch):
    """A joint registration may turn the whole of it about the first scan."""
    monkeypatch.setattr(backend, "sharpness", lambda endpoints, poses: -float(np.abs(np.diff(poses[:, 1])).max()))
    one, closing = closing_of(21, (17.9, 0.0, 0.0))
    before = np.array(one._path.values)
    bent = before + 0.06 * np.sin(np.arange(22) / 2)[:, None] * np.array((0.0, 1.0, 0.0))
    turned = np.asarray(se2.compose((0.0, 0.0, 0.02), bent))
    monkeypatch.setattr(one, "_registered", lambda graph, endpoints, off: turned[:21])
    monkeypatch.setattr(closing.graph, "misfit", lambda pairs, poses: 0.1 if poses[-1, 2] == 0 else 0.05)
    corrected = one._correction(closing)
    assert np.abs(turned - before)[:21].max() > 0.35
    assert np.abs(corrected - before).max() < 0.1


def test_what_was_registered_jointly_is_bent_by_later_loops_alone():
    graph = graph_of(20)
    assert len(graph.nodes) == 21
    enter(graph, 0, 10, (10.0, 0.3, 0.0))
    graph.solve()
    bent = graph.poses.copy()
    assert bent[10, 1] == pytest.approx(0.3, abs=0.05)
    registered = np.asarray(se2.compose(bent, (0.0, 0.01, 0.0)))
    graph.register(registered)
    graph.solve()
    np.testing.assert_allclose(graph.poses, registered, atol=1e-4)
    enter(graph, 0, 20, (20.0, 1.5, 0.0))
    graph.solve()
    assert graph.poses[20, 1] == pytest.approx(1.5, abs=0.2)
    graph.solve_as_measured()
    assert graph.poses[10, 1] == pytest.approx(0.3, abs=0.1)
    assert all(found.accepted for found in graph.ledger)


CELLS = np.array((1000, 1010, 990, 1000))
FEW, CLEARLY = (2, 30, -4, 20), (12, 11, 14, 9)
"""How many cells less, of each direction: within what these differ by, and by more."""


@pytest.mark.parametrize(
    ("elsewhere", "fewer", "starts", "taken"),
    [
        (0.0, FEW, 1, False),
        (0.1, FEW, 1, False),
        (2.0, FEW, 2, False),
        (2.0, CLEARLY, 2, True),
        (2.0, (0, 0, 0, 0), 2, False),
    ],
)
def test_a_joint_registration_starts_from_each_path_and_one_that_contradicts_must_be_clearly_sharper(
    monkeypatch: pytest.MonkeyPatch, elsewhere: float, fewer: tuple[int, ...], starts: int, taken: bool
):
    """Laid over each other rigidly first; by more cells than the directions of the grid differ in what they count."""
    graph, started = graph_of(12), []

    def register(endpoints: Endpoints, poses: np.ndarray, *given: object) -> np.ndarray:
        if given[-1] == JointConfig().last_reach:
            started.append(poses)
        return poses

    def cells(endpoints: Endpoints, poses: np.ndarray) -> np.ndarray:
        return CELLS - np.array(fewer) * bool(np.ptp(poses[:, 1]) > 1)

    monkeypatch.setattr(backend, "register_jointly", register)
    monkeypatch.setattr(backend, "cells_along", cells)
    bent = graph.poses + np.eye(13, 3, k=-6)[:, [1, 0, 2]] * elsewhere
    found, measured = sharpest(graph, np.asarray(se2.compose((3.0, 2.0, 1.0), bent)), GraphConfig())
    assert len(started) == starts
    np.testing.assert_array_equal(started[0], graph.poses)
    laid = se2.between(started[-1][0], started[-1])
    np.testing.assert_allclose(laid, bent if starts == 2 else graph.poses, atol=1e-9)
    assert measured != taken
    np.testing.assert_array_equal(found, started[-1 if taken else 0])


@pytest.mark.parametrize(("fewer", "taken"), [(FEW, False), (CLEARLY, True)])
def test_what_a_wide_reach_pulls_together_must_be_clearly_sharper(
    monkeypatch: pytest.MonkeyPatch, fewer: tuple[int, ...], taken: bool
):
    graph = graph_of(12)
    pulled = graph.poses + np.eye(13, 3, k=-6)[:, [1, 0, 2]]

    def register(endpoints: Endpoints, poses: np.ndarray, *given: object) -> np.ndarray:
        return pulled if given[-1] == JointConfig().first_reach else poses

    def cells(endpoints: Endpoints, poses: np.ndarray) -> np.ndarray:
        return CELLS - np.array(fewer) * (poses is pulled)

    monkeypatch.setattr(backend, "register_jointly", register)
    monkeypatch.setattr(backend, "cells_along", cells)
    found, _ = sharpest(graph, graph.poses, GraphConfig())
    np.testing.assert_array_equal(found, pulled if taken else graph.poses)


def test_what_the_final_path_contradicts_is_told(monkeypatch: pytest.MonkeyPatch):
    graph = graph_of(12)
    assert contradictions(graph, graph.poses, (), measured=True) == ()
    bent = graph.poses.copy()
    bent[7:, :2] += (1.0, 2.0)
    (step,) = contradictions(graph, bent, (), measured=False)  # no loop, none left
    assert (step.code, step.count) == ("step-contradicted", 1)
    monkeypatch.setattr(type(graph), "ledger", (SimpleNamespace(accepted=True),), raising=False)
    left, _ = contradictions(graph, bent, (), measured=False)
    assert (left.code, left.count) == ("graph-left", 1)
    first, last = graph.nodes.stamps[6:8]
    assert f"from {first:.2f} to {last:.2f} s, by 2.24 m" in step.message


def test_cells_are_counted_alike_on_a_grid_and_by_sorting(monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(4)
    points = rng.uniform(-3, 3, (400, 2)).astype(np.float32)
    owners = np.repeat(np.arange(4), 100).astype(np.int32)
    scans = Endpoints(points, points, np.arange(0, 401, 100, dtype=np.int32), owners)
    poses = rng.uniform(-20, 20, (4, 3))
    counted = sharpness(scans, poses)
    monkeypatch.setattr(raster, "LARGEST_GRID", 0)
    assert sharpness(scans, poses) == counted
    assert 300 < counted <= 400
    assert sharpness(scans, poses[[0, 0, 0, 0]]) <= 400
    again = Endpoints(points[np.arange(400) % 100], points, scans.starts, owners)
    assert sharpness(again, poses[[0, 0, 0, 0]]) <= 100
