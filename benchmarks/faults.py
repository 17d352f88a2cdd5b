"""What faults of a log cost: the ATE with a fault over that without, and whether a warning names it and its time.

    python benchmarks/faults.py --out result.json
    python benchmarks/faults.py --worlds loop office --platforms ucsd rplidar_a1 --seeds 200-203 --faults gap stale

Every fault is put into a drive while the robot drives straight and where it goes into a bend, at a place that goes by
the seed; gaps and stale odometry take 1, 3 and 10 s. Carts and aslant lidars last for the whole drive, scans are
repeated for 5 s, and wheels are stuck for 5 s. ``--forms`` chooses what SLAM is given: the sensors; poses by the base
in place of wheels and gyro; key scans with these. The complete preset ``default`` runs on one thread, with seed 0.

What is asked: of gaps, stale and jumping odometry at most twice the ATE without; of what is seen to travel, repeated
scans and stuck wheels at most 1.5 times that and 5 cm; of all a warning of its kind, with its times to two seconds.
"""

from __future__ import annotations

import argparse
import re
import statistics
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from parts.options import count, result_file, seeds
from parts.pool import Row, row_or_error, study
from parts.runs import KEY_SCANS, expect_names

from moteslam.errors import ConfigError
from moteslam.eval.cli.text import table

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording
    from moteslam.robot.trajectory import Trajectory
    from moteslam.robot.values import Issue
    from moteslam.sim.simulate import Simulation

WORLDS = ("loop", "office", "corridor", "big_loop")
PLATFORMS = ("ucsd", "rplidar_a1", "turtlebot3")
FORMS = ("sensors", "poses", "keys")
SLACK = 2.0
"""A time in a warning may be off by this much [s]."""
FIRST, LAST = 10.0, 10.0
"""No fault begins sooner after the first moment, nor ends later before the last [s]."""
LOOK = 1.5
"""What the robot does at a moment is what it does in this time after it [s]."""


@dataclass(frozen=True)
class Fault:
    """A fault and what is asked.

    Attributes:
        text: its keys but for ``start`` and ``duration``.
        codes: of the warnings of which one must name it.
        bend: begins where the robot goes into a bend, not on a straight; None: it lasts for the whole drive.
        duration: [s]; 0 of a moment.
        factor, slack: the largest ATE, times that without and plus [m].
    """

    text: str
    codes: tuple[str, ...]
    bend: bool | None = None
    duration: float = 0.0
    factor: float = 2.0
    slack: float = 0.0

    def setting(self, start: float) -> str:
        """As a scenario is given it."""
        keys = [self.text]
        if self.bend is not None:
            keys.append(f"start={start:.3f}")
        if self.duration:
            keys.append(f"duration={self.duration:g}")
        return f"faults=[{{{', '.join(keys)}}}]"


def _faults() -> dict[str, Fault]:
    faults = {}
    for bend in (False, True):
        where = "bend" if bend else "straight"
        for seconds in (1, 3, 10):
            gap, stale = ("gap",), ("stale-odometry",)
            faults[f"gap-{seconds}-{where}"] = Fault('kind="gap"', gap, bend, seconds)
            faults[f"lost-{seconds}-{where}"] = Fault('kind="gap", counters="lost"', gap, bend, seconds)
            faults[f"stale-{seconds}-{where}"] = Fault('kind="stale_odometry"', stale, bend, seconds)
        for name, step in (("far", "x=1.0, theta=0.5"), ("near", "x=0.3"), ("turn", "theta=0.3")):
            faults[f"jump-{name}-{where}"] = Fault(f'kind="odometry_jump", {step}', ("odometry-jumps",), bend)
    seen: dict[str, Any] = {"factor": 1.5, "slack": 0.05}
    faults["cart"] = Fault('kind="cart"', ("travels-along",), **seen)
    for pitch in (0.035, 0.087):
        faults[f"tilt-{pitch:g}"] = Fault(f'kind="tilt", pitch={pitch:g}', ("travels-along",), **seen)
    faults["repeated"] = Fault('kind="repeated_scans"', ("scans-repeat",), False, 5, **seen)
    faults["stuck"] = Fault('kind="stuck_wheels"', ("wheels-spin",), False, 5, **seen)
    return faults


