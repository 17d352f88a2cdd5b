"""Long bags: how fast they open, and how much memory reading all their scans takes; a dated result file.

    python benchmarks/bags.py --hours 1 --out result.json
    python benchmarks/bags.py --hours 0.02 --kinds bag
    python benchmarks/bags.py --hours 1 --image-rate 0

A recording is made up as it is written, and written by moteslam into a temporary folder: 1081 beams at 40 Hz, odometry
at 40 Hz with its transforms, an IMU at 100 Hz, and colour and depth images of a wall with noise. Each bag is opened in
a fresh process; memory is the most that the process held, above what it held when everything was imported. The files
were just written: they are in memory, as far as it goes, and the time to fetch them from a disk is not counted. The
bar for opening is of processor time, which other work on the machine leaves alone; the load is in the result file.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from cost import python
from numpy.typing import NDArray
from parts.bars import Bar
from parts.machine import save, stamp
from parts.options import count, factor, folder, result_file

BEAMS, SCAN_RATE, IMU_RATE = 1081, 40, 100
START = 1.6e9
PATTERNS = 16
"""Different images; there is no need for more."""
BARS = (Bar("opening_cpu_s", "worst", 10.0, strict=True), Bar("memory_mb", "worst", 300.0, strict=True))
"""Of a bag of an hour."""

OPENED = """
import json, resource, sys, time
import moteslam.robot.formats.bags.formats
from moteslam import open_recording
from moteslam.robot.recording import chunks

def peak():
    try:  # not ru_maxrss, which begins with what the parent held
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) * 1024 / 1e6
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6

before = peak()
began, used = time.perf_counter(), time.process_time()
recording = open_recording(sys.argv[1])
opened, used = time.perf_counter(), time.process_time() - used
at_open = peak()
scans = sum(len(chunk) for chunk in chunks(recording.lidar.ranges))
print(json.dumps({
    "opening_s": opened - began,
    "opening_cpu_s": used,
    "reading_s": time.perf_counter() - opened,
    "scans": scans,
    "opened_mb": at_open - before,
    "memory_mb": peak() - before,
}))
"""


class Images:
    """Colour and disparity images of a wall with noise, drawn once."""

    def __init__(self) -> None:
        random = np.random.default_rng(0)
        shade = np.linspace(80, 160, 640)[None, :, None] + random.normal(0, 3, (PATTERNS, 480, 640, 3))
        self._rgb = shade.astype(np.uint8)
        self._disparity = (np.linspace(600, 900, 640) + random.normal(0, 1, (PATTERNS, 480, 640))).astype(np.uint16)

    def rgb(self, index: int) -> NDArray[np.uint8]:
        """See `ImageSource`."""
        return np.asarray(self._rgb[index % PATTERNS])

    def disparity(self, index: int) -> NDArray[np.uint16]:
        """See `ImageSource`."""
        return np.asarray(self._disparity[index % PATTERNS])


def made_up(hours: float, image_rate: float) -> Any:
    """A recording of some hours whose ranges and images are made when they are written."""
    from moteslam.robot.platforms import bundled_platform
    from moteslam.robot.recording import ChunkedRanges, ImuStream, LidarStream, OdometryStream, Recording, RgbdStream

    def times(rate: float) -> NDArray[np.float64]:
        return START + np.arange(round(hours * 3600 * rate)) / rate

    def load(first: int, last: int) -> NDArray[np.float32]:
        return np.random.default_rng(first).uniform(0.5, 29.0, (last - first, BEAMS)).astype(np.float32)

    scans, readings = times(SCAN_RATE), times(IMU_RATE)
    turn = 0.1 * (scans - START)
    poses = np.column_stack((5 * np.cos(turn), 5 * np.sin(turn), np.mod(turn, 2 * np.pi) - np.pi))
    random = np.random.default_rng(1)
    images = None
    if image_rate:
        images = RgbdStream(times(image_rate) + 0.01, times(image_rate), images=Images())
    return Recording(
        "made up",
        bundled_platform("ucsd"),
        lidar=LidarStream(scans, ChunkedRanges(load, len(scans), BEAMS), -2.356, 0.00436, 0.1, 30.0, 1.7e-5),
        odometry=OdometryStream(scans, poses),
        imu=ImuStream(readings, random.normal(0, 1, (len(readings), 3)), random.normal(0, 1, (len(readings), 3))),
        rgbd=images,
    )


def measure(kind: str, path: Path, recording: Any, repeats: int) -> dict[str, Any]:
    """Write a bag, and open it in fresh processes: the median of the times, the most memory."""
    from moteslam.robot.formats.format import FORMATS

    write = FORMATS[kind].write
    assert write is not None
    began = time.perf_counter()
    write(path, recording)
    written = time.perf_counter() - began
    files = [path] if path.is_file() else sorted(path.iterdir())
    runs = [json.loads(python("-c", OPENED, str(path))[0]) for _ in range(repeats)]
    return {
        "kind": kind,
        "megabytes": sum(file.stat().st_size for file in files) / 1e6,
        "writing_s": written,
        "scans": runs[0]["scans"],
        **{key: float(np.median([run[key] for run in runs])) for key in ("opening_s", "opening_cpu_s", "reading_s")},
        **{key: max(run[key] for run in runs) for key in ("opened_mb", "memory_mb")},
    }


def table(rows: list[dict[str, Any]]) -> list[str]:
    """The figures, a line a bag."""
    keys = ("megabytes", "scans", "writing_s", "opening_s", "opening_cpu_s", "reading_s", "opened_mb", "memory_mb")
    head = f"{'kind':<8}" + "".join(f"{key:>15}" for key in keys)
    return [head, *(f"{row['kind']:<8}" + "".join(f"{row[key]:>15.4g}" for key in keys) for row in rows)]


def main() -> int:
    """Measure, print, write; 1 where a bar does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=factor, default=0.05, help="length of each bag [h]")
    parser.add_argument("--image-rate", type=factor, default=2.0, help="colour and depth images a second [Hz]")
    parser.add_argument("--kinds", nargs="+", default=["bag", "rosbag2", "mcap"], choices=["bag", "rosbag2", "mcap"])
    parser.add_argument("--repeats", type=count, default=3, help="how often each bag is opened")
    parser.add_argument("--folder", type=folder, default=None, help="where the bags are made, and removed again")
    parser.add_argument("--out", type=result_file, default=None, help="JSON of the results")
    options = parser.parse_args()
    recording = made_up(options.hours, options.image_rate)
    rows = []
    for kind in options.kinds:
        with tempfile.TemporaryDirectory(dir=options.folder) as place:
            name = "x" if kind == "rosbag2" else f"x.{kind}"
            rows.append(measure(kind, Path(place) / name, recording, options.repeats))
        print("\n".join(table(rows[-1:])), flush=True)
    bars = [
        {"kind": row["kind"], "figure": bar.figure, "text": str(bar), "holds": bar.holds(row[bar.figure])}
        for row in rows
        for bar in BARS
    ]
    for bar in bars:
        print(f"{bar['kind']} {bar['figure']} {bar['text']}: {'holds' if bar['holds'] else 'DOES NOT HOLD'}")
    settings = {"hours": options.hours, "image_rate": options.image_rate, "repeats": options.repeats}
    save(options.out, {**stamp(), "rosbags": version("rosbags"), **settings, "rows": rows, "bars": bars})
    return 0 if all(bar["holds"] for bar in bars) else 1


if __name__ == "__main__":
    sys.exit(main())
