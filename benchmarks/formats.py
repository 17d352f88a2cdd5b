"""Whether a recording survives every format that is written: stream by stream, and in what SLAM makes of it.

    python benchmarks/formats.py --out formats.csv
    python benchmarks/formats.py --robots lms200 --seeds 2 --duration 15

A simulated drive, of the robot lms200 with the odometry that its base computes, is written in every format and read
back. Every stream that the format holds must be equal within the rounding that docs/reference/formats.md states, and
the trajectories that the preset default makes of it the same bytes.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parts.harness import Bar, Row, arguments, benchmark, factor, status
from parts.readback import HELD, beyond, differences, write_and_read
from parts.runs import simulate_case

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording

ROBOTS = ("ucsd", "lms200")
WHOLE = (Bar("within_rounding", "worst", 1.0, least=True), Bar("same_trajectories", "worst", 1.0, least=True))


def measure(robot: str, form: str, seed: int, duration: float) -> Row:
    """Of one drive in one format: the differences, and whether SLAM makes the same bytes of it."""
    from moteslam.kernels import runtime

    runtime.init("cpu", 1)
    recording, own = original(robot, seed, duration)
    with tempfile.TemporaryDirectory() as folder:
        back = write_and_read(form, Path(folder), recording)
        found, trajectories = differences(form, recording, back), replay(back, seed)
    off = {f"off {field}": value for field, value in found.items()}
    return {"within_rounding": not beyond(form, found), "same_trajectories": trajectories == own, **off}


@lru_cache(maxsize=1)
def original(robot: str, seed: int, duration: float) -> tuple[Recording, bytes]:
    """The drive, and what SLAM makes of it."""
    from moteslam.sim.logged import with_odometry

    recording = simulate_case("corridor", seed, platform=robot, duration=duration).recording
    if robot == "lms200":
        recording = with_odometry(recording)
    return recording, replay(recording, seed)


def replay(recording: Recording, seed: int) -> bytes:
    """The bytes of both trajectories that SLAM makes of a recording."""
    from moteslam.slam.run import run_slam

    estimate = run_slam(recording, seed=seed)
    paths = (estimate.trajectory, estimate.trajectory_final)
    return b"".join(array.tobytes() for path in paths for array in (path.stamps, path.poses))


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
    return status(benchmark(measure, cases, options, bars=bars), bars)


if __name__ == "__main__":
    sys.exit(main())
