"""What the benchmarks run: real logs with their references, simulated scenarios with their truth; and what is asked.

The limits are those that the preset ``default`` was built for: a quarter less error than the best of GMapping, Karto,
Cartographer and Hector on the same logs (docs/results.md).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from moteslam.errors import ConfigError
from parts.bars import Bar

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording
    from moteslam.robot.trajectory import Trajectory
    from moteslam.sim.scenario import Scenario
    from moteslam.slam.backend.graph.backend import GraphBackend
    from moteslam.slam.estimate import Estimate
    from moteslam.slam.run import SlamSession

DATA = Path(os.environ.get("MOTESLAM_DATA", Path(__file__).parents[3] / "shared" / "data"))

RELATIONS = "intel_raw_part"
"""The log that is scored by hand-checked relations."""
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
UNSEEN_LOGS = ("aces", "fhw")
"""Logs that no setting of the filter was chosen on, though the back end was made looking at them; the others were
looked at while the preset ``default`` was made."""
UNSEEN_BUILDINGS = tuple(f"random-corridors-{number}" for number in range(1000, 1020))
"""Simulated buildings that no setting was chosen on, a seed each."""
SCENARIOS = ("corridor", "loop", "office")
"""Simulated, scored by ATE over 20 seeds."""
HALL = "hall"
"""Simulated, scored along and across its only direction."""
HALF_DEGREE = (
    "platform.lidar.beams=361",
    "platform.lidar.angle_increment=0.008726646259971648",
    "platform.lidar.rate=5.0",
    "platform.lidar.time_increment=3.7e-5",
)
"""Makes of the robot ``lms200`` one with 361 beams half a degree apart, as of csail and freiburg-101."""
KEY_SCANS = (0.75, 0.5)
"""The distance [m] and turn [rad] between the scans of the classic key-scan logs."""
STEP_NOISE = (0.05, 0.1)
"""Noise of a poor odometry, as shares of the length and of the turn of each step between key scans."""
FILTER_ALONE = ("backend.method=none",)
"""Leaves the back end out of the preset ``default``."""
LOST = 0.15
"""A larger ATE [m] counts as a divergence."""

NOT_MUCH_WORSE_AT_ONCE = Bar("online_over_final", "worst", 1.5)
NEVER_LOST = Bar("final", "worst", LOST, strict=True)
BARS: dict[str, tuple[Bar, ...]] = {
    RELATIONS: (
        Bar("final_clear", "worst", 0.0145),
        Bar("final_clear_deg", "worst", 0.215),
        NOT_MUCH_WORSE_AT_ONCE,
        Bar("online_over_final_deg", "worst", 1.5),
    ),
    "aces": (Bar("final", "worst", 0.12),),
    "fhw": (Bar("final", "worst", 0.17),),
    "intel_key_scans": (Bar("final", "worst", 0.078), NOT_MUCH_WORSE_AT_ONCE),
    "freiburg-101": (Bar("final", "worst", 0.046), NOT_MUCH_WORSE_AT_ONCE),
    "belgioioso": (Bar("final", "worst", 0.095), NOT_MUCH_WORSE_AT_ONCE),
    "csail": (Bar("final", "worst", 0.105), NOT_MUCH_WORSE_AT_ONCE),
    HALL: (
        Bar("final_across", "worst", 0.05, strict=True),
        Bar("along_over_dead_reckoning", "worst", 1.0),
        NOT_MUCH_WORSE_AT_ONCE,
    ),
} | dict.fromkeys(SCENARIOS, (NEVER_LOST, Bar("final", "median", 0.03), NOT_MUCH_WORSE_AT_ONCE))


@dataclass(frozen=True)
class Case:
    """A recording and what it is scored with.

    Attributes:
        recording: what SLAM gets.
        reference: truth or reference trajectory; None where there are relations.
        scenario: None of a real log.
        end: why the simulated drive ended; empty of a real log.
    """

    recording: Recording
    reference: Trajectory | None
    scenario: Scenario | None = None
    end: str = ""


def expect_names(names: Sequence[str], known: Sequence[str], *, field: str) -> None:
    """Refuse what cannot be run, before anything is measured.

    Args:
        names: of runs.
        known: those that there are; random buildings are known besides.
        field: for the message.

    Raises:
        ConfigError: a name that is not known.
    """
    for name in names:
        if name not in known and not name.startswith("random-corridors"):
            raise ConfigError(f"no {name!r}, expected of {', '.join(known)}, random-corridors-7", field=field)


def that_are_there(names: Sequence[str]) -> list[str]:
    """The names without the real logs where there is no ``DATA``, which is printed then."""
    if DATA.is_dir() or not any(name in LOGS for name in names):
        return list(names)
    print(f"no {DATA}: the real logs are left out; MOTESLAM_DATA names their folder")
    return [name for name in names if name not in LOGS]


def log_file(name: str) -> Path:
    """The real log of that name."""
    return DATA / f"{LOGS[name]}.log.gz"


def reference_file(name: str) -> Path:
    """What it is scored with."""
    return DATA / f"{LOGS[name]}.{'relations' if name == RELATIONS else 'reference.tum'}"


def load_log(name: str) -> Case:
    """A real log and its reference trajectory, if that is what it has."""
    from moteslam.robot.formats import open_recording
    from moteslam.robot.trajectories.text import read_tum

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
    odometry_noise: float = 1.0,
    duration: float | None = None,
    laps: float | None = None,
) -> Case:
    """A bundled scenario, simulated, without its camera.

    Args:
        name: of the scenario.
        seed: of its noise.
        platform, noise_class: in place of the scenario's own robot and class of noise.
        settings: ``key=value`` over the scenario's.
        key_scans: keep a scan only after this distance [m] or this turn [rad]; None to keep all.
        step_noise: shares of noise added to the length and the turn of each of their steps.
        odometry_noise: how many times the scenario's own noise of wheels and gyro.
        duration: ends it after this time [s].
        laps: how many times round its closed route.
    """
    from moteslam.sim.logged import Logging, logged
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.simulate import simulate

    scenario = load_scenario(name, platform=platform, noise=noise_class, settings=settings)
    noise = scenario.noise.model_copy(update={"odometry_scale": scenario.noise.odometry_scale * odometry_noise})
    changes: dict[str, Any] = {"camera": None, "noise": noise}
    if duration is not None:
        changes["duration"] = duration
    if laps is not None:
        assert scenario.route is not None
        changes["route"] = scenario.route.model_copy(update={"laps": laps})
    simulation = simulate(scenario.model_copy(update=changes), seed=seed)
    if key_scans is not None:
        simulation = logged(simulation, Logging(*key_scans, step_noise))
    return Case(simulation.recording, simulation.truth, scenario, simulation.end)


def wheels_case(
    name: str,
    seed: int,
    *,
    platform: str = "lms200",
    noise_class: str | None = None,
    step_noise: tuple[float, float] | None = None,
    settings: Sequence[str] = (),
    every_scan: bool = False,
) -> Case:
    """A bundled scenario driven by a robot without gyro, as a log of key scans (``KEY_SCANS``).

    Args:
        name: of the scenario.
        seed: of its noise.
        platform: the robot.
        noise_class: in place of that of data sheets.
        step_noise: noise added to each step, as ``STEP_NOISE``.
        settings: ``key=value`` over the scenario's.
        every_scan: keep all scans; without noise of the steps.
    """
    return simulate_case(
        name,
        seed,
        platform=platform,
        noise_class=noise_class,
        settings=("platform.imu=false", *settings),
        key_scans=None if every_scan else KEY_SCANS,
        step_noise=step_noise,
    )


def errors(name: str, estimate: Estimate, case: Case) -> dict[str, float]:
    """The figures of an estimate: ATE RMSE or errors of relations [m], [deg], online, final and of dead reckoning."""
    trajectories = {
        "final": estimate.trajectory_final,
        "online": estimate.trajectory,
        "dead_reckoning": estimate.dead_reckoning,
    }
    if case.reference is None:
        figures = relation_figures(trajectories)
        figures["online_over_final"] = figures["online_clear"] / figures["final_clear"]
        figures["online_over_final_deg"] = figures["online_clear_deg"] / figures["final_clear_deg"]
        return figures
    from moteslam.eval.metrics.ate import absolute_trajectory_error

    scores = {key: absolute_trajectory_error(trajectory, case.reference) for key, trajectory in trajectories.items()}
    figures = {key: score.rmse for key, score in scores.items()}
    figures["online_over_final"] = figures["online"] / figures["final"]
    if name == HALL:
        assert case.scenario is not None
        figures |= hall_figures(trajectories, case.reference, case.scenario)
    return figures


def late_errors(estimate: Estimate, case: Case) -> dict[str, float]:
    """RMSE [m] of online and of final poses over the same late stamps, laid on the truth as the final trajectory is.

    ``_late`` is the last quarter of the scans, ``_after_loops`` what comes after the last accepted loop, if anything.
    """
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.robot import se2
    from moteslam.robot.trajectory import Trajectory

    assert case.reference is not None
    placed = absolute_trajectory_error(estimate.trajectory_final, case.reference).transform
    last_loop = max((loop.stamps[1] for loop in estimate.loops if loop.accepted), default=-np.inf)
    figures = {}
    for name, trajectory in (("online", estimate.trajectory), ("final", estimate.trajectory_final)):
        laid = Trajectory(trajectory.stamps, np.asarray(se2.compose(placed, trajectory.poses)))
        error = absolute_trajectory_error(laid, case.reference, align=False)
        quarter = np.arange(len(error.stamps)) >= 0.75 * len(error.stamps)
        for when, some in (("late", quarter), ("after_loops", error.stamps > last_loop)):
            if some.any():
                figures[f"{name}_{when}"] = float(np.sqrt(np.square(error.errors[some]).mean()))
    return figures


def relation_figures(trajectories: dict[str, Trajectory]) -> dict[str, float]:
    """Mean errors of the Intel relations [m], [deg]: of the clear ones, and of all that match, with how many there are.

    At a stamp of several scans the first counts.
    """
    from moteslam.eval.metrics.relations import evaluate_relations, read_relations

    figures: dict[str, float] = {}
    for which, file in (("clear", reference_file(RELATIONS)), ("all", DATA / "intel" / "intel.relations")):
        relations = read_relations(file)
        for key, trajectory in trajectories.items():
            score = evaluate_relations(trajectory, relations, interpolate=False).all
            figures[f"{key}_{which}"] = score.translation.mean
            figures[f"{key}_{which}_deg"] = score.rotation.mean
            figures[f"n_{which}"] = score.translation.count
    return figures


def hall_figures(trajectories: dict[str, Trajectory], truth: Trajectory, scenario: Scenario) -> dict[str, float]:
    """RMSE along and across the line from the first waypoint to the last [m], aligned; and as it is, from the start on.

    The alignment takes out a constant heading error and half of a drift along the hall; ``_from_start`` puts the first
    pose of each trajectory on the true one and changes nothing else.
    """
    from moteslam.eval.metrics.association import match
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.robot import se2

    assert scenario.route is not None
    line = scenario.route.corners[-1] - scenario.route.corners[0]
    axes = np.array((line, (-line[1], line[0]))) / np.hypot(*line)
    figures: dict[str, float] = {}
    for key, trajectory in trajectories.items():
        aligned = absolute_trajectory_error(trajectory, truth)
        matched = match(trajectory, truth)
        placed = se2.compose(matched.reference[0], se2.between(matched.estimate[0], matched.estimate))
        for suffix, off in (
            ("", aligned.aligned - aligned.reference),
            ("_from_start", placed - matched.reference),
        ):
            along, across = np.sqrt(np.mean((off[:, :2] @ axes.T) ** 2, axis=0)).tolist()
            figures |= {f"{key}_along{suffix}": along, f"{key}_across{suffix}": across}
    figures["along_over_dead_reckoning"] = figures["final_along"] / figures["dead_reckoning_along"]
    return figures


def graph_backend(session: SlamSession) -> GraphBackend:
    """The back end of a session that has the back end ``graph``."""
    from moteslam.slam.backend.graph.backend import GraphBackend

    assert isinstance(session._backend, GraphBackend)
    return session._backend
