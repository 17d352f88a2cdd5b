"""The scores of a run against the truth: every metric of SLAM's trajectories and of dead reckoning."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from moteslam.errors import InputError
from moteslam.eval.loop_table import looks_for_loops
from moteslam.eval.metrics.ate import AteResult
from moteslam.eval.metrics.kinds import METRICS, Result
from moteslam.eval.metrics.localisation import LocalisationResult, score_localisation
from moteslam.eval.metrics.loops import LoopResult, score_loops
from moteslam.eval.metrics.rpe import RpeResult
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.wording import expect_type
from moteslam.slam.estimate import Estimate


@dataclass(frozen=True)
class Score:
    """How good one trajectory is.

    Attributes:
        results: of every metric by its name; None where it cannot be had, as over a metre that was never driven.
    """

    results: Mapping[str, Result | None]

    @property
    def ate(self) -> AteResult:
        """The absolute error, after alignment."""
        result = self.results["ate"]
        assert isinstance(result, AteResult)
        return result

    @property
    def rpe_1m(self) -> RpeResult | None:
        """The relative error over a metre; None where the robot did not drive one."""
        result = self.results["rpe_1m"]
        assert result is None or isinstance(result, RpeResult)
        return result

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into ``metrics.json``."""
        return {name: None if result is None else result.as_dict() for name, result in self.results.items()}


@dataclass(frozen=True)
class Scores:
    """The scores of a run.

    Attributes:
        online: of SLAM's poses as known at each scan.
        final: of SLAM's poses as known at the end.
        dead_reckoning: of odometry alone.
        localisation: of covariances and states; None where no scan has a map around it.
        loops: of the loops that the back end accepted; None where it looks for none.
    """

    online: Score
    final: Score
    dead_reckoning: Score
    localisation: LocalisationResult | None = None
    loops: LoopResult | None = None

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into ``metrics.json``."""
        return {
            "online": self.online.as_dict(),
            "final": self.final.as_dict(),
            "dead_reckoning": self.dead_reckoning.as_dict(),
            "localisation": None if self.localisation is None else self.localisation.as_dict(),
            **({} if self.loops is None else {"loops": self.loops.as_dict()}),
        }


def score_estimate(estimate: Estimate, truth: Trajectory, *, recording: Recording | None = None) -> Scores:
    """Score a run.

    Args:
        estimate: the run.
        truth: on the clock of its recording.
        recording: its scans show which loops are possible; without it there is no recall of loops.

    Raises:
        InputError: the truth has no stamps in common with the run.
    """
    expect_type(estimate, Estimate, "estimate", "run_slam(recording) makes one")
    return Scores(
        online=score_trajectory(estimate.trajectory, truth),
        final=score_trajectory(estimate.trajectory_final, truth),
        dead_reckoning=score_trajectory(estimate.dead_reckoning, truth),
        localisation=_score_localisation(estimate, truth),
        loops=score_loops(estimate.loops, truth, recording) if looks_for_loops(estimate.config) else None,
    )


def _score_localisation(estimate: Estimate, truth: Trajectory) -> LocalisationResult | None:
    """The scores of covariances and states; None where they cannot be had: a robot that hardly moved."""
    states, updated = estimate.diagnostics["state"], estimate.diagnostics["updated"]
    try:
        return score_localisation(estimate.trajectory, estimate.covariances, states, updated, truth)
    except InputError as error:
        if error.field != "truth":
            raise
        return None


def score_trajectory(trajectory: Trajectory, truth: Trajectory) -> Score:
    """Score one trajectory with every metric.

    Raises:
        InputError: the truth has no stamps in common with it.
    """
    results: dict[str, Result | None] = {"ate": METRICS["ate"].score(trajectory, truth)}
    for name, metric in METRICS.items():
        if name not in results:
            try:
                results[name] = result = metric.score(trajectory, truth)
                if not METRICS.is_bundled(name):
                    json.dumps(result.as_dict())
            except InputError:  # cannot be had: a robot that hardly moved
                results[name] = None
            except Exception as error:  # a plug-in's fault must not cost the run
                if METRICS.is_bundled(name):
                    raise
                METRICS.warn(name, f"{type(error).__name__}: {error}")
                results[name] = None
    return Score(results)
