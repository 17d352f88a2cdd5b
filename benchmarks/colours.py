"""Colours of the floor in the weights: the same drives with and without, seed by seed; a dated result file.

    python benchmarks/colours.py --out result.json
    python benchmarks/colours.py --runs two_halls hall --seeds 5-9 --set colours.share=0.05

Each scenario is simulated with its camera, at its full rate and with lost frames, and run twice with the filter of the
preset `default`, without its back end, which knows nothing of colours: as it is, and with `colours.enabled`. Both get
the same recording and the same seed. No image is written: the frames that SLAM asks for are drawn then, the very pixels
that files would hold. Scored is the ATE RMSE of the final trajectory. Without --runs: `two_halls` on seeds 0 to 9, then
every other bundled scenario on seeds 0 and 1. What was broken off goes on with --resume.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from parts.machine import save, stamp
from parts.options import result_file, seeds
from parts.runs import FILTER_ALONE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from moteslam.sim.sensors.rgbd import CameraFrames

PARALLEL = "two_halls"
"""The scenario whose error is to be halved; the others may not grow by more than a tenth."""
HALVED, WORSE = 0.5, 1.1


class Drawn:
    """A simulated camera's images, drawn when they are asked for."""

    def __init__(self, frames: CameraFrames) -> None:
        self._frames = frames

    def rgb(self, index: int) -> NDArray[np.uint8]:
        """The colour image [480, 640, 3] of a stamp."""
        return np.asarray(self._frames.draw_rgb(np.array([index]))[0])

    def disparity(self, index: int) -> NDArray[np.uint16]:
        """The raw disparity image [480, 640] of a stamp."""
        return np.asarray(self._frames.draw_disparity(np.array([index]))[0])


def run(name: str, seed: int, settings: list[str], with_settings: list[str]) -> dict[str, Any]:
    """One seed of a scenario, without and with colours: the errors [m], and what each took."""
    from dataclasses import replace

    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.sim.scenario import load_scenario, with_camera
    from moteslam.sim.simulate import simulate
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    simulation = simulate(with_camera(load_scenario(name)), seed)
    recording, frames = simulation.recording, simulation.frames
    assert recording.rgbd is not None
    assert frames is not None
    recording = recording.replace(rgbd=replace(recording.rgbd, images=Drawn(frames)))
    row: dict[str, Any] = {"run": name, "seed": seed}
    for which, more in (("without", []), ("with", ["colours.enabled=true", *with_settings])):
        config = resolve_config("default", [*FILTER_ALONE, "texture.enabled=false", *settings, *more])
        spent = time.process_time()
        estimate = run_slam(recording, config, seed=seed)
        row[which] = absolute_trajectory_error(estimate.trajectory_final, simulation.truth).rmse
        row[f"{which}_online"] = absolute_trajectory_error(estimate.trajectory, simulation.truth).rmse
        row[f"{which}_processor_s"] = time.process_time() - spent
        row[f"{which}_warnings"] = [str(issue) for issue in estimate.warnings if issue.message.startswith("colours")]
    row["ratio"] = row["with"] / row["without"]
    return row


def todo(names: list[str], chosen: range | None) -> list[tuple[str, int]]:
    """The runs in their order: the parallel walls first, then a seed of every other scenario before the next seed."""
    others = [name for name in names if name != PARALLEL]
    first = [(PARALLEL, seed) for seed in chosen or range(10)] if PARALLEL in names else []
    return first + [(name, seed) for seed in chosen or range(2) for name in others]


def summarised(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """For each scenario the medians, the worst, the median of the pairs' ratios, and whether the bar holds."""
    summaries = {}
    for name in dict.fromkeys(row["run"] for row in rows):
        mine = [row for row in rows if row["run"] == name]
        limit = HALVED if name == PARALLEL else WORSE
        medians = {which: statistics.median(row[which] for row in mine) for which in ("without", "with")}
        summaries[name] = {
            "seeds": len(mine),
            **{f"{which}_median": value for which, value in medians.items()},
            **{f"{which}_worst": max(row[which] for row in mine) for which in ("without", "with")},
            "of_medians": medians["with"] / medians["without"],
            "median_of_ratios": statistics.median(row["ratio"] for row in mine),
            "limit": limit,
        }
        summary = summaries[name]
        summary["holds"] = max(summary["of_medians"], summary["median_of_ratios"]) <= limit
    return summaries


def main() -> None:
    """Run, print a row a seed, and write the result file, anew after every one."""
    from moteslam.eval.cli.text import table
    from moteslam.kernels import runtime
    from moteslam.sim.scenario import bundled_scenarios

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", nargs="+", metavar="NAME", help="scenarios by name")
    parser.add_argument("--seeds", type=seeds, metavar="N", help="of each run, from 0; or 10-19")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings", help="of both")
    parser.add_argument("--with", action="append", default=[], metavar="KEY=VALUE", dest="colours", help="of one")
    parser.add_argument("--threads", type=int, default=1, help="the errors do not depend on it")
    parser.add_argument("--out", type=result_file)
    parser.add_argument("--resume", action="store_true", help="keep the rows that --out already has")
    options = parser.parse_args()
    names = options.runs or list(bundled_scenarios())
    runtime.init("cpu", options.threads)
    about = {
        **stamp(),
        "preset": "default",
        "settings": options.settings,
        "with": options.colours,
        "threads": options.threads,
    }
    rows: list[dict[str, Any]] = []
    if options.resume and options.out is not None and options.out.exists():
        rows = json.loads(options.out.read_text())["rows"]
    have = {(row["run"], row["seed"]) for row in rows}
    for name, seed in todo(names, options.seeds):
        if (name, seed) in have:
            continue
        rows.append(run(name, seed, options.settings, options.colours))
        figures = " ".join(f"{key}={value:.4f}" for key, value in rows[-1].items() if isinstance(value, float))
        print(f"{name} {seed} {figures}", flush=True)
        save(options.out, {**about, "summary": summarised(rows), "rows": rows})
    lines: list[tuple[str, ...]] = [
        ("run", "seeds", "without", "with", "of medians", "median of ratios", "limit", "holds")
    ]
    for name, summary in summarised(rows).items():
        values = [summary[key] for key in ("without_median", "with_median", "of_medians", "median_of_ratios", "limit")]
        lines.append(
            (name, str(summary["seeds"]), *(f"{value:.3f}" for value in values), "yes" if summary["holds"] else "NO")
        )
    print(table(lines))


if __name__ == "__main__":
    main()
