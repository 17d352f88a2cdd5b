"""ATE and RPE equal evo's to 1e-9, on random trajectories and on real ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evo_scores import Drive, evo_metric
from scipy.spatial.transform import Rotation

from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.metrics.rpe import relative_pose_error
from moteslam.robot import se2
from moteslam.robot.trajectories.text import read_tum
from moteslam.robot.trajectory import Trajectory

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
