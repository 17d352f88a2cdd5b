"""The scores of a run against the truth: absolute and relative errors of SLAM and of dead reckoning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from moteslam.errors import InputError
from moteslam.eval.metrics.ate import AteResult, absolute_trajectory_error
from moteslam.eval.metrics.rpe import RpeResult, Unit, relative_pose_error
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.estimate import Estimate


@dataclass(frozen=True)
class Score:
    """How good one trajectory is.

    Attributes:
        ate: absolute error, after alignment.
        rpe_1m, rpe_1s: relative error over a metre and over a second; None where there is no such stretch.
    """

    ate: AteResult
    rpe_1m: RpeResult | None
    rpe_1s: RpeResult | None

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into ``metrics.json``."""
        return {
            "ate": self.ate.as_dict(),
            "rpe_1m": None if self.rpe_1m is None else self.rpe_1m.as_dict(),
            "rpe_1s": None if self.rpe_1s is None else self.rpe_1s.as_dict(),
        }


@dataclass(frozen=True)
class Scores:
    """The scores of a run: SLAM as known at each scan (online) and at the end (final), and dead reckoning."""

    online: Score
    final: Score
    dead_reckoning: Score

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into ``metrics.json``."""
        return {
            "online": self.online.as_dict(),
            "final": self.final.as_dict(),
            "dead_reckoning": self.dead_reckoning.as_dict(),
        }


def score_estimate(estimate: Estimate, truth: Trajectory) -> Scores:
    """Score a run.

    Raises:
        InputError: the truth has no stamps in common with the run.
    """
    return Scores(
        online=score_trajectory(estimate.trajectory, truth),
        final=score_trajectory(estimate.trajectory_final, truth),
        dead_reckoning=score_trajectory(estimate.dead_reckoning, truth),
    )


def score_trajectory(trajectory: Trajectory, truth: Trajectory) -> Score:
    """Score one trajectory.

    Raises:
        InputError: the truth has no stamps in common with it.
    """
    return Score(
        ate=absolute_trajectory_error(trajectory, truth),
        rpe_1m=_relative(trajectory, truth, "m"),
        rpe_1s=_relative(trajectory, truth, "s"),
    )


def _relative(trajectory: Trajectory, truth: Trajectory, unit: Unit) -> RpeResult | None:
    try:
        return relative_pose_error(trajectory, truth, delta=1.0, unit=unit)
    except InputError:  # a robot that hardly moved
        return None
