"""ATE and RPE equal evo's to 1e-9, on random trajectories and on real ones."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

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


def as_evo(trajectory: Trajectory):
    from evo.core.trajectory import PoseTrajectory3D

    x, y, theta = trajectory.poses.T
    zero = np.zeros_like(x)
    return PoseTrajectory3D(
        positions_xyz=np.stack((x, y, zero), axis=-1),
        orientations_quat_wxyz=np.stack((np.cos(theta / 2), zero, zero, np.sin(theta / 2)), axis=-1),
        timestamps=trajectory.stamps.copy(),
    )


def evo_ate(pair: Pair, relation: str = "translation_part", *, lay: str = "align", **how):
    """The metric of evo; ``lay`` is how the estimate is laid on the reference."""
    from evo.core import sync
    from evo.core.metrics import APE, PoseRelation

    estimate, reference = pair
    matched = sync.associate_trajectories(as_evo(reference), as_evo(estimate), max_diff=0.01, **how)
    true, there = copy.deepcopy(matched)
    if lay == "from_start":
        there.align_origin(true)
    elif lay != "not":
        there.align(true, correct_scale=lay == "scale")
    metric = APE(PoseRelation[relation])
    metric.process_data((true, there))
    return metric


def evo_rpe(pair: Pair, relation: str, delta: float, unit: str, *, all_pairs: bool = False) -> np.ndarray:
    from evo.core import sync
    from evo.core.metrics import RPE, PoseRelation, Unit

    matched = sync.associate_trajectories(as_evo(pair[1]), as_evo(pair[0]), max_diff=0.01)
    metric = RPE(PoseRelation[relation], delta, {"m": Unit.meters, "frames": Unit.frames}[unit], all_pairs=all_pairs)
    metric.process_data(matched)
    return metric.error


LAID = {"align": {}, "not": {"align": False}, "from_start": {"from_start": True}, "scale": {"scale": True}}


@pytest.mark.parametrize("lay", LAID)
@pytest.mark.parametrize(("seed", "every"), [(0, 1), (1, 1), (2, 3), (3, 7)])
def test_ate_by_nearest_stamp_is_evos(seed: int, every: int, lay: str) -> None:
    estimate, reference = random_pair(seed, every=every)
    estimate = Trajectory(estimate.stamps, estimate.poses * ((1.07, 1.07, 1.0) if lay == "scale" else 1.0))
    ours = absolute_trajectory_error(estimate, reference, **LAID[lay], interpolate=False)
    assert ours.pairs < len(estimate)  # some are stamped too late for a partner
    assert (ours.scale == 1.0) == (lay != "scale")
    theirs = evo_ate((estimate, reference), lay=lay)
    np.testing.assert_allclose(ours.errors, theirs.error, atol=1e-9)
    for name, value in theirs.get_all_statistics().items():
        assert name == "sse" or ours.translation.as_dict()[name] == pytest.approx(value, abs=1e-9)
    turns = evo_ate((estimate, reference), "rotation_angle_rad", lay=lay).error
    # evo's angle comes from an arc cosine, which knows small angles to the root of an ulp
    np.testing.assert_allclose(ours.rotation_errors, turns, atol=3e-8)
    swapped = absolute_trajectory_error(reference, estimate, interpolate=False)  # from the shorter one, as evo does
    np.testing.assert_allclose(swapped.errors, evo_ate((reference, estimate)).error, atol=1e-9)


def test_both_errors_of_50_random_trajectories_are_evos() -> None:
    for seed in range(100, 150):
        pair = random_pair(seed, n=150, every=1 + seed % 3)
        ate = absolute_trajectory_error(*pair, interpolate=False)
        np.testing.assert_allclose(ate.errors, evo_ate(pair).error, atol=1e-9)
        rpe = relative_pose_error(*pair, interpolate=False)
        np.testing.assert_allclose(rpe.errors, evo_rpe(pair, "translation_part", 1.0, "m"), atol=1e-9)


@pytest.mark.parametrize("all_pairs", [True, False])
@pytest.mark.parametrize(("delta", "unit"), [(1, "frames"), (7, "frames"), (1.0, "m"), (5.0, "m"), (0.3, "m")])
def test_rpe_is_evos(delta: float, unit, all_pairs: bool) -> None:
    for seed in range(3):
        pair = random_pair(seed)
        ours = relative_pose_error(*pair, delta=delta, unit=unit, all_pairs=all_pairs, interpolate=False)
        evo = evo_rpe(pair, "translation_part", delta, unit, all_pairs=all_pairs)
        np.testing.assert_allclose(ours.errors, evo, atol=1e-9)
        turn = evo_rpe(pair, "rotation_angle_rad", delta, unit, all_pairs=all_pairs)
        np.testing.assert_allclose(ours.rotation_errors, turn, atol=3e-8)


def test_both_errors_of_real_trajectories_are_evos(real_pair: Pair) -> None:
    for align in (True, False):
        ours = absolute_trajectory_error(*real_pair, align=align)
        np.testing.assert_allclose(ours.errors, evo_ate(real_pair, lay="align" if align else "not").error, atol=1e-9)
    for delta, unit, all_pairs in ((1, "frames", True), (5.0, "m", True), (1, "frames", False), (5.0, "m", False)):
        rpe = relative_pose_error(*real_pair, delta=delta, unit=unit, all_pairs=all_pairs)
        evo = evo_rpe(real_pair, "translation_part", delta, unit, all_pairs=all_pairs)
        np.testing.assert_allclose(rpe.errors, evo, atol=1e-9)


def test_interpolation_is_evos_where_the_reference_is_dense() -> None:
    from evo.core.sync_method import SyncMethod

    estimate, reference = random_pair(6, every=5)
    dense = np.linspace(reference.stamps[0], reference.stamps[-1], 20 * len(reference))
    reference = reference.at(dense)
    inside = (estimate.stamps > dense[0]) & (estimate.stamps < dense[-1])
    estimate = Trajectory(estimate.stamps[inside], estimate.poses[inside])
    ours = absolute_trajectory_error(estimate, reference)
    theirs = evo_ate((estimate, reference), sync_method=SyncMethod.interpolation)
    np.testing.assert_allclose(ours.errors, theirs.error, atol=1e-9)
