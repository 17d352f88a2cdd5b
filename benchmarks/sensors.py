"""What another robot, another lidar, key scans and the noise of real recordings do to the error.

    python benchmarks/sensors.py classes      all scenarios, both noise classes, presets paper and default, seeds 0 to 4
    python benchmarks/sensors.py lidars       three lidars, dense and as key scans, three scenarios, seeds 0 to 19
    python benchmarks/sensors.py key-scans    key scans of the LMS200 in all scenarios, seeds 0 to 19
    python benchmarks/sensors.py turtlebot3   the TurtleBot3 in worlds small enough for it, seeds 0 to 19
    python benchmarks/sensors.py robots       three small robots and shorter ranges of one of them, seeds 0 to 4
    python benchmarks/sensors.py residuals    scan residuals of the simulated LMS200, seeds 0 to 4, beside Intel
    python benchmarks/sensors.py half-degree  the same of one of 361 beams, beside csail and freiburg-101

Every run is simulated, replayed by the filter alone (the joint registration of the back end minimises the residuals
that are measured here), and scored by ATE RMSE after alignment, with and without scale. A run is lost from an
ATE of 0.15 m on, and is counted as such, never left out. Every run is on one thread.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from typing import Any

from parts.bars import summarise
from parts.machine import save, stamp
from parts.options import count, result_file, seeds
from parts.pool import Row, row_or_error, rows_of
from parts.runs import (
    FILTER_ALONE,
    HALF_DEGREE,
    KEY_SCANS,
    LOST,
    errors,
    expect_names,
    load_log,
    simulate_case,
    that_are_there,
)

from moteslam.errors import ConfigError
from moteslam.eval.cli.text import table

TEN_HERTZ = ("platform.lidar.rate=10.0", "platform.lidar.time_increment=0.00027")
"""Makes of the RPLidar A1 a lidar of 360 beams, 12 m and 10 Hz."""


@dataclass(frozen=True)
class Setup:
    """What is simulated: robot, noise class, settings of the scenario, key scans (or None), and the preset of SLAM."""

    name: str
    platform: str
    noise: str = "datasheet"
    settings: tuple[str, ...] = ()
    key_scans: tuple[float, float] | None = None
    preset: str = "default"


@dataclass(frozen=True)
class Study:
    """Setups, scenarios (None for all of them), seeds, and real logs beside whose residuals those of the runs stand."""

    setups: tuple[Setup, ...]
    scenarios: tuple[str, ...] | None
    seeds: range
    logs: tuple[str, ...] = ()


STUDIES = {
    "classes": Study(
        tuple(
            Setup(f"{preset}, {noise}", "ucsd", noise, preset=preset)
            for preset in ("default", "paper")
            for noise in ("datasheet", "as_recorded")
        ),
        None,
        range(5),
    ),
    "lidars": Study(
        (
            Setup("UTM-30LX", "ucsd"),
            Setup("360 beams, 12 m, 10 Hz", "rplidar_a1", settings=TEN_HERTZ),
            Setup("360 beams, 12 m, 10 Hz, key scans", "rplidar_a1", settings=TEN_HERTZ, key_scans=KEY_SCANS),
            Setup("LMS200", "lms200"),
            Setup("LMS200, key scans", "lms200", key_scans=KEY_SCANS),
        ),
        ("corridor", "office", "big_loop"),
        range(20),
    ),
    "key-scans": Study(
        (
            Setup("LMS200, key scans", "lms200", key_scans=KEY_SCANS),
            Setup("LMS200, key scans, as recorded", "lms200", "as_recorded", key_scans=KEY_SCANS),
        ),
        None,
        range(20),
    ),
    "turtlebot3": Study((Setup("TurtleBot3", "turtlebot3"),), ("lab", "office", "corridor"), range(20)),
    "robots": Study(
        (
            Setup("turtlebot3", "turtlebot3"),
            Setup("rplidar_a1", "rplidar_a1"),
            Setup("rplidar_s2", "rplidar_s2"),
            Setup("rplidar_a1, 6 m", "rplidar_a1", settings=("platform.lidar.range_max=6.0",)),
            Setup("rplidar_a1, 3 m", "rplidar_a1", settings=("platform.lidar.range_max=3.0",)),
        ),
        ("office", "corridor", "two_halls"),
        range(5),
    ),
    "half-degree": Study(
        (
            Setup("LMS200 at half a degree, datasheet", "lms200", settings=HALF_DEGREE),
            Setup("LMS200 at half a degree, as recorded", "lms200", "as_recorded", settings=HALF_DEGREE),
        ),
        ("corridor", "office", "loop", "big_loop"),
        range(5),
        logs=("csail", "freiburg-101"),
    ),
    "residuals": Study(
        (Setup("LMS200, datasheet", "lms200"), Setup("LMS200, as recorded", "lms200", "as_recorded")),
        None,
        range(5),
        logs=("intel_key_scans",),
    ),
}


def run(setup: Setup, scenario: str, seed: int, residuals: bool) -> Row:
    """One run: its errors [m] and, where asked for, the residuals of its scans; what went wrong, if it crashes."""
    about = {"setup": setup.name, "scenario": scenario, "seed": seed}
    return row_or_error(about, measure, setup, scenario, seed, residuals)


def measure(setup: Setup, scenario: str, seed: int, residuals: bool) -> Row:
    """The figures of one run."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.eval.metrics.residuals import scan_residuals
    from moteslam.kernels import runtime
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    runtime.init("cpu", 1)
    case = simulate_case(
        scenario,
        seed,
        platform=setup.platform,
        noise_class=setup.noise,
        settings=setup.settings,
        key_scans=setup.key_scans,
    )
    estimate = run_slam(case.recording, resolve_config(setup.preset, FILTER_ALONE), seed=seed)
    row = {"scans": len(estimate.trajectory), "end": case.end, **errors(scenario, estimate, case)}
    assert case.reference is not None  # a simulation has a truth
    scaled = absolute_trajectory_error(estimate.trajectory_final, case.reference, scale=True)
    row |= {"final_scaled": scaled.rmse, "scale": scaled.scale}
    if residuals:
        row |= figures(scan_residuals(case.recording, estimate.trajectory_final))
    return row


