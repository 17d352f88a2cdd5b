"""How far covariances and states can be trusted: NEES, precision and recall of "lost", said against true probability.

    python benchmarks/localisation_state.py --out result.json
    python benchmarks/localisation_state.py --setups "key scans" --scenarios doors lab --seeds 200-204
    python benchmarks/localisation_state.py --draw docs/images/reliability.png --out FILE

Every bundled scenario as the setups have it: every scan of the scenario's own robot, by the noise of data sheets or as
recorded; key scans of the LMS200 by wheels alone, with noise of 5 % and 10 % added to each step; robots that are
carried on along their way for 20 s while their lidar is off and their wheels stand. On one thread, with seed 0. What is
counted: docs/theory/am-i-lost.md.
"""

from __future__ import annotations

import argparse
import statistics
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from parts.options import count, result_file, seeds
from parts.pool import Row, row_or_error, study
from parts.runs import STEP_NOISE, expect_names, simulate_case, wheels_case

from moteslam.errors import ConfigError
from moteslam.eval.cli.text import table

LONG = ("campus", "mile", "twins", "grid")
"""Left out of the setups of every scan, unless asked for: they take longer than all others together."""

CARRIED = 'faults=[{{kind="carried", start=40, duration=20, along={}, lidar="off"}}]'
COUNTS = ("wrong", "lost", "lost_wrong", "doubted", "doubted_wrong")
"""Figures of a run that are counts of scans."""
BINS = (0.0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.93, 1.0)
"""Said probabilities of a wrong pose are gathered between these."""


@dataclass(frozen=True)
class Setup:
    """What is simulated, logged and run.

    Attributes:
        every_scan: of the scenario's own robot; else key scans of the LMS200 by noisy wheels.
        seeds: of the simulations.
        recorded: noise class ``as_recorded``.
        carried: how far the robot is carried [m].
        preset: of SLAM.
    """

    every_scan: bool
    seeds: range
    recorded: bool = False
    carried: float = 0.0
    preset: str = "default"


SETUPS = {
    "key scans": Setup(False, range(100, 105)),
    "key scans, as recorded": Setup(False, range(100, 105), recorded=True),
    "key scans, carried 6 m": Setup(False, range(107, 110), carried=6.0),
    "every scan": Setup(True, range(100, 101)),
    "every scan, as recorded": Setup(True, range(101, 102), recorded=True),
    "every scan, carried 4 m": Setup(True, range(102, 103), carried=4.0),
    "every scan, carried 10 m": Setup(True, range(103, 104), carried=10.0),
    "every scan, paper": Setup(True, range(100, 101), preset="paper"),
}


def run(name: str, scenario: str, seed: int) -> Row:
    """The counts of one run, and its NEES; what went wrong, if it crashes."""
    return row_or_error({"setup": name, "scenario": scenario, "seed": seed}, measure, SETUPS[name], scenario, seed)


def measure(setup: Setup, scenario: str, seed: int) -> Row:
    """The counts of one run, and its NEES."""
    from moteslam.eval.metrics.localisation import score_localisation
    from moteslam.kernels import runtime
    from moteslam.slam.filter.certainty import LocalisationState
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    runtime.init("cpu", 1)
    settings = [CARRIED.format(setup.carried)] if setup.carried else []
    noise_class = "as_recorded" if setup.recorded else None
    if setup.every_scan:
        case = simulate_case(scenario, seed, noise_class=noise_class, settings=settings)
    else:
        case = wheels_case(scenario, seed, noise_class=noise_class, settings=settings, step_noise=STEP_NOISE)
    recording, truth = case.recording, case.reference
    assert truth is not None
    estimate = run_slam(recording, resolve_config(setup.preset), seed=0)
    found = score_localisation(
        estimate.trajectory,
        estimate.covariances,
        estimate.diagnostics["state"],
        estimate.diagnostics["updated"],
        truth,
        corrections=estimate.corrections,
    )
    said = estimate.diagnostics["wrong"][np.searchsorted(estimate.trajectory.stamps, found.stamps)]
    bins = np.clip(np.searchsorted(BINS, said, side="right") - 1, 0, len(BINS) - 2)
    nees = found.as_dict()["nees"] or {}
    lost, doubted = found.states == LocalisationState.LOST, found.states >= LocalisationState.DOUBTFUL
    return {
        "scans": len(found.stamps),
        "wrong": int(found.wrong.sum()),
        "lost": int(lost.sum()),
        "lost_wrong": int((found.wrong & lost).sum()),
        "doubted": int(doubted.sum()),
        "doubted_wrong": int((found.wrong & doubted).sum()),
        "said": [float(said[bins == k].sum()) for k in range(len(BINS) - 1)],
        "in_bin": [int((bins == k).sum()) for k in range(len(BINS) - 1)],
        "wrong_in_bin": [int(found.wrong[bins == k].sum()) for k in range(len(BINS) - 1)],
        **{f"nees_{key}": value for key, value in nees.items()},
    }


