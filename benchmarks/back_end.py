"""What the back end brings: key-scan logs with truth, worlds of loops, and its stages switched off one at a time.

    python benchmarks/back_end.py key-scans --out benchmarks/results/back-end-key-scans-YYYY-MM-DD.json
    python benchmarks/back_end.py worlds --out benchmarks/results/back-end-worlds-YYYY-MM-DD.json
    python benchmarks/back_end.py stages --out benchmarks/results/back-end-stages-YYYY-MM-DD.json

key-scans: the LMS200 by wheels alone, a scan each 0.75 m or 0.5 rad, the steps as they are and with noise of 5 % and
10 %, six scenarios on seeds 100 to 109 and ten random buildings; and every scan of big_loop. worlds: campus, twins and
grid as key scans of poor odometry, with the loops judged by the truth. stages: real and simulated key-scan logs with
each stage off. Every run is on one thread, with seed 0 of SLAM.

    python benchmarks/back_end.py picture --out docs/images/back_end_aces.png
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from parts.bars import summarise, summary_lines
from parts.machine import save, stamp
from parts.options import count, result_file, seeds
from parts.pool import rows_of
from parts.runs import LOGS, load_log, log_file, simulate_case

from moteslam.eval.cli.text import table

KEY_SCANS, STEP_NOISE = (0.75, 0.5), (0.05, 0.1)
SCENARIOS = ("doors", "lab", "corridor", "loop", "big_loop", "people")
WORLDS = ("campus", "twins", "grid")
LOGS_OF_STAGES = ("aces", "fhw", "intel_key_scans", "freiburg-101", "belgioioso")
STAGES = {
    "all": (),
    "without loops": ("backend.loops.enabled=false",),
    "without non-convexity": ("backend.graduated=false",),
    "without joint registration": ("backend.joint.enabled=false",),
    "without back end": ("backend.method=none",),
}
Call = tuple[str, str, int, tuple[float, float] | None, bool, tuple[str, ...]]
"""What a row is called, the recording, its seed, noise of the steps, whether all scans are kept, settings of SLAM."""


def run(
    called: str, name: str, seed: int, noise: tuple[float, float] | None, dense: bool, settings: Any
) -> dict[str, Any]:
    """The ATE RMSE of a recording, final and online; with truth that of its loops, too."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.eval.metrics.loops import score_loops
    from moteslam.kernels import runtime
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    row: dict[str, Any] = {"run": called, "seed": seed}
    try:
        runtime.init("cpu", 1)
        if name in LOGS:
            case = load_log(name)
        else:
            case = simulate_case(
                name, seed, platform="lms200", settings=["platform.imu=false"],
                key_scans=None if dense else KEY_SCANS, step_noise=noise,
            )  # fmt: skip
        assert case.reference is not None
        estimate = run_slam(case.recording, resolve_config("default", settings), seed=0)
        for key, trajectory in (("final", estimate.trajectory_final), ("online", estimate.trajectory)):
            reference = case.reference if name in LOGS else case.reference.at(trajectory.stamps)
            row[key] = absolute_trajectory_error(trajectory, reference).rmse
        if name not in LOGS:
            loops = score_loops(estimate.loops, case.reference, case.recording)
            row |= {"accepted": loops.accepted, "false": loops.false}
            if loops.recall is not None:
                row["recall"] = loops.recall
    except Exception as error:  # one crash is a result, and no reason to lose the others
        row["error"] = f"{type(error).__name__}: {error}"
    return row


def calls(study: str, chosen: range | None) -> list[Call]:
    """The runs of a study."""
    if study == "key-scans":
        numbers = chosen or range(100, 110)
        logs = [(name, seed) for name in SCENARIOS for seed in numbers]
        logs += [(f"random-corridors-{seed}", seed) for seed in numbers]
        noises = (("", None), (", noise", STEP_NOISE))
        rows: list[Call] = [
            (name.partition("s-")[0] + extra, name, seed, noise, False, ())
            for extra, noise in noises
            for name, seed in logs
        ]
        return rows + [("big_loop, every scan", "big_loop", seed, None, True, ()) for seed in numbers]
    if study == "worlds":
        return [(name, name, seed, STEP_NOISE, False, ()) for name in WORLDS for seed in chosen or range(5)]
    logs = [(name, 0) for name in LOGS_OF_STAGES if log_file(name).is_file()]
    logs += [(name, seed) for name in (*SCENARIOS, "twins", "grid") for seed in chosen or range(200, 203)]
    return [
        (f"{name}, {stage}", name, seed, None if name in LOGS else STEP_NOISE, False, settings)
        for name, seed in logs
        for stage, settings in STAGES.items()
    ]


def draw_before_and_after(path: Path, log: str = "aces") -> None:
    """The map of a log without back end and with it, side by side at one scale; a PNG."""
    from moteslam.eval.report import style
    from moteslam.eval.report.plans import draw_map, map_corners
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    recording = load_log(log).recording
    runs = {
        "without back end": run_slam(recording, resolve_config("default", STAGES["without back end"])),
        "with loops, pose graph and joint registration": run_slam(recording, resolve_config("default")),
    }
    with style.saved_figure(path, size=(12.0, 6.2)) as figure:
        for axes, (title, estimate) in zip(figure.subplots(1, 2), runs.items(), strict=True):
            poses = estimate.trajectory_final.poses[:, :2]
            draw_map(axes, estimate.map)
            axes.plot(*poses.T, color=style.SLAM, lw=0.7)
            style.plan(axes)
            style.show_everything(axes, map_corners(estimate.map), margin=0.5)
            axes.set_title(title, fontsize="medium")
        style.heading(figure, f"{recording.name}: map and final path")


def main() -> None:
    """Run a study, print a table, and write the result file, anew after every run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=("key-scans", "worlds", "stages", "picture"))
    parser.add_argument("--seeds", type=seeds, metavar="N", help="of the simulated runs; or 10-19")
    parser.add_argument("--workers", type=count, default=2)
    parser.add_argument("--out", type=result_file)
    options = parser.parse_args()
    if options.study == "picture":
        draw_before_and_after(options.out or Path("back_end_aces.png"))
        return
    rows: list[dict[str, Any]] = []
    summary: dict[str, Any] = {}
    for row in rows_of(run, calls(options.study, options.seeds), options.workers):
        rows.append(row)
        names = dict.fromkeys(row["run"] for row in rows)
        summary = {name: summarise([row for row in rows if row["run"] == name], ()) for name in names}
        save(options.out, {**stamp(), "study": options.study, "summary": summary, "rows": rows})
    print()
    print(table(summary_lines(summary), right=(3, 4)))


if __name__ == "__main__":
    main()
