"""Lidars and odometry that are not as stated: how often that is found, how exactly, and what mending it comes to.

    python benchmarks/not_as_stated.py --out benchmarks/results/not-as-stated-YYYY-MM-DD.json
    python benchmarks/not_as_stated.py --worlds office --platforms ucsd --seeds 200-203 --faults narrow --ate

A fault is put into the recording or the platform of a simulated drive afterwards, at its size and at half of it, which
mirrored beams and a lidar mounted backwards have not. Asked: every fault is found, alone, within a fifth of its size in
9 of 10 runs; nothing is found in 99 of 100 drives without one; with ``--ate``, SLAM over the mended recording has at
most twice the ATE that it has over the true one.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from parts.options import count, result_file, seeds
from parts.pool import Row, row_or_error, study
from parts.runs import SCENARIOS

from moteslam.errors import ConfigError
from moteslam.eval.cli.text import table

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording
    from moteslam.sim.simulate import Simulation

WITHOUT = "none"
SEEDS = range(100, 103)


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes:
        put: gives the recording with the fault at a share of its size.
        code: of the issue.
        shows: the figure that it shows in, by the beginning of its name.
        size: by which that differs from what is stated then, at a share of its size; None where there is no size.
        side: that is mended, where the recording leaves it open.
    """

    put: Callable[[Recording, float], Recording]
    code: str
    shows: str = ""
    size: Callable[[float], float] | None = None
    side: str = "lidar"


def _lidar(**changes: Callable[[Any, float], Any]) -> Callable[[Recording, float], Recording]:
    def put(recording: Recording, share: float) -> Recording:
        lidar = recording.lidar
        assert lidar is not None
        return recording.replace(
            lidar=replace(lidar, **{name: change(lidar, share) for name, change in changes.items()})
        )

    return put


def _mount(**shifts: float) -> Callable[[Recording, float], Recording]:
    def put(recording: Recording, share: float) -> Recording:
        spec = recording.platform.lidar
        moved = spec.model_copy(update={name: getattr(spec, name) + share * by for name, by in shifts.items()})
        return recording.replace(platform=recording.platform.model_copy(update={"lidar": moved}))

    return put


def _odometry(
    change: Callable[[Any, float], Any] | None = None, late: float = 0.0
) -> Callable[[Recording, float], Recording]:
    """Odometry poses in place of wheels and gyro, changed."""

    def put(recording: Recording, share: float) -> Recording:
        from moteslam.robot.recording import OdometryStream
        from moteslam.slam.odometry.dead_reckoning import dead_reckon

        path = dead_reckon(recording)
        poses = path.poses if change is None else change(path.poses, share)
        odometry = OdometryStream(path.stamps + share * late, poses)
        return recording.replace(encoders=None, imu=None, odometry=odometry)

    return put


FAULTS = {
    WITHOUT: Fault(lambda recording, _: recording, ""),
    "narrow": Fault(
        _lidar(angle_increment=lambda s, share: s.angle_increment * (1 - 0.05 * share)),
        "lidar-angles",
        "angles",
        lambda share: 1 / (1 - 0.05 * share) - 1,
    ),
    "long": Fault(
        _lidar(
            ranges=lambda s, share: s.ranges * np.float32(1 + 0.1 * share),
            range_max=lambda s, share: s.range_max * (1 + 0.1 * share),
        ),
        "range-scale",
        "lengths",
        lambda share: 0.1 * share,
    ),
    "mirrored": Fault(_lidar(ranges=lambda s, _: np.ascontiguousarray(s.ranges[:, ::-1])), "mirrored"),
    "backwards": Fault(_mount(yaw=np.pi), "lidar-mount"),
    "ahead": Fault(_mount(x=0.2), "lidar-mount", "x", lambda share: -0.2 * share),
    "aside": Fault(_mount(y=0.2), "lidar-mount", "y", lambda share: -0.2 * share),
    "turned": Fault(_mount(yaw=np.radians(10)), "lidar-mount", "yaw", lambda share: -10 * share),
    "drift": Fault(
        _lidar(stamps=lambda s, share: s.stamps[0] + (s.stamps - s.stamps[0]) * (1 + 0.005 * share)),
        "clock-drift",
        "drift",
        lambda share: -0.005 * share,
    ),
    "odometry": Fault(_odometry(), ""),
    "odometry-mirrored": Fault(_odometry(lambda p, _: p * (1, -1, -1)), "mirrored", side="odometry"),
    "odometry-turns": Fault(_odometry(lambda p, _: p * (1, 1, -1)), "odometry-signs", side="odometry"),
    "odometry-y": Fault(_odometry(lambda p, _: p * (1, -1, 1)), "odometry-signs", side="odometry"),
    "odometry-headings": Fault(_odometry(lambda p, _: p * (1, 1, 0)), "odometry-headings", side="odometry"),
    "odometry-scaled": Fault(
        _odometry(lambda p, share: p * (1 + 0.1 * share, 1 + 0.1 * share, 1)),
        "range-scale",
        "lengths",
        lambda share: 1 / (1 + 0.1 * share) - 1,
        side="odometry",
    ),
    "odometry-late": Fault(_odometry(late=0.4), "clock-offset", "offset", lambda share: 0.4 * share, side="odometry"),
    "odometry-5-s-late": Fault(_odometry(late=5.0), "clock-offset", "offset", lambda share: 5 * share, side="odometry"),
}
"""Faults by their names; the first, and ``odometry``, put nothing in."""


