"""How far covariances and states can be trusted: NEES, precision and recall of "lost", said against true probability.

    python benchmarks/localisation_state.py --out state.csv
    python benchmarks/localisation_state.py --setups "key scans" --scenarios doors lab --seeds 200-204
    python benchmarks/localisation_state.py --out state.csv --draw docs/images/reliability.png

Every bundled scenario as the setups have it: every scan of the scenario's own robot, by the noise of data sheets or as
recorded; key scans of the LMS200 by wheels alone, with noise of 5 % and 10 % added to each step; robots that are
carried on along their way for 20 s while their lidar is off and their wheels stand. On one thread, SLAM with seed 0.
Precision and recall are over all scans, every run counted alike; NEES is the median over runs. What is counted:
docs/theory/am-i-lost.md.
"""

import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from parts.harness import Row, arguments, benchmark, by_run, draw_reliability, expect_known, status
from parts.runs import NOISY, simulate_case

from moteslam.eval.metrics.localisation import score_localisation
from moteslam.eval.tables import aligned
from moteslam.kernels import runtime
from moteslam.sim.scenario import bundled_scenarios
from moteslam.slam.config import resolve_config
from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.online import run_slam

LONG = ("campus", "mile", "twins", "grid")
"""Left out of the setups of every scan, unless asked for: they take longer than all others together."""
BINS = (0.0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.93, 1.0)  # Said probabilities of a wrong pose are gathered between these


def carried(metres: float) -> tuple[str, ...]:
    """The settings of a scenario whose robot is carried."""
    return (f'faults=[{{kind="carried", start=40, duration=20, along={metres}, lidar="off"}}]',)


SETUPS: dict[str, tuple[range, Mapping[str, Any]]] = {
    "key scans": (range(100, 105), NOISY),
    "key scans, as recorded": (range(100, 105), NOISY | {"noise_class": "as_recorded"}),
    "key scans, carried 6 m": (range(107, 110), NOISY | {"settings": (*NOISY["settings"], *carried(6.0))}),
    "every scan": (range(100, 101), {}),
    "every scan, as recorded": (range(101, 102), {"noise_class": "as_recorded"}),
    "every scan, carried 4 m": (range(102, 103), {"settings": carried(4.0)}),
    "every scan, carried 10 m": (range(103, 104), {"settings": carried(10.0)}),
    "every scan, paper": (range(100, 101), {}),
}
"""The seeds of the simulations, and what is simulated."""


def measure(setup: str, scenario: str, seed: int) -> Row:
    """Shares of the scans, the counts in each bin, and NEES of one run."""
    runtime.init("cpu", 1)
    case = simulate_case(scenario, seed, **SETUPS[setup][1])
    assert case.reference is not None
    estimate = run_slam(case.recording, resolve_config("paper" if setup.endswith("paper") else "default"), seed=0)
    diagnostics = estimate.diagnostics
    found = score_localisation(
        estimate.trajectory,
        estimate.covariances,
        diagnostics["state"],
        diagnostics["updated"],
        case.reference,
        corrections=estimate.corrections,
    )
    said = diagnostics["wrong"][np.searchsorted(estimate.trajectory.stamps, found.stamps)]
    bins = np.clip(np.searchsorted(BINS, said, side="right") - 1, 0, len(BINS) - 2)
    lost, doubted = found.states == LocalisationState.LOST, found.states >= LocalisationState.DOUBTFUL
    return {
        "scans": len(found.stamps),
        "wrong": float(found.wrong.mean()),
        "lost": float(lost.mean()),
        "lost_wrong": float((found.wrong & lost).mean()),
        "doubted": float(doubted.mean()),
        "doubted_wrong": float((found.wrong & doubted).mean()),
        "in_bin": [float((bins == k).mean()) for k in range(len(BINS) - 1)],
        "said": [float((said * (bins == k)).mean()) for k in range(len(BINS) - 1)],
        "wrong_in_bin": [float((found.wrong & (bins == k)).mean()) for k in range(len(BINS) - 1)],
        **{f"nees_{key}": value for key, value in (found.as_dict()["nees"] or {}).items()},
    }


def summary(rows: Sequence[Row]) -> str:
    """A line a setup, and one for each of its scenarios."""
    heads = ("", "runs", "NEES mean", "median", "within 95 %", "wrong", "lost", "precision", "recall")
    lines: list[tuple[str, ...]] = [(*heads, "doubted or lost", "precision", "recall")]
    groups = by_run(rows)
    groups |= by_run({**row, "run": f"{row['run']}: {row['scenario']}"} for row in rows)
    for run, mine in groups.items():
        good = [row for row in mine if "error" not in row]
        values: list[float | None] = []
        for key in ("nees_mean", "nees_median", "nees_within_95"):
            some = [row[key] for row in good if key in row]
            values.append(statistics.median(some) if some else None)
        share = {
            key: sum(row[key] for row in good) for key in ("wrong", "lost", "lost_wrong", "doubted", "doubted_wrong")
        }
        values.append(share["wrong"] / len(good) if good else None)
        for key in ("lost", "doubted"):
            right = share[f"{key}_wrong"]
            values.append(share[key] / len(good) if good else None)
            values += [right / share[of] if share[of] else None for of in (key, "wrong")]
        lines.append((run, str(len(mine)), *("-" if value is None else f"{value:.3f}" for value in values)))
    return aligned(lines)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--setups", nargs="+", metavar="NAME", choices=SETUPS, default=tuple(SETUPS))
    parser.add_argument("--scenarios", nargs="+", metavar="NAME", help="in place of all")
    parser.add_argument("--draw", type=Path, metavar="PNG", help="the reliability diagram")
    options = parser.parse_args()
    expect_known(parser, "--scenarios", options.scenarios or (), bundled_scenarios())
    cases = [
        ({"run": setup, "scenario": scenario, "seed": seed}, (setup, scenario, seed))
        for setup in options.setups
        for scenario in options.scenarios or bundled_scenarios()
        if options.scenarios or not (setup.startswith("every scan") and scenario in LONG)
        for seed in options.seeds or SETUPS[setup][0]
    ]
    rows = benchmark(measure, cases, options, summary=summary)
    if options.draw:
        groups = by_run(row for row in rows if "error" not in row)
        labels = "probability of a wrong pose, as said", "share of the poses that are wrong"
        draw_reliability(options.draw, groups, ("in_bin", "said", "wrong_in_bin"), labels)
    return status(rows)


if __name__ == "__main__":
    sys.exit(main())
