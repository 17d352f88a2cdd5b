"""The accuracy of SLAM over many seeds, on real logs and in simulated scenarios, beside what is asked.

    python benchmarks/accuracy.py logs --out logs.csv
    python benchmarks/accuracy.py scenarios --runs corridor loop office --seeds 20 --preset paper
    python benchmarks/accuracy.py worlds --runs twins grid --seeds 0-99 --out worlds.csv

| study | what | seeds |
|---|---|---|
| logs | real logs, where MOTESLAM_DATA is, against references and relations | 0 to 4, of SLAM |
| scenarios | every bundled scenario | 0 to 4 |
| buildings | twenty random buildings that no setting was chosen on | 0 |
| floors | fifty floors drawn as PNG (parts/floors.py), a lidar of 8 m | 300 to 349 |
| classes | all scenarios, noise of data sheets and as recorded, presets default and paper | 0 to 4 |
| lidars | three lidars, dense and as key scans | 0 to 19 |
| robots | three small robots, and shorter ranges of one of them | 0 to 4 |
| residuals | residuals of the simulated LMS200's scans at 1 and 0.5 degrees, beside real ones | 0 to 4 |
| key-scans | the LMS200 by wheels alone, steps as they are and with noise of 5 and 10 % | 100 to 109 |
| worlds | campus, twins, grid and mile as key scans with noise of the steps | 0 to 4 |
| dense | every scan of campus and mile | 0 to 4 |
| false-loops | worlds with false loops in the final graph, a tenth as many as were accepted, and without | 0 to 4 |
| stages | each stage of the back end off: logs, key scans, false loops, every scan | 200 to 202 |
| particles | fork and lookalikes as key scans, 1 to 100 particles, with the back end and without | 100 to 149 |
| colours | colours of the floor in the weights, with and without | 0 and 1; two_halls 0 to 9 |

From classes to residuals, and with colours, the filter runs alone. From key-scans on SLAM has seed 0; else that of the
simulation. Scored is the ATE RMSE after alignment [m], of Intel the mean error of relations; a run is lost from 0.15 m
on, and stays in the medians. Every run is on one thread.
"""

import itertools
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from parts.floors import drawn_floor
from parts.harness import Bar, Case, Row, arguments, benchmark, expect_known, status
from parts.runs import (
    FILTER_ALONE,
    HALF_DEGREE,
    KEY_SCANS,
    LOGS,
    LOST,
    NOISY,
    WHEELS,
    errors,
    load_log,
    log_file,
    loop_figures,
    simulate_case,
)

from moteslam.errors import MoteslamError
from moteslam.eval.metrics.residuals import scan_residuals
from moteslam.kernels import runtime
from moteslam.robot import se2
from moteslam.sim.scenario import bundled_scenarios, load_scenario
from moteslam.slam.backend.graph.loop_closing import LoopClosing
from moteslam.slam.backend.graph.loop_graph import PROVED, LoopGraph
from moteslam.slam.config import resolve_config
from moteslam.slam.online import run_slam

TEN_HERTZ = {
    "platform": "rplidar_a1",
    "settings": ("platform.lidar.rate=10.0", "platform.lidar.time_increment=0.00027"),
}
"""A lidar of 360 beams, 12 m and 10 Hz."""
EIGHT_METRES = {"platform": "rplidar_a1", "settings": ("platform.lidar.range_max=8.0",)}
FLOOR = "floor"
"""The name of a floor that its seed draws."""
WORLDS = ("campus", "twins", "grid", "mile")
SMALL = ("doors", "lab", "corridor", "loop", "big_loop", "people")
INDOORS = (*SMALL, "glass_front", "hall", "office", "outage", "slippery", "two_halls", "warehouse")
BUILDINGS = tuple(f"random-corridors-{number}" for number in range(1000, 1020))
NOISES = ("datasheet", "as_recorded")
STAGES: dict[str, tuple[str, ...]] = {
    "all": (),
    "without loops": ("backend.loops.enabled=false",),
    "without non-convexity": ("backend.graduated=false",),
    "without joint registration": ("backend.joint.enabled=false",),
    "without back end": FILTER_ALONE,
}
FORKS = {"fork": NOISY, "lookalikes": WHEELS | {"platform": "urg04lx", "step_noise": (0.1, 0.1)}}
"""Worlds in which a second hypothesis is needed."""
RIGHT = 0.5
"""A final path that went the right way has a smaller ATE [m]; the next corridor costs 0.7 m, the next opening 1 m."""


