"""Sessions of one building bound to each other: how exact it is, which loops are false, what stays in its map.

    python benchmarks/sessions.py --out sessions.csv
    python benchmarks/sessions.py --tasks orders --seeds 501-501

| task | a row is | what counts |
|---|---|---|
| orders | `campus` in three recordings that overlap, in one order | ATE of all three together, over that of the whole |
| twins | `twins` cut in two somewhere | loops between the two that are false |
| moved | two visits, a tenth of the furniture moved in between | F1 of the map by the new truth, over a fresh one's |

Right is a loop within 0.3 m and 5 degrees of the truth; `bound` sessions are those that were bound.
"""

import sys
from collections.abc import Callable, Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from parts.harness import Case, Row, arguments, benchmark, status
from parts.runs import is_right, true_poses
from scipy.ndimage import binary_dilation

from moteslam.eval.cli.simulate import scenario_of
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.metrics.map_quality import map_accuracy
from moteslam.kernels import runtime
from moteslam.robot import se2
from moteslam.robot.formats import Cut, cut
from moteslam.robot.formats.map_server import UNKNOWN, trinary
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.scenario import Scenario, load_scenario
from moteslam.sim.simulate import Simulation, simulate
from moteslam.slam.backend.building import Building
from moteslam.slam.estimate import Estimate
from moteslam.slam.online import run_slam
from moteslam.slam.sessions import go_on

Array = NDArray[np.float64]
SEEDS = {"orders": range(501, 502), "twins": range(600, 610), "moved": range(700, 703)}
PARTS = ((0.0, 0.40), (0.33, 0.72), (0.65, 1.0))  # Of the time of a drive
BUILDINGS = ("office", "lab", "random-corridors")  # That are visited twice


def part(recording: Recording, first: float, last: float) -> Recording:
    """A part of a recording, as shares of its time."""
    assert recording.lidar is not None
    span = float(np.ptp(recording.lidar.stamps))
    return cut(recording, Cut(first * span, last * span))


def together(estimates: Sequence[Estimate], order: Sequence[int]) -> tuple[Estimate, Building]:
    """Estimates of recordings, bound to each other in an order: the latest that was bound, and the building."""
    found, building = estimates[order[0]], estimates[order[0]].building
    assert building is not None
    for number in order[1:]:
        new = go_on(estimates[number], building)
        assert new.building is not None
        if len(new.building.sessions) > 1:
            found, building = new, new.building
    return found, building


def false_loops(building: Building, truths: Sequence[Trajectory]) -> tuple[int, int]:
    """How many loops bind two sessions, and how many of these are false."""
    each = zip(truths, building.sessions, strict=False)
    true = np.concatenate([true_poses(truth, one.stamps[one.nodes]) for truth, one in each])
    loops, between = building.loops, building.between
    right = is_right(loops.relative, se2.between(true[loops.first], true[loops.second]))[between]
    return int(between.sum()), int((~right).sum())


def f1(occupancy: Raster, path: Trajectory, simulation: Simulation) -> float:
    """Of a map, laid on the truth as its path is, where the true map is known: not of rooms that are shut now."""
    placed = absolute_trajectory_error(path, simulation.truth).transform
    true, values = simulation.true_map(occupancy.cell_size), trinary(occupancy.values)
    known = Raster(binary_dilation(true.values != UNKNOWN, iterations=2), true.cell_size, true.origin)
    cells = np.argwhere(values != UNKNOWN)
    shut = ~known.values_at(se2.transform_points(placed, occupancy.centres(cells)), outside=False)
    values[tuple(cells[shut].T)] = UNKNOWN
    return map_accuracy(Raster(values, occupancy.cell_size, occupancy.origin), true, transform=placed).f1


def orders(seed: int) -> Row:
    simulation = simulate(load_scenario("campus"), seed)
    recording, truth = simulation.recording, simulation.truth
    whole = absolute_trajectory_error(run_slam(recording, seed=seed).trajectory_final, truth).rmse
    parts = [run_slam(part(recording, *share), seed=seed) for share in PARTS]
    row: Row = {"whole": whole}
    for order in permutations(range(len(parts))):
        building = together(parts, order)[1]
        stamps = np.concatenate([one.stamps for one in building.sessions])
        poses = np.concatenate([one.path for one in building.sessions])
        by_time = np.argsort(stamps, kind="stable")
        rmse = absolute_trajectory_error(Trajectory(stamps[by_time], poses[by_time]), truth).rmse
        loops, false = false_loops(building, [truth] * len(parts))
        name = "".join(str(k + 1) for k in order)
        row |= {f"bound {name}": len(building.sessions), f"loops {name}": loops, f"false {name}": false}
        row |= {f"ratio {name}": rmse / whole}
        print(name, f"{rmse:.4f} m of {whole:.4f}", loops, false, flush=True)
    return row


def twins(seed: int) -> Row:
    simulation = simulate(load_scenario("twins"), seed)
    share = float(np.random.default_rng(seed).uniform(0.15, 0.85))
    parts = [run_slam(part(simulation.recording, *of), seed=seed) for of in ((0.0, share), (share, 1.0))]
    building = together(parts, (0, 1))[1]
    loops, false = false_loops(building, [simulation.truth] * 2)
    return {"share": share, "bound": len(building.sessions), "loops": loops, "false": false}


def moved(seed: int, name: str) -> Row:
    first = scenario_of(name, seed)
    visit = Scenario.model_validate({**first.model_dump(), "visit": {"seed": seed, "building": seed}})
    visits = [simulate(first, seed), simulate(visit, seed + 1)]
    parts = [run_slam(one.recording, seed=seed) for one in visits]
    found, building = together(parts, (0, 1))
    loops, false = false_loops(building, [one.truth for one in visits])
    alike = building.draw(found.config.map.model_copy(update={"memory": 0.0}))
    fresh = f1(parts[1].map, parts[1].trajectory_final, visits[1])
    both, without = (f1(one, building.sessions[-1].trajectory, visits[1]) for one in (found.map, alike))
    ratios = {"fresh": fresh, "f1": both, "ratio": both / fresh, "ratio without": without / fresh}
    return {"bound": len(building.sessions), "loops": loops, "false": false, **ratios}


TASKS: dict[str, Callable[..., Row]] = {"orders": orders, "twins": twins, "moved": moved}


def measure(task: str, seed: int, *more: str) -> Row:
    runtime.init("cpu", 1)
    return TASKS[task](seed, *more)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS), metavar="NAME")
    given = parser.parse_args()
    cases: list[Case] = []
    for task in given.tasks:
        for seed in given.seeds or SEEDS[task]:
            for more in [(name,) for name in BUILDINGS] if task == "moved" else [()]:
                cases.append(({"run": " ".join((task, *more)), "seed": seed}, (task, seed, *more)))
    return status(benchmark(measure, cases, given))


if __name__ == "__main__":
    sys.exit(main())
