"""Scoring against its twin: integers, so equal."""

from __future__ import annotations

import numpy as np
import pytest
from twins import grids

from moteslam.errors import InputError
from moteslam.kernels.scoring import score_poses

pytestmark = pytest.mark.usefixtures("taichi")


def random_grid(seed: int, shape: tuple[int, int], *, highest: int = 1) -> np.ndarray:
    generator = np.random.default_rng(seed)
    grid = np.zeros(shape, np.uint8)
    inner = (shape[0] - 2, shape[1] - 2)
    grid[1:-1, 1:-1] = generator.integers(1, highest + 1, inner) * (generator.random(inner) < 0.3)
    return grid


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("shape", "beams"), [((2, 8), 5), ((37, 24), 1), ((40, 104), 131), ((64, 64), 0)])
@pytest.mark.parametrize("highest", [1, 255])
def test_equals_the_twin(seed: int, shape: tuple[int, int], beams: int, highest: int) -> None:
    generator = np.random.default_rng(seed)
    grid = random_grid(seed, shape, highest=highest)
    points = generator.normal(0, 1.5, (beams, 2)).astype(np.float32)
    poses = np.column_stack((generator.uniform(-3, 3, (23, 2)), generator.uniform(-7, 7, 23)))
    origin = (-1.2, -0.7)
    expected = grids.score_poses(grid, origin, 0.05, poses, points)
    scores = score_poses(grid, origin, 0.05, poses, points)
    assert scores.dtype == np.int32
    assert scores.tolist() == expected


def test_poses_off_the_map_score_nothing() -> None:
    grid = random_grid(1, (40, 40), highest=255)
    poses = [(-100.0, 0, 0), (100, 0, 1), (0, 1e7, 2), (0, -1e12, 3), (1e30, 1, 1)]
    assert score_poses(grid, (0, 0), 0.1, poses, [(0.5, 0.5), (-1, 2)]).tolist() == [0] * 5


def test_no_poses_and_an_array_to_write_to() -> None:
    grid = random_grid(1, (40, 40))
    assert score_poses(grid, (0, 0), 0.1, np.empty((0, 3)), [(0.5, 0.5)]).shape == (0,)
    out = np.full(2, -1, np.int32)
    assert score_poses(grid, (0, 0), 0.1, np.ones((2, 3)), np.empty((0, 2)), out=out) is out
    assert out.tolist() == [0, 0]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"occupied": np.zeros((8, 12), np.uint8)}, "occupied"),
        ({"occupied": np.zeros((8, 0), np.uint8)}, "occupied"),
        ({"occupied": np.ones((8, 8), np.uint8)}, "occupied"),
        ({"occupied": np.zeros((8, 8), np.int32)}, "occupied"),
        ({"origin": (0, np.nan)}, "origin"),
        ({"cell_size": 0.0}, "cell_size"),
        ({"cell_size": np.inf}, "cell_size"),
        ({"poses": np.zeros((3, 2))}, "poses"),
        ({"poses": [(0, np.inf, 0)]}, "poses"),
        ({"points": [(np.nan, 1.0)]}, "points"),
        ({"points": np.zeros((4, 3))}, "points"),
        ({"out": np.zeros(3, np.int32)}, "out"),
        ({"out": np.zeros(1, np.int64)}, "out"),
    ],
)
def test_bad_input(change: dict[str, object], field: str) -> None:
    arguments: dict[str, object] = {
        "occupied": np.zeros((8, 8), np.uint8), "origin": (0, 0), "cell_size": 0.1, "poses": [(0, 0, 0)],
        "points": [(0.1, 0.1)],
    }  # fmt: skip
    with pytest.raises(InputError, match=f"^{field}: "):
        score_poses(**{**arguments, **change})  # type: ignore[arg-type]
