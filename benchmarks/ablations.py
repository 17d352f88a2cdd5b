"""One setting at a time against the error: a curve for each sweep, every seed a dot; a dated result file.

    python benchmarks/ablations.py --out benchmarks/results/ablations-YYYY-MM-DD.json --figures docs/images
    python benchmarks/ablations.py --sweeps particles --seeds 2

particles   how many, preset `default`: on loops of real logs, and where wheels slip or the lidar sees nothing
yaw_noise   noise on the yaw rate of the motion model, preset `paper` (figure 7 of the paper)
low_pass    cut-off of the low-pass on the gyro's yaw rate, both presets; 0 is without

Errors are those of the final trajectory: ATE RMSE after alignment [m].
"""

from __future__ import annotations

import argparse
import json
import statistics
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from accuracy import run
from parts.machine import save, stamp
from parts.options import count, folder, result_file, seeds


@dataclass(frozen=True)
class Sweep:
    """A setting and what it is tried on.

    Attributes:
        setting: its key in the configuration.
        values: that it takes.
        label: of the axis.
        runs: real logs and scenarios, each with the presets it is run with.
    """

    setting: str
    values: tuple[float, ...]
    label: str
    runs: dict[str, tuple[str, ...]]


DEFAULT, PAPER = ("default",), ("paper",)
SWEEPS = {
    "particles": Sweep(
        "particles",
        (1, 3, 10, 30, 100),
        "particles",
        dict.fromkeys(("intel_key_scans", "belgioioso", "big_loop", "outage", "two_halls"), DEFAULT),
    ),
    "yaw_noise": Sweep(
        "motion.yaw_rate",
        (0, 0.02, 0.05, 0.1, 0.2, 0.5, 1),
        "standard deviation of the noise on the yaw rate [rad/s]",
        dict.fromkeys(("corridor", "loop", "freiburg-101"), PAPER),
    ),
    "low_pass": Sweep(
        "sync.low_pass_hz",
        (0, 1, 3, 10, 30),
        "cut-off of the low-pass on the yaw rate [Hz]; 0 is without",
        dict.fromkeys(("corridor", "loop"), DEFAULT + PAPER),
    ),
}


def jobs(sweep: Sweep, chosen: range) -> list[tuple[str, str, float, int]]:
    """Run, preset, value and seed of all that a sweep takes."""
    return [
        (name, preset, value, seed)
        for name, presets in sweep.runs.items()
        for preset in presets
        for value in sweep.values
        for seed in chosen
    ]


def measured(sweep: Sweep, job: tuple[str, str, float, int]) -> dict[str, Any]:
    """One of them: its error [m]."""
    name, preset, value, seed = job
    row = run(name, preset, [f"{sweep.setting}={value:g}"], seed, 1.0)
    keep = {key: row[key] for key in ("final", "online", "dead_reckoning", "cpu_seconds_a_scan", "error") if key in row}
    return {"run": name, "preset": preset, "value": value, "seed": seed, **keep}


def curves(rows: list[dict[str, Any]]) -> dict[str, dict[float, list[float]]]:
    """By run and preset, and by value: the errors of the seeds [m]."""
    found: dict[str, dict[float, list[float]]] = {}
    for row in rows:
        if "final" in row:
            found.setdefault(f"{row['run']}, {row['preset']}", {}).setdefault(row["value"], []).append(row["final"])
    return found


def draw(path: Path, sweep: Sweep, rows: list[dict[str, Any]]) -> None:
    """The medians of the seeds joined, and every seed a dot, both axes logarithmic."""
    from moteslam.eval.report import style

    colours = (style.SLAM, style.DEAD_RECKONING, style.TRUTH, "#CC79A7", "#E69F00")
    least = min(value for value in sweep.values if value > 0)
    with style.saved_figure(path, size=(7.5, 4.5)) as figure:
        axes = figure.subplots()
        for colour, (name, errors) in zip(colours, curves(rows).items(), strict=False):
            axes.plot(
                list(errors),
                [statistics.median(each) for each in errors.values()],
                "-",
                color=colour,
                lw=1.3,
                label=name,
            )
            for value, each in errors.items():
                axes.plot([value] * len(each), each, "o", color=colour, ms=3, alpha=0.6)
        if 0 in sweep.values:
            axes.set_xscale("symlog", linthresh=least, linscale=0.5)
        else:
            axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(sweep.values, [f"{value:g}" for value in sweep.values])
        axes.minorticks_off()
        ticks = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20)
        low, high = axes.get_ylim()
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_ylim(low, high)
        axes.set_xlabel(sweep.label)
        axes.set_ylabel("ATE RMSE of the final trajectory [m]")
        axes.grid(visible=True, color="0.9")
        style.legend_below(figure, axes)


def table_of(rows: list[dict[str, Any]]) -> list[str]:
    """A Markdown table: the medians and, in brackets, the worst seeds."""
    found = curves(rows)
    values = sorted({row["value"] for row in rows})
    lines = ["| run | " + " | ".join(f"{value:g}" for value in values) + " |", "|---" * (len(values) + 1) + "|"]
    for name, errors in found.items():
        cells = [
            f"{statistics.median(errors[value]):.3f} ({max(errors[value]):.3f})" if value in errors else ""
            for value in values
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def main() -> None:
    """Run, print the tables, and write the result file anew after every run, the figures at the end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sweeps", nargs="+", choices=list(SWEEPS), default=list(SWEEPS), metavar="NAME")
    parser.add_argument("--seeds", type=seeds, default=range(3), metavar="N", help="of each run, from 0; or 5-9")
    parser.add_argument("--workers", type=count, default=2)
    parser.add_argument("--out", type=result_file)
    parser.add_argument("--figures", type=folder, metavar="FOLDER", help="for ablation_NAME.png")
    options = parser.parse_args()
    result: dict[str, Any] = {**stamp(), "rows": {}}
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for name in options.sweeps:
            sweep, rows = SWEEPS[name], result["rows"].setdefault(name, [])
            for row in [pool.submit(measured, sweep, job) for job in jobs(sweep, options.seeds)]:
                rows.append(row.result())
                print(name, json.dumps(rows[-1]), flush=True)
                save(options.out, result)
            if options.figures:
                draw(options.figures / f"ablation_{name}.png", sweep, rows)
    for name, rows in result["rows"].items():
        print(f"\n{name}: {SWEEPS[name].setting}", *table_of(rows), sep="\n")


if __name__ == "__main__":
    main()
