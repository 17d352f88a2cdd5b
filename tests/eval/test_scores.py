"""Which trajectory a score is of, and which distance a metric is over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from moteslam.eval.metrics.registry import METRICS
from moteslam.eval.metrics.rpe import RpeResult
from moteslam.eval.scores import score_estimate, score_trajectory
from moteslam.robot.trajectory import Trajectory


def test_each_trajectory_has_its_own_score(run, simulation) -> None:
    estimate, _ = run
    true = simulation.truth.at(estimate.trajectory.stamps)
    off = np.random.default_rng(0).normal(size=(len(true), 3)) * (1.0, 1.0, 0.0)

    def astray(deviation: float) -> Trajectory:
        return Trajectory(true.stamps, true.poses + deviation * off)

    apart = replace(estimate, trajectory=astray(0.2), trajectory_final=astray(0.05), dead_reckoning=astray(0.8))
    scores = score_estimate(apart, simulation.truth)
    errors = [score.ate.rmse for score in (scores.online, scores.final, scores.dead_reckoning)]
    assert errors == pytest.approx(np.sqrt(2) * np.array([0.2, 0.05, 0.8]), rel=0.1)
    written = scores.as_dict()
    assert [written[name]["ate"]["translation_m"]["rmse"] for name in ("online", "final", "dead_reckoning")] == errors


def test_the_relative_error_over_a_metre_is_not_that_over_a_second() -> None:
    """Half a metre a second, and two per cent too far: two centimetres a metre, one a second."""
    stamps = np.arange(0.0, 40.0, 0.1)
    true = np.stack((0.5 * stamps, 0 * stamps, 0 * stamps), axis=-1)
    score = score_trajectory(Trajectory(stamps, true * 1.02), Trajectory(stamps, true))
    over = {"rpe_1m": score.rpe_1m, "rpe_1s": score.rpe_1s}
    for (name, result), unit, error in zip(over.items(), ("m", "s"), (0.02, 0.01), strict=True):
        assert isinstance(result, RpeResult)
        assert (result.delta, result.unit) == (1.0, unit)
        assert result.rmse == pytest.approx(error, rel=0.03)
        assert METRICS[name].unit == "m"
