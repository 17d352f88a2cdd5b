"""How well a robot is found in a known map: by one scan, by driving, after it was carried, and where it is not at all.

    python benchmarks/localize.py --out localize.csv
    python benchmarks/localize.py --tasks "one scan" --scenarios office lab --platforms turtlebot3 --seeds 300-300

| task | a row is | what counts |
|---|---|---|
| one scan | PLACES scans at random places, each searched for alone | the best one is right; the truth is listed |
| driving | STARTS starts in a drive, 15 m each | path until it is rightly `sure`; scans that are wrongly so |
| carried | a drive on which the robot is carried 6 m in 20 s | the same from where it stands again |
| visit | a drive with a tenth of the furniture moved and doors shut, in the map of before | the same, and errors |
| plan | a drive in a floor plan without the furniture | the same, and the share of the scans that are `sure` |
| elsewhere | a drive in another building's map | `not-in-this-map` is told; scans that are `sure` of a place |

Right is within 0.3 m and 5 degrees of the truth. A robot that is not found in time is ``open`` while the true place is
not excluded: it is searched for in the whole map, or particles are there. The map is the true one in cells of 5 cm; in
symmetric worlds several places are right for a while. On one thread; milliseconds are processor time of a search.
"""

import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from parts.harness import Row, arguments, benchmark, by_run, draw_reliability, expect_known, status
from parts.runs import is_right, true_poses

from moteslam.eval.cli.simulate import scenario_of
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.tables import aligned
from moteslam.kernels import runtime
from moteslam.robot.formats import Cut, cut
from moteslam.robot.formats.map_server import FREE, write_map
from moteslam.robot.noise import Surroundings
from moteslam.robot.platforms import bundled_platforms
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.robot.drive import Drive
from moteslam.sim.robot.driver import sampled
from moteslam.sim.robot.vehicle import PHYSICS_RATE
from moteslam.sim.scenario import Scenario, bundled_scenarios
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.lidar import Lidar, LidarErrors
from moteslam.sim.simulate import Simulation, simulate
from moteslam.sim.world.visit import Visit
from moteslam.sim.world.world import World, lived_in, true_map
from moteslam.slam.config import resolve_config
from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.step import thin
from moteslam.slam.known_map.config import KnownMapConfig
from moteslam.slam.known_map.maps import KnownMaps
from moteslam.slam.known_map.search import Sight, WholeMapSearch, silent_rays
from moteslam.slam.online import OnlineSlam, run_slam

STARTS, PLACES = 10, 50
FOUND, FOUND_AGAIN, METRES = 10.0, 5.0, 15.0  # In time; how far starts are followed [m]
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0)  # Of the probabilities that are said
SCENARIOS = ("office", "lab", "warehouse", "corridor", "random-corridors")
PLATFORMS = ("ucsd", "rplidar_a1", "turtlebot3")
FURNITURE = ("boxes", "pillars", "tables", "chairs", "shelves")
OTHER = {"office": "warehouse", "warehouse": "lab", "lab": "corridor"}
CARRIED = 'faults=[{kind="carried", start=40, duration=20, along=6, lidar="off"}]'
Array = NDArray[np.float64]


def scattered(world: World, occupancy: Raster, scenario: Scenario, seed: int) -> tuple[Any, Array, list[int]]:
    """Scans of a scenario's lidar at random free places in random headings: the true poses [n, 3], and which."""
    rng, platform, noise = np.random.default_rng(seed), scenario.platform, scenario.noise.lidar
    places = rng.permutation(occupancy.centres(np.argwhere(occupancy.values == FREE)))[: 4 * PLACES]
    places = places[world.is_free(places, platform.radius)][:PLACES]
    poses = np.column_stack((places, rng.uniform(-np.pi, np.pi, len(places))))
    held = 4 / platform.lidar.scan.rate  # at each place [s]
    times = np.arange(0, held * len(poses), 1 / PHYSICS_RATE)
    at = np.minimum((times / held).astype(int), len(poses) - 1)
    still = Drive(times, poses[at], np.zeros((len(times), 3)), np.zeros((len(times), 4)), "arrived")
    errors = LidarErrors.drawn(noise, rng)
    sensor = Lidar(platform.lidar, noise, (0.0, times[-1]), rng, errors=errors, effects=rng)
    lidar = sensor.read(still, Scene(world, None), len(sensor.times))
    scans = np.abs(lidar.stamps[:, None] - held * (np.arange(len(poses)) + 0.375)).argmin(axis=0)
    return Scans(lidar, platform.lidar), poses, scans.tolist()


