"""Marching through a grid against a twin that crosses every cell side in order."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from twins import rays

from moteslam.errors import InputError
from moteslam.kernels.marching import distance_field, march_rays

pytestmark = pytest.mark.usefixtures("taichi")


def random_grid(seed: int, shape: tuple[int, int], share: float) -> np.ndarray:
    return np.random.default_rng(seed).random(shape) < share


@pytest.mark.parametrize(("shape", "share"), [((1, 1), 1.0), ((7, 40), 0.02), ((60, 33), 0.3), ((200, 150), 0.001)])
def test_distances_equal_scipy(shape: tuple[int, int], share: float) -> None:
    occupied = random_grid(2, shape, share)
    occupied[0, 0] = True
    expected = ndimage.distance_transform_edt(~occupied) * 0.05
    np.testing.assert_allclose(distance_field(occupied, 0.05), expected, rtol=1e-6)


def test_distances_where_nothing_is() -> None:
    np.testing.assert_allclose(distance_field(np.zeros((30, 40), bool), 0.1), 5.0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("share", [0.0, 0.001, 0.01, 0.2])
def test_equals_the_twin(seed: int, share: float) -> None:
    generator = np.random.default_rng(seed)
    occupied = random_grid(seed, (90, 120), share)
    origin, cell = (-3.1, -200.7), 0.05
    poses = np.column_stack((generator.uniform(-1, 7, (12, 2)) + origin, generator.uniform(-4, 4, 12)))
    beams = np.append(np.linspace(-2.2, 2.2, 30), 0.0)
    ranges = march_rays(distance_field(occupied, cell), origin, cell, poses, beams, max_range=5.0)
    for pose, row in zip(poses, ranges, strict=True):
        expected = [rays.march(occupied, origin, cell, pose, beam, max_range=5.0) for beam in beams]
        # float32 on 200 cells; a beam that grazes a corner within that may meet the next cell instead
        close = np.isclose(row, expected, rtol=1e-6, atol=2e-5)
        assert (~close).sum() <= 1


def test_from_outside_and_from_within() -> None:
    occupied = np.zeros((10, 10), bool)
    occupied[4, 7] = True
    field = distance_field(occupied, 0.1)
    poses = [(-1.0, 0.45, 0.0), (0.75, 0.45, 1.0), (2.0, 0.45, np.pi), (2.0, 0.45, 0.0), (-1e6, 0.45, 0.0)]
    ranges = march_rays(field, (0, 0), 0.1, poses, [0.0], max_range=3.0)[:, 0]
    np.testing.assert_allclose(ranges, [1.7, 0, 1.2, np.inf, np.inf], rtol=1e-5)


def test_nothing_to_march() -> None:
    assert march_rays(np.ones((4, 4), np.float32), (0, 0), 0.1, np.empty((0, 3)), [0.0], max_range=1.0).shape == (0, 1)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"distance": np.ones((4, 4))}, "distance"),
        ({"cell_size": 0.0}, "cell_size"),
        ({"max_range": -1.0}, "max_range"),
        ({"max_range": 1e9}, "poses"),
        ({"poses": [(1e30, 0, 0)]}, "poses"),
        ({"poses": [(np.nan, 0, 0)]}, "poses"),
        ({"beam_angles": [np.inf]}, "beam_angles"),
        ({"origin": (0, 0, 0)}, "origin"),
    ],
)
def test_bad_input(change: dict[str, object], field: str) -> None:
    arguments: dict[str, object] = {
        "distance": np.ones((4, 4), np.float32), "origin": (0, 0), "cell_size": 0.1, "poses": [(0, 0, 0)],
        "beam_angles": [0.0], "max_range": 1.0,
    }  # fmt: skip
    with pytest.raises(InputError, match=f"^{field}: "):
        march_rays(**{**arguments, **change})  # type: ignore[arg-type]


@pytest.mark.parametrize("occupied", [np.zeros((4, 4)), np.zeros(4, bool), np.zeros((0, 4), bool)])
def test_bad_grid(occupied: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"^occupied: "):
        distance_field(occupied, 0.1)
