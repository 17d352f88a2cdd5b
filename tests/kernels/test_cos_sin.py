"""Cosine and sine by plain arithmetic against the C library's, by way of NumPy."""

# no `from __future__ import annotations`: Taichi reads the annotations of the kernel below

import numpy as np
import pytest

from moteslam.kernels.cos_sin import cos_sin
from moteslam.kernels.types import F64_1D, F64_2D, kernel

pytestmark = pytest.mark.usefixtures("taichi")


@kernel
def _fill(angles: F64_1D, out: F64_2D):
    for i in range(angles.shape[0]):
        c, s = cos_sin(angles[i])
        out[0, i], out[1, i] = c, s


def assert_equal(angles: np.ndarray) -> None:
    found, expected = np.empty((2, len(angles))), np.stack((np.cos(angles), np.sin(angles)))
    _fill(angles, found)
    np.testing.assert_allclose(found, expected, rtol=0, atol=3e-16)
    apart = found.astype(np.float32) != expected.astype(np.float32)
    assert (np.abs(expected[apart]) < 1e-14).all()


@pytest.mark.parametrize("span", [1e-9, 1.0, 10.0, 1e3, 1e5, 1e8, 1e300])
def test_equals_the_library(span: float) -> None:
    assert_equal(np.random.default_rng(3).uniform(-span, span, 20_000))


def test_where_the_reduction_changes_its_multiple() -> None:
    edges = np.pi / 4 * np.arange(-64, 65)
    assert_equal(np.concatenate((edges, np.nextafter(edges, 100), np.nextafter(edges, -100), [0.0, -0.0, 1e5, -1e5])))
