"""Absolute and relative errors: by hand, as evo computes them, against relations; metrics by name."""

import gzip
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_lines import Capsys, printed, shown
from evo_scores import Drive, evo_metric
from scipy.spatial.transform import Rotation

from moteslam.errors import ConfigError, InputError
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.metrics.ate import absolute_trajectory_error as ate
from moteslam.eval.metrics.evidence import FINAL, Cost, Evidence
from moteslam.eval.metrics.registry import BUNDLED, METRICS, Metric, measure, metric
from moteslam.eval.metrics.relations import RelationResult, Relations, evaluate_relations, read_relations
from moteslam.eval.metrics.rpe import LENGTHS, drift, loop_closing_error, relative_pose_error
from moteslam.eval.scores import evidence_of
from moteslam.robot import se2
from moteslam.robot.se2 import umeyama
from moteslam.robot.trajectories.text import read_tum
from moteslam.robot.trajectory import Trajectory


def line(n: int, *, speed: float = 1.0, rate: float = 10.0, start: float = 0.0) -> Trajectory:
    stamps = start + np.arange(n) / rate
    return Trajectory(stamps, np.stack((speed * np.arange(n) / rate, np.zeros(n), np.zeros(n)), axis=-1))


def circle(turns: float, turned: float = 2 * np.pi) -> Trajectory:
    """A circle of 8 m radius, a step of 0.1 m each; ``turned`` is how far the estimate turns each time around."""
    n = round(turns * 2 * np.pi * 8 / 0.1)
    step = np.array([0.1, 0.0, turned / (2 * np.pi * 8 / 0.1)])
    return Trajectory(0.2 * np.arange(n + 1), np.vstack((np.zeros(3), se2.accumulate(np.tile(step, (n, 1))))))


@pytest.mark.parametrize("count", [1, 2, 30])
def test_alignment_of_points_in_one_place_is_a_shift(count: int) -> None:
    source, target = np.full((count, 2), 0.1) + 1e6, np.full((count, 2), -7.3)
    np.testing.assert_allclose(umeyama(source, target), [-7.4 - 1e6, -7.4 - 1e6, 0], atol=1e-9)


def test_where_the_reference_stands_still_the_headings_are_laid_on_each_other() -> None:
    """Jitter of a millimetre about one place would turn the estimate by any angle."""
    rng, stamps = np.random.default_rng(0), np.arange(0, 10, 0.1)
    still = np.tile((3.0, -2.0, 3.0), (len(stamps), 1)) + rng.normal(0, (1e-5, 1e-5, 0), (len(stamps), 3))
    off = se2.compose((1.0, 5.0, 2.0), still) + rng.normal(0, (1e-3, 1e-3, 1e-3), still.shape)
    result = ate(Trajectory(stamps, off), Trajectory(stamps, still))
    assert max(result.rmse, result.rotation.rmse) < 2e-3
    assert se2.wrap(result.transform[2] + 2.0) == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(result.aligned[:, :2].mean(axis=0), still[:, :2].mean(axis=0), atol=1e-9)


def test_a_dense_reference_is_interpolated_but_not_over_a_hole() -> None:
    reference, stamps = line(1000, rate=100, speed=2), np.arange(1, 9) + 0.003
    estimate = Trajectory(stamps, np.stack((2 * stamps, 0 * stamps, 0 * stamps), axis=-1))
    assert ate(estimate, reference, align=False).translation.max < 1e-12
    assert ate(estimate, reference, align=False, interpolate=False).translation.max > 0.005
    reference = line(1000, rate=100)
    kept = (reference.stamps < 3) | (reference.stamps > 6)
    assert ate(line(90), Trajectory(reference.stamps[kept], reference.poses[kept])).pairs == 61  # to 3.0, from 6.0 on
    assert ate(line(90), reference).pairs == 90


def test_equal_stamps_are_distinct_poses() -> None:
    poses = np.stack((np.array([0.0, 1.0, 1.1, 2.0]), np.zeros(4), np.zeros(4)), axis=-1)
    one = Trajectory(np.array([0.0, 1.0, 1.0, 2.0]), poses)
    assert ate(one, line(30)).pairs == 4
    assert ate(one, one).rmse < 1e-12


def test_rpe_by_time_of_a_known_drift() -> None:
    for all_pairs in (True, False):
        error = relative_pose_error(line(101, speed=1.02), line(101), delta=2.0, unit="s", all_pairs=all_pairs)
        # with all pairs the last two pairs are 1.9 and 1.8 s long
        np.testing.assert_allclose(error.errors, 0.04, atol=0.0041 if all_pairs else 1e-9)
    assert error.pairs == 5


