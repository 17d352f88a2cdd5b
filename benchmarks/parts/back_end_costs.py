"""What the stages of the back end cost: the cases of ``cost.py`` that measure them alone."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.backend.graph import backend
from moteslam.slam.backend.graph import joint as registration
from moteslam.slam.backend.graph.backend import GraphBackend
from moteslam.slam.backend.graph.chain import Chain
from moteslam.slam.backend.graph.joint import Endpoints
from moteslam.slam.backend.graph.pose_graph import Edges, MeasuredChain, solve
from moteslam.slam.online import OnlineSlam, run_slam
from moteslam.slam.tsdf.filter import TsdfFilter
from parts.harness import Row, memory
from parts.runs import NOISY, simulate_case, start_kernels

Array = NDArray[np.float64]

NODES, EDGES, FALSE, CLUSTER = 2000, 5000, 0.1, 5
"""Of the graph that is solved: how many, which share of the loops is false, and how many false ones agree."""
LAP = 200  # Nodes of a ring of it, 0.5 m apart
SEED = 200  # Of the simulated drives


def solver(*_: Any) -> Row:
    """A graph of rings driven again and again, its chain skewed by noise, solved with graduated non-convexity."""
    random = np.random.default_rng(SEED)
    angle = 2 * np.pi * np.arange(NODES) / LAP
    radius = LAP * 0.5 / (2 * np.pi)
    true = np.column_stack((radius * np.sin(angle), radius * (1 - np.cos(angle)), se2.wrap(angle)))

    def edges(first: NDArray[np.intp], second: NDArray[np.intp], off: Array, deviation: Array, robust: bool) -> Edges:
        relative = np.asarray(se2.compose(se2.between(true[first], true[second]), off))
        information = np.tile(np.diag(1 / deviation**2), (len(first), 1, 1))
        return Edges(first, second, relative, information, np.full(len(first), robust))

    step, loop = np.array((0.02, 0.01, 0.005)), np.array((0.03, 0.03, 0.01))
    at = np.arange(NODES - 1)
    measured = edges(at, at + 1, random.normal(0, 1, (len(at), 3)) * step, step, False)
    loops = EDGES - len(at)
    wrong = int(FALSE * loops) // CLUSTER * CLUSTER
    first = random.integers(0, NODES - LAP, loops - wrong)
    laps = LAP * (1 + random.integers(0, (NODES - 1 - first) // LAP))
    measured = measured.plus(edges(first, first + laps, random.normal(0, 1, (len(first), 3)) * loop, loop, True))
    clusters = wrong // CLUSTER
    first = np.repeat(random.integers(0, NODES - 2 * LAP, clusters), CLUSTER) + np.tile(range(CLUSTER), clusters)
    off = np.repeat(random.uniform((-3, -3, -0.3), (3, 3, 0.3), (clusters, 3)), CLUSTER, axis=0)
    measured = measured.plus(edges(first, first + LAP // 2, off, loop, True))
    chain = np.vstack((true[:1], se2.accumulate(measured.relative[at], true[0])))
    began = time.process_time()
    poses, weights = solve(chain, measured)
    spent = time.process_time() - began
    return {
        "cpu_s": spent,
        "nodes": NODES,
        "edges": len(measured),
        "false_kept": float((weights[-wrong:] > 0.5).sum()),
        "rmse_m": float(np.sqrt(np.square(poses[:, :2] - true[:, :2]).sum(axis=1).mean())),
    }


def joint(_seed: int, _settings: list[str], scans: int) -> Row:
    """The first nodes of `campus`, registered jointly twice; the second time counts."""
    config = start_kernels([], 1)
    session = OnlineSlam.over(simulate_case("campus", SEED, **NOISY).recording, config)
    for _ in session:
        pass
    assert isinstance(session._backend, GraphBackend)
    assert session._backend._closing is not None
    graph = session._backend._closing.graph
    endpoints = Endpoints.of(graph.nodes.scans[:scans])
    chain = MeasuredChain._make(part[: scans - 1] for part in graph.measured)
    for _ in range(2):
        began = time.process_time()
        reach = graph._config.joint.first_reach
        registration.register_jointly(endpoints, graph.poses[:scans], chain, graph._config, reach)
        spent = time.process_time() - began
    return {"cpu_s": spent, "scans": scans, "points_a_scan": len(endpoints.points) / scans}


def back_end(_seed: int, _settings: list[str], *, keys: bool) -> Row:
    """Processor time over `campus`: the filter, the chain, loop search and graph, the joint registrations."""
    config = start_kernels([], 1)
    case = simulate_case("campus", SEED, **(NOISY if keys else {}))
    with (
        counted(TsdfFilter, "step") as filtering,
        counted(backend, "register_jointly") as jointly,
        counted(Chain, "add") as chaining,
        counted(backend.GraphBackend, "add") as adding,
        counted(backend.GraphBackend, "finish", first=True) as finishing,
    ):
        estimate = run_slam(case.recording, config)
    rest = adding[0] + finishing[0] - jointly[0] - chaining[0]
    return {
        "filter_cpu_s": filtering[0],
        "chain_cpu_s": chaining[0],
        "search_and_graph_cpu_s": rest,
        "joint_cpu_s": jointly[0],
        "search_and_graph_over_filter": rest / filtering[0],
        "loops": len(estimate.loops),
        "peak_mb": memory("VmHWM"),
    }


@contextmanager
def counted(owner: Any, name: str, *, first: bool = False) -> Iterator[list[float]]:
    """Processor time [s] that a function takes, in the one element of a list; its first call counts where asked for."""
    function: Callable[..., Any] = getattr(owner, name)
    spent, calls = [0.0], 0

    def timed(*given: Any, **more: Any) -> Any:
        nonlocal calls
        began = time.process_time()
        try:
            return function(*given, **more)
        finally:
            calls += 1
            spent[0] += time.process_time() - began if first or calls > 1 else 0.0

    setattr(owner, name, timed)
    try:
        yield spent
    finally:
        setattr(owner, name, function)
