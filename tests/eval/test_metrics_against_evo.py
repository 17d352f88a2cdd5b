"""ATE and RPE equal evo's to 1e-9, on random trajectories and on real ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.metrics.rpe import relative_pose_error
from moteslam.robot import se2
from moteslam.robot.trajectories.text import read_tum
from moteslam.robot.trajectory import Trajectory

pytestmark = pytest.mark.filterwarnings("ignore")


def random_pair(seed: int, n: int = 400, every: int = 1) -> tuple[Trajectory, Trajectory]:
    """A wandering reference, and an estimate of every k-th pose that drifts, starts elsewhere, is late."""
    rng = np.random.default_rng(seed)
    steps = np.stack((rng.uniform(0, 0.4, n), rng.normal(0, 0.01, n), rng.normal(0, 0.15, n)), axis=-1)
    noisy = steps + rng.normal(0, (0.01, 0.005, 0.005), (n, 3))
    stamps = 1.3e9 + np.cumsum(rng.uniform(0.02, 0.06, n))
    reference = Trajectory(stamps, se2.accumulate(steps))
    estimate = Trajectory(
        np.sort(stamps + rng.uniform(-0.008, 0.014, n))[::every], se2.accumulate(noisy, rng.normal(0, 3, 3))[::every]
    )
    return estimate, reference


def as_evo(trajectory: Trajectory):
    from evo.core.trajectory import PoseTrajectory3D

    x, y, theta = trajectory.poses.T
    zero = np.zeros_like(x)
    return PoseTrajectory3D(
        positions_xyz=np.stack((x, y, zero), axis=-1),
        orientations_quat_wxyz=np.stack((np.cos(theta / 2), zero, zero, np.sin(theta / 2)), axis=-1),
        timestamps=trajectory.stamps.copy(),
    )


def associated(estimate: Trajectory, reference: Trajectory, **how):
    from evo.core import sync

    return sync.associate_trajectories(as_evo(reference), as_evo(estimate), max_diff=0.01, **how)


def evo_ape(pair, relation: str, *, align: bool, scale: bool = False) -> np.ndarray:
    import copy

    from evo.core.metrics import APE, PoseRelation

    pair = copy.deepcopy(pair)
    if align:
        pair[1].align(pair[0], correct_scale=scale)
    metric = APE(PoseRelation[relation])
    metric.process_data(pair)
    return metric.error


def evo_rpe(pair, relation: str, delta: float, unit: str, *, all_pairs: bool) -> np.ndarray:
    from evo.core.metrics import RPE, PoseRelation, Unit

    metric = RPE(PoseRelation[relation], delta, {"m": Unit.meters, "frames": Unit.frames}[unit], all_pairs=all_pairs)
    metric.process_data(pair)
    return metric.error


@pytest.fixture(params=["csail", "intel", "aces"])
def real_pair(request, data_folder: Path) -> tuple[Trajectory, Trajectory]:
    """A real reference, and odometry-like drift put on it."""
    name = {
        "csail": "csail/csail.reference.tum",
        "intel": "intel/intel_key_scans.reference.tum",
        "aces": "key_scans/aces.reference.tum",
    }[request.param]
    reference = read_tum(data_folder / name)
    rng = np.random.default_rng(5)
    steps = se2.between(reference.poses[:-1], reference.poses[1:])
    noisy = steps + rng.normal(0, (0.02, 0.02, 0.01), steps.shape)
    poses = np.concatenate((reference.poses[:1], se2.accumulate(noisy, reference.poses[0])))
    return Trajectory(reference.stamps, poses), reference


@pytest.mark.parametrize("align", [True, False])
@pytest.mark.parametrize(("seed", "every"), [(0, 1), (1, 1), (2, 3), (3, 7)])
def test_ate_by_nearest_stamp_is_evos(seed: int, every: int, align: bool) -> None:
    estimate, reference = random_pair(seed, every=every)
    pair = associated(estimate, reference)
    ours = absolute_trajectory_error(estimate, reference, align=align, interpolate=False)
    assert ours.pairs < len(estimate)  # some are stamped too late for a partner
    np.testing.assert_allclose(ours.errors, evo_ape(pair, "translation_part", align=align), atol=1e-9)
    np.testing.assert_allclose(
        ours.rotation_errors, evo_ape(pair, "rotation_angle_rad", align=align), atol=3e-8
    )  # evo's angle comes from an arc cosine, which knows small angles to the root of an ulp


def test_both_errors_of_50_random_trajectories_are_evos() -> None:
    for seed in range(100, 150):
        estimate, reference = random_pair(seed, n=150, every=1 + seed % 3)
        pair = associated(estimate, reference)
        ate = absolute_trajectory_error(estimate, reference, interpolate=False)
        np.testing.assert_allclose(ate.errors, evo_ape(pair, "translation_part", align=True), atol=1e-9)
        rpe = relative_pose_error(estimate, reference, interpolate=False)
        np.testing.assert_allclose(rpe.errors, evo_rpe(pair, "translation_part", 1.0, "m", all_pairs=False), atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_ate_from_the_start_is_evos(seed: int) -> None:
    """Evo's ``align_origin``."""
    import copy

    from evo.core.metrics import APE, PoseRelation

    estimate, reference = random_pair(seed)
    pair = copy.deepcopy(associated(estimate, reference))
    pair[1].align_origin(pair[0])
    metric = APE(PoseRelation.translation_part)
    metric.process_data(pair)
    ours = absolute_trajectory_error(estimate, reference, from_start=True, interpolate=False)
    np.testing.assert_allclose(ours.errors, metric.error, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_ate_with_scale_is_evos(seed: int) -> None:
    estimate, reference = random_pair(seed)
    estimate = Trajectory(estimate.stamps, estimate.poses * (1.07, 1.07, 1.0))
    ours = absolute_trajectory_error(estimate, reference, scale=True, interpolate=False)
    evo = evo_ape(associated(estimate, reference), "translation_part", align=True, scale=True)
    np.testing.assert_allclose(ours.errors, evo, atol=1e-9)
    assert ours.scale != pytest.approx(1.0, abs=0.01)
    rigid = absolute_trajectory_error(estimate, reference, interpolate=False)
    assert rigid.scale == 1.0
    assert rigid.rmse > ours.rmse


@pytest.mark.parametrize("longer", ["estimate", "reference"])
def test_association_starts_from_the_shorter_as_evo_does(longer: str) -> None:
    estimate, reference = random_pair(8, every=4)
    if longer == "estimate":
        estimate, reference = reference, estimate
    evo = evo_ape(associated(estimate, reference), "translation_part", align=True)
    ours = absolute_trajectory_error(estimate, reference, interpolate=False)
    np.testing.assert_allclose(ours.errors, evo, atol=1e-9)


def test_ate_of_real_trajectories_is_evos(real_pair: tuple[Trajectory, Trajectory]) -> None:
    pair = associated(*real_pair)
    for align in (True, False):
        ours = absolute_trajectory_error(*real_pair, align=align)
        np.testing.assert_allclose(ours.errors, evo_ape(pair, "translation_part", align=align), atol=1e-9)


@pytest.mark.parametrize("all_pairs", [True, False])
@pytest.mark.parametrize(("delta", "unit"), [(1, "frames"), (7, "frames"), (1.0, "m"), (5.0, "m"), (0.3, "m")])
def test_rpe_is_evos(delta: float, unit, all_pairs: bool) -> None:
    for seed in range(3):
        estimate, reference = random_pair(seed)
        pair = associated(estimate, reference)
        ours = relative_pose_error(estimate, reference, delta=delta, unit=unit, all_pairs=all_pairs, interpolate=False)
        evo = evo_rpe(pair, "translation_part", delta, unit, all_pairs=all_pairs)
        np.testing.assert_allclose(ours.errors, evo, atol=1e-9)
        turn = evo_rpe(pair, "rotation_angle_rad", delta, unit, all_pairs=all_pairs)
        np.testing.assert_allclose(ours.rotation_errors, turn, atol=3e-8)


@pytest.mark.parametrize("all_pairs", [True, False])
def test_rpe_of_real_trajectories_is_evos(real_pair: tuple[Trajectory, Trajectory], all_pairs: bool) -> None:
    pair = associated(*real_pair)
    for delta, unit in ((1, "frames"), (5.0, "m")):
        ours = relative_pose_error(*real_pair, delta=delta, unit=unit, all_pairs=all_pairs)
        evo = evo_rpe(pair, "translation_part", delta, unit, all_pairs=all_pairs)
        np.testing.assert_allclose(ours.errors, evo, atol=1e-9)


def test_statistics_are_evos() -> None:
    from evo.core.metrics import APE, PoseRelation

    estimate, reference = random_pair(4)
    metric = APE(PoseRelation.translation_part)
    metric.process_data(associated(estimate, reference))
    evo = metric.get_all_statistics()
    ours = absolute_trajectory_error(estimate, reference, align=False).translation.as_dict()
    for name in ("rmse", "mean", "median", "std", "min", "max"):
        assert ours[name] == pytest.approx(evo[name], abs=1e-9)


def test_interpolation_is_evos_where_the_reference_is_dense() -> None:
    from evo.core.sync_method import SyncMethod

    estimate, reference = random_pair(6, every=5)
    dense = np.linspace(reference.stamps[0], reference.stamps[-1], 20 * len(reference))
    reference = reference.at(dense)
    inside = (estimate.stamps > dense[0]) & (estimate.stamps < dense[-1])
    estimate = Trajectory(estimate.stamps[inside], estimate.poses[inside])
    pair = associated(estimate, reference, sync_method=SyncMethod.interpolation)
    ours = absolute_trajectory_error(estimate, reference)
    np.testing.assert_allclose(ours.errors, evo_ape(pair, "translation_part", align=True), atol=1e-9)