FAULTS = _faults()


def run(fault: str, world: str, platform: str, form: str, seed: int) -> Row:
    """The figures of one run with a fault beside those without; what went wrong, if it crashes."""
    about = {"fault": fault, "world": world, "platform": platform, "form": form, "seed": seed}
    return row_or_error(about, measure, FAULTS[fault], world, platform, form, seed)


def measure(fault: Fault, world: str, platform: str, form: str, seed: int) -> Row:
    """The figures of one run with a fault beside those without."""
    from moteslam.kernels import runtime
    from moteslam.sim.sensors.clock import EPOCH

    runtime.init("cpu", 1)
    truth, online, final = _without(world, platform, form, seed)
    start = 0.0 if fault.bend is None else moment(truth, fault, seed)
    simulation = _simulated(world, platform, form, seed, fault.setting(start))
    (faulty_online, faulty_final), issues = _scored(simulation, form)
    end = start + fault.duration if fault.bend is not None else truth.stamps[-1] - EPOCH
    warned = [issue for issue in issues if issue.code in fault.codes]
    asked = [fault.factor * value + fault.slack for value in (online, final)]
    return {
        "start": start,
        "online": faulty_online,
        "final": faulty_final,
        "online_ratio": faulty_online / online,
        "final_ratio": faulty_final / final,
        "within": faulty_online <= asked[0] and faulty_final <= asked[1],
        "warned": any(names_the_time(one.message, start + EPOCH, end + EPOCH, fault) for one in warned),
        "codes": " ".join(issue.code for issue in issues),
    }


def names_the_time(message: str, start: float, end: float, fault: Fault) -> bool:
    """Whether a warning's times are those of a fault; within the drive, of one that lasts for all of it."""
    spans = [
        (float(first), float(last or first)) for first, last in re.findall(r"(\d+\.\d+)(?: to (\d+\.\d+))? s", message)
    ]
    if not spans or spans[0][0] < start - SLACK or spans[-1][1] > end + SLACK:
        return False
    return fault.bend is None or any(abs(first - start) < SLACK and abs(last - end) < SLACK for first, last in spans)


def moment(truth: Trajectory, fault: Fault, seed: int) -> float:
    """When a fault begins, after the drive's first moment [s]: on a straight or into a bend, by the seed.

    Args:
        truth: of the drive without.
        fault: of some duration.
        seed: which of the moments.
    """
    from moteslam.robot import se2
    from moteslam.sim.sensors.clock import EPOCH

    since = truth.stamps - EPOCH
    times = np.arange(FIRST, since[-1] - LAST - fault.duration, 0.1)
    moved = se2.between(truth.at(times + EPOCH).poses, truth.at(times + LOOK + EPOCH).poses)
    before = se2.between(truth.at(times - 0.5 + EPOCH).poses, truth.at(times + EPOCH).poses)
    distance, turn = np.hypot(moved[:, 0], moved[:, 1]), np.abs(moved[:, 2])
    drives = np.hypot(before[:, 0], before[:, 1]) > 0.25 * np.quantile(distance, 0.9) * 0.5 / LOOK
    straight: NDArray[np.bool_] = drives & (distance > 0.7 * np.quantile(distance, 0.9)) & (turn < 0.05)
    bend: NDArray[np.bool_] = drives & (np.abs(before[:, 2]) < 0.1) & (turn > 0.6 * np.quantile(turn, 0.98))
    found = times[bend if fault.bend else straight]
    if not len(found):
        raise ConfigError("no such moment in the drive", field="fault")
    return float(found[int(len(found) * (seed * 0.618034 % 1.0))])


@lru_cache(maxsize=4)
def _without(world: str, platform: str, form: str, seed: int) -> tuple[Trajectory, float, float]:
    """The truth of a drive without a fault, and the ATE of online and final trajectory there [m]."""
    simulation = _simulated(world, platform, form, seed)
    (online, final), _ = _scored(simulation, form)
    return simulation.truth, online, final


