"""The scores of a run against the truth: every metric of SLAM's trajectories and of dead reckoning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from moteslam.errors import InputError
from moteslam.eval.loop_table import looks_for_loops
from moteslam.eval.metrics.ate import AteResult
from moteslam.eval.metrics.evidence import DEAD_RECKONING, FINAL, ONLINE, Certainty, Evidence, Track
from moteslam.eval.metrics.localisation import LocalisationResult
from moteslam.eval.metrics.loops import LoopResult
from moteslam.eval.metrics.registry import Value, measure
from moteslam.eval.metrics.rpe import RpeResult, Unit
from moteslam.robot.formats.map_server import trinary
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import expect_type
from moteslam.slam.estimate import Estimate


@dataclass(frozen=True)
class Score:
    """How good one trajectory is.

    Attributes:
        ate: the absolute error, after alignment.
        rpe_1m: the relative error over a metre; None where the robot did not drive one.
        rpe_1s: over a second, likewise.
    """

    ate: AteResult
    rpe_1m: RpeResult | None
    rpe_1s: RpeResult | None

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into ``metrics.json``."""
        results = {"ate": self.ate, "rpe_1m": self.rpe_1m, "rpe_1s": self.rpe_1s}
        return {name: None if result is None else result.as_dict() for name, result in results.items()}


@dataclass(frozen=True)
class Scores:
    """The scores of a run.

    Attributes:
        online: of SLAM's poses as known at each scan.
        final: of SLAM's poses as known at the end.
        dead_reckoning: of odometry alone.
        localisation: of covariances and states; None where no scan has a map around it.
        loops: of the loops that the back end accepted; None where it looks for none.
        values: of all metrics that are not costly, by name: ``final.ate``, ``map_f1``.
    """

    online: Score
    final: Score
    dead_reckoning: Score
    localisation: LocalisationResult | None = None
    loops: LoopResult | None = None
    values: Mapping[str, Value] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into ``metrics.json``."""
        return {
            "online": self.online.as_dict(),
            "final": self.final.as_dict(),
            "dead_reckoning": self.dead_reckoning.as_dict(),
            "localisation": None if self.localisation is None else self.localisation.as_dict(),
            **({} if self.loops is None else {"loops": self.loops.as_dict()}),
        }


def evidence_of(
    estimate: Estimate,
    truth: Trajectory | None = None,
    *,
    recording: Recording | None = None,
    true_map: Raster | None = None,
) -> Evidence:
    """What is known of a run of ours when it is scored; arguments as of ``score_estimate``."""
    diagnostics, occupancy = estimate.diagnostics, estimate.map
    return Evidence(
        trajectories={
            FINAL: estimate.trajectory_final,
            ONLINE: estimate.trajectory,
            DEAD_RECKONING: estimate.dead_reckoning,
        },
        truth=truth,
        occupancy=Raster(trinary(occupancy.values), occupancy.cell_size, occupancy.origin),
        true_map=true_map,
        recording=recording,
        certainty=Certainty(
            estimate.covariances,
            diagnostics["state"],
            diagnostics["updated"],
            diagnostics["n_eff"],
            estimate.particle_spread,
            estimate.corrections,
        ),
        loops=estimate.loops if looks_for_loops(estimate.config) else None,
    )


def score_estimate(
    estimate: Estimate, truth: Trajectory, *, recording: Recording | None = None, true_map: Raster | None = None
) -> Scores:
    """Score a run.

    Args:
        estimate: the run.
        truth: on the clock of its recording.
        recording: its scans show which loops are possible, and which walls were seen.
        true_map: trinary, in the frame of the truth; without it the map is not scored.

    Raises:
        InputError: the truth has no stamps in common with the run.
    """
    expect_type(estimate, Estimate, "estimate", "run_slam(recording) makes one")
    run = evidence_of(estimate, truth, recording=recording, true_map=true_map)
    return Scores(
        online=_score(run.track(ONLINE)),
        final=_score(run.track(FINAL)),
        dead_reckoning=_score(run.track(DEAD_RECKONING)),
        localisation=_localisation(run),
        loops=None if run.loops is None else run.loop_result,
        values=measure(run),
    )


def score_trajectory(trajectory: Trajectory, truth: Trajectory) -> Score:
    """Score one trajectory.

    Raises:
        InputError: the truth has no stamps in common with it.
    """
    return _score(Evidence({FINAL: trajectory}, truth).track(FINAL))


def _score(track: Track) -> Score:
    def relative(unit: Unit) -> RpeResult | None:
        try:
            return track.rpe(1.0, unit)
        except InputError:  # cannot be had: a robot that hardly moved
            return None

    return Score(track.ate, relative("m"), relative("s"))


def _localisation(run: Evidence) -> LocalisationResult | None:
    """The scores of covariances and states; None where they cannot be had: a robot that hardly moved."""
    try:
        return run.localisation
    except InputError as error:
        if error.field != "truth":
            raise
        return None
