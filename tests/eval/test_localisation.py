"""Covariances and states against the truth, relative to the map around the robot, and anchored at the start."""

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.metrics.localisation import (
    CHI_SQUARED_95,
    LocalisationResult,
    nees_from_start,
    nees_interval,
    score_localisation,
    share_within_spread,
)
from moteslam.robot import se2
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.estimate import Correction
from moteslam.slam.filter.certainty import LocalisationState

SURE, DOUBTFUL, LOST = LocalisationState
N = 1500
STEP, NOISE = np.array([0.2, 0.0, 0.02]), np.diag((1e-4, 1e-4, 1e-6))
RUNS, STEPS = 100, 300
COVARIANCE = np.array([[4e-4, 1e-4, 0], [1e-4, 1e-4, 0], [0, 0, 2.5e-5]])


def driven(turn: float = 0.0) -> np.ndarray:
    """Poses [N, 3], 0.1 m apart: on a wavy path that comes nowhere twice, or with a turn on a slowly moving circle."""
    turns = turn + 0.02 * np.sin(np.arange(N) / 40)
    return se2.accumulate(np.column_stack((np.full(N, 0.1), np.zeros(N), turns)))


def score(
    estimated: np.ndarray, true: np.ndarray, *, covariance: np.ndarray = COVARIANCE, states: np.ndarray | None = None
) -> LocalisationResult:
    """With every fifth scan in the map."""
    stamps, updated = np.arange(len(true)) * 0.1, np.arange(len(true)) % 5 == 0
    states = np.zeros(len(true)) if states is None else states
    covariances = np.tile(covariance, (len(true), 1, 1))
    return score_localisation(
        Trajectory(stamps, estimated), covariances, states, updated.astype(float), Trajectory(stamps, true)
    )


def noisy(true: np.ndarray, covariance: np.ndarray = COVARIANCE) -> np.ndarray:
    """The poses off by errors of this covariance, all but those of the map, which are right."""
    errors = np.random.default_rng(0).multivariate_normal(np.zeros(3), covariance, len(true))
    errors[::5] = 0.0
    return se2.compose(true, errors)


def test_errors_of_the_stated_covariance_have_a_nees_of_three():
    result = score(noisy(driven(0.05)), driven(0.05))
    off = np.arange(N)[1:] % 5 > 0
    assert len(result.stamps) == N - 1  # the first has no map around it
    assert result.nees[off].mean() == pytest.approx(3, abs=0.2)
    assert (result.nees[off] < CHI_SQUARED_95).mean() == pytest.approx(0.95, abs=0.015)
    np.testing.assert_allclose(np.cov(result.errors[off].T), COVARIANCE, atol=3e-5)
    assert score(noisy(driven(0.05)), driven(0.05), covariance=4 * COVARIANCE).nees[off].mean() == pytest.approx(
        0.75, abs=0.1
    )


def test_after_a_correction_the_map_is_where_it_was_drawn_anew():
    """The estimate is 2 m off until scan 700; there the back end moves it, and the map, to the truth."""
    true = driven(0.05)
    early = se2.compose(np.array([2.0, 0.0, 0.1]), true)
    online = np.vstack((early[:701], true[701:]))
    stamps, updated = np.arange(N) * 0.1, (np.arange(N) % 5 == 0).astype(float)
    covariances = np.tile(COVARIANCE, (N, 1, 1))
    given = (Trajectory(stamps, online), covariances, np.zeros(N), updated, Trajectory(stamps, true))
    correction = Correction(700, true[np.flatnonzero(updated)[:141]])
    corrected = score_localisation(*given, corrections=(correction,))
    assert np.abs(corrected.errors).max() < 1e-9
    assert score_localisation(*given).wrong.sum() > 100


def test_slow_drift_and_the_frame_of_the_map_are_no_errors():
    """The estimate lies elsewhere, and bends by 2 m over the drive: 1 mm from one scan to the next."""
    true = driven()  # comes nowhere twice
    bent = se2.compose(np.array([5.0, -3.0, 2.0]), true)
    bent[:, 0] += np.linspace(0, 2.0, N)
    result = score(bent, true)
    assert np.hypot(*result.errors[:, :2].T).max() < 0.1
    assert not result.wrong.any()