def at_once(*bars: Bar) -> tuple[Bar, ...]:
    """Bars of the final path, and online ones half as high again: a pose must be right when it is said.

    The bar is held against what is asked, not against the final path, which loops make ten times better.
    """
    online = (Bar(one.figure.replace("final", "online"), one.over, 1.5 * one.limit) for one in bars)
    return (*bars, *online)


NEVER_LOST = Bar("final", "worst", LOST)
BARS: dict[str, tuple[Bar, ...]] = {
    "intel_raw_part": at_once(Bar("final_clear", "worst", 0.0145), Bar("final_clear_deg", "worst", 0.215)),
    "aces": (Bar("final", "worst", 0.12),),
    "fhw": (Bar("final", "worst", 0.17),),
    "intel_key_scans": at_once(Bar("final", "worst", 0.078)),
    "freiburg-101": at_once(Bar("final", "worst", 0.046)),
    "belgioioso": at_once(Bar("final", "worst", 0.095)),
    "csail": at_once(Bar("final", "worst", 0.105)),
    FLOOR: (Bar("final", "worst", 0.015), Bar("online", "worst", 0.03)),
    "hall": (*at_once(Bar("final_across", "worst", 0.05)), Bar("along_over_dead_reckoning", "worst", 1.0)),
} | dict.fromkeys(("corridor", "loop", "office"), at_once(NEVER_LOST, Bar("final", "median", 0.03)))
"""On logs a quarter less error than the best of GMapping, Karto, Cartographer and Hector (docs/results.md)."""


@dataclass(frozen=True)
class Runs:
    """Runs of a study, each name with each seed."""

    run: str  # rows of the same one are summarised together; ``{}`` is the name
    names: Iterable[str]  # of logs and scenarios; ``{seed}`` is the seed
    seeds: range  # of the simulations; of SLAM, too, unless ``slam_seed`` is given
    slam_seed: int | None = None
    simulated: Mapping[str, Any] = field(default_factory=dict)  # what ``simulate_case`` takes besides
    preset: str = "default"
    settings: tuple[str, ...] = ()
    false_loops: bool = False  # enter false ones into the final graph, a tenth as many as were accepted
    residuals: bool = False  # measure those of the scans under the final poses


def alone(run: str, names: Iterable[str], seeds: int, **more: Any) -> Runs:
    """The filter without the back end."""
    return Runs(run + ", {}", names, range(seeds), settings=FILTER_ALONE, **more)


def key_scans(run: str, names: Iterable[str], seeds: range, simulated: Mapping[str, Any] = NOISY, **more: Any) -> Runs:
    """Key scans of wheels alone, with noise of their steps unless given otherwise."""
    return Runs(run, names, seeds, slam_seed=0, simulated=simulated, **more)


ALL = tuple(bundled_scenarios())
FALSE_LOOPS = key_scans("{}, false loops", WORLDS, range(5), false_loops=True)
FEW = range(200, 203)
STAGED = (
    Runs("{}", LOGS, range(1)),
    key_scans("{}", (*SMALL, *WORLDS), FEW),
    replace(FALSE_LOOPS, seeds=FEW),
    Runs("{} every scan", INDOORS, FEW, slam_seed=0),
    Runs("{} every scan", ("campus", "mile"), FEW[:1], slam_seed=0),
)
COLOURS = {"without": (), "with": ("colours.enabled=true",)}