def run_log(name: str) -> dict[str, Any]:
    """The residuals of a real log, under the final poses of the preset ``default``."""
    from moteslam.eval.metrics.residuals import scan_residuals
    from moteslam.kernels import runtime
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    runtime.init("cpu", 1)
    recording = load_log(name).recording
    estimate = run_slam(recording, resolve_config("default", FILTER_ALONE), seed=0)
    return {
        "setup": "real",
        "scenario": name,
        "seed": 0,
        **figures(scan_residuals(recording, estimate.trajectory_final)),
    }


def figures(found: Any) -> dict[str, float]:
    """The four figures by which recordings are compared: median and 90 % [m], shares beyond 3 cm, without return."""
    return {
        "residual_median": found.median,
        "residual_90": found.quantile_90,
        "residual_beyond_3_cm": found.beyond_3_cm,
        "no_return": found.no_return,
    }


def summarised(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Median and worst of every figure, and how many were lost, by setup and scenario."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["setup"], row["scenario"]), []).append(row)
    found = []
    for (setup, scenario), mine in groups.items():
        summary = summarise(mine, ())
        counts = {"runs": summary["seeds"], "crashed": summary["crashed"]}
        values = {f"{key}_{over}": value for key, both in summary["figures"].items() for over, value in both.items()}
        lost = sum(row.get("final", 0.0) >= LOST for row in mine)
        found.append({"setup": setup, "scenario": scenario, **counts, **values, "lost": lost})
    return found


def printed(summary: list[dict[str, Any]]) -> str:
    """The summary as a table."""
    rows = [("setup", "scenario", "runs", "lost", "ATE [m]", "worst", "scaled", "worst", "dead reckoning", "residuals")]
    for one in summary:
        known = "final_median" in one
        keys = ("final_median", "final_worst", "final_scaled_median", "final_scaled_worst", "dead_reckoning_median")
        shown = tuple(f"{one[key]:.3f}" if known else "-" for key in keys)
        residuals = "-"
        if "residual_median_median" in one:
            median, most = 1000 * one["residual_median_median"], 1000 * one["residual_90_median"]
            far, none = 100 * one["residual_beyond_3_cm_median"], 100 * one["no_return_median"]
            residuals = f"{median:.1f}, {most:.0f} mm, {far:.1f} %, {none:.1f} %"
        runs = str(one["runs"]) + (f", {one['crashed']} crashed" if one["crashed"] else "")
        rows.append((one["setup"], one["scenario"], runs, str(one["lost"]), *shown, residuals))
    return table(rows, right=range(2, 9))


def main() -> None:
    """Run a study, print its table, and write the result file, anew after every run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--seeds", type=seeds, metavar="N", help="of each run, from 0; or 10-19")
    parser.add_argument("--scenarios", nargs="+", metavar="NAME", help="in place of the study's own")
    parser.add_argument("--workers", type=count, default=2, help="processes; 2")
    parser.add_argument("--out", type=result_file, help="JSON of the results")
    options = parser.parse_args()
    from moteslam.sim.scenario import bundled_scenarios

    study = STUDIES[options.study]
    scenarios = options.scenarios or study.scenarios or tuple(bundled_scenarios())
    try:
        expect_names(scenarios, tuple(bundled_scenarios()), field="--scenarios")
    except ConfigError as error:
        parser.error(str(error))
    about = {**stamp(), "study": options.study, "setups": [asdict(setup) for setup in study.setups]}
    calls = [
        (setup, scenario, seed, bool(study.logs))
        for scenario in scenarios
        for setup in study.setups
        for seed in options.seeds or study.seeds
    ]
    rows = list(rows_of(run_log, [(name,) for name in that_are_there(study.logs)], options.workers))
    for row in rows_of(run, calls, options.workers):
        rows.append(row)
        save(options.out, {**about, "summary": summarised(rows), "rows": rows})
    print(printed(summarised(rows)))


if __name__ == "__main__":
    main()
