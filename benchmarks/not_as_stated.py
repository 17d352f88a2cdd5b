"""Lidars that are not as stated: how often that is found, and how exactly.

    python benchmarks/not_as_stated.py --out not-as-stated.csv
    python benchmarks/not_as_stated.py --platforms lms200 --faults narrow ahead --worlds office --seeds 200-203
    python benchmarks/not_as_stated.py --ate --worlds office --seeds 100-100 --workers 1

A fault is put into the recording, or the platform, of a simulated drive: at its size and at half of it; mirrored beams
and a lidar mounted backwards have no size. Figures of a run:

| figure | what |
|---|---|
| right | the fault is found, alone, and measured to a fifth of its size; without a fault: nothing is found |
| off | by how much of the fault's size the estimate is off |
| interval | half the width of the 95 % interval, over the fault's size |
| inside | the true value is in the interval |
| codes | what is found |

With ``--ate``, at full size alone: the ATE of the final path after ``--calibrate lidar``, without it (as a replay does
without the option), and of the recording without the fault [m]; ``over`` is the first over the last.

Asked: right in 9 of 10 runs of every fault, and in 99 of 100 without one; with ``--ate``, at most twice.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from parts.harness import Bar, Case, Row, arguments, benchmark, expect_known, status
from parts.runs import Case as Drive
from parts.runs import errors, simulate_case

from moteslam.robot.platforms import bundled_platforms, load_platform
from moteslam.robot.recording import LidarStream, Recording
from moteslam.sim.scenario import bundled_scenarios
from moteslam.slam.calibration.checked import checked
from moteslam.slam.calibration.findings import WITHIN
from moteslam.slam.calibration.mended import calibrated
from moteslam.slam.config import resolve_config
from moteslam.slam.online import run_slam

Change = Callable[["LidarStream", float], Any]  # Gives a field of a stream, changed by a share of the fault


@dataclass(frozen=True)
class Fault:
    code: str  # of the issue that tells it; empty without a fault
    shows: str = ""  # how the name of its figure begins
    # by how much that differs then from what is stated, at a share of the fault; None where it has no size
    size: Callable[[float], float] | None = None
    stream: dict[str, Change] | None = None  # changes of the lidar's stream, by field
    mount: dict[str, float] | None = None  # what is added to the lidar's pose as stated

    def put(self, recording: Recording, share: float) -> Recording:
        """The recording with a share of the fault."""
        lidar, spec = recording.lidar, recording.platform.lidar
        assert lidar is not None
        changed = {name: change(lidar, share) for name, change in (self.stream or {}).items()}
        stated = {name: getattr(spec, name) + share * by for name, by in (self.mount or {}).items()}
        platform = recording.platform.model_copy(update={"lidar": spec.model_copy(update=stated)})
        return recording.replace(lidar=replace(lidar, **changed), platform=platform)


FAULTS = {
    "none": Fault(""),
    "narrow": Fault(
        "lidar-angles",
        "angles",
        lambda share: 1 / (1 - 0.05 * share) - 1,
        stream={"angle_increment": lambda lidar, share: lidar.angle_increment * (1 - 0.05 * share)},
    ),
    "long": Fault(
        "range-scale",
        "lengths",
        lambda share: 0.1 * share,
        stream={
            "ranges": lambda lidar, share: lidar.ranges[:] * np.float32(1 + 0.1 * share),
            "range_max": lambda lidar, share: lidar.range_max * (1 + 0.1 * share),
        },
    ),
    "mirrored": Fault("mirrored", stream={"ranges": lambda lidar, _: np.ascontiguousarray(lidar.ranges[:][:, ::-1])}),
    "backwards": Fault("lidar-mount", mount={"yaw": np.pi}),
    "ahead": Fault("lidar-mount", "x", lambda share: -0.2 * share, mount={"x": 0.2}),
    "aside": Fault("lidar-mount", "y", lambda share: -0.2 * share, mount={"y": 0.2}),
    "turned": Fault("lidar-mount", "yaw", lambda share: -10 * share, mount={"yaw": np.radians(10)}),
    "drift": Fault(
        "clock-drift",
        "drift",
        lambda share: -0.005 * share,
        stream={"stamps": lambda lidar, share: lidar.stamps + 0.005 * share * (lidar.stamps - lidar.stamps[0])},
    ),
}


@lru_cache(maxsize=1)
def driven(world: str, platform: str, seed: int) -> Drive:
    """A drive whose clocks and wheels have no such errors of their own; consecutive cases share it."""
    sensors = [name for name in ("lidar", "encoders", "imu") if getattr(load_platform(platform), name) is not None]
    without = [f"platform.noise.{name}.clock.rate_error=0" for name in sensors]
    settings = ("platform.noise.encoders.scale_error=0", *without)
    return simulate_case(world, seed, platform=platform, settings=settings)


def final_ate(recording: Recording, drive: Drive, seed: int) -> float:
    """The ATE [m] of the final path of the preset ``default``."""
    return errors(run_slam(recording, resolve_config("default"), seed=seed), drive)["final"]


@lru_cache(maxsize=1)
def true_ate(world: str, platform: str, seed: int) -> float:
    drive = driven(world, platform, seed)
    return final_ate(drive.recording, drive, seed)


def measure_ate(name: str, share: float, world: str, platform: str, seed: int) -> Row:
    """What a fault costs, and what is left of that after ``--calibrate lidar``."""
    drive = driven(world, platform, seed)
    recording = FAULTS[name].put(drive.recording, share)
    calibration, _ = checked(recording)
    if calibration is None:
        return {"codes": "not measured"}
    ate = final_ate(calibrated(recording, calibration, "lidar"), drive, seed)
    without = final_ate(calibrated(recording, calibration, None), drive, seed)
    true = true_ate(world, platform, seed)
    return {"ate": ate, "without": without, "true": true, "over": ate / true}


def measure(name: str, share: float, world: str, platform: str, seed: int) -> Row:
    fault = FAULTS[name]
    recording = fault.put(driven(world, platform, seed).recording, share)
    calibration, found = checked(recording)
    if calibration is None or found is None:
        return {"right": False, "codes": "not measured"}
    codes = " ".join(issue.code for issue in found.issues)
    row: Row = {"right": codes == fault.code, "codes": codes or "-"}
    if fault.size is not None:
        size = fault.size(share)
        figure = next(one for one in found.figures if one.name.split(" ")[0] == fault.shows)
        off = abs((figure.value - figure.stated) / size - 1)
        interval = WITHIN * figure.deviation / abs(size)
        row |= {"right": row["right"] and off < 0.2, "off": off, "interval": interval, "inside": off < interval}
    return row


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--worlds", nargs="+", metavar="NAME", default=["office", "loop"])
    parser.add_argument("--platforms", nargs="+", choices=bundled_platforms(), default=list(bundled_platforms()))
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=list(FAULTS))
    parser.add_argument("--ate", action="store_true", help="run SLAM on what is mended, and on what is not")
    options = parser.parse_args()
    expect_known(parser, "--worlds", options.worlds, bundled_scenarios())
    drives = [
        (world, platform, seed)
        for platform in options.platforms
        for world in options.worlds
        for seed in options.seeds or range(100, 103)
    ]
    halves = not options.ate
    faults = [
        (name, share) for name in options.faults for share in ((0.5, 1.0) if FAULTS[name].size and halves else (1.0,))
    ]
    cases: list[Case] = [
        (
            {"run": f"{name} {share:g}", "platform": platform, "world": world, "seed": seed},
            (name, share, world, platform, seed),
        )
        for world, platform, seed in drives
        for name, share in faults
    ]
    least = {name: 0.99 if name == "none" else 0.9 for name in FAULTS}
    bars = {f"{name} {share:g}": (Bar("right", "median", least[name], least=True),) for name, share in faults}
    if options.ate:
        bars = {f"{name} {share:g}": (Bar("over", "worst", 2.0),) for name, share in faults}
        return status(benchmark(measure_ate, cases, options, bars=bars), bars)
    return status(benchmark(measure, cases, options, bars=bars), bars)


if __name__ == "__main__":
    sys.exit(main())
