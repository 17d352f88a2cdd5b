"""Whether a recording survives every format that is written: stream by stream, and in what SLAM makes of it.

    python benchmarks/formats.py --out formats.csv
    python benchmarks/formats.py --robots lms200 --seeds 2 --duration 15

A simulated drive, of the robot lms200 with the odometry that its base computes, is written in every format and read
back. Every stream that the format holds must be equal within the rounding that docs/reference/formats.md states. Where
streams and robot come back bit for bit, the trajectories of the preset default must be the same bytes; else the median
of its ATE over the seeds must lie in the 95 % bootstrap interval of the median of the recording's own.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parts.harness import Bar, Row, arguments, benchmark, by_run, factor, status
from parts.readback import HELD, beyond, differences, digest, write_and_read
from parts.runs import Case, simulate_case

from moteslam.eval.statistics import Summary

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording

ROBOTS = ("ucsd", "lms200")
WHOLE = (Bar("within_rounding", "worst", 1.0, least=True), Bar("as_exact_as_its_bits", "worst", 1.0, least=True))


def measure(robot: str, form: str, seed: int, duration: float) -> Row:
    """Of one drive in one format: differences, the ATE of the final trajectory, whether its bytes are the same."""
    from moteslam.kernels import runtime

    runtime.init("cpu", 1)
    case, (own, own_ate) = original(robot, seed, duration)
    with tempfile.TemporaryDirectory() as folder:
        back = write_and_read(form, Path(folder), case.recording)
        found = differences(form, case.recording, back)
        same = digest(back) == digest(case.recording)
        trajectories, ate = replay(back, case.reference, seed)
    return {
        "within_rounding": not beyond(form, found),
        "same_bits": same,
        "same_trajectories": trajectories == own,
        "as_exact_as_its_bits": trajectories == own or not same,
        "ate_m": ate,
        "own_ate_m": own_ate,
        **{f"off {field}": value for field, value in found.items()},
    }


@lru_cache(maxsize=1)
def original(robot: str, seed: int, duration: float) -> tuple[Case, tuple[bytes, float]]:
    """The drive, and what SLAM makes of it."""
    from moteslam.sim.logged import with_odometry

    case = simulate_case("corridor", seed, platform=robot, duration=duration)
    if robot == "lms200":
        case = Case(with_odometry(case.recording), case.reference)
    return case, replay(case.recording, case.reference, seed)


def replay(recording: Recording, truth: Any, seed: int) -> tuple[bytes, float]:
    """The bytes of both trajectories that SLAM makes of a recording, and the ATE of the final one [m]."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.slam.run import run_slam

    estimate = run_slam(recording, seed=seed)
    paths = (estimate.trajectory, estimate.trajectory_final)
    ate = absolute_trajectory_error(estimate.trajectory_final, truth).rmse
    return b"".join(array.tobytes() for path in paths for array in (path.stamps, path.poses)), ate


def main() -> int:
    """Run, and print; 1 where something does not hold."""
    parser = arguments(__doc__)
    parser.add_argument("--robots", nargs="+", default=ROBOTS, choices=ROBOTS)
    parser.add_argument("--duration", type=factor, default=60.0, metavar="S", help="of a drive [s]")
    options = parser.parse_args()
    cases: list[tuple[Row, tuple[Any, ...]]] = []
    for robot, seed, form in itertools.product(options.robots, options.seeds or range(10), HELD):
        about = {"run": f"{robot}, {form}", "seed": seed, "duration": str(options.duration)}
        cases.append((about, (robot, form, seed, options.duration)))
    bars = {row["run"]: WHOLE for row, _ in cases}
    rows = benchmark(measure, cases, options, bars=bars)
    worse = []
    for run, mine in by_run(rows).items():
        ate, own = (Summary.of([row[key] for row in mine if key in row]) for key in ("ate_m", "own_ate_m"))
        if ate.median is None or own.low is None or own.high is None or not own.low <= ate.median <= own.high:
            worse.append(run)
            print(f"{run}: the median ATE is not in the interval of the recording's own")
    return 1 if worse else status(rows, bars)


if __name__ == "__main__":
    sys.exit(main())