def pooled(rows: list[Row]) -> Row:
    """NEES as medians over runs; precision and recall over all scans, every run counted alike."""
    good = [row for row in rows if "error" not in row]
    if not good:
        return {"runs": len(rows), "crashed": len(rows)}
    share = {key: sum(row[key] / row["scans"] for row in good) / len(good) for key in COUNTS}
    result: Row = {"runs": len(rows), "crashed": len(rows) - len(good), **share}
    for key, wrong in (("lost", "lost_wrong"), ("doubted", "doubted_wrong")):
        result[f"{key}_precision"] = share[wrong] / share[key] if share[key] else None
        result[f"{key}_recall"] = share[wrong] / share["wrong"] if share["wrong"] else None
    for key in ("nees_mean", "nees_median", "nees_within_95"):
        values = [row[key] for row in good if key in row]
        result[key] = statistics.median(values) if values else None
    result["reliability"] = reliability(good)
    return result


def reliability(rows: list[Row]) -> list[Row]:
    """For each bin of ``BINS`` with scans: their share, the mean probability that was said, and the share wrong."""
    weights = [1 / row["scans"] for row in rows]  # every run counts alike
    sums = {
        key: np.sum([weight * np.array(row[key]) for weight, row in zip(weights, rows, strict=True)], axis=0)
        for key in ("in_bin", "said", "wrong_in_bin")
    }
    return [
        {"scans": float(scans / len(rows)), "said": float(said / scans), "wrong": float(wrong / scans)}
        for scans, said, wrong in zip(*sums.values(), strict=True)
        if scans > 0
    ]


def draw(path: Path, summary: dict[str, Row]) -> None:
    """The reliability diagram of each setup, said against true; the larger a mark, the more scans."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 5), constrained_layout=True)
    axes.plot((0, 1), (0, 1), color="0.6", label="said is true")
    for k, (name, marker) in enumerate(zip((name for name in summary if ":" not in name), "osD^vP*X", strict=False)):
        bins = summary[name]["reliability"]
        said, wrong, scans = ([one[key] for one in bins] for key in ("said", "wrong", "scans"))
        sizes = 30 + 200 * np.array(scans)
        axes.scatter(
            said, wrong, sizes, facecolors="none", edgecolors=f"C{k}", linewidths=1.5, marker=marker, label=name
        )
    axes.set(xlabel="probability of a wrong pose, as said", ylabel="share of the poses that are wrong")
    axes.legend(loc="lower right", fontsize="small", markerscale=0.5)
    figure.savefig(path, dpi=150)


def printed(summary: dict[str, Row]) -> str:
    """The summary as a table."""
    heads = ("", "runs", "NEES mean", "median", "within 95 %", "wrong", "lost", "precision", "recall")
    rows: list[tuple[str, ...]] = [(*heads, "doubted or lost", "precision", "recall")]
    keys = ("nees_mean", "nees_median", "nees_within_95", "wrong", "lost", "lost_precision", "lost_recall")
    for name, one in summary.items():
        values = [one.get(key) for key in (*keys, "doubted", "doubted_precision", "doubted_recall")]
        rows.append((name, str(one["runs"]), *("-" if value is None else f"{value:.3f}" for value in values)))
    return table(rows, right=range(1, 12))


def summarised(rows: list[Row]) -> dict[str, Row]:
    """By setup, and by setup and scenario."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row["setup"], []).append(row)
    for row in rows:
        groups.setdefault(f"{row['setup']}: {row['scenario']}", []).append(row)
    return {name: pooled(mine) for name, mine in groups.items()}


def main() -> None:
    """Run, print a table, and write the result file, anew after every run."""
    from moteslam.sim.scenario import bundled_scenarios

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--setups", nargs="+", metavar="NAME", choices=SETUPS, default=tuple(SETUPS))
    parser.add_argument("--scenarios", nargs="+", metavar="NAME", help="in place of all")
    parser.add_argument("--seeds", type=seeds, metavar="N", help="in place of the setups' own; or 200-204")
    parser.add_argument("--workers", type=count, default=2, help="processes; 2")
    parser.add_argument("--out", type=result_file)
    parser.add_argument("--draw", type=Path, metavar="PNG", help="the reliability diagram")
    options = parser.parse_args()
    try:
        expect_names(options.scenarios or (), tuple(bundled_scenarios()), field="--scenarios")
    except ConfigError as error:
        parser.error(str(error))
    calls = [
        (name, scenario, seed)
        for name in options.setups
        for scenario in options.scenarios or bundled_scenarios()
        if options.scenarios or not (SETUPS[name].every_scan and scenario in LONG)
        for seed in options.seeds or SETUPS[name].seeds
    ]
    rows = study(run, calls, options.workers, options.out, summarised=summarised, printed=printed)
    if options.draw:
        draw(options.draw, summarised(rows))


if __name__ == "__main__":
    main()