def test_a_scale_and_a_yaw_rate_that_are_off_are_the_drift() -> None:
    result = drift(line(600, speed=1.02), line(600))
    assert set(result.lengths) == set(LENGTHS[:4])
    for length in LENGTHS[:4]:
        assert result.translation[result.lengths == length].mean() == pytest.approx(0.02, rel=0.03), length
    assert result.rotation.max() == 0
    result = drift(circle(1.0, 2 * np.pi + 0.1), circle(1.0))
    assert result.rotation.mean() == pytest.approx(0.1 / (2 * np.pi * 8), rel=0.01)


def test_the_loop_that_does_not_close() -> None:
    """Twice around a circle: everything from the second time on is seen again, 0.1 rad and a bit farther turned."""
    result = loop_closing_error(circle(1.98, 2 * np.pi + 0.1), circle(1.98))
    np.testing.assert_allclose(result.rotation_errors, 0.1, rtol=0.05)
    assert result.translation.median == pytest.approx(8 * 0.1, rel=0.1)
    assert (np.diff(result.stamps, axis=1)[:, 0] / 0.2 * 0.1 > 15).all()
    assert loop_closing_error(circle(2.0), circle(2.0)).translation.max < 1e-9


@pytest.mark.parametrize(
    ("measure", "problem"),
    [
        (lambda: ate(line(10), line(10, start=100)), r"0\.000 to 0\.900 s.*100\.000 to 100\.900 s"),
        (lambda: ate(line(10), line(10), from_start=True, scale=True), "^scale: "),
        (lambda: relative_pose_error(line(10), line(10), delta=100), "^pairs: .*shorter delta"),
        *((lambda d=d: relative_pose_error(line(10), line(10), delta=d), "^delta: ") for d in (0, -1, np.nan)),
        (lambda: relative_pose_error(line(10), line(10), delta=1.5, unit="frames"), "^delta: "),
        (lambda: relative_pose_error(line(10), line(10), unit="feet"), "^unit: "),  # type: ignore[arg-type]
        (lambda: drift(line(40), line(40)), "^path: 3.90 m driven"),
        (lambda: loop_closing_error(line(600), line(600)), "^path: no place visited twice"),
    ],
)
def test_what_cannot_be_measured_says_why(measure: Callable[[], Any], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        measure()


pytestmark = pytest.mark.filterwarnings("ignore")
Pair = tuple[Trajectory, Trajectory]


def random_pair(seed: int, n: int = 400, every: int = 1) -> Pair:
    """An estimate of every k-th pose that drifts, starts elsewhere, is late; and a wandering reference."""
    rng = np.random.default_rng(seed)
    steps = np.stack((rng.uniform(0, 0.4, n), rng.normal(0, 0.01, n), rng.normal(0, 0.15, n)), axis=-1)
    noisy = steps + rng.normal(0, (0.01, 0.005, 0.005), (n, 3))
    stamps = 1.3e9 + np.cumsum(rng.uniform(0.02, 0.06, n))
    late = np.sort(stamps + rng.uniform(-0.008, 0.014, n))[::every]
    estimated = se2.accumulate(noisy, rng.normal(0, 3, 3))[::every]
    return Trajectory(late, estimated), Trajectory(stamps, se2.accumulate(steps))


@pytest.fixture(params=["csail/csail", "intel/intel_key_scans", "key_scans/aces"])
def real_pair(request, data_folder: Path) -> Pair:
    """A real reference, and odometry-like drift put on it."""
    reference = read_tum(data_folder / f"{request.param}.reference.tum")
    steps = se2.between(reference.poses[:-1], reference.poses[1:])
    noisy = steps + np.random.default_rng(5).normal(0, (0.02, 0.02, 0.01), steps.shape)
    poses = np.concatenate((reference.poses[:1], se2.accumulate(noisy, reference.poses[0])))
    return Trajectory(reference.stamps, poses), reference


def in_space(trajectory: Trajectory) -> Drive:
    x, y, theta = trajectory.poses.T
    return trajectory.stamps, np.column_stack((x, y, 0 * x)), Rotation.from_euler("z", theta[:, None])


def evo(pair: Pair, relation: str = "translation_part", **how: Any) -> np.ndarray:
    """The errors of evo's APE, or with a delta of its RPE."""
    return evo_metric(in_space(pair[0]), in_space(pair[1]), relation, **how).error


LAID = {"align": {}, "not": {"align": False}, "from_start": {"from_start": True}, "scale": {"scale": True}}


@pytest.mark.parametrize("lay", LAID)
@pytest.mark.parametrize(("seed", "every"), [(0, 1), (1, 1), (2, 3), (3, 7)])
def test_ate_by_nearest_stamp_is_evos(seed: int, every: int, lay: str) -> None:
    estimate, reference = random_pair(seed, every=every)
    estimate = Trajectory(estimate.stamps, estimate.poses * ((1.07, 1.07, 1.0) if lay == "scale" else 1.0))
    ours = absolute_trajectory_error(estimate, reference, **LAID[lay], interpolate=False)
    assert ours.pairs < len(estimate)  # some are stamped too late for a partner
    assert (ours.scale == 1.0) == (lay != "scale")
    theirs = evo_metric(in_space(estimate), in_space(reference), lay=lay)
    np.testing.assert_allclose(ours.errors, theirs.error, atol=1e-9)
    for name, value in theirs.get_all_statistics().items():
        assert name == "sse" or ours.translation.as_dict()[name] == pytest.approx(value, abs=1e-9)
    turns = evo((estimate, reference), "rotation_angle_rad", lay=lay)
    # evo's angle comes from an arc cosine, which knows small angles to the root of an ulp
    np.testing.assert_allclose(ours.rotation_errors, turns, atol=3e-8)
    swapped = absolute_trajectory_error(reference, estimate, interpolate=False)  # from the shorter one, as evo does
    np.testing.assert_allclose(swapped.errors, evo((reference, estimate)), atol=1e-9)


def test_both_errors_of_50_random_trajectories_are_evos() -> None:
    for seed in range(100, 150):
        pair = random_pair(seed, n=150, every=1 + seed % 3)
        ate = absolute_trajectory_error(*pair, interpolate=False)
        np.testing.assert_allclose(ate.errors, evo(pair), atol=1e-9)
        rpe = relative_pose_error(*pair, interpolate=False)
        np.testing.assert_allclose(rpe.errors, evo(pair, delta=1.0), atol=1e-9)


@pytest.mark.parametrize("all_pairs", [True, False])
@pytest.mark.parametrize(("delta", "unit"), [(1, "frames"), (7, "frames"), (1.0, "m"), (5.0, "m"), (0.3, "m")])
def test_rpe_is_evos(delta: float, unit, all_pairs: bool) -> None:
    for seed in range(3):
        pair = random_pair(seed)
        ours = relative_pose_error(*pair, delta=delta, unit=unit, all_pairs=all_pairs, interpolate=False)
        how = {"delta": delta, "unit": unit, "all_pairs": all_pairs}
        np.testing.assert_allclose(ours.errors, evo(pair, **how), atol=1e-9)
        turn = evo(pair, "rotation_angle_rad", **how)
        np.testing.assert_allclose(ours.rotation_errors, turn, atol=3e-8)


def test_both_errors_of_real_trajectories_are_evos(real_pair: Pair) -> None:
    for align in (True, False):
        ours = absolute_trajectory_error(*real_pair, align=align)
        np.testing.assert_allclose(ours.errors, evo(real_pair, lay="align" if align else "not"), atol=1e-9)
    for delta, unit, all_pairs in ((1, "frames", True), (5.0, "m", True), (1, "frames", False), (5.0, "m", False)):
        rpe = relative_pose_error(*real_pair, delta=delta, unit=unit, all_pairs=all_pairs)
        theirs = evo(real_pair, delta=delta, unit=unit, all_pairs=all_pairs)
        np.testing.assert_allclose(rpe.errors, theirs, atol=1e-9)


def test_interpolation_is_evos_where_the_reference_is_dense() -> None:
    estimate, reference = random_pair(6, every=5)
    dense = np.linspace(reference.stamps[0], reference.stamps[-1], 20 * len(reference))
    reference = reference.at(dense)
    inside = (estimate.stamps > dense[0]) & (estimate.stamps < dense[-1])
    estimate = Trajectory(estimate.stamps[inside], estimate.poses[inside])
    ours = absolute_trajectory_error(estimate, reference)
    np.testing.assert_allclose(ours.errors, evo((estimate, reference), interpolate=True), atol=1e-9)


LINE = "{} {} {} {} 0 0 0 {}\n"


X = np.array([0, 1, 2, 2.1, 3])
DRIVE = Trajectory(np.array([0.0, 1.0, 2.0, 2.0, 3.0]), np.stack((X, 0 * X, 0 * X), axis=-1))
"""Straight along x, one metre a second; the stamp 2 belongs to two poses, 0.1 m apart."""


@pytest.fixture
def score(tmp_path: Path) -> Callable[..., RelationResult]:
    """Evaluate relations (t1, t2, x, y, yaw) of a file."""

    def evaluate(*rows: tuple[float, ...], drive: Trajectory = DRIVE, **options: Any) -> RelationResult:
        (tmp_path / "some.relations").write_text("".join(LINE.format(*row) for row in rows))
        return evaluate_relations(drive, read_relations(tmp_path / "some.relations"), **options)

    return evaluate


def test_errors_by_hand(score) -> None:
    result = score((0, 1, 1.3, 0.4, 0), (0, 3, 3, 0, np.deg2rad(10)))
    assert (result.total, result.at_stamps.pairs) == (2, 2)
    assert (result.translation.max, result.rotation_deg.max) == pytest.approx((0.5, 10))
    # the angle too: seen from a pose turned by 10 degrees, the shift of 0 stays 0
    assert (result.translation.mean, result.translation.min) == pytest.approx((0.25, 0))
    assert score((3, 1, -2, 0, 0)).rmse == pytest.approx(0)  # backwards in time
    turned = Trajectory(np.array([0.0, 1.0]), np.array([[0, 0, 3.1], [0, 0, -3.1]]))
    assert score((0, 1, 0, 0, 2 * np.pi - 6.2), drive=turned).rotation.max == pytest.approx(0, abs=1e-9)


def test_repeated_stamps_take_the_first_pose_and_are_not_clear(score) -> None:
    result = score((0, 2, 2, 0, 0), (2, 3, 1, 0, 0), (0, 3, 3.2, 0, 0))
    assert result.at_stamps.pairs == 3
    assert (result.clear.translation.count, result.clear.translation.max) == (1, pytest.approx(0.2))
    assert (result.translation.min, result.translation.max) == pytest.approx((0, 0.2))


def test_only_stamps_within_the_tolerance_match(score) -> None:
    rows = ((0.00005, 1, 1, 0, 0), (0.01, 1, 1, 0, 0), (0, 9, 1, 0, 0))
    assert (score(*rows).at_stamps.pairs, score(*rows, tolerance=0.02).at_stamps.pairs) == (1, 2)
    assert score(*rows, interpolate=False).pairs == 1


def test_stamps_between_poses_are_interpolated_but_not_far_apart(score) -> None:
    rows = ((0.25, 1, 0.75, 0, 0), (0.5, 2.5, 2.1, 0, 0), (-1, 1, 2, 0, 0))
    result = score(*rows)
    assert (result.total, result.pairs) == (3, 2)
    assert result.errors == pytest.approx([0, 0.05])  # at 2.5 s the robot is at 2.55 m
    assert result.clear is result.at_stamps is None
    with pytest.raises(InputError, match="none of 3 relations"):
        score(*rows, interpolate=False)
    sparse = Trajectory(np.array([0.0, 5.0, 5.5]), np.zeros((3, 3)))
    assert score((2.5, 5, 0, 0, 0), (5, 5.2, 0, 0, 0), drive=sparse).pairs == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no lines"),
        ("1 2 3\n", ":1: expected 8 finite numbers"),
        ("1 2 3 4 5 6 7 8\n1 2 3 4 5 6 7 nan\n", ":2: expected 8"),
        ("a b c d e f g h\n", ":1: expected 8"),
        ("# degrees\n1 2 3 4 0 0 0 -5\n1 2 3 4 0 0 0 -90\n", ":3: yaw: an angle of -90"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.relations"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_relations(path)
    with pytest.raises(InputError, match="No such file"):
        read_relations(tmp_path / "absent")


def test_the_intel_log_has_452_clear_relations(data_folder: Path) -> None:
    """Raw odometry against the relations: the counts of the data's own README, and the figures of PEERS."""
    stamps, poses = [], []
    with gzip.open(data_folder / "intel/intel_raw_part.log.gz", "rt") as log:
        for line in log:
            words = line.split()
            if words and words[0] == "FLASER":
                stamps.append(float(words[-3]))
                poses.append([float(word) for word in words[-6:-3]])
    odometry = Trajectory(np.array(stamps), np.array(poses))
    assert len(odometry) == 5505
    result = evaluate_relations(odometry, read_relations(data_folder / "intel/intel.relations"))
    assert (result.total, result.at_stamps.pairs) == (2984, 1030)
    assert result.clear.translation.count == 452
    assert result.clear.translation.mean == pytest.approx(3.46, abs=0.01)
    assert result.clear.rotation_deg.mean == pytest.approx(39.5, abs=0.1)
    assert result.pairs > 1030
    alone = evaluate_relations(odometry, read_relations(data_folder / "intel/intel_raw_part.relations"))
    assert alone.clear.as_dict() == result.clear.as_dict() == alone.as_dict()["all"]


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
    assert values["final.ate"].number < 0.05
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


def test_the_list(capsys: Capsys) -> None:
    listing = printed(capsys, "metrics")
    assert all(f"\n{name} " in listing for name in BUNDLED)
    listed = shown(capsys, "metrics")
    assert listed["ate"]["of"] == "trajectory"
    assert listed["map_f1"]["better"] == "higher"
    assert set(listed) >= set(BUNDLED)