def test_a_lidar_that_is_not_where_it_is_said_to_be_is_no_error():
    true, mount = driven(0.05), np.array([0.03, -0.02, 0.04])
    result = score(se2.compose(noisy(true), mount), true)
    np.testing.assert_allclose(result.offset, mount, atol=0.003)
    off = np.arange(N)[1:] % 5 > 0
    assert result.nees[off].mean() == pytest.approx(3, abs=0.3)


def test_a_robot_that_is_carried_off_is_astray_and_one_that_jumps_by_itself_is_not():
    """It stands 3 m aside from scan 800 on; the estimate knows nothing of it, or another particle is the best one."""
    path, carried, jumped = driven(), driven(), driven()
    carried[800:, 0] += 3.0
    result = score(path, carried)
    assert not result.wrong[:799].any()
    assert result.wrong[799:].all()
    assert np.abs(result.errors[-300:]).max() < 0.1  # all around was seen since
    jumped[800:] = se2.compose((3.0, 0.0, 0.5), jumped[800:])
    assert not score(jumped, path).astray.any()


def test_a_robot_that_was_astray_is_right_where_it_is_about_what_was_mapped_before():
    angles = np.linspace(0, 6 * np.pi, N)
    estimated = np.column_stack((4 * np.cos(angles), 4 * np.sin(angles), angles + np.pi / 2))
    true = estimated.copy()
    true[800:1200] = se2.compose((3.0, 0.0, 0.5), true[800:1200])
    astray = score(estimated, true).astray
    np.testing.assert_array_equal(np.flatnonzero(astray) + 1, np.arange(800, 1200))


def test_precision_and_recall_count_the_scans():
    estimated = driven()
    true = estimated.copy()
    true[800:, 0] += 3.0
    wrong = score(estimated, true).wrong
    first, many = int(np.flatnonzero(wrong)[0]), int(wrong.sum())
    states = np.zeros(N)
    states[1:][first : first + 10] = LOST
    states[1:][first - 30 : first] = DOUBTFUL
    states[1:][first - 40 : first - 30] = LOST
    result = score(estimated, true, states=states)
    assert result.precision(LOST) == 0.5
    assert result.recall(LOST) == pytest.approx(10 / many)
    assert result.precision(DOUBTFUL) == 0.2
    assert result.recall(DOUBTFUL) == pytest.approx(10 / many)
    found = result.as_dict()
    assert (found["wrong"], found["states"]) == (many, {"sure": N - 1 - 50, "doubtful": 30, "lost": 20})
    assert found["lost"] == {"precision": 0.5, "recall": result.recall(LOST)}
    # without wrong poses there is no recall, and without doubt no precision
    found = score(driven(), driven()).as_dict()
    assert found["lost"] == found["doubtful_or_lost"] == {"precision": None, "recall": None}
    assert found["nees"] == {"mean": pytest.approx(0, abs=1e-9), "median": pytest.approx(0, abs=1e-9), "within_95": 1}


@pytest.mark.parametrize(
    ("later", "covariances", "updated", "problem"),
    [
        (0, np.zeros((2, 3, 3)), 1, r"covariances: expected \[n, 3, 3\], \[n\] and \[n\] of 3 poses"),
        (0, np.tile(np.diag([1.0, 1.0, 0.0]), (3, 1, 1)), 1, "covariances: a covariance that is not positive definite"),
        (100, np.tile(COVARIANCE, (3, 1, 1)), 1, "truth: it covers no scan with a map around it, expected two updates"),
        (0, np.tile(COVARIANCE, (3, 1, 1)), 0, "truth: it covers no scan with a map around it, expected two updates"),
    ],
)
def test_what_does_not_fit_is_refused(later: int, covariances: np.ndarray, updated: int, problem: str):
    path = Trajectory(np.arange(3.0), np.zeros((3, 3)))
    truth = Trajectory(path.stamps + later, path.poses)
    with pytest.raises(InputError, match=problem):
        score_localisation(path, covariances, np.zeros(3), np.full(3, updated), truth)


