"""Ten hours in a loop with the back end on: what memory a run takes, hour by hour.

    python benchmarks/soak.py --out result.json

    python benchmarks/soak.py --hours 0.02

The scenario `loop` is driven round a hundred times by the robot `lms200`, again and again with another seed, and the
drives are put one behind the other; ranges are read from their file, 256 scans at a time. Every hour: resident memory,
what of it the trajectory takes (poses, covariances and diagnostics of every scan, and the paths of the particles), the
nodes of the graph, and the processor time of a scan.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from parts.machine import resident_bytes, save, stamp
from parts.options import count, factor, result_file
from parts.runs import graph_backend

from moteslam.robot.platforms import load_platform
from moteslam.robot.recording import ChunkedRanges, EncoderStream, LidarStream, Recording
from moteslam.slam.run import SlamSession

LAPS = 100
"""Of a drive, at most."""
LAP = 79.0, 90.0
"""A lap takes at least, and at most, so long [s]."""
PAUSE = 0.1
"""Between two drives [s]."""


def drive(seed: int, laps: int, folder: Path) -> None:
    """Simulate a drive of some laps into a folder: arrays, and the ranges as they are."""
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.simulate import simulate

    scenario = load_scenario("loop", platform="lms200", settings=[f"route.laps={laps}", f"duration={LAP[1] * laps}"])
    recording = simulate(scenario, seed=seed).recording
    lidar, encoders = recording.lidar, recording.encoders
    assert lidar is not None
    assert encoders is not None
    np.asarray(lidar.ranges).tofile(folder / f"{seed}.ranges")
    np.savez(
        folder / f"{seed}.npz",
        scans=lidar.stamps,
        readings=encoders.stamps,
        counts=encoders.counts,
        fan=(lidar.angle_min, lidar.angle_increment, lidar.range_min, lidar.range_max, lidar.ranges.shape[1]),
    )


def recorded(folder: Path, drives: int) -> Recording:
    """The drives one behind the other, with their ranges in files."""
    parts, shift, starts = [], 0.0, [0]
    for seed in range(drives):
        with np.load(folder / f"{seed}.npz") as arrays:
            part = dict(arrays)
        first = min(part["scans"][0], part["readings"][0])
        part["scans"], part["readings"] = part["scans"] - first + shift, part["readings"] - first + shift
        shift = max(part["scans"][-1], part["readings"][-1]) + PAUSE
        starts.append(starts[-1] + len(part["scans"]))
        parts.append(part)
    angle_min, increment, range_min, range_max, beams = parts[0]["fan"].tolist()
    beams = int(beams)

    def load(first: int, last: int) -> np.ndarray:
        found = []
        for seed in range(drives):
            begin, end = max(first, starts[seed]), min(last, starts[seed + 1])
            if begin < end:
                offset, size = 4 * beams * (begin - starts[seed]), beams * (end - begin)
                found.append(np.fromfile(folder / f"{seed}.ranges", np.float32, size, offset=offset))
        return np.concatenate(found).reshape(-1, beams)

    return Recording(
        "soak",
        load_platform("lms200"),
        lidar=LidarStream(
            np.concatenate([part["scans"] for part in parts]),
            ChunkedRanges(load, starts[-1], beams),
            angle_min,
            increment,
            range_min,
            range_max,
        ),
        encoders=EncoderStream(
            np.concatenate([part["readings"] for part in parts]), np.concatenate([part["counts"] for part in parts])
        ),
    )


def trajectory_bytes(session: SlamSession, scans: int) -> int:
    """What the poses of so far are in memory [bytes]: of every scan with its covariance, of every particle's path."""
    inputs, history = session._inputs, session._filter.history
    a_scan = [inputs.stamps, inputs.odometry, inputs.motions, inputs.jumped, inputs.measured]
    paths = sum(poses.nbytes + sys.getsizeof(poses) for poses in history._poses)
    keys = sum(sys.getsizeof(pose) + pose.nbytes for pose in graph_backend(session)._path)
    return int(sum(values.nbytes // len(values) for values in a_scan) * scans + session._records.nbytes + paths + keys)


def soak(folder: Path, drives: int, hours: float, settings: list[str]) -> None:
    """Run SLAM over the drives; a line of JSON an hour."""
    from moteslam.kernels.runtime import init
    from moteslam.slam.settings import resolve_config

    init("cpu", 1)
    recording = recorded(folder, drives)
    session = SlamSession(recording, resolve_config("default", settings))
    first = session._inputs.stamps[0]
    hour, began, before = 1, time.process_time(), 0
    for update in session:
        last = update.stamp - first >= 3600 * hours
        if update.stamp - first >= 3600 * hour or last:
            row: dict[str, Any] = {
                "hours": float(update.stamp - first) / 3600,
                "scans": update.index + 1,
                "resident": resident_bytes(),
                "trajectory": trajectory_bytes(session, update.index + 1),
                "maps": session.map_bytes,
                "nodes": len(graph_backend(session)._nodes),
                "cpu_seconds_a_scan": (time.process_time() - began) / (update.index + 1 - before),
            }
            print(json.dumps(row), flush=True)
            hour, began, before = hour + 1, time.process_time(), update.index + 1
        if last:
            break


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=factor, default=10.0)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of the configuration")
    parser.add_argument("--folder", type=Path, help="of the drives, kept; they are simulated where they are missing")
    parser.add_argument("--out", type=result_file)
    parser.add_argument("--drive", type=count, help=argparse.SUPPRESS)
    parser.add_argument("--soak", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    laps = min(LAPS, math.ceil(3600 * options.hours / LAP[0]) + 1)
    drives = math.ceil(3600 * options.hours / (laps * LAP[0]))
    if options.drive is not None:
        drive(options.drive - 1, laps, options.folder)
        return
    if options.soak:
        soak(options.folder, drives, options.hours, options.set)
        return
    with tempfile.TemporaryDirectory(prefix="soak-") as scratch:
        folder = options.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        again = [sys.executable, __file__, "--hours", str(options.hours), "--folder", str(folder)]
        for number in range(1, drives + 1):  # each in a process of its own: what it took goes with it
            if not (folder / f"{number - 1}.npz").exists():
                subprocess.run([*again, "--drive", str(number)], check=True)
        settings = [word for setting in options.set for word in ("--set", setting)]
        rows = []
        with subprocess.Popen([*again, "--soak", *settings], stdout=subprocess.PIPE, text=True) as run:
            assert run.stdout is not None
            for line in run.stdout:
                if not line.startswith("{"):
                    continue
                row = json.loads(line)
                rows.append(row)
                print(
                    f"{row['hours']:5.2f} h  {row['scans']:7d} scans  resident {row['resident'] / 1e6:7.1f} MB, of it "
                    f"trajectory {row['trajectory'] / 1e6:6.1f} MB  maps {row['maps'] / 1e6:6.1f} MB  "
                    f"{row['nodes']} nodes  {1000 * row['cpu_seconds_a_scan']:.2f} ms of CPU a scan",
                    flush=True,
                )
    if run.returncode:
        sys.exit(run.returncode)
    save(options.out, {**stamp(), "hours": options.hours, "settings": options.set, "rows": rows})


if __name__ == "__main__":
    main()