def one_scan(scenario: Scenario, seed: int) -> Row:
    config = KnownMapConfig()
    world, rng = World.of(scenario.standing), np.random.default_rng(seed)
    if scenario.noise.surroundings != Surroundings() and scenario.route is not None:
        path, _ = sampled(scenario.route.path())
        world = lived_in(world, scenario.noise.surroundings, rng, path=path, radius=scenario.platform.radius)
    maps = KnownMaps(true_map(world, 0.05, seen_from=scenario.start[:2]), config.tsdf)
    search = WholeMapSearch(maps, config.registration)
    scans, poses, chosen = scattered(world, maps.occupancy, scenario, seed)
    rows, cost = [], []
    for scan, true in zip(chosen, poses, strict=True):
        points = scans.points(scan)
        thinned = thin(points, scans.origin, config.thinning).points
        silent = silent_rays(scans.silent(scan), scans.origin, len(thinned) / len(points))
        began = time.process_time()
        found = search.find(Sight(np.zeros(3), thinned, scans.origin, silent))
        cost.append(1000 * (time.process_time() - began))
        right, said = is_right(true, found.poses), found.probabilities
        rows.append((right[0], right[said > 0.001].any(), said[0]))
    best, listed, said = np.array(rows, float).T
    sure, bins = said > 0.99, np.digitize(said, BINS[1:-1])
    area = float((maps.occupancy.values == FREE).sum()) * maps.occupancy.cell_size**2
    return {
        "right": best.mean(), "listed": listed.mean(), "said": said.mean(), "sure": sure.mean(),
        "sure_wrong": float(sure @ (1 - best)), "ms": statistics.median(cost), "area": area,
        "said_in_bins": np.bincount(bins, said, len(BINS) - 1).round(2).tolist(),
        "right_in_bins": np.bincount(bins, best, len(BINS) - 1).tolist(),
        "in_bins": np.bincount(bins, minlength=len(BINS) - 1).tolist(),
    }  # fmt: skip


def session_in(occupancy: Raster, recording: Recording, seed: int) -> OnlineSlam:
    """A run in a known map."""
    with tempfile.TemporaryDirectory() as folder:
        write_map(Path(folder) / "map.pgm", occupancy)
        return OnlineSlam.over(recording, resolve_config("localize", [f"known_map={folder}/map.yaml"]), seed=seed)


def _followed(
    simulation: Simulation,
    seed: int,
    occupancy: Raster,
    *,
    start: float = 0.0,
    after: float = 0.0,
    in_time: float = FOUND,
    most: float = np.inf,
) -> Row:
    """Path until the pose is rightly ``sure``, and the share of the sure scans that are wrong.

    And the median error of these as it is, and with their path laid on the truth, as SLAM's is.
    """
    found, driven, last, states, stamps, poses, scans = np.nan, 0.0, None, [], [], [], 0
    left_open = None
    for update in session_in(occupancy, cut(simulation.recording, Cut(start)), seed):
        true = true_poses(simulation.truth, np.array([update.stamp]))[0]
        if update.stamp - simulation.truth.stamps[0] < after:
            continue
        driven += 0.0 if last is None else float(np.hypot(*(true - last)[:2]))
        last, right, scans = true, bool(is_right(true, update.pose)), scans + 1
        if update.state is LocalisationState.SURE:
            states.append(right)
            stamps.append(update.stamp)
            poses.append(update.pose)
            found = driven if right and np.isnan(found) else found
        if left_open is None and driven > in_time:
            anywhere = update.state is LocalisationState.LOST or bool(is_right(true, update.poses).any())
            left_open = bool(np.isnan(found)) and anywhere
        if driven > most:
            break
    wrong = 1 - float(np.mean(states)) if states else 0.0
    off = laid = np.nan
    if states:
        sure = Trajectory(np.array(stamps), np.array(poses))
        off = float(np.median(np.hypot(*(sure.poses - true_poses(simulation.truth, sure.stamps))[:, :2].T)))
        laid = float(np.median(absolute_trajectory_error(sure, simulation.truth).errors))
    share = len(states) / max(scans, 1)
    return {"found_after": found, "sure_wrong": wrong, "sure": share, "open": left_open, "off": off, "laid": laid}


def driving(simulation: Simulation, seed: int) -> Row:
    """Starts along a drive."""
    stamps = simulation.recording.lidar.stamps  # type: ignore[union-attr]
    starts = np.random.default_rng(seed).uniform(0, 0.85 * (stamps[-1] - stamps[0]), STARTS)
    true = simulation.true_map(0.05)
    rows = [_followed(simulation, seed, true, start=start, most=METRES) for start in starts.tolist()]
    found = np.array([row["found_after"] for row in rows])
    return {
        "right": float(np.isfinite(found).mean()),
        "within_10_m": float((found <= FOUND).mean()),
        "open": float(np.mean([bool(row["open"]) for row in rows])),
        "found_after": float(np.nanmedian(found)) if np.isfinite(found).any() else np.nan,
        "wrongly_sure": float(np.mean([row["sure_wrong"] > 0.01 for row in rows])),
        "off": float(np.nanmedian([row["off"] for row in rows])),
    }


