"""What the stages of the back end cost in processor time, at sizes that do not depend on a recording, and on `campus`.

    python benchmarks/back_end_cost.py --out result.json
    python benchmarks/back_end_cost.py --cases solver joint

| case | what |
|---|---|
| solver | 2000 nodes on nested rings, 5000 edges, a tenth of the loops false: all stages of the non-convexity |
| joint | the joint registration of 1000 scans of 180 beams, the first nodes of `campus`, from their solved graph |
| key_scans | `campus` as key scans of a poor odometry: loop search and graph beside the filter, and most memory |
| every_scan | every scan of `campus` by its own robot: the same |

Each case runs in a fresh process on one thread, with the kernels loaded before the clock starts.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from parts.bars import Bar
from parts.machine import most_bytes, save, stamp
from parts.options import result_file
from parts.pool import Row, row_or_error, rows_of
from parts.runs import STEP_NOISE, Case, graph_backend, simulate_case, wheels_case

from moteslam.eval.cli.text import table
from moteslam.robot import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from moteslam.slam.backend.graph.loop_graph import LoopGraph
    from moteslam.slam.backend.graph.pose_graph import Edges

    Array = NDArray[np.float64]

NODES, EDGES, FALSE, CLUSTER = 2000, 5000, 0.1, 5
"""Of the graph that is solved: how many, which share of the loops is false, and how many false ones agree."""
LAP = 200
"""Nodes of a ring of it, 0.5 m apart."""
SCANS = 1000
"""That are registered jointly."""
SEED = 200
"""Of the simulated drives."""
BARS = {
    "solver": (Bar("cpu_s", "worst", 4.0),),
    "joint": (Bar("cpu_s", "worst", 4.0),),
    "key_scans": (Bar("search_and_graph_over_filter", "worst", 1 / 3),),
    "every_scan": (Bar("search_and_graph_over_filter", "worst", 1 / 3), Bar("peak_mb", "worst", 1000.0)),
}


def solver() -> Row:
    """A graph of rings driven again and again, its chain skewed by noise, solved with graduated non-convexity."""
    from moteslam.slam.backend.graph.pose_graph import SCHEDULE, Edges, solve

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
    start = np.vstack((true[:1], se2.accumulate(measured.relative[at], true[0])))
    largest = measured.squares(measured.errors(start))[measured.robust].max()
    began = time.process_time()
    poses, weights = solve(start, measured)
    spent = time.process_time() - began
    return {
        "cpu_s": spent,
        "nodes": NODES,
        "edges": len(measured),
        "largest_square_over_first_scale": float(largest / SCHEDULE[0]),
        "false_kept": float((weights[-wrong:] > 0.5).sum()),
        "rmse_m": float(np.sqrt(np.square(poses[:, :2] - true[:, :2]).sum(axis=1).mean())),
    }


def joint() -> Row:
    """The first nodes of `campus`, registered jointly twice; the second time counts."""
    from moteslam.slam.backend.graph import joint as registration
    from moteslam.slam.backend.graph.endpoints import Endpoints

    graph = solved(wheels_case("campus", SEED, step_noise=STEP_NOISE))
    poses = graph.poses[:SCANS]
    endpoints = Endpoints.of(graph.nodes.scans[:SCANS])
    prior = graph.chain.prior(graph.poses)

    class First:
        """The chain of the first nodes."""

        def prior(self, _: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
            steps, covariance, doubted = prior
            return steps[: SCANS - 1], covariance[: SCANS - 1], doubted[: SCANS - 1]

    spent = []
    for _ in range(2):
        began = time.process_time()
        registration.register_jointly(endpoints, poses, First(), graph._config)  # type: ignore[arg-type]
        spent.append(time.process_time() - began)
    return {"cpu_s": spent[1], "scans": len(poses), "points_a_scan": len(endpoints.points) / len(poses)}


def solved(case: Case) -> LoopGraph:
    """The back end's graph at the end of a run."""
    from moteslam.slam.run import SlamSession
    from moteslam.slam.settings import resolve_config

    session = SlamSession(case.recording, resolve_config("default"))
    for _ in session:
        pass
    closing = graph_backend(session)._closing
    assert closing is not None
    return closing.graph


def stages(case: Case) -> Row:
    """Processor time of a whole run: the filter, the chain, loop search and graph, the joint registrations."""
    from moteslam.slam.backend.graph import backend
    from moteslam.slam.backend.graph.chain import Chain
    from moteslam.slam.run import SlamSession
    from moteslam.slam.settings import resolve_config
    from moteslam.slam.tsdf.filter import TsdfFilter

    config = resolve_config("default")
    with (
        counted(TsdfFilter, "step") as filtering,
        counted(backend, "register_jointly") as jointly,
        counted(Chain, "add") as chaining,
        counted(backend.GraphBackend, "add") as adding,
        counted(backend.GraphBackend, "finish", first=True) as finishing,
    ):
        session = SlamSession(case.recording, config)
        for _ in session:
            pass
        estimate = session.estimate()
    rest = adding[0] + finishing[0] - jointly[0] - chaining[0]
    return {
        "filter_cpu_s": filtering[0],
        "chain_cpu_s": chaining[0],
        "search_and_graph_cpu_s": rest,
        "joint_cpu_s": jointly[0],
        "search_and_graph_over_filter": rest / filtering[0],
        "scans": len(session),
        "loops": len(estimate.loops),
        "peak_mb": most_bytes() / 1e6,
    }


@contextmanager
def counted(owner: Any, name: str, *, first: bool = False) -> Iterator[list[float]]:
    """Processor time [s] that a function takes, in the one element of a list; its first call counts where asked for."""
    function: Callable[..., Any] = getattr(owner, name)
    spent, calls = [0.0], 0

    def timed(*arguments: Any, **more: Any) -> Any:
        nonlocal calls
        began = time.process_time()
        try:
            return function(*arguments, **more)
        finally:
            calls += 1
            spent[0] += time.process_time() - began if first or calls > 1 else 0.0

    setattr(owner, name, timed)
    try:
        yield spent
    finally:
        setattr(owner, name, function)


CASES: dict[str, Callable[[], Row]] = {
    "solver": solver,
    "joint": joint,
    "key_scans": lambda: stages(wheels_case("campus", SEED, step_noise=STEP_NOISE)),
    "every_scan": lambda: stages(simulate_case("campus", SEED)),
}


def measure(case: str) -> Row:
    """The figures of one case; what went wrong, if it crashes."""
    from moteslam.kernels import runtime

    runtime.init("cpu", 1)
    return row_or_error({"case": case}, CASES[case])


def main() -> int:
    """Measure one case after the other, print a table, and write the result file; 1 where a bar does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=tuple(CASES), default=list(CASES), metavar="CASE")
    parser.add_argument("--out", type=result_file)
    options = parser.parse_args()
    rows: list[Row] = []
    for case in options.cases:
        rows += rows_of(measure, [(case,)], 1)
        save(options.out, {**stamp(), "rows": rows})
    lines: list[tuple[str, ...]] = [("case", "figure", "value", "bar", "holds")]
    held = True
    for row in rows:
        bars = {bar.figure: bar for bar in BARS[row["case"]]}
        for figure, value in row.items():
            if not isinstance(value, float):
                continue
            bar = bars.get(figure)
            holds = bar is None or bar.holds(value)
            held &= holds
            said = ("", "") if bar is None else (f"at most {bar.limit:.3g}", "yes" if holds else "NO")
            lines.append((row["case"], figure, f"{value:.4g}", *said))
    print(table(lines, right=(2,)))
    return 0 if held and not any("error" in row for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
