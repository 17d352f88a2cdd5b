"""Ten hours in a loop with the back end on: what memory a run takes, hour by hour.

    python benchmarks/soak.py --out soak.csv
    python benchmarks/soak.py --live --drives 1 --beams 91 --workers 1
    python benchmarks/soak.py --hours 0.02

The scenario `loop` is driven round a hundred times by the robot `lms200`, again and again with another seed, and the
drives are put one behind the other (with --drives N these, again and again); ranges are read from their file, 256 scans
at a time, --beams of them. With --live the messages are added one by one, as on a robot. Every hour: resident memory,
what of it the trajectory takes (poses, covariances and diagnostics of every scan, and the paths of the particles), the
nodes of the graph, and the processor time of a scan.
"""

import math
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from parts.harness import Row, arguments, benchmark, count, factor, memory, parsed, status
from parts.runs import fed

from moteslam.kernels.runtime import init
from moteslam.robot.platforms import load_platform
from moteslam.robot.recording import ChunkedRanges, EncoderStream, LidarStream, Recording
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate
from moteslam.slam.config import resolve_config
from moteslam.slam.online import OnlineSlam
from moteslam.slam.tsdf.filter import TsdfFilter

LAPS = 100  # Of a drive, at most
LAP = 79.0, 90.0  # A lap takes at least, and at most, so long [s]
PAUSE = 0.1  # Between two drives [s]


def drive(seed: int, laps: int, folder: Path) -> None:
    """Simulate a drive of some laps into a folder: arrays, and the ranges as they are."""
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


def recorded(folder: Path, drives: int, made: int, beams: int) -> Recording:
    """The drives one behind the other, of which so many were made, with their ranges in files: every k-th beam."""
    parts, shift, starts = [], 0.0, [0]
    for seed in (number % made for number in range(drives)):
        with np.load(folder / f"{seed}.npz") as arrays:
            part = dict(arrays)
        first = min(part["scans"][0], part["readings"][0])
        part["scans"], part["readings"] = part["scans"] - first + shift, part["readings"] - first + shift
        shift = max(part["scans"][-1], part["readings"][-1]) + PAUSE
        starts.append(starts[-1] + len(part["scans"]))
        parts.append(part)
    *fan, width = parts[0]["fan"].tolist()
    width, every = int(width), max(1, int(width) // beams)
    kept = -(-width // every)
    fan[1] *= every

    def load(first: int, last: int) -> np.ndarray:
        found = []
        for number in range(drives):
            begin, end = max(first, starts[number]), min(last, starts[number + 1])
            if begin < end:
                offset, size = 4 * width * (begin - starts[number]), width * (end - begin)
                found.append(np.fromfile(folder / f"{number % made}.ranges", np.float32, size, offset=offset))
        return np.ascontiguousarray(np.concatenate(found).reshape(-1, width)[:, ::every])

    scans, readings, counts = (np.concatenate([part[key] for part in parts]) for key in ("scans", "readings", "counts"))
    return Recording(
        "soak",
        load_platform("lms200"),
        lidar=LidarStream(scans, ChunkedRanges(load, starts[-1], kept), *fan),
        encoders=EncoderStream(readings, counts),
    )


def trajectory_bytes(session: OnlineSlam, scans: int) -> int:
    """What the poses of so far are in memory [bytes]: of every scan with its covariance, of every particle's path."""
    inputs, history, backend, records = session._inputs, session._filter.history, session._backend, session._records
    a_scan = [inputs.stamps, inputs.odometry, inputs.motions, inputs.jumped, inputs.measured]
    a_scan += [records._rows.values]
    paths = sum(part.poses.nbytes for part in history._parts)
    keys = backend._path.values.nbytes if hasattr(backend, "_path") else 0
    return int(sum(values.nbytes // len(values) for values in a_scan) * scans + paths + keys)


def measure(folder: Path, drives: int, made: int, hours: float, settings: list[str], beams: int, *, live: bool) -> Row:
    """Run SLAM over the drives: figures of every hour, printed as they come."""
    init("cpu", 1)
    recording, config = recorded(folder, drives, made, beams), resolve_config("default", settings)
    lidar = recording.lidar
    assert lidar is not None
    fan = {"beams": lidar.ranges.shape[1], "angle_min": lidar.angle_min, "angle_increment": lidar.angle_increment}
    robot = recording.platform.with_(lidar=fan)
    session = OnlineSlam(robot, config) if live else OnlineSlam.over(recording, config)
    tsdf = session._filter
    assert isinstance(tsdf, TsdfFilter)
    rows: list[Row] = []
    began, before = time.process_time(), 0
    for scans, update in enumerate(fed(session, recording) if live else session, start=1):
        since = float(update.stamp - lidar.stamps[0]) / 3600
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
    parser = arguments(__doc__, settings=True)
    parser.add_argument("--hours", type=factor, default=10.0)
    parser.add_argument("--live", action="store_true", help="add the messages one by one")
    parser.add_argument("--drives", type=count, help="simulate so many [as many as fill the hours]")
    parser.add_argument("--beams", type=count, default=361, help="about so many [all]")
    options = parsed(parser)
    laps = min(LAPS, math.ceil(3600 * options.hours / LAP[0]) + 1)
    drives = math.ceil(3600 * options.hours / (laps * LAP[0]))
    with tempfile.TemporaryDirectory(prefix="soak-") as scratch:
        folder, context = Path(scratch), get_context("spawn")
        with ProcessPoolExecutor(options.workers, mp_context=context, max_tasks_per_child=1) as pool:
            made = min(options.drives or drives, drives)
            for job in [pool.submit(drive, seed, laps, folder) for seed in range(made)]:
                job.result()
        about = {"run": f"{options.hours:g} hours", "settings": " ".join(options.settings)}
        given = (folder, drives, made, options.hours, options.settings, options.beams)
        run = partial(measure, live=options.live)
        return status(benchmark(run, [(about, given)], options, fresh=True))


if __name__ == "__main__":
    sys.exit(main())