def visit(simulation: Simulation, seed: int) -> Row:
    """A drive in the map of another day, in its own in two cell sizes, and by SLAM: median errors [m]."""
    before = Visit(building=seed, moved=0.0, shut=0.0)
    other = simulate(simulation.scenario.model_copy(update={"visit": before}), seed + 1)
    maps = other.true_map(0.05), simulation.true_map(0.05), simulation.true_map(0.02)
    found, own, fine = (_followed(simulation, seed, occupancy) for occupancy in maps)
    slam = absolute_trajectory_error(run_slam(simulation.recording, seed=seed).trajectory_final, simulation.truth)
    return {
        **found, "right": float(found["found_after"] <= FOUND), "wrongly_sure": float(found["sure_wrong"] > 0.01),
        "off_own": own["off"], "off_fine": fine["off"], "laid_own": own["laid"],
        "off_slam": float(np.median(slam.errors)),
    }  # fmt: skip


def plan(simulation: Simulation, seed: int) -> Row:
    """A drive in a floor plan without the furniture."""
    bare = simulation.scenario.standing.model_copy(update=dict.fromkeys(FURNITURE, ()))
    drawn = true_map(World.of(bare), 0.05, seen_from=simulation.scenario.start[:2])
    found = _followed(simulation, seed, drawn)
    return {**found, "right": float(found["found_after"] <= FOUND), "wrongly_sure": float(found["sure_wrong"] > 0.01)}


def measure(task: str, scenario: str, platform: str, noise: str, seed: int) -> Row:
    runtime.init("cpu", 1)
    settings = {"carried": (CARRIED,), "visit": (f"visit={{building={seed}, seed={seed}}}",)}.get(task, ())
    asked = scenario_of(scenario, seed, platform=platform, noise=noise, settings=settings)
    if task == "one scan":
        return one_scan(asked, seed)
    simulation = simulate(asked, seed)
    if task == "visit":
        return visit(simulation, seed)
    if task == "driving":
        return driving(simulation, seed)
    if task == "plan":
        return plan(simulation, seed)
    if task == "carried":
        found = _followed(simulation, seed, simulation.true_map(0.05), after=60, in_time=FOUND_AGAIN)
        right = float(found["found_after"] <= FOUND_AGAIN)
        return {**found, "right": right, "wrongly_sure": float(found["sure_wrong"] > 0.01)}
    other = simulate(scenario_of(OTHER.get(scenario, "office"), seed, platform=platform, noise=noise), seed)
    session = session_in(other.true_map(0.05), simulation.recording, seed)
    sure = float(np.mean([update.state is LocalisationState.SURE for update in session]))
    told = "not-in-this-map" in {issue.code for issue in session.warnings}
    return {"right": float(told), "wrongly_sure": float(sure > 0.01), "sure": sure}


TASKS = ("one scan", "driving", "carried", "elsewhere", "visit", "plan")


def summary(rows: Sequence[Row]) -> str:
    keys = (
        "right", "listed", "said", "sure", "sure_wrong", "within_10_m", "open", "found_after", "wrongly_sure", "off",
        "laid", "off_own", "laid_own", "off_slam", "ms",
    )  # fmt: skip
    lines: list[tuple[str, ...]] = [("", "rows", *keys)]
    for run, mine in by_run(rows).items():
        good = [row for row in mine if "error" not in row]
        cells = []
        for key in keys:
            values = [float(row[key]) for row in good if row.get(key) is not None and row[key] == row[key]]
            cells.append(f"{statistics.mean(values):.3f}" if values else "-")
        lines.append((run, str(len(mine)), *cells))
    return aligned(lines)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--tasks", nargs="+", metavar="NAME", choices=TASKS, default=TASKS)
    parser.add_argument("--scenarios", nargs="+", metavar="NAME", default=SCENARIOS)
    parser.add_argument("--platforms", nargs="+", metavar="NAME", default=PLATFORMS)
    parser.add_argument("--noise", nargs="+", metavar="CLASS", default=("datasheet", "as_recorded"))
    parser.add_argument("--draw", type=Path, metavar="PNG", help="the reliability diagram of single scans")
    options = parser.parse_args()
    expect_known(parser, "--scenarios", options.scenarios, (*bundled_scenarios(), "random-corridors"))
    expect_known(parser, "--platforms", options.platforms, bundled_platforms())
    cases = [
        (
            {"run": f"{task}: {scenario}", "platform": platform, "noise": noise, "seed": seed},
            (task, scenario, platform, noise, seed),
        )
        for task, scenario, platform, noise, seed in product(
            options.tasks, options.scenarios, options.platforms, options.noise, options.seeds or range(300, 301)
        )
    ]
    rows = benchmark(measure, cases, options, summary=summary)
    if options.draw:
        groups = by_run({**row, "run": row["platform"]} for row in rows if "in_bins" in row)
        keys = ("in_bins", "said_in_bins", "right_in_bins")
        labels = "probability of the most probable place, as said", "share of the scans where it is right"
        draw_reliability(options.draw, groups, keys, labels, intervals=True)
    return status(rows)


if __name__ == "__main__":
    sys.exit(main())