STUDIES: dict[str, list[Runs]] = {
    "logs": [Runs("{}", LOGS, range(5))],
    "scenarios": [Runs("{}", ALL, range(5))],
    "buildings": [Runs("random-corridors", BUILDINGS, range(1))],
    "floors": [Runs("floors", (FLOOR,), range(300, 350), slam_seed=0, simulated=EIGHT_METRES)],
    "classes": [
        alone(f"{preset}, {noise}", ALL, 5, preset=preset, simulated={"platform": "ucsd", "noise_class": noise})
        for preset in ("default", "paper")
        for noise in NOISES
    ],
    "lidars": [
        alone(name, ("corridor", "office", "big_loop"), 20, simulated=simulated)
        for name, simulated in (
            ("UTM-30LX", {"platform": "ucsd"}),
            ("360 beams, 12 m, 10 Hz", TEN_HERTZ),
            ("360 beams, 12 m, 10 Hz, key scans", TEN_HERTZ | {"key_scans": KEY_SCANS}),
            ("LMS200", {"platform": "lms200"}),
            ("LMS200, key scans", {"platform": "lms200", "key_scans": KEY_SCANS}),
        )
    ],
    "robots": [
        alone(name, ("office", "corridor", "two_halls"), 5, simulated=simulated)
        for name, simulated in (
            ("turtlebot3", {"platform": "turtlebot3"}),
            ("rplidar_a1", {"platform": "rplidar_a1"}),
            ("rplidar_s2", {"platform": "rplidar_s2"}),
            ("rplidar_a1, 6 m", {"platform": "rplidar_a1", "settings": ("platform.lidar.range_max=6.0",)}),
            ("rplidar_a1, 3 m", {"platform": "rplidar_a1", "settings": ("platform.lidar.range_max=3.0",)}),
        )
    ],
    "residuals": [
        Runs("{}", ("intel_key_scans", "csail", "freiburg-101"), range(1), settings=FILTER_ALONE, residuals=True),
        *(
            alone(
                f"{name}, {noise}",
                ("corridor", "office", "loop", "big_loop", "hall"),
                5,
                simulated={"platform": "lms200", "noise_class": noise, "settings": settings},
                residuals=True,
            )
            for name, settings in (("LMS200", ()), ("LMS200 at half a degree", HALF_DEGREE))
            for noise in NOISES
        ),
    ],
    "key-scans": [
        key_scans(run + more, names, range(100, 110), simulated=simulated)
        for more, simulated in (("", WHEELS), (", noise", NOISY))
        for run, names in (("{}", SMALL), ("random-corridors", ("random-corridors-{seed}",)))
    ],
    "worlds": [key_scans("{}", WORLDS, range(5))],
    "dense": [Runs("{}, every scan", ("campus", "mile"), range(5), slam_seed=0)],
    "false-loops": [key_scans("{}", WORLDS, range(5)), FALSE_LOOPS],
    "stages": [
        replace(runs, run=f"{runs.run}, {stage}", settings=settings)
        for runs in STAGED
        for stage, settings in STAGES.items()
        if not (runs.false_loops and stage in ("without loops", "without back end"))
    ],
    "particles": [
        key_scans(
            f"{{}}, {number} particles, {back_end}",
            (name,),
            range(100, 150),
            simulated=simulated,
            settings=(f"particles={number}", *settings),
        )
        for name, simulated in FORKS.items()
        for number in (1, 10, 30, 100)
        for back_end, settings in (("back end", ()), ("filter alone", FILTER_ALONE))
    ],
    "colours": [
        Runs(
            f"{{}}, {which} colours",
            names,
            range(seeds),
            simulated={"camera": True},
            settings=(*FILTER_ALONE, "texture.enabled=false", *settings),
        )
        for names, seeds in ((("two_halls",), 10), ([name for name in ALL if name != "two_halls"], 2))
        for which, settings in COLOURS.items()
    ],
}


SHARE, CLUSTER = 0.1, 5  # As many false loops as this share of the accepted ones, in clusters of neighbouring nodes
NEAREST, FARTHEST, TURN = 1.0, 3.0, 0.1
"""How far off a cluster is [m], and its heading at most [rad]: as a look-alike along a corridor would be."""


@contextmanager
def false_loops(seed: int) -> Iterator[None]:
    """Within it every back end ``graph`` is given false loops before its final path is solved."""
    close = LoopClosing.close

    def close_and_inject(self: LoopClosing[LoopGraph], start: int = 0) -> None:
        close(self, start)
        inject(self.graph, np.random.default_rng(seed))

    with patch.object(LoopClosing, "close", close_and_inject):
        yield


