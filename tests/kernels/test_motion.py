"""Sampled motion and its random words against their twins, published answers, and the laws of the distribution."""

from collections.abc import Callable

import numpy as np
import pytest
from random_words import philox_words
from twins.philox import normals
from twins.philox import philox as twin_words

from moteslam.kernels.motion import STREAM, sample_motion
from moteslam.robot import se2

pytestmark = pytest.mark.usefixtures("taichi")


@pytest.mark.parametrize(("seed", "step", "n"), [(0, 0, 1), (3, 17, 333), (2**63 + 5, 2**32 - 1, 50), (1, 1, 0)])
def test_equals_the_twin(seed: int, step: int, n: int) -> None:
    generator = np.random.default_rng(1)
    poses = np.column_stack((generator.uniform(-500, 500, (n, 2)), generator.uniform(-np.pi, np.pi, n)))
    motion, spread = np.array((0.3, -0.02, 4.0)), np.array((0.05, 0.01, 0.6))
    expected = se2.compose(poses, motion + spread * normals(seed, step, n, STREAM)[:, :3])
    sample_motion(poses, motion, spread, seed=seed, step=step)
    # the same float64 arithmetic up to the last bits of sin, cos and log, at coordinates of 500 m
    np.testing.assert_allclose(poses[:, :2], expected[:, :2], rtol=0, atol=1e-11)
    np.testing.assert_allclose(np.sin(poses[:, 2] - expected[:, 2]), 0, atol=1e-13)
    assert (poses[:, 2] > -np.pi).all()
    assert (poses[:, 2] <= np.pi).all()


def test_noise_has_the_spread_asked_for() -> None:
    n, spread = 20_000, np.array((0.1, 0.02, 0.3))
    poses = np.zeros((n, 3))
    sample_motion(poses, (0, 0, 0), spread, seed=5, step=9)
    # five standard errors
    assert (np.abs(poses.mean(axis=0)) < 5 * spread / np.sqrt(n)).all()
    assert (np.abs(poses.std(axis=0) / spread - 1) < 5 / np.sqrt(2 * n)).all()
    correlations = np.corrcoef(poses.T)[np.triu_indices(3, 1)]
    assert (np.abs(correlations) < 5 / np.sqrt(n)).all()


Words = tuple[int, ...]
# Random123 1.14, tests/kat_vectors, philox 4x32 10: counter, key, words
KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@pytest.mark.parametrize("philox", [philox_words, twin_words])
def test_published_random_words(philox: Callable[[list[Words], list[Words]], np.ndarray]) -> None:
    counters, keys, words = zip(*KNOWN, strict=True)
    np.testing.assert_array_equal(philox(list(counters), list(keys)), words)


def test_headings_are_wrapped_at_the_edges_too() -> None:
    edges = np.pi * np.array((-3.0, -2.0, -1.0, -0.0, 1.0, 2.0, 3.0))
    headings = np.concatenate((edges, np.nextafter(edges, 100), np.nextafter(edges, -100)))
    poses = np.column_stack((np.zeros((len(headings), 2)), headings))
    sample_motion(poses, (0, 0, 0), (0, 0, 0), seed=0, step=0)
    np.testing.assert_allclose(np.exp(1j * poses[:, 2]), np.exp(1j * headings), rtol=0, atol=1e-13)
    assert (poses[:, 2] > -np.pi).all()
    assert (poses[:, 2] <= np.pi).all()
