"""KLD sampling: the bound against the chi-square, the number against the spread, and runs in which it changes."""

from __future__ import annotations

import numpy as np
import pytest
from slam_rooms import circled_room

from moteslam.slam.filter.history import History
from moteslam.slam.filter.resampling import KldConfig, enough_particles, particle_number
from moteslam.slam.run import SlamSession
from moteslam.slam.settings import resolve_config

KLD = KldConfig(enabled=True, least=10)


def number(poses: np.ndarray, most: int = 5000, config: KldConfig = KLD) -> int:
    return particle_number(poses, np.full(len(poses), 1 / len(poses)), config, most, seed=0, step=0)


def test_the_bound_is_the_quantile_of_chi_square():
    from scipy.stats import chi2

    bins = np.array([2, 3, 10, 50, 500])
    np.testing.assert_allclose(
        enough_particles(bins, 0.05, 0.01), chi2.ppf(0.99, bins - 1) / (2 * 0.05), rtol=0.03
    )  # Wilson and Hilferty's approximation is worst for one degree of freedom
    assert enough_particles(np.array(1), 0.05, 0.01) == 0
    assert enough_particles(np.array(10), 0.1, 0.01) == pytest.approx(enough_particles(np.array(10), 0.05, 0.01) / 2)


def test_few_particles_for_one_place_and_many_for_many():
    generator = np.random.default_rng(0)
    near = generator.normal((3.05, 1.05, 0), 0.003, (400, 3))
    wide = generator.uniform((-1, -1, -0.5), (1, 1, 0.5), (400, 3))
    wider = generator.uniform((-3, -3, -1), (3, 3, 1), (5000, 3))
    assert number(near) == KLD.least
    assert number(near) < number(wide) < number(wider)
    assert number(wider, most=800) == 800
    assert number(near, most=4) == 4


def test_headings_about_pi_are_near_to_each_other():
    generator = np.random.default_rng(0)
    about = generator.normal((0.05, 0.05, np.pi), (1e-3, 1e-3, 1e-3), (400, 3))
    about[:, 2] = np.pi - np.mod(np.pi - about[:, 2], 2 * np.pi)
    assert (about[:, 2] < 0).any()
    assert number(about) == KLD.least


def test_particles_without_weight_do_not_count():
    poses = np.vstack((np.full((10, 3), 0.02), np.random.default_rng(0).uniform(-3, 3, (90, 3))))
    weights = np.repeat((0.1, 0.0), (10, 90))
    assert particle_number(poses, weights, KLD, 1000, seed=0, step=0) == KLD.least


def test_paths_follow_parents_through_a_changing_number():
    history = History()
    history.append(np.arange(12.0).reshape(4, 3), np.array([1, 3]))
    history.append(np.arange(6.0).reshape(2, 3) + 20, np.array([0, 1, 1]))
    history.append(np.arange(9.0).reshape(3, 3) + 40, None)
    assert history.particles == 3
    np.testing.assert_array_equal(history.paths(np.arange(3))[..., 0], [[3, 20, 40], [9, 23, 43], [9, 23, 46]])


@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize(
    ("preset", "scheme", "bin_size"),
    [("default", "systematic", 0.1), ("default", "residual", 0.1), ("paper", "stratified", 0.3)],
)
def test_the_number_falls_where_the_place_is_known(preset: str, scheme: str, bin_size: float):
    recording, true = circled_room(scans=60)
    settings = ["particles=100", "kld.enabled=true", "kld.least=12", "resample_below=1.0", f"resampling={scheme}"]
    settings += [f"kld.bin_size={bin_size}", f"kld.bin_angle={bin_size / 2}"]
    session = SlamSession(recording, resolve_config(preset, settings), seed=1)
    updates = list(session)
    numbers = [len(update.weights) for update in updates]
    assert numbers[0] == 100
    assert 12 <= numbers[-1] < 60
    assert all(update.poses.shape == (n, 3) for update, n in zip(updates, numbers, strict=True))
    assert all(update.weights.sum() == pytest.approx(1) for update in updates)
    estimate = session.estimate()
    assert len(estimate.trajectory) == len(estimate.trajectory_final) == len(recording.lidar)
    assert estimate.particle_paths.shape[1:] == (sum(update.updated for update in updates), 3)
    assert 12 <= len(estimate.particle_paths) < 60
    assert np.hypot(*(estimate.trajectory_final.poses - true)[:, :2].T).max() < 0.12
