"""Ten hours in a loop with the back end on: what memory a run takes, hour by hour.

    python benchmarks/soak.py --out soak.csv
    python benchmarks/soak.py --hours 0.02

The scenario `loop` is driven round a hundred times by the robot `lms200`, again and again with another seed, and the
drives are put one behind the other; ranges are read from their file, 256 scans at a time. Every hour: resident memory,
what of it the trajectory takes (poses, covariances and diagnostics of every scan, and the paths of the particles), the
nodes of the graph, and the processor time of a scan.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from parts.harness import Row, arguments, benchmark, factor, memory, status

from moteslam.errors import MoteslamError
from moteslam.slam.settings import resolve_config

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording
    from moteslam.slam.online import OnlineSlam

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
    from moteslam.robot.platforms import load_platform
    from moteslam.robot.recording import ChunkedRanges, EncoderStream, LidarStream, Recording

    parts, shift, starts = [], 0.0, [0]
    for seed in range(drives):
        with np.load(folder / f"{seed}.npz") as arrays:
            part = dict(arrays)
        first = min(part["scans"][0], part["readings"][0])
        part["scans"], part["readings"] = part["scans"] - first + shift, part["readings"] - first + shift
        shift = max(part["scans"][-1], part["readings"][-1]) + PAUSE
        starts.append(starts[-1] + len(part["scans"]))
        parts.append(part)
    *fan, beams = parts[0]["fan"].tolist()
    beams = int(beams)

    def load(first: int, last: int) -> np.ndarray:
        found = []
        for seed in range(drives):
            begin, end = max(first, starts[seed]), min(last, starts[seed + 1])
            if begin < end:
                offset, size = 4 * beams * (begin - starts[seed]), beams * (end - begin)
                found.append(np.fromfile(folder / f"{seed}.ranges", np.float32, size, offset=offset))
        return np.concatenate(found).reshape(-1, beams)

    scans, readings, counts = (np.concatenate([part[key] for part in parts]) for key in ("scans", "readings", "counts"))
    return Recording(
        "soak",
        load_platform("lms200"),
        lidar=LidarStream(scans, ChunkedRanges(load, starts[-1], beams), *fan),
        encoders=EncoderStream(readings, counts),
    )


def trajectory_bytes(session: OnlineSlam, scans: int) -> int:
    """What the poses of so far are in memory [bytes]: of every scan with its covariance, of every particle's path."""
    inputs, history, backend, records = session._inputs, session._filter.history, session._backend, session._records
    a_scan = [inputs.stamps, inputs.odometry, inputs.motions, inputs.jumped, inputs.measured]
    a_scan += [records._rows.values]
    paths = sum(poses.nbytes + sys.getsizeof(poses) for poses in history._poses)
    keys = sum(sys.getsizeof(pose) + pose.nbytes for pose in getattr(backend, "_path", ()))
    return int(sum(values.nbytes // len(values) for values in a_scan) * scans + paths + keys)


def measure(folder: Path, drives: int, hours: float, settings: list[str]) -> Row:
    """Run SLAM over the drives: figures of every hour, printed as they come."""
    from moteslam.kernels.runtime import init
    from moteslam.slam.online import OnlineSlam
    from moteslam.slam.tsdf.filter import TsdfFilter

    init("cpu", 1)
    session = OnlineSlam.over(recorded(folder, drives), resolve_config("default", settings))
    tsdf = session._filter
    assert isinstance(tsdf, TsdfFilter)
    first = session._inputs.stamps[0]
    rows: list[Row] = []
    began, before = time.process_time(), 0
    for scans, update in enumerate(session, start=1):
        since = float(update.stamp - first) / 3600
        if since < min(len(rows) + 1, hours):
            continue
        row = {
            "hours": since,
            "scans": scans,
            "resident_mb": memory("VmRSS"),
            "trajectory_mb": trajectory_bytes(session, scans) / 1e6,
            "maps_mb": tsdf._particles.maps.memory / 1e6,
            "nodes": len(getattr(session._backend, "_nodes", ())),
            "cpu_ms_a_scan": 1e3 * (time.process_time() - began) / (scans - before),
        }
        print("  ".join(f"{key} {value:.2f}" for key, value in row.items()), flush=True)
        rows.append(row)
        began, before = time.process_time(), scans
        if since >= hours:
            break
    hourly = {f"{key}_hourly": [row[key] for row in rows] for key in rows[0]}
    return {**rows[-1], **hourly}


def main() -> int:
    """Simulate, run, and print; 1 where the run crashed."""
    parser = arguments(__doc__)
    parser.add_argument("--hours", type=factor, default=10.0)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings", help="of SLAM")
    options = parser.parse_args()
    try:
        resolve_config("default", options.settings)
    except MoteslamError as error:
        parser.error(str(error))
    laps = min(LAPS, math.ceil(3600 * options.hours / LAP[0]) + 1)
    drives = math.ceil(3600 * options.hours / (laps * LAP[0]))
    with tempfile.TemporaryDirectory(prefix="soak-") as scratch:
        folder, context = Path(scratch), get_context("spawn")
        with ProcessPoolExecutor(options.workers, mp_context=context, max_tasks_per_child=1) as pool:
            for job in [pool.submit(drive, seed, laps, folder) for seed in range(drives)]:
                job.result()
        about = {"run": f"{options.hours:g} hours", "settings": " ".join(options.settings)}
        given = (folder, drives, options.hours, options.settings)
        return status(benchmark(measure, [(about, given)], options, fresh=True))


if __name__ == "__main__":
    sys.exit(main())
