"""What the benchmarks run: real logs with their references and simulated scenarios with their truth; and its errors."""

import heapq
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.metrics.loops import score_loops
from moteslam.eval.metrics.relations import evaluate_relations, read_relations
from moteslam.kernels import runtime
from moteslam.robot import se2
from moteslam.robot.formats import open_recording
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories.text import read_tum
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.logged import Logging, logged
from moteslam.sim.scenario import load_scenario, with_camera
from moteslam.sim.simulate import Simulation, simulate
from moteslam.slam.config import SlamConfig, resolve_config
from moteslam.slam.estimate import Estimate
from moteslam.slam.online import OnlineSlam
from moteslam.slam.scan_records import Update

Array = NDArray[np.float64]
DATA = Path(os.environ.get("MOTESLAM_DATA", Path(__file__).parents[3] / "shared" / "data"))

RELATIONS = "intel_raw_part"  # The log that is scored by hand-checked relations
LOGS = {
    RELATIONS: "intel/intel_raw_part",
    "intel_key_scans": "intel/intel_key_scans",
    "freiburg-101": "key_scans/freiburg-101",
    "belgioioso": "key_scans/belgioioso",
    "csail": "csail/csail",
    "aces": "key_scans/aces",
    "fhw": "key_scans/fhw",
}
"""Real logs under ``DATA``: ``.log.gz``, and beside it ``.reference.tum`` (or ``.relations``)."""
HALF_DEGREE = (
    "platform.lidar.beams=361",
    "platform.lidar.angle_increment=0.008726646259971648",
    "platform.lidar.rate=5.0",
    "platform.lidar.time_increment=3.7e-5",
)
"""Makes of the robot ``lms200`` one with 361 beams half a degree apart, as of csail and freiburg-101."""
KEY_SCANS = (0.75, 0.5)  # The distance [m] and turn [rad] between the scans of the classic key-scan logs
WHEELS: dict[str, Any] = {"platform": "lms200", "settings": ("platform.imu=false",), "key_scans": KEY_SCANS}
"""What `simulate_case` takes of a robot without gyro that logs key scans."""
STEP_NOISE = (0.05, 0.1)
"""Noise of a poor odometry, as shares of the length and of the turn of each step between key scans."""
NOISY = WHEELS | {"step_noise": STEP_NOISE}
FILTER_ALONE = ("backend.method=none",)  # Leaves the back end out of the preset ``default``
LOST = 0.15  # A larger ATE [m] counts as a divergence


@dataclass(frozen=True)
class Case:
    """A recording and what it is scored with."""

    recording: Recording
    reference: Trajectory | None  # truth or reference trajectory; None where there are relations
    simulation: Simulation | None = None  # None of a real log


def start_kernels(settings: list[str], threads: int, **more: Any) -> SlamConfig:
    runtime.init("cpu", threads)
    return resolve_config("default", [*settings, *(f"{key}={value}" for key, value in more.items())])


def log_file(name: str) -> Path:
    """The real log of that name.

    Raises:
        InputError: it is not there.
    """
    path = DATA / f"{LOGS[name]}.log.gz"
    if not path.is_file():
        raise InputError("not there; MOTESLAM_DATA names the folder of the real logs", file=path)
    return path


def reference_file(name: str) -> Path:
    return DATA / f"{LOGS[name]}.{'relations' if name == RELATIONS else 'reference.tum'}"


def load_log(name: str) -> Case:
    """A real log and its reference trajectory, if that is what it has."""
    return Case(open_recording(log_file(name)), None if name == RELATIONS else read_tum(reference_file(name)))


def simulate_case(
    name: str,
    seed: int,
    *,
    platform: str | None = None,
    noise_class: str | None = None,
    settings: Sequence[str] = (),
    key_scans: tuple[float, float] | None = None,
    step_noise: tuple[float, float] | None = None,
    duration: float | None = None,
    camera: bool = False,
) -> Case:
    """A bundled scenario, simulated.

    Args:
        name: of the scenario.
        seed: of its noise.
        platform, noise_class: in place of the scenario's own robot and class of noise.
        settings: ``key=value`` over the scenario's.
        key_scans: keep a scan only after this distance [m] or this turn [rad]; None to keep all.
        step_noise: shares of noise added to the length and the turn of each of their steps.
        duration: ends it after this time [s].
        camera: with a camera at its full rate, whose images are drawn when they are asked for.
    """
    scenario = load_scenario(name, platform=platform, noise=noise_class, settings=settings)
    scenario = with_camera(scenario) if camera else scenario.model_copy(update={"camera": None})
    if duration is not None:
        scenario = scenario.model_copy(update={"duration": duration})
    simulation = simulate(scenario, seed=seed)
    if key_scans is not None:
        simulation = logged(simulation, Logging(*key_scans, step_noise))
    return Case(with_images(simulation) if camera else simulation.recording, simulation.truth, simulation)


def with_images(simulation: Simulation) -> Recording:
    """A simulation's recording, its images drawn when they are asked for."""
    assert simulation.frames is not None
    return simulation.recording.replace(rgbd=simulation.frames.drawn)


Message = tuple[float, int, str, int]  # when it arrives [s], the place of its stream, the stream, its number there


def messages(recording: Recording, late: dict[str, float]) -> Iterator[Message]:
    """In the order in which they arrive, some streams so late [s]."""
    streams: list[Iterator[Message]] = []
    for name in ("lidar", "encoders", "odometry", "imu", "rgb", "disparity"):
        of_camera = name in ("rgb", "disparity")
        stream: Any = getattr(recording, "rgbd" if of_camera else name)
        if stream is not None:
            stamps = getattr(stream, f"{name}_stamps") if of_camera else stream.stamps
            arrive = (stamps + late.get("images" if of_camera else name, 0.0)).tolist()
            streams.append(zip(arrive, repeat(len(streams)), repeat(name), range(len(arrive)), strict=False))
    return heapq.merge(*streams)