def _simulated(world: str, platform: str, form: str, seed: int, *settings: str) -> Simulation:
    from moteslam.sim.logged import Logging, logged
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.simulate import simulate

    simulation = simulate(load_scenario(world, platform=platform, settings=settings), seed)
    if form == "sensors":
        return simulation
    return logged(simulation, Logging(*KEY_SCANS) if form == "keys" else Logging())


def _scored(simulation: Simulation, form: str) -> tuple[tuple[float, float], tuple[Issue, ...]]:
    """The ATE of online and final trajectory [m], and the warnings."""
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.slam.run import run_slam
    from moteslam.slam.settings import resolve_config

    recording: Recording = simulation.recording
    if form != "sensors":  # as a CARMEN log has it
        recording = recording.replace(encoders=None, imu=None)
    estimate = run_slam(recording, resolve_config("default"), seed=0)
    online, final = (
        absolute_trajectory_error(trajectory, simulation.truth).rmse
        for trajectory in (estimate.trajectory, estimate.trajectory_final)
    )
    return (online, final), estimate.warnings


def summarised(rows: list[Row]) -> dict[str, Row]:
    """By fault: median and worst ratios, the shares of runs within what is asked and with the right warning."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row["fault"], []).append(row)
    return {fault: _pooled(mine) for fault, mine in groups.items()}


def _pooled(rows: list[Row]) -> Row:
    good = [row for row in rows if "error" not in row]
    result: Row = {"runs": len(rows), "crashed": len(rows) - len(good)}
    if good:
        for key in ("online_ratio", "final_ratio", "online", "final"):
            values = [row[key] for row in good]
            result |= {f"{key}_median": statistics.median(values), f"{key}_worst": max(values)}
        result |= {key: sum(row[key] for row in good) / len(rows) for key in ("within", "warned")}
    return result


def printed(summary: dict[str, Row]) -> str:
    """The summary as a table."""
    heads = ("fault", "runs", "crashed", "online / without", "worst", "final / without", "worst", "worst final [m]")
    rows: list[tuple[str, ...]] = [(*heads, "within", "warned")]
    keys = ("online_ratio_median", "online_ratio_worst", "final_ratio_median", "final_ratio_worst")
    for name, one in summary.items():
        values = [one.get(key) for key in (*keys, "final_worst", "within", "warned")]
        shown = ("-" if value is None else f"{value:.2f}" for value in values)
        rows.append((name, str(one["runs"]), str(one["crashed"]), *shown))
    return table(rows, right=range(1, 10))


def chosen(names: list[str] | None) -> list[str]:
    """The faults whose name is one of these or begins with it.

    Raises:
        ConfigError: there is none of that name.
    """
    for name in names or ():
        if not any(fault.startswith(name) for fault in FAULTS):
            raise ConfigError(f"no {name!r}, expected of {', '.join(FAULTS)}", field="--faults")
    return [fault for fault in FAULTS if names is None or any(fault.startswith(name) for name in names)]


def main() -> None:
    """Run, print a table, and write the result file, anew after every run."""
    from moteslam.sim.scenario import bundled_scenarios

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", metavar="NAME", default=WORLDS)
    parser.add_argument("--platforms", nargs="+", metavar="NAME", default=PLATFORMS)
    parser.add_argument("--forms", nargs="+", choices=FORMS, default=FORMS[:1])
    parser.add_argument("--seeds", type=seeds, metavar="N", default=range(20), help="20; or 200-203")
    parser.add_argument("--faults", nargs="+", metavar="NAME", help="or how their names begin; all of them")
    parser.add_argument("--jobs", type=count, default=1, help="processes; 1")
    parser.add_argument("--out", type=result_file)
    options = parser.parse_args()
    try:
        expect_names(options.worlds, tuple(bundled_scenarios()), field="--worlds")
        faults = chosen(options.faults)
    except ConfigError as error:
        parser.error(str(error))
    calls = [
        (fault, world, platform, form, seed)
        for world in options.worlds
        for platform in options.platforms
        for form in options.forms
        for seed in options.seeds
        for fault in faults
    ]
    study(run, calls, options.jobs, options.out, summarised=summarised, printed=printed)


if __name__ == "__main__":
    main()
