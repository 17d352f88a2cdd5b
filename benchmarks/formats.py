"""Whether a recording survives every format that is written: stream by stream, and in what SLAM makes of it.

    python benchmarks/formats.py --out result.json
    python benchmarks/formats.py --robots lms200 --seeds 2 --duration 15

A simulated drive is written in every format and read back. Every stream that the format holds must be equal within the
rounding that docs/reference/formats.md states. Where streams and robot come back bit for bit, the preset's trajectories
must be the same bytes; else the median of its ATE over the seeds must lie in the 95 % bootstrap interval of the median
of the recording's own.

Of the robot lms200 the odometry that its base computes is recorded, too. Recordings that are the same bit for bit are
replayed once, those of the first seed in every format. Every run is on one thread.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from parts.machine import save, stamp
from parts.options import count, factor, result_file, seeds
from parts.pool import Row, row_or_error, rows_of
from parts.readback import HELD, beyond, differences, digest, write_and_read
from parts.runs import simulate_case

from moteslam.errors import ConfigError
from moteslam.eval.cli.text import table
from moteslam.eval.statistics import Summary
from moteslam.slam.settings import resolve_config

ROBOTS = ("ucsd", "lms200")
ITSELF = "recording"
"""The name, among those of formats, of the recording that was not written."""


def run(robot: str, seed: int, preset: str, duration: float) -> Row:
    """One drive in every format; what went wrong, if it crashes."""
    return row_or_error({"robot": robot, "seed": seed}, measure, robot, seed, preset, duration)


def measure(robot: str, seed: int, preset: str, duration: float) -> Row:
    """Of one drive, for every format: differences, the ATE of the final trajectory, whether its bytes are the same."""
    from moteslam.kernels import runtime
    from moteslam.sim.logged import with_odometry

    runtime.init("cpu", 1)
    case = simulate_case("corridor", seed, platform=robot, duration=duration)
    recording = with_odometry(case.recording) if robot == "lms200" else case.recording
    config = resolve_config(preset)
    original = digest(recording)
    replays = {original: replay(recording, config, case.reference, seed)}
    formats: dict[str, Any] = {ITSELF: {"ate": replays[original][1]}}
    for name in HELD:
        with tempfile.TemporaryDirectory() as folder:
            back = write_and_read(name, Path(folder), recording)
            key = digest(back)
            if seed == 0 or key not in replays:
                replays[key] = replay(back, config, case.reference, seed)
            found = differences(name, recording, back)
        formats[name] = {
            "differences": found,
            "beyond": beyond(name, found),
            "same_bits": key == original,
            "ate": replays[key][1],
            "same_trajectory": replays[key][0] == replays[original][0],
        }
    return {"formats": formats}


def replay(recording: Any, config: Any, truth: Any, seed: int) -> tuple[bytes, float]:
    """The bytes of both trajectories that SLAM makes of a recording, and the ATE of the final one [m]."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.slam.run import run_slam

    estimate = run_slam(recording, config, seed=seed)
    arrays = [array for each in (estimate.trajectory, estimate.trajectory_final) for array in (each.stamps, each.poses)]
    return b"".join(array.tobytes() for array in arrays), absolute_trajectory_error(
        estimate.trajectory_final, truth
    ).rmse


def shown(row: Row) -> Row:
    """What is printed of a row: the ATE [m] of the recording itself and in every format."""
    ates = {name: one["ate"] for name, one in row.get("formats", {}).items()}
    return {key: value for key, value in row.items() if key != "formats"} | ates


def judged(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """A verdict for every robot and format over its seeds."""
    verdicts = []
    for robot in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == robot]
        good = [row["formats"] for row in mine if "error" not in row]
        if not good:
            verdicts.append({"robot": robot, "format": "all", "seeds": len(mine), "holds": False})
            continue
        own = Summary.of([formats[ITSELF]["ate"] for formats in good])
        for name in HELD:
            these = [formats[name] for formats in good]
            ate = Summary.of([one["ate"] for one in these])
            exact = all(one["same_bits"] for one in these)
            assert own.low is not None
            assert own.high is not None
            assert ate.median is not None
            same = all(one["same_trajectory"] for one in these)
            replays = same if exact else own.low <= ate.median <= own.high
            fields = {field: max(one["differences"][field] for one in these) for field in these[0]["differences"]}
            within = not any(one["beyond"] for one in these)
            verdicts.append(
                {
                    "robot": robot,
                    "format": name,
                    "seeds": len(mine),
                    "differences": fields,
                    "within_rounding": within,
                    "same_bits": exact,
                    "same_trajectories": sum(one["same_trajectory"] for one in these),
                    "median_ate": ate.median,
                    "own_median_ate": own.median,
                    "own_interval": [own.low, own.high],
                    "holds": within and replays and len(good) == len(mine),
                }
            )
    return verdicts


def differences_table(verdicts: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """The largest difference of each stream by robot and format."""
    fields = list(dict.fromkeys(field for one in verdicts for field in one.get("differences", ())))
    plain = [field for field in fields if ".figures." not in field]
    lines: list[tuple[str, ...]] = [("robot", "format", *plain, "figures")]
    for one in verdicts:
        found = one.get("differences", {})
        cells = [f"{found[field]:.2g}" if field in found else "-" for field in plain]
        figures = max((value for field, value in found.items() if ".figures." in field), default=0.0)
        lines.append((one["robot"], one["format"], *cells, f"{figures:.2g}"))
    return lines


def verdicts_table(verdicts: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """What SLAM makes of each, beside the recording's own."""
    lines: list[tuple[str, ...]] = [
        ("robot", "format", "seeds", "same bits", "same trajectories", "median ATE", "own, with its interval", "holds")
    ]
    for one in verdicts:
        holds = "yes" if one["holds"] else "NO"
        if "median_ate" not in one:
            lines.append((one["robot"], one["format"], str(one["seeds"]), "-", "-", "-", "-", holds))
            continue
        low, high = one["own_interval"]
        own = f"{one['own_median_ate']:.4f} ({low:.4f} to {high:.4f}) m"
        same = "yes" if one["same_bits"] else "no"
        trajectories = f"{one['same_trajectories']}"
        ate = f"{one['median_ate']:.4f} m"
        lines.append((one["robot"], one["format"], str(one["seeds"]), same, trajectories, ate, own, holds))
    return lines


def main() -> int:
    """Run, print the tables, write the result file anew after every drive; 1 where something does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS), choices=ROBOTS)
    parser.add_argument("--seeds", type=seeds, default=range(10), metavar="N", help="of each robot, from 0; or 10-19")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--duration", type=factor, default=60.0, metavar="S", help="of a drive [s]")
    parser.add_argument("--workers", type=count, default=1, help="processes; 1")
    parser.add_argument("--out", type=result_file)
    options = parser.parse_args()
    try:
        resolve_config(options.preset)
    except ConfigError as error:
        parser.error(str(error))
    about = {**stamp(), "preset": options.preset, "duration": options.duration, "workers": options.workers}
    rows: list[Row] = []
    verdicts: list[dict[str, Any]] = []
    calls = [(robot, seed, options.preset, options.duration) for robot in options.robots for seed in options.seeds]
    for row in rows_of(run, calls, options.workers, shown=shown):
        rows.append(row)
        verdicts = judged(rows)
        save(options.out, {**about, "verdicts": verdicts, "rows": rows})
    print(table(differences_table(verdicts)))
    print(table(verdicts_table(verdicts)))
    return 0 if all(one["holds"] for one in verdicts) else 1


if __name__ == "__main__":
    sys.exit(main())