def dead_reckoned(seed: int) -> tuple[Trajectory, np.ndarray, Trajectory]:
    """An odometry with noise, the covariances that follow from it, and the truth, which starts elsewhere."""
    rng = np.random.default_rng(seed)
    steps = np.tile(STEP, (STEPS, 1))
    noisy = steps + rng.multivariate_normal(np.zeros(3), NOISE, STEPS)
    true = np.vstack((np.zeros(3), se2.accumulate(steps)))
    estimated = np.vstack((np.zeros(3), se2.accumulate(noisy)))
    c, s = np.cos(STEP[2]), np.sin(STEP[2])
    back = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])  # from the frame before the step to that after it
    moved = back @ np.array([[1, 0, -STEP[1]], [0, 1, STEP[0]], [0, 0, 1]])
    covariances = np.zeros((STEPS + 1, 3, 3))
    for k in range(STEPS):
        covariances[k + 1] = moved @ covariances[k] @ moved.T + back @ NOISE @ back.T
    stamps = 0.1 * np.arange(STEPS + 1)
    elsewhere = se2.compose((4.0, -7.0, 2.0), true)
    return Trajectory(stamps, estimated), covariances, Trajectory(stamps, elsewhere)


def test_of_100_runs_of_a_consistent_filter_95_lie_in_the_interval() -> None:
    results = [nees_from_start(*dead_reckoned(seed)) for seed in range(RUNS)]
    low, high = nees_interval(1)
    assert (low, high) == pytest.approx((0.2158, 9.3484), abs=1e-4)
    ends = np.array([result.end for result in results])
    assert 90 <= ((low < ends) & (ends < high)).sum() <= 99
    assert 90 <= sum(result.interval[0] < result.mean < result.interval[1] for result in results) <= 99
    # the ends of the runs are independent of each other
    low, high = nees_interval(RUNS)
    assert low < ends.mean() < high


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_covariances_that_are_wrong_are_noticed(factor: float) -> None:
    drives = [dead_reckoned(seed) for seed in range(RUNS)]
    ends = [nees_from_start(estimate, factor * covariances, truth).end for estimate, covariances, truth in drives]
    low, high = nees_interval(RUNS)
    assert not low < np.mean(ends) < high


def test_the_error_is_seen_from_the_start() -> None:
    """Half a metre at the first pose is no error: estimate and truth are laid on each other there."""
    estimate, covariances, truth = dead_reckoned(0)
    moved = Trajectory(estimate.stamps, se2.compose((0.5, 0.3, -1.0), estimate.poses))
    kept = nees_from_start(estimate, covariances, truth)
    np.testing.assert_allclose(nees_from_start(moved, covariances, truth).nees, kept.nees)


def test_covariances_that_do_not_fit_are_refused() -> None:
    estimate, covariances, truth = dead_reckoned(0)
    later = Trajectory(truth.stamps + 1e6, truth.poses)
    for given, against, problem in (
        (covariances[:3], truth, r"^covariances: \[3, 3, 3\], expected one of each of 301"),
        (-covariances, truth, "^covariances: one that is not positive"),
        (0 * covariances, truth, "^covariances: no covariance of rank three"),
        (covariances, later, "^truth: it covers 0 poses"),
    ):
        with pytest.raises(InputError, match=problem):
            nees_from_start(estimate, given, against)


def test_the_share_within_the_spread() -> None:
    rng = np.random.default_rng(0)
    deviations = np.tile((0.02, 0.01, 0.005), (4000, 1))
    errors = rng.normal(size=(4000, 3)) * deviations
    assert share_within_spread(errors, deviations) == pytest.approx(0.95, abs=0.015)
    assert share_within_spread(3 * errors, deviations) < 0.6
    assert share_within_spread(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), np.zeros((2, 3))) == 0.5
    with pytest.raises(InputError, match="deviations"):
        share_within_spread(errors, deviations[:3])
