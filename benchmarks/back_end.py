"""What the back end brings: key-scan logs with truth, worlds of loops, and its stages switched off one at a time.

    python benchmarks/back_end.py key-scans --out result.json
    python benchmarks/back_end.py worlds --out result.json
    python benchmarks/back_end.py worlds --runs twins grid --seeds 0-99 --out result.json
    python benchmarks/back_end.py dense --noise as_recorded --out result.json
    python benchmarks/back_end.py false-loops --out result.json
    python benchmarks/back_end.py stages --out result.json
    python benchmarks/back_end.py particles --out result.json
    python benchmarks/back_end.py picture --out docs/images/back_end_aces.png

key-scans: the LMS200 by wheels alone, a scan each 0.75 m or 0.5 rad, the steps as they are and with noise of 5 % and
10 %, six scenarios on seeds 100 to 109 and ten random buildings; and every scan of big_loop. worlds: campus, twins,
grid and mile as key scans of poor odometry, with the loops judged by the truth. dense: every scan of campus and mile,
by the scenario's own robot. With --noise as_recorded errors are stated with the scale fitted, too. false-loops: the
worlds with false loops in the final graph, in clusters of five, a tenth as many as were accepted, and without.
stages: each stage off, on the real logs, on key scans of the scenarios and the worlds, on these worlds with false
loops, and on every scan of the bundled scenarios, of campus and mile. particles: fork and lookalikes as key scans,
seeds 100 to 149, with 1, 10, 30 and 100 particles, with the back end and without: how often the final path is right.
picture: the map of aces without and with the back end. Every run is on one thread, with seed 0 of SLAM.
"""

from __future__ import annotations

import argparse
import time
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from parts.bars import summarise, summary_lines
from parts.false_loops import false_loops
from parts.machine import save, stamp
from parts.options import count, result_file, seeds
from parts.pool import Row, row_or_error, rows_of
from parts.runs import (
    FILTER_ALONE,
    LOGS,
    STEP_NOISE,
    Case,
    errors,
    late_errors,
    load_log,
    log_file,
    simulate_case,
    that_are_there,
    wheels_case,
)

from moteslam.errors import ConfigError
from moteslam.eval.cli.text import table

SCENARIOS = ("doors", "lab", "corridor", "loop", "big_loop", "people")
WORLDS = ("campus", "twins", "grid", "mile")
DENSE = ("campus", "mile")
BUNDLED = (
    "big_loop",
    "corridor",
    "doors",
    "glass_front",
    "hall",
    "lab",
    "loop",
    "office",
    "outage",
    "people",
    "slippery",
    "two_halls",
    "warehouse",
)
"""Scenarios whose every scan is run with each stage off."""
LOG_OF_PICTURE = "aces"
STAGES: dict[str, tuple[str, ...]] = {
    "all": (),
    "without loops": ("backend.loops.enabled=false",),
    "without non-convexity": ("backend.graduated=false",),
    "without joint registration": ("backend.joint.enabled=false",),
    "without back end": FILTER_ALONE,
}
WITHOUT_LOOPS = ("without loops", "without back end")
"""Of ``STAGES``: false loops cannot be entered there."""
MORE_IS_BETTER = ("accepted", "recall", "right")
PARTICLES = (1, 10, 30, 100)
FORKS: dict[str, tuple[str, tuple[float, float]]] = {
    "fork": ("lms200", STEP_NOISE),
    "lookalikes": ("urg04lx", (0.1, 0.1)),
}
"""Worlds in which a second hypothesis is needed: the robot, and the noise of the steps."""
RIGHT = 0.5
"""A final path that went the right way has a smaller ATE [m]; the next corridor costs 0.7 m, the next opening 1 m."""


@dataclass(frozen=True)
class Run:
    """A row of a study.

    Attributes:
        label: the rows of one label are summarised together.
        name: of the log or the scenario.
        seed: of the simulation.
        step_noise: shares of noise added to the steps between key scans; None as they are.
        every_scan: no key scans, but all.
        settings: of SLAM.
        platform: the robot.
        noise_class: of the sensors, in place of that of data sheets.
        own_robot: the scenario's own robot with its gyro, and all its scans.
        injected: a tenth as many false loops as there are accepted ones are entered into the final graph.
    """

    label: str
    name: str
    seed: int
    step_noise: tuple[float, float] | None = None
    every_scan: bool = False
    settings: tuple[str, ...] = ()
    platform: str = "lms200"
    noise_class: str | None = None
    own_robot: bool = False
    injected: bool = False