def run(fault: str, share: float, world: str, platform: str, seed: int, ate: bool) -> Row:
    """The figures of one run; what went wrong, if it crashes."""
    about = {"fault": fault, "size": share, "world": world, "platform": platform, "seed": seed}
    return row_or_error(about, measure, FAULTS[fault], share, world, platform, seed, ate)


def measure(fault: Fault, share: float, world: str, platform: str, seed: int, ate: bool) -> Row:
    """What is found of a fault, and what mending it comes to."""
    import time

    from moteslam.kernels import runtime
    from moteslam.slam.calibration.calibrate import calibrate
    from moteslam.slam.calibration.findings import calibrated, findings

    runtime.init("cpu", 1)
    simulation = _simulated(world, platform, seed)
    recording = fault.put(simulation.recording, share)
    began = time.perf_counter()
    found = calibrate(recording)
    seconds = time.perf_counter() - began
    about = None if found is None else findings(found, recording)
    codes = () if about is None else tuple(issue.code for issue in about.issues)
    row: Row = {"codes": " ".join(codes), "right": codes == ((fault.code,) if fault.code else ()), "seconds": seconds}
    if fault.size is not None and about is not None:
        figure = next((one for one in about.figures if one.name.startswith(fault.shows)), None)
        if figure is not None:
            off = abs((figure.value - figure.stated) / fault.size(share) - 1)
            row |= {"value": figure.value - figure.stated, "off": off, "right": row["right"] and off < 0.2}
        else:
            row["right"] = False
    if ate and found is not None:
        true = FAULTS["odometry"].put(simulation.recording, 0) if fault.side == "odometry" else simulation.recording
        side: Any = fault.side
        mended = calibrated(recording, found, side)
        row |= {"ate": _ate(recording, simulation), "mended": _ate(mended, simulation), "true": _ate(true, simulation)}
    return row


@lru_cache(maxsize=1)
def _simulated(world: str, platform: str, seed: int) -> Simulation:
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.simulate import simulate

    return simulate(load_scenario(world, platform=platform), seed)


def _ate(recording: Recording, simulation: Simulation) -> float:
    """ATE of the final trajectory [m]; infinite where SLAM refuses the recording."""
    from moteslam.errors import MoteslamError
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.slam.run import run_slam

    try:
        return absolute_trajectory_error(run_slam(recording, seed=0).trajectory_final, simulation.truth).rmse
    except MoteslamError:
        return float("inf")


def summarised(rows: list[Row]) -> dict[str, Row]:
    """By fault and size: the share found rightly, the median error of the size, and the ATE."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(f"{row['fault']} {row['size']:g}", []).append(row)
    return {name: _pooled(mine) for name, mine in groups.items()}


def _pooled(rows: list[Row]) -> Row:
    good = [row for row in rows if "error" not in row]
    pooled: Row = {"runs": len(rows), "crashed": len(rows) - len(good)}
    pooled["right"] = sum(row["right"] for row in good)
    if offs := [row["off"] for row in good if "off" in row]:
        pooled |= {"off_median": float(np.median(offs)), "off_90": float(np.quantile(offs, 0.9))}
    if ates := [row for row in good if "ate" in row]:
        pooled |= {
            f"{name}_median": float(np.median([row[name] for row in ates])) for name in ("ate", "mended", "true")
        }
        pooled["within_twice"] = sum(row["mended"] <= 2 * row["true"] for row in ates)
    return pooled


def printed(summary: dict[str, Row]) -> str:
    """The summary as a table."""
    keys = ("right", "off_median", "off_90", "ate_median", "mended_median", "true_median", "within_twice")
    rows: list[tuple[str, ...]] = [("fault, size", "runs", "crashed", *(key.replace("_", " ") for key in keys))]
    for name, one in summary.items():
        shown = ("-" if one.get(key) is None else f"{one[key]:.3g}" for key in keys)
        rows.append((name, str(one["runs"]), str(one["crashed"]), *shown))
    return table(rows, right=range(1, 10))


def main() -> None:
    """Run, print a table, and write the result file, anew after every run."""
    from moteslam.robot.platforms import bundled_platforms

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", metavar="NAME", default=SCENARIOS)
    parser.add_argument("--platforms", nargs="+", metavar="NAME", default=list(bundled_platforms()))
    parser.add_argument("--seeds", type=seeds, metavar="N", default=SEEDS)
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=list(FAULTS))
    parser.add_argument("--sizes", nargs="+", type=float, default=[0.5, 1.0])
    parser.add_argument("--ate", action="store_true", help="run SLAM, too: as it is, mended, and without the fault")
    parser.add_argument("--jobs", type=count, default=1, help="processes; 1")
    parser.add_argument("--out", type=result_file)
    options = parser.parse_args()
    calls = [
        (fault, share, world, platform, seed, options.ate)
        for platform in options.platforms
        for world in options.worlds
        for seed in options.seeds
        for fault in options.faults
        for share in (options.sizes if FAULTS[fault].size is not None else [1.0])
    ]
    try:
        study(run, calls, options.jobs, options.out, summarised=summarised, printed=printed)
    except ConfigError as error:
        raise SystemExit(f"not_as_stated: {error}") from None


if __name__ == "__main__":
    main()
