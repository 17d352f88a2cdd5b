"""The metrics by name: a number with a unit, or the reason why there is none."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from moteslam.errors import ConfigError
from moteslam.eval.cli import main
from moteslam.eval.metrics.evidence import FINAL, Cost, Evidence
from moteslam.eval.metrics.registry import BUNDLED, METRICS, Metric, measure, metric
from moteslam.eval.metrics.relations import Relations
from moteslam.eval.scores import evidence_of
from moteslam.robot import se2
from moteslam.robot.trajectory import Trajectory


def test_every_metric_says_what_it_is() -> None:
    for name in BUNDLED:
        one = METRICS[name]
        assert one.meaning.endswith("."), name
        assert one.source, name
        assert one.better in ("lower", "higher", None)
    with pytest.raises(ConfigError, match="metric: expected either"):
        Metric("m", "Both.", "none", of_trajectory=lambda _: 1.0, of_run=lambda _: 1.0)


@pytest.fixture(scope="module")
def evidence(run, simulation) -> Evidence:
    """All that is known of a run."""
    estimate, _ = run
    known = evidence_of(estimate, simulation.truth, recording=simulation.recording, true_map=simulation.true_map(0.05))
    pairs = estimate.trajectory.stamps[[[0, 20], [20, 40]]]
    true = simulation.truth.at(pairs.reshape(-1)).poses.reshape(-1, 2, 3)
    relations = Relations(pairs, se2.between(true[:, 0], true[:, 1]))
    n = len(estimate.trajectory)
    return replace(known, relations=relations, cost=Cost(2.0, 1.0, 500_000_000, tuple(np.full(n, 0.01))))


@pytest.mark.slow
def test_a_run_of_which_all_is_known_has_next_to_all_metrics(evidence: Evidence) -> None:
    values = measure(evidence, BUNDLED)
    absent = {name: value.reason for name, value in values.items() if value.number is None}
    assert {name.rpartition(".")[2] for name in absent} <= {
        "loop_closing", "loop_closing_rotation", "map_far", "map_twice", "lost_precision", "lost_recall",
        "loops_precision", "loops_recall", "loops_false", "rpe_10m", "rpe_10m_rotation", "drift", "drift_rotation",
    }, absent  # fmt: skip
    assert all(absent.values())
    assert values["final.ate"].number is not None
    assert values["final.ate"].number < 0.05
    assert values["map_f1"].number is not None
    assert values["map_f1"].number > 0.8
    assert values["final.relations"].number == pytest.approx(0.0, abs=0.05)
    assert values["memory"].as_dict() == {"value": 500.0, "unit": "MB"}
    assert values["wall_per_scan_99"].number == pytest.approx(10.0)
    assert values["cpu_per_scan"].number == pytest.approx(2 * (values["wall_per_scan"].number or 0))
    stamps = evidence.trajectories[FINAL].stamps
    assert values["real_time_factor"].number == pytest.approx(stamps[-1] - stamps[0])
    json.dumps({name: value.as_dict() for name, value in values.items()}, allow_nan=False)


def test_what_cannot_be_had_is_absent_with_its_reason(evidence: Evidence) -> None:
    """A trajectory alone."""
    alone = Evidence({"theirs": evidence.trajectories[FINAL]})
    values = measure(alone, BUNDLED)
    assert all(value.number is None for value in values.values())
    reasons = {
        "theirs.ate": "no truth", "theirs.relations": "no relations", "theirs.residual": "no recording",
        "map_f1": "no map", "nees": "no covariances", "cpu_per_scan": "no time was measured",
        "loops_recall": "no back end that looks for loops", "effective_particles": "no diagnostics",
    }  # fmt: skip
    assert {name: values[name].reason for name in reasons} == reasons
    assert values["map_f1"].as_dict() == {"absent": "no map"}
    stamps = np.arange(3.0)
    short = Evidence({"theirs": Trajectory(stamps, np.zeros((3, 3)))}, Trajectory(stamps, np.zeros((3, 3))))
    assert measure(short, ["rpe_1m"])["theirs.rpe_1m"].reason.startswith("no pair 1 m apart")


def test_of_a_robot_that_stood_still_there_is_no_heading_and_no_scale(evidence: Evidence) -> None:
    assert evidence.truth is not None
    stamps = evidence.truth.stamps
    still = Trajectory(stamps, np.tile((1.0, 2.0, 0.3), (len(stamps), 1)))
    trajectories = {FINAL: Trajectory(stamps, still.poses + np.array((0.001, 0.0, 0.0)))}
    values = measure(replace(evidence, truth=still, trajectories=trajectories), ["heading", "ate_scaled", "ate"])
    assert values["final.heading"].number is None
    assert "stood still" in values["final.heading"].reason
    assert values["final.ate_scaled"].number is None
    assert values["final.ate"].number == pytest.approx(0, abs=1e-9)


def test_names_choose_trajectories_lengths_and_times(evidence: Evidence) -> None:
    assert "final.residual" not in measure(evidence)  # costly: measured when asked for
    values = measure(evidence, ["final.ate", "online.rpe_2.5m", "rpe_3frames_rotation", "map_f1"])
    assert list(values) == [
        "final.ate", "online.rpe_2.5m", "final.rpe_3frames_rotation", "online.rpe_3frames_rotation",
        "dead_reckoning.rpe_3frames_rotation", "map_f1",
    ]  # fmt: skip
    assert values["online.rpe_2.5m"].unit == "m"
    assert values["final.rpe_3frames_rotation"].unit == "deg"
    assert metric("rpe_1m") is METRICS["rpe_1m"]
    assert measure(evidence, ["theirs.ate"])["theirs.ate"].reason == "no theirs trajectory"
    for wrong, problem in (
        ("ate_", "ate_"),
        ("final.map_f1", "expected 'map_f1'"),
        ("rpe_m", "rpe_m"),
        ("rpe_0m", "expected a length above 0"),
        ("final.rpe_1.5frames", "expected a whole number of poses"),
    ):
        with pytest.raises(ConfigError, match=problem):
            measure(evidence, [wrong])


def test_the_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["metrics"]) == 0
    printed = capsys.readouterr().out
    assert all(f"\n{name} " in printed for name in BUNDLED)
    assert main.run(["metrics", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert listed["ate"]["of"] == "trajectory"
    assert listed["map_f1"]["better"] == "higher"
    assert set(listed) >= set(BUNDLED)
