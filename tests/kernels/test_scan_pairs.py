"""Endpoints held to surfaces of other scans: against the twin, and by derivatives."""

from collections.abc import Iterator

import numpy as np
import pytest
from twins import scan_pairs

from moteslam.kernels.scan_pairs import MAX_PARTNERS, PAIR, accumulate, match_endpoints
from moteslam.robot import se2
from moteslam.slam.backend.graph import config

pytestmark = pytest.mark.usefixtures("taichi")

SCANS, POINTS = 5, 40


@pytest.fixture(scope="module")
def case() -> dict[str, np.ndarray]:
    """Scans of a square room from poses that are a little off."""
    rng = np.random.default_rng(3)
    true = np.column_stack((rng.uniform(-1, 1, (SCANS, 2)), rng.uniform(-3, 3, SCANS)))
    points, normals = [], []
    for pose in true:
        side, along = rng.integers(0, 4, POINTS), rng.uniform(-1.9, 1.9, POINTS)
        turn = side * np.pi / 2
        wall = np.column_stack((2 * np.cos(turn) - along * np.sin(turn), 2 * np.sin(turn) + along * np.cos(turn)))
        inverse = se2.between(pose, np.zeros(3))
        points.append(se2.transform_points(inverse, wall))
        normals.append(se2.transform_points(inverse, wall - np.column_stack((np.cos(turn), np.sin(turn)))) - points[-1])
    normals[0][:5] = 0.0
    partners = np.array([[1, 2, -1], [0, 3, 4], [0, 4, -1], [1, -1, -1], [0, 2, -1]], np.int32)
    return {
        "points": np.vstack(points).astype(np.float32),
        "normals": np.vstack(normals).astype(np.float32),
        "owners": np.repeat(np.arange(SCANS), POINTS).astype(np.int32),
        "starts": np.arange(SCANS + 1, dtype=np.int32) * POINTS,
        "partners": partners,
        "poses": true + rng.normal(0, 0.02, true.shape),
    }


def placed(case: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    pose = case["poses"][case["owners"]]
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    turned = [
        np.column_stack((c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1]))
        for v in (case["points"], case["normals"])
    ]
    return turned[0] + pose[:, :2], turned[1]


def matched(case: dict[str, np.ndarray], reach: float = 0.3) -> np.ndarray:
    points, normals = placed(case)
    return match_endpoints(points, normals, case["owners"], case["partners"], reach=reach, agreement=0.8)


def summed(case: dict[str, np.ndarray], poses: np.ndarray, matches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The sums and costs at these poses, with a scale so large that the weights hardly change."""
    given = (case["points"], case["normals"], case["starts"], poses, case["partners"], matches)
    return accumulate(*given, scale=1.0)


def of_pairs(
    case: dict[str, np.ndarray], poses: np.ndarray, pairs: np.ndarray
) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
    """Each scan, its partner, the matrix from the Jacobian by the one pose to that by the other, and the sums."""
    for a in range(SCANS):
        for slot, b in enumerate(case["partners"][a]):
            if b >= 0:
                dx, dy = poses[a, :2] - poses[b, :2]
                yield a, int(b), np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]]), pairs[a, slot]


@pytest.mark.parametrize("reach", [0.05, 0.3, 5.0])
def test_the_nearest_endpoint_of_every_partner_is_found(case: dict[str, np.ndarray], reach: float):
    points, normals = placed(case)
    twin = scan_pairs.match(points, normals, case["owners"], case["partners"], reach, 0.8)
    found = matched(case, reach)
    assert (twin >= 0).sum() > 20
    differ = found != twin
    assert differ.mean() < 0.01  # distances that are equal in float32
    np.testing.assert_array_equal(found < 0, twin < 0)


def test_the_sums_are_derivatives_of_the_cost(case: dict[str, np.ndarray]):
    matches = matched(case)
    pairs, costs = summed(case, case["poses"], matches)
    assert pairs.shape == (SCANS, 3, PAIR)
    points, normals = (case[name].astype(float) for name in ("points", "normals"))

    def cost(poses: np.ndarray) -> float:
        return scan_pairs.cost(points, normals, case["owners"], poses, matches, 1.0)

    assert costs[:, 0].sum() == pytest.approx(cost(case["poses"]), rel=1e-4)
    gradient = np.zeros((SCANS, 3))
    for a, b, about, sums in of_pairs(case, case["poses"], pairs):
        gradient[a] += sums[6:9]
        gradient[b] -= about.T @ sums[6:9]
    numeric = np.zeros((SCANS, 3))
    for a in range(SCANS):
        for axis in range(3):
            step = np.zeros((SCANS, 3))
            step[a, axis] = 1e-5
            numeric[a, axis] = (cost(case["poses"] + step) - cost(case["poses"] - step)) / 2e-5
    np.testing.assert_allclose(gradient, numeric, atol=2e-3 * np.abs(numeric).max())


def test_the_blocks_solve_for_the_poses(case: dict[str, np.ndarray]):
    """A step of Gauss-Newton with all of them lowers the cost to next to nothing."""
    poses, matches = case["poses"].copy(), matched(case)
    before = None
    for _ in range(3):
        pairs, costs = summed(case, poses, matches)
        before = before or costs[:, 0].sum()
        h, g = np.zeros((3 * SCANS, 3 * SCANS)), np.zeros(3 * SCANS)
        for a, b, about, sums in of_pairs(case, poses, pairs):
            at, to = slice(3 * a, 3 * a + 3), slice(3 * b, 3 * b + 3)
            block = sums[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)
            h[at, at] += block
            h[at, to] -= block @ about
            h[to, at] -= about.T @ block
            h[to, to] += about.T @ block @ about
            g[at] += sums[6:9]
            g[to] -= about.T @ sums[6:9]
        h[:3, :3] += 1e6 * np.eye(3)
        poses -= np.linalg.solve(h + 1e-9 * np.eye(len(h)), g).reshape(-1, 3)
    assert summed(case, poses, matches)[1][:, 0].sum() < 0.01 * before


def test_the_back_end_asks_for_no_more_partners_than_the_kernel_keeps():
    assert config.MAX_PARTNERS == MAX_PARTNERS