def inject(graph: LoopGraph, rng: np.random.Generator) -> None:
    """Enter clusters of loops beside true ones: all of a cluster agree with each other, and are off alike."""
    accepted = [pair for pair, loop in graph.loops.items() if loop.candidate.accepted]
    for _ in range(max(round(SHARE * len(accepted) / CLUSTER), 1) if accepted else 0):
        first, second = accepted[int(rng.integers(len(accepted)))]
        like = graph.loops[first, second]
        angle, distance = rng.uniform(-np.pi, np.pi), rng.uniform(NEAREST, FARTHEST)
        off = np.array([distance * np.cos(angle), distance * np.sin(angle), rng.uniform(-TURN, TURN)])
        wrong = np.asarray(se2.compose(like.candidate.found, off))  # the whole passage is somewhere else
        for later in range(second, min(second + CLUSTER, len(graph.nodes))):
            if (first, later) in graph.loops:
                continue
            found = np.asarray(se2.compose(wrong, se2.between(graph.poses[second], graph.poses[later])))
            stamps = float(graph.nodes.stamps[first]), float(graph.nodes.stamps[later])
            which: dict[str, Any] = {"later": int(graph.nodes.indices[later]), "stamps": stamps}
            candidate = replace(like.candidate, **which, found=found, verdict="accepted")
            graph.enter((first, later), like._replace(candidate=candidate))
    graph.solve(PROVED)


def measure(this: Runs, name: str, seed: int) -> Row:
    runtime.init("cpu", 1)
    config = resolve_config(this.preset, this.settings)
    with tempfile.TemporaryDirectory() as folder:
        scenario = str(drawn_floor(seed, Path(folder))) if name == FLOOR else name
        case = load_log(name) if name in LOGS else simulate_case(scenario, seed, **this.simulated)
    began = time.process_time()
    with false_loops(seed) if this.false_loops else nullcontext():
        estimate = run_slam(case.recording, config, seed=seed if this.slam_seed is None else this.slam_seed)
    spent = time.process_time() - began
    row: Row = {**errors(estimate, case), "scans": len(estimate.trajectory), "cpu_s": spent}
    row["updates"] = int(estimate.diagnostics["updated"].sum())
    if case.simulation is not None and config.backend.method != "none":
        row |= loop_figures(estimate, case)
    if name in FORKS:
        row["right"] = row["final"] < RIGHT
    if this.residuals:
        found = scan_residuals(case.recording, estimate.trajectory_final)
        names = ("median", "quantile_90", "beyond_3_cm", "no_return")
        row |= {f"residual_{each}": getattr(found, each) for each in names}
    return row


def asked(study: str, name: str) -> tuple[Bar, ...]:
    """The bars of a log or a scenario; where getting lost is expected, fewer."""
    if study not in ("logs", "scenarios", "buildings", "floors"):
        return ()
    expected = name not in LOGS and name != FLOOR and load_scenario(name).expect_divergence
    return BARS.get(name, () if expected else (NEVER_LOST,))


def main() -> int:
    parser = arguments(__doc__, settings=True)
    parser.add_argument("study", choices=STUDIES, metavar="STUDY")
    parser.add_argument("--runs", nargs="+", metavar="NAME", help="of the study, by the names of logs and scenarios")
    parser.add_argument("--preset", help="in place of the study's")
    options = parser.parse_args()
    about = {"preset": options.preset, "settings": " ".join(options.settings)}
    cases: list[Case] = []
    for runs in STUDIES[options.study]:
        this = replace(
            runs,
            preset=options.preset or runs.preset,
            settings=(*runs.settings, *options.settings),
        )
        for pattern, seed in itertools.product(runs.names, options.seeds or runs.seeds):
            name = pattern.format(seed=seed)
            row = {"study": options.study, "run": runs.run.format(name), "name": name, "seed": seed, **about}
            cases.append((row, (this, name, seed)))
    expect_known(parser, "--runs", options.runs or (), dict.fromkeys(row["name"] for row, _ in cases))
    cases = [case for case in cases if options.runs is None or case[0]["name"] in options.runs]
    bars = {row["run"]: asked(options.study, row["name"]) for row, _ in cases}
    try:
        for _, (this, name, _) in cases:
            resolve_config(this.preset, this.settings)
            if name in LOGS:
                log_file(name)
    except MoteslamError as error:
        parser.error(str(error))
    return status(benchmark(measure, cases, options, bars=bars), bars)


if __name__ == "__main__":
    sys.exit(main())
