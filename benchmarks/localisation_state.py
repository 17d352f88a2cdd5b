"""How far covariances and states can be trusted: NEES, and precision and recall of "lost", over all scenarios.

    python benchmarks/localisation_state.py --out benchmarks/results/localisation-state-YYYY-MM-DD.json
    python benchmarks/localisation_state.py --setups "key scans" --scenarios doors lab --seeds 200-204

Every bundled scenario as the setups have it: a scan each 0.1 m; key scans of the LMS200 by wheels alone, with noise of
5 % and 10 % added to each step; all that noise class `as_recorded` adds, with three times its odometry noise; robots
that are carried off: for a part of the path there are no scans, and the odometry stands still. The filter runs alone
(`backend.method=none`), but for the setups that say so, on one thread, with seed 0. What is counted:
docs/theory/am-i-lost.md.
"""

from __future__ import annotations

import argparse
import statistics
from dataclasses import dataclass

from parts.carried import carried_off
from parts.options import count, result_file, seeds
from parts.pool import Row, row_or_error, study
from parts.runs import FILTER_ALONE, STEP_NOISE, expect_names, simulate_case, wheels_case

from moteslam.errors import ConfigError
from moteslam.eval.cli.text import table

LONG = ("campus",)
"""Left out of dense setups, unless asked for: 1.6 km of a scan each 0.1 m take longer than all others together."""
DENSE = (0.1, 0.1)
"""Distance [m] and turn [rad] between the scans of dense setups."""

COUNTS = ("wrong", "lost", "lost_wrong", "doubted", "doubted_wrong")
"""Figures of a run that are counts of scans."""


@dataclass(frozen=True)
class Setup:
    """What is simulated, logged and run.

    Attributes:
        dense: a scan each 0.1 m of the scenario's own robot; else key scans of the LMS200 by noisy wheels.
        recorded: noise class ``as_recorded``, with three times its odometry noise.
        carried: after which share of the path the robot is carried off, and how far [m].
        preset: of SLAM.
        back_end: the filter does not run alone.
        seeds: of the simulations.
    """

    dense: bool
    seeds: range
    recorded: bool = False
    carried: tuple[float, float] | None = None
    preset: str = "default"
    back_end: bool = False


SETUPS = {
    "key scans": Setup(False, range(100, 105)),
    "key scans, carried 1.2 m": Setup(False, range(105, 108), carried=(0.4, 1.2)),
    "key scans, carried 6 m": Setup(False, range(107, 110), carried=(0.6, 6.0)),
    "dense": Setup(True, range(100, 101)),
    "dense, as recorded": Setup(True, range(101, 102), recorded=True),
    "dense, carried 4 m": Setup(True, range(102, 103), carried=(0.5, 4.0)),
    "dense, paper": Setup(True, range(100, 101), preset="paper"),
    "key scans, back end": Setup(False, range(100, 105), back_end=True),
    "key scans, carried 1.2 m, back end": Setup(False, range(105, 108), carried=(0.4, 1.2), back_end=True),
    "key scans, carried 6 m, back end": Setup(False, range(107, 110), carried=(0.6, 6.0), back_end=True),
    "dense, back end": Setup(True, range(100, 101), back_end=True),
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
    if setup.dense:
        case = simulate_case(
            scenario,
            seed,
            noise_class="as_recorded" if setup.recorded else None,
            key_scans=DENSE,
            odometry_noise=3.0 if setup.recorded else 1.0,
        )
    else:
        case = wheels_case(scenario, seed, step_noise=STEP_NOISE)
    recording, truth = case.recording, case.reference
    assert truth is not None
    if setup.carried is not None:
        after, distance = setup.carried
        recording = carried_off(recording, truth, after=after, distance=distance)
    estimate = run_slam(recording, resolve_config(setup.preset, () if setup.back_end else FILTER_ALONE), seed=0)
    found = score_localisation(
        estimate.trajectory,
        estimate.covariances,
        estimate.diagnostics["state"],
        estimate.diagnostics["updated"],
        truth,
        corrections=estimate.corrections,
    )
    nees = found.as_dict()["nees"] or {}
    lost, doubted = found.states == LocalisationState.LOST, found.states >= LocalisationState.DOUBTFUL
    return {
        "scans": len(found.stamps),
        "wrong": int(found.wrong.sum()),
        "lost": int(lost.sum()),
        "lost_wrong": int((found.wrong & lost).sum()),
        "doubted": int(doubted.sum()),
        "doubted_wrong": int((found.wrong & doubted).sum()),
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
    return result


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
    options = parser.parse_args()
    try:
        expect_names(options.scenarios or (), tuple(bundled_scenarios()), field="--scenarios")
    except ConfigError as error:
        parser.error(str(error))
    calls = [
        (name, scenario, seed)
        for name in options.setups
        for scenario in options.scenarios or bundled_scenarios()
        if options.scenarios or not (SETUPS[name].dense and scenario in LONG)
        for seed in options.seeds or SETUPS[name].seeds
    ]
    study(run, calls, options.workers, options.out, summarised=summarised, printed=printed)


if __name__ == "__main__":
    main()