def run(this: Run) -> Row:
    """One run: its errors [m] and, with a truth, the scores of its loops; what went wrong, if it crashes."""
    return row_or_error({"run": this.label, "seed": this.seed}, measure, this)


def measure(this: Run) -> Row:
    """The figures of one run."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.eval.metrics.loops import score_loops
    from moteslam.kernels import runtime
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    runtime.init("cpu", 1)
    real = this.name in LOGS
    case = load_log(this.name) if real else simulated(this)
    began = time.process_time()
    with false_loops(this.seed) if this.injected else nullcontext():
        estimate = run_slam(case.recording, resolve_config("default", this.settings), seed=0)
    row: Row = {"seconds": time.process_time() - began, **errors(this.name, estimate, case)}
    if not real:  # the references of the logs are no truth
        assert case.reference is not None
        loops = score_loops(estimate.loops, case.reference, case.recording)
        if this.noise_class is not None:
            score = absolute_trajectory_error(estimate.trajectory_final, case.reference, scale=True)
            row["final_scaled"] = score.rmse
        row |= {"accepted": loops.accepted, "false": loops.false, **late_errors(estimate, case)}
        row |= {"overruled": loops.overruled, "overruled_false": loops.overruled_false}
        if this.name in FORKS:
            row["right"] = float(row["final"] < RIGHT)
        if loops.recall is not None:
            row["recall"] = loops.recall
    return row


def simulated(this: Run) -> Case:
    """The recording of a run that is simulated."""
    if this.own_robot:
        return simulate_case(this.name, this.seed, noise_class=this.noise_class)
    return wheels_case(
        this.name,
        this.seed,
        platform=this.platform,
        noise_class=this.noise_class,
        step_noise=this.step_noise,
        every_scan=this.every_scan,
    )


def runs(study: str, chosen: range | None, noise_class: str | None) -> list[Run]:
    """The runs of a study, in their order; real logs that are not there are left out."""
    if study == "key-scans":
        numbers = chosen or range(100, 110)
        logs = [(name, name, seed) for name in SCENARIOS for seed in numbers]
        logs += [("random-corridors", f"random-corridors-{seed}", seed) for seed in numbers]
        noises = (("", None), (", noise", STEP_NOISE))
        dense = [Run("big_loop, every scan", "big_loop", seed, every_scan=True) for seed in numbers]
        return [Run(label + more, name, seed, noise) for more, noise in noises for label, name, seed in logs] + dense
    if study == "worlds":
        return [
            Run(name, name, seed, STEP_NOISE, noise_class=noise_class) for name in WORLDS for seed in chosen or range(5)
        ]
    if study == "dense":
        return [
            Run(f"{name}, every scan", name, seed, noise_class=noise_class, own_robot=True)
            for name in DENSE
            for seed in chosen or range(5)
        ]
    if study == "false-loops":
        return [
            Run(f"{name}, false loops" if injected else name, name, seed, STEP_NOISE, injected=injected)
            for name in WORLDS
            for seed in chosen or range(5)
            for injected in (False, True)
        ]
    if study == "particles":
        return [
            Run(
                f"{name}, {number} particles, {back_end}",
                name,
                seed,
                noise,
                settings=(f"particles={number}", *settings),
                platform=platform,
            )
            for name, (platform, noise) in FORKS.items()
            for number in PARTICLES
            for back_end, settings in (("back end", ()), ("filter alone", FILTER_ALONE))
            for seed in chosen or range(100, 150)
        ]
    numbers = chosen or range(200, 203)
    real = [Run(name, name, 0) for name in that_are_there(tuple(LOGS))]
    key_scans = [Run(name, name, seed, STEP_NOISE) for name in (*SCENARIOS, *WORLDS) for seed in numbers]
    injected = [
        Run(f"{name} with false loops", name, seed, STEP_NOISE, injected=True) for name in WORLDS for seed in numbers
    ]
    dense = [Run(f"{name} every scan", name, seed, own_robot=True) for name in BUNDLED for seed in numbers]
    dense += [Run(f"{name} every scan", name, numbers[0], own_robot=True) for name in DENSE]
    return [
        replace(each, label=f"{each.label}, {stage}", settings=settings)
        for each in (*real, *key_scans, *injected, *dense)
        for stage, settings in STAGES.items()
        if not (each.injected and stage in WITHOUT_LOOPS)
    ]


def draw_before_and_after(path: Path, log: str) -> None:
    """The map of a log without back end and with it, side by side at one scale; a PNG."""
    from moteslam.eval.report import style
    from moteslam.eval.report.maps import draw_map, map_corners
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    recording = load_log(log).recording
    estimates = {
        "without back end": run_slam(recording, resolve_config("default", FILTER_ALONE)),
        "with back end": run_slam(recording, resolve_config("default")),
    }
    shown = [map_corners(estimate.map) for estimate in estimates.values()]
    with style.saved_figure(path, size=(12.0, 6.0)) as figure:
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, (title, estimate) in zip(panels, estimates.items(), strict=True):
            poses = estimate.trajectory_final.poses
            draw_map(axes, estimate.map)
            axes.plot(*poses[:, :2].T, color=style.SLAM, lw=0.7, label=style.FINAL)
            style.mark_start(axes, poses)
            style.mark_ends(axes, (poses, style.SLAM))
            style.plan(axes)
            axes.set_title(title, fontsize="medium")
        style.show_everything(panels[0], *shown, margin=0.5)
        style.legend_below(figure, *panels)
        style.heading(figure, f"{recording.name}: map and final path")


def main() -> None:
    """Run a study, print a table, and write the result file, anew after every run; or draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "study", choices=("key-scans", "worlds", "dense", "false-loops", "stages", "particles", "picture")
    )
    parser.add_argument("--seeds", type=seeds, metavar="N", help="of the simulated runs; or 10-19")
    parser.add_argument("--noise", choices=("datasheet", "as_recorded"), help="of the sensors, of worlds and dense")
    parser.add_argument("--workers", type=count, default=2, help="processes; 2")
    parser.add_argument("--out", type=result_file, help="a result file, or the picture")
    parser.add_argument("--runs", nargs="+", metavar="NAME", help="of the study, by the names of logs and scenarios")
    options = parser.parse_args()
    if options.noise is not None and options.study not in ("worlds", "dense"):
        parser.error(f"--noise: not of {options.study}, expected worlds or dense")
    if options.study == "picture":
        if options.out is None:
            parser.error("picture: no --out, expected a PNG")
        if not log_file(LOG_OF_PICTURE).is_file():
            error = "not there; MOTESLAM_DATA names the folder of the real logs"
            parser.error(str(ConfigError(error, file=log_file(LOG_OF_PICTURE))))
        draw_before_and_after(options.out, LOG_OF_PICTURE)
        return
    chosen = runs(options.study, options.seeds, options.noise)
    known = list(dict.fromkeys(each.name for each in chosen))
    for name in options.runs or ():
        if name not in known:
            parser.error(f"--runs: {name!r}, expected of {', '.join(known)}")
    chosen = [each for each in chosen if not options.runs or each.name in options.runs]
    rows: list[Row] = []
    summary: dict[str, Any] = {}
    for row in rows_of(run, [(each,) for each in chosen], options.workers):
        rows.append(row)
        summary = summarised(rows)
        save(options.out, {**stamp(), "study": options.study, "noise": options.noise, "summary": summary, "rows": rows})
    print()
    print(table(summary_lines(summary), right=(3, 4)))
    if options.study == "particles":
        print()
        print(table([("", "right", "runs"), *how_many_right(rows)], right=(1, 2)))


def how_many_right(rows: list[Row]) -> list[tuple[str, str, str]]:
    """Of every label the runs whose final path is right, and all; a crash is not right."""
    labels: dict[str, list[float]] = {}
    for row in rows:
        labels.setdefault(row["run"], []).append(row.get("right", 0.0))
    return [(label, f"{sum(right):.0f}", str(len(right))) for label, right in labels.items()]


def summarised(rows: list[Row]) -> dict[str, Any]:
    """Median and worst of every figure, by label."""
    labels = dict.fromkeys(row["run"] for row in rows)
    return {
        label: summarise([row for row in rows if row["run"] == label], (), more_is_better=MORE_IS_BETTER)
        for label in labels
    }


if __name__ == "__main__":
    main()