def add(slam: OnlineSlam, recording: Recording, stream: str, index: int) -> Update | None:
    if stream in ("rgb", "disparity"):
        assert recording.rgbd is not None
        image = getattr(recording.rgbd.images, stream)(index)
        return slam.add_image(getattr(recording.rgbd, f"{stream}_stamps")[index], image)
    values = getattr(recording, stream)
    stamp = values.stamps[index]
    if stream == "lidar":
        pose = None if values.odometry is None else values.odometry[index]
        return slam.add_scan(values.ranges[index], stamp, odometry=pose)
    if stream == "imu":
        return slam.add_imu(stamp, values.angular_velocity[index, 2])
    if stream == "encoders":
        return slam.add_odometry(stamp, counts=values.counts[index])
    return slam.add_odometry(stamp, values.poses[index])


def fed(slam: OnlineSlam, recording: Recording, **late: float) -> Iterator[Update]:
    """Feed a recording message by message; every update that there was."""
    for _, _, stream, index in messages(recording, late):
        if (update := add(slam, recording, stream, index)) is not None:
            yield update
    if (update := slam.finish()) is not None:
        yield update


def true_poses(truth: Trajectory, stamps: Array) -> Array:
    """The true poses [n, 3] at stamps [n], of the nearest of 100 a second."""
    return np.asarray(truth.poses[np.searchsorted(truth.stamps, stamps - 0.005).clip(max=len(truth) - 1)])


def is_right(true: Array, poses: Array) -> NDArray[np.bool_]:
    """Which poses [..., 3] are within 0.3 m and 5 degrees of the true one."""
    off = se2.between(true, poses)
    return np.asarray((np.hypot(off[..., 0], off[..., 1]) < 0.3) & (np.abs(off[..., 2]) < np.radians(5)))


def errors(estimate: Estimate, case: Case) -> dict[str, float]:
    """The figures of an estimate: ATE RMSE or errors of relations [m], [deg], online, final and of dead reckoning."""
    trajectories = {
        "final": estimate.trajectory_final,
        "online": estimate.trajectory,
        "dead_reckoning": estimate.dead_reckoning,
    }
    if case.reference is None:
        return relation_figures(trajectories)
    figures = {key: absolute_trajectory_error(path, case.reference).rmse for key, path in trajectories.items()}
    if case.simulation is not None:
        scaled = absolute_trajectory_error(estimate.trajectory_final, case.reference, scale=True)
        figures |= {"lost": figures["final"] >= LOST, "final_scaled": scaled.rmse}
        if case.simulation.scenario.name == "hall":
            figures |= hall_figures(trajectories, case.simulation)
    return figures


def loop_figures(estimate: Estimate, case: Case) -> dict[str, float]:
    """How many loops were accepted and overruled, how many of them false, and recall; by a simulation's truth.

    And the RMSE [m] of the last quarter of the online poses, laid on the truth as the final trajectory is.
    """
    assert case.reference is not None
    loops = score_loops(estimate.loops, case.reference, case.recording).as_dict()
    names = ("accepted", "false", "overruled", "overruled_false", "recall")
    figures: dict[str, float] = {name: loops[name] for name in names if loops[name] is not None}
    placed = absolute_trajectory_error(estimate.trajectory_final, case.reference).transform
    online = Trajectory(estimate.trajectory.stamps, np.asarray(se2.compose(placed, estimate.trajectory.poses)))
    late = absolute_trajectory_error(online, case.reference, align=False).errors
    late = late[-(-3 * len(late) // 4) :]
    return figures | ({"online_late": float(np.sqrt(np.square(late).mean()))} if len(late) else {})


def relation_figures(trajectories: dict[str, Trajectory]) -> dict[str, float]:
    """Mean errors of the Intel relations [m], [deg]: of the clear ones, and of all that match, with how many there are.

    At a stamp of several scans the first counts.
    """
    figures: dict[str, float] = {}
    for which, file in (("clear", reference_file(RELATIONS)), ("all", DATA / "intel" / "intel.relations")):
        relations = read_relations(file)
        for key, trajectory in trajectories.items():
            score = evaluate_relations(trajectory, relations, interpolate=False)
            figures[f"{key}_{which}"] = score.translation.mean
            assert score.rotation_deg is not None
            figures[f"{key}_{which}_deg"] = score.rotation_deg.mean
            figures[f"relations_{which}"] = score.translation.count
    return figures


def hall_figures(trajectories: dict[str, Trajectory], simulation: Simulation) -> dict[str, float]:
    """RMSE along and across the line from the first waypoint to the last [m], aligned."""
    route = simulation.scenario.route
    assert route is not None
    line = route.corners[-1] - route.corners[0]
    axes = np.array((line, (-line[1], line[0]))) / np.hypot(*line)
    figures: dict[str, float] = {}
    for key, trajectory in trajectories.items():
        found = absolute_trajectory_error(trajectory, simulation.truth)
        off = (found.aligned - found.reference)[:, :2] @ axes.T
        figures[f"{key}_along"], figures[f"{key}_across"] = np.sqrt(np.mean(off**2, axis=0)).tolist()
    figures["along_over_dead_reckoning"] = figures["final_along"] / figures["dead_reckoning_along"]
    return figures
