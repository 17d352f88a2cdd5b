"""Sampled motion against its twin, and against the distribution it should have."""

from __future__ import annotations

import numpy as np
import pytest
from twins.philox import normals

from moteslam.errors import InputError
from moteslam.kernels.motion import STREAM, sample_motion
from moteslam.robot import se2

pytestmark = pytest.mark.usefixtures("taichi")


def random_poses(seed: int, n: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return np.column_stack((generator.uniform(-500, 500, (n, 2)), generator.uniform(-np.pi, np.pi, n)))


@pytest.mark.parametrize(("seed", "step", "n"), [(0, 0, 1), (3, 17, 333), (2**63 + 5, 2**32 - 1, 50), (1, 1, 0)])
def test_equals_the_twin(seed: int, step: int, n: int) -> None:
    poses = random_poses(1, n)
    motion, spread = np.array((0.3, -0.02, 4.0)), np.array((0.05, 0.01, 0.6))
    expected = se2.compose(poses, motion + spread * normals(seed, step, n, STREAM)[:, :3])
    sample_motion(poses, motion, spread, seed=seed, step=step)
    # the same float64 arithmetic up to the last bits of sin, cos and log, at coordinates of 500 m
    np.testing.assert_allclose(poses[:, :2], expected[:, :2], rtol=0, atol=1e-11)
    np.testing.assert_allclose(np.sin(poses[:, 2] - expected[:, 2]), 0, atol=1e-13)
    assert (poses[:, 2] > -np.pi).all()
    assert (poses[:, 2] <= np.pi).all()


def test_without_noise_every_particle_moves_alike() -> None:
    poses = random_poses(2, 64)
    expected = se2.compose(poses, (1.0, 0.5, -2.0))
    sample_motion(poses, (1.0, 0.5, -2.0), (0, 0, 0), seed=1, step=1)
    np.testing.assert_allclose(poses, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("before", "turn", "after"), [(3.0, 0.5, 3.5 - 2 * np.pi), (np.pi, 0.0, np.pi), (-3.0, -0.5, 2 * np.pi - 3.5)]
)
def test_headings_wrap(before: float, turn: float, after: float) -> None:
    poses = np.array([[0.0, 0.0, before]])
    sample_motion(poses, (0, 0, turn), (0, 0, 0), seed=0, step=0)
    assert poses[0, 2] == pytest.approx(after, abs=1e-14)


def test_noise_has_the_spread_asked_for() -> None:
    n, spread = 20_000, np.array((0.1, 0.02, 0.3))
    poses = np.zeros((n, 3))
    sample_motion(poses, (0, 0, 0), spread, seed=5, step=9)
    # five standard errors
    assert (np.abs(poses.mean(axis=0)) < 5 * spread / np.sqrt(n)).all()
    assert (np.abs(poses.std(axis=0) / spread - 1) < 5 / np.sqrt(2 * n)).all()
    correlations = np.corrcoef(poses.T)[np.triu_indices(3, 1)]
    assert (np.abs(correlations) < 5 / np.sqrt(n)).all()


def test_steps_seeds_and_streams_differ() -> None:
    drawn = []
    for seed, step, stream in ((0, 0, 1), (0, 1, 1), (1, 0, 1), (2**32, 0, 1), (0, 0, 2)):
        poses = np.zeros((4, 3))
        sample_motion(poses, (0, 0, 0), (1, 1, 1), seed=seed, step=step, stream=stream)
        drawn.append(poses.tobytes())
    assert len(set(drawn)) == 5


@pytest.mark.parametrize(
    ("poses", "motion", "spread", "field"),
    [
        (np.zeros((4, 3), np.float32), (0, 0, 0), (1, 1, 1), "poses"),
        (np.zeros((4, 2)), (0, 0, 0), (1, 1, 1), "poses"),
        (np.zeros((8, 3))[::2], (0, 0, 0), (1, 1, 1), "poses"),
        (np.zeros((4, 3)), (0, np.nan, 0), (1, 1, 1), "motion"),
        (np.zeros((4, 3)), (0, 0), (1, 1, 1), "motion"),
        (np.zeros((4, 3)), (0, 0, 0), (1, -1, 1), "spread"),
        (np.zeros((4, 3)), (0, 0, 0), (1, np.inf, 1), "spread"),
    ],
)
def test_bad_input(poses: np.ndarray, motion: tuple[float, ...], spread: tuple[float, ...], field: str) -> None:
    with pytest.raises(InputError, match=f"^{field}: "):
        sample_motion(poses, motion, spread, seed=0, step=0)
