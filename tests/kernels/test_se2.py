"""The kernels' SE(2) against robot/se2.py."""

# no `from __future__ import annotations`: Taichi reads the annotations of the kernel below

import numpy as np
import pytest

from moteslam.kernels import se2 as in_kernels
from moteslam.kernels.runtime import ti
from moteslam.kernels.types import F64_1D, F64_2D, kernel
from moteslam.robot import se2

pytestmark = pytest.mark.usefixtures("taichi")


@kernel
def _apply(a: F64_2D, b: F64_2D, composed: F64_2D, wrapped: F64_1D):
    for i in range(a.shape[0]):
        pose = ti.Vector([a[i, 0], a[i, 1], a[i, 2]], dt=ti.f64)
        other = ti.Vector([b[i, 0], b[i, 1], b[i, 2]], dt=ti.f64)
        both = in_kernels.compose(pose, other)
        for j in ti.static(range(3)):
            composed[i, j] = both[j]
        wrapped[i] = in_kernels.wrap(a[i, 2])


def test_equals_the_reference() -> None:
    generator = np.random.default_rng(4)
    a, b = generator.uniform(-20, 20, (2, 400, 3))
    edges = np.pi * np.array((-3.0, -2.0, -1.0, -0.0, 1.0, 2.0, 3.0))
    a[:7, 2] = edges
    a[7:14, 2] = np.nextafter(edges, 100)
    a[14:21, 2] = np.nextafter(edges, -100)
    composed, wrapped = np.empty_like(a), np.empty(len(a))
    _apply(a, b, composed, wrapped)
    reference = se2.compose(a, b)
    np.testing.assert_allclose(composed[:, :2], reference[:, :2], rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.sin(composed[:, 2] - reference[:, 2]), 0, atol=1e-13)
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * a[:, 2]), rtol=0, atol=1e-13)
    for angles in (wrapped, composed[:, 2]):
        assert (angles > -np.pi).all()
        assert (angles <= np.pi).all()
