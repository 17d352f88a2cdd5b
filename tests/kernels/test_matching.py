"""The search against its twin, on each of its paths."""

from __future__ import annotations

import numpy as np
import pytest
from twins import grids

from moteslam.errors import InputError
from moteslam.kernels import matching
from moteslam.kernels.matching import match_poses

pytestmark = pytest.mark.usefixtures("taichi")

CELL = 0.05
PAPER = (-0.1, -0.05, 0.0, 0.05, 0.1)
ORIGIN = (-2.3, -1.9)


def random_case(
    seed: int, *, beams: int, particles: int, highest: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    grid = np.zeros((61, 88), np.uint8)
    grid[1:-1, 1:-1] = generator.integers(1, highest + 1, (59, 86)) * (generator.random((59, 86)) < 0.2)
    points = generator.normal(0, 0.8, (beams, 2)).astype(np.float32)
    poses = np.column_stack((generator.uniform(-3, 3, (particles, 2)), generator.uniform(-7, 7, particles)))
    return grid, poses, points


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("beams", [0, 1, 57, 600])
@pytest.mark.parametrize("highest", [1, 3])
@pytest.mark.parametrize(
    ("offsets_xy", "offsets_theta"),
    [
        (PAPER, (-0.1, 0.0, 0.1)),
        ((0.0,), (0.0,)),
        ((0.05, 0.15), (0.02,)),  # whole cells on one side, of even number
        ((-0.2, 0.0, 0.2), (0.0, 0.1)),  # whole cells, too far apart for the windows
        ((-0.07, 0.0, 0.03), (-0.2, 0.0)),  # no whole cells
    ],
)
def test_equals_the_twin(
    seed: int, beams: int, highest: int, offsets_xy: tuple[float, ...], offsets_theta: tuple[float, ...]
) -> None:
    grid, poses, points = random_case(seed, beams=beams, particles=3, highest=highest)
    offsets = {"offsets_xy": offsets_xy, "offsets_theta": offsets_theta}
    scores, indices = grids.match_poses(grid, ORIGIN, CELL, poses, points, **offsets)
    found = match_poses(grid, ORIGIN, CELL, poses, points, **offsets)
    assert found.scores.tolist() == scores
    assert found.indices.tolist() == [list(index) for index in indices]
    i, j, k = found.indices.T
    moved = poses + np.column_stack((np.take(offsets_xy, i), np.take(offsets_xy, j), np.take(offsets_theta, k)))
    np.testing.assert_array_equal(found.poses, moved)


@pytest.mark.parametrize("seed", range(6))
def test_the_windows_find_what_the_search_of_single_poses_finds(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    grid, poses, points = random_case(seed, beams=300, particles=40)
    offsets = {"offsets_xy": PAPER, "offsets_theta": PAPER}
    windows = match_poses(grid, ORIGIN, CELL, poses, points, **offsets)
    monkeypatch.setattr(matching, "_match_windows", lambda *_: False)
    singles = match_poses(grid, ORIGIN, CELL, poses, points, **offsets)
    for ours, theirs in zip(windows, singles, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_shifted_and_turned_pose_is_found() -> None:
    grid, _, points = random_case(4, beams=400, particles=1)
    truth = np.array((0.02, 0.1, 0.3))
    grid[:] = 0
    for col, row in grids.cells_under(ORIGIN, CELL, truth, points):
        if 0 < row < 60 and 0 < col < 87:
            grid[row, col] = 1
    start = truth - (0.1, -0.05, 0.05)
    found = match_poses(grid, ORIGIN, CELL, [start], points, offsets_xy=PAPER, offsets_theta=PAPER)
    assert found.indices.tolist() == [[4, 1, 3]]
    np.testing.assert_allclose(found.poses[0], truth, rtol=0, atol=1e-12)


def test_ties_go_to_the_centre_then_to_the_first() -> None:
    grid = np.zeros((40, 40), np.uint8)
    nothing = match_poses(grid, (0, 0), CELL, [(1.0, 1.0, 0.0)], [(0.1, 0.1)], offsets_xy=PAPER, offsets_theta=PAPER)
    assert nothing.indices.tolist() == [[2, 2, 2]]
    grid[19, 20] = grid[21, 20] = grid[20, 19] = grid[20, 21] = 1  # each one cell from the centre
    tied = match_poses(grid, (0, 0), CELL, [(1.01, 1.01, 0.0)], [(0.0, 0.0)], offsets_xy=PAPER, offsets_theta=(0.0,))
    assert tied.scores.tolist() == [1]
    assert tied.indices.tolist() == [[1, 2, 0]]


def test_particles_far_apart_and_off_the_map() -> None:
    grid, poses, points = random_case(5, beams=50, particles=8)
    poses[:4, :2] = [(1e6, 0), (-1e6, 0), (0, 1e9), (-2.3, 1e3)]
    scores, indices = grids.match_poses(grid, ORIGIN, CELL, poses, points, offsets_xy=PAPER, offsets_theta=(0.0, 0.1))
    found = match_poses(grid, ORIGIN, CELL, poses, points, offsets_xy=PAPER, offsets_theta=(0.0, 0.1))
    assert found.scores.tolist() == scores
    assert found.indices.tolist() == [list(index) for index in indices]
    beyond = [(-100.0, 0, 0), (0, -1e12, 3), (1e30, 1, 1)]
    for offsets in (PAPER, (-0.07, 0.0, 0.03)):
        nothing = match_poses(grid, ORIGIN, CELL, beyond, points, offsets_xy=offsets, offsets_theta=(0.0, 0.1))
        assert nothing.scores.tolist() == [0, 0, 0]


def test_no_particles() -> None:
    grid, _, points = random_case(5, beams=5, particles=1)
    found = match_poses(grid, ORIGIN, CELL, np.empty((0, 3)), points, offsets_xy=PAPER, offsets_theta=PAPER)
    assert found.poses.shape == found.indices.shape == (0, 3)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"occupied": np.ones((8, 8), np.uint8)}, "occupied"),
        ({"occupied": np.zeros((8, 12), np.uint8)}, "occupied"),
    ],
)
def test_bad_input(change: dict[str, object], field: str) -> None:
    arguments: dict[str, object] = {
        "occupied": np.zeros((8, 8), np.uint8), "origin": (0, 0), "cell_size": 0.1, "poses": [(0, 0, 0)],
        "points": [(0.1, 0.1)], "offsets_xy": (0.0,), "offsets_theta": (0.0,),
    }  # fmt: skip
    with pytest.raises(InputError, match=f"^{field}: "):
        match_poses(**{**arguments, **change})  # type: ignore[arg-type]
