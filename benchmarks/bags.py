"""Long bags: how fast they open, and how much memory reading all their scans takes.

    python benchmarks/bags.py --hours 1 --image-rate 0.5 --out bags.csv
    python benchmarks/bags.py --hours 0.02 --kinds bag

A recording is made up as it is written, and written into a temporary folder: 1081 beams at 40 Hz, odometry at 40 Hz
with its transforms, an IMU at 100 Hz, and colour and depth images of a wall with noise. Each bag is opened in a fresh
process, three times; memory is the most that the process held, above what it held when everything was imported. The
files were just written: they are in memory, as far as it goes, and the time to fetch them from a disk is not counted.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from parts.harness import Bar, Row, arguments, benchmark, factor, memory, status

if TYPE_CHECKING:
    from moteslam.robot.recording import Images

BEAMS, SCAN_RATE, IMU_RATE = 1081, 40, 100
START = 1.6e9
PATTERNS = 16  # Different images; there is no need for more
KINDS = ("bag", "rosbag2", "mcap")
BARS = dict.fromkeys(KINDS, (Bar("opening_cpu_s", "worst", 10.0), Bar("memory_mb", "worst", 300.0)))
"""Of a bag of an hour."""


def made_up_images() -> Images:
    """Colour and disparity images of a wall with noise, drawn once."""
    from moteslam.robot.recording import Images

    random = np.random.default_rng(0)
    shade = np.linspace(80, 160, 640)[None, :, None] + random.normal(0, 3, (PATTERNS, 480, 640, 3))
    rgb = shade.astype(np.uint8)
    disparity = (np.linspace(600, 900, 640) + random.normal(0, 1, (PATTERNS, 480, 640))).astype(np.uint16)
    return Images(lambda k: np.asarray(rgb[k % PATTERNS]), lambda k: np.asarray(disparity[k % PATTERNS]))


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
        images = RgbdStream(times(image_rate) + 0.01, times(image_rate), images=made_up_images())
    return Recording(
        "made up",
        bundled_platform("ucsd"),
        lidar=LidarStream(scans, ChunkedRanges(load, len(scans), BEAMS), -2.356, 0.00436, 0.1, 30.0, 1.7e-5),
        odometry=OdometryStream(scans, poses),
        imu=ImuStream(readings, random.normal(0, 1, (len(readings), 3)), random.normal(0, 1, (len(readings), 3))),
        rgbd=images,
    )


def measure(path: str, about: Row) -> Row:
    import moteslam.robot.formats.bags  # noqa: F401 - imported before the clock starts
    from moteslam import open_recording
    from moteslam.robot.recording import chunks

    before, began, used = memory("VmHWM"), time.perf_counter(), time.process_time()
    recording = open_recording(path)
    opened, used, at_open = time.perf_counter(), time.process_time() - used, memory("VmHWM")
    assert recording.lidar is not None
    scans = sum(len(chunk) for chunk in chunks(recording.lidar.ranges))
    return {
        **about,
        "opening_s": opened - began,
        "opening_cpu_s": used,
        "reading_s": time.perf_counter() - opened,
        "scans": scans,
        "opened_mb": at_open - before,
        "memory_mb": memory("VmHWM") - before,
    }


def main() -> int:
    from moteslam.robot.formats import write_recording

    parser = arguments(__doc__)
    parser.add_argument("--hours", type=factor, default=0.05, help="length of each bag [h]")
    parser.add_argument("--image-rate", type=factor, default=2.0, help="colour and depth images a second [Hz]")
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    options = parser.parse_args()
    recording = made_up(options.hours, options.image_rate)
    cases = []
    with tempfile.TemporaryDirectory() as place:
        for kind in options.kinds:
            path, began = Path(place) / (kind if kind == "rosbag2" else f"x.{kind}"), time.perf_counter()
            write_recording(path, recording, to=kind)
            files = [path] if path.is_file() else list(path.iterdir())
            about = {
                "writing_s": time.perf_counter() - began,
                "megabytes": sum(file.stat().st_size for file in files) / 1e6,
            }
            row = {"run": kind, "hours": str(options.hours), "image_rate": str(options.image_rate)}
            cases += [({**row, "seed": k}, (str(path), about)) for k in options.seeds or range(3)]
        rows = benchmark(measure, cases, options, bars=BARS, fresh=True)
    return status(rows, BARS)


if __name__ == "__main__":
    sys.exit(main())
