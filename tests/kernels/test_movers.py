"""Rays against moving discs and lines, each tried in float64 where it is at the ray's moment."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.kernels.movers import cast_movers

pytestmark = pytest.mark.usefixtures("taichi")

RATE = 10.0


def at(poses: np.ndarray, time: float) -> np.ndarray:
    """The movers' poses [k, c] at a time, straight between those at the rate."""
    flat = poses.reshape(len(poses), -1).astype(np.float64)
    stamps = np.arange(len(poses)) / RATE
    return np.array([np.interp(time, stamps, column) for column in flat.T]).reshape(poses.shape[1:])


def nearest(discs: np.ndarray, lines: np.ndarray, origin: np.ndarray, angle: float, time: float) -> tuple[float, int]:
    """Range and number of the first mover on a ray."""
    ahead = np.array((np.cos(angle), np.sin(angle)))
    found = [(np.inf, -1)]
    for k, (x, y, radius) in enumerate(at(discs, time)):
        away = np.array((x, y)) - origin
        along, aside = away @ ahead, ahead[0] * away[1] - ahead[1] * away[0]
        if abs(aside) < radius:
            half = np.sqrt(radius**2 - aside**2)
            found += [(t, k) for t in [along - half] if t >= 0] + [(0.0, k)] * int(along - half < 0 <= along + half)
    for k, line in enumerate(at(lines, time)):
        a, b = line[:2] - origin, line[2:] - line[:2]
        across = ahead[0] * b[1] - ahead[1] * b[0]
        t, u = (a[0] * b[1] - a[1] * b[0]) / across, (a[0] * ahead[1] - a[1] * ahead[0]) / across
        found += [(t, len(discs[0]) + k)] * int(t >= 0 and 0 <= u <= 1)
    return min(found)


@pytest.mark.parametrize(("k", "m"), [(4, 3), (0, 3), (4, 0)])
def test_equals_the_twin(k: int, m: int) -> None:
    generator = np.random.default_rng(5)
    start, end = generator.uniform(-8, 8, (2, k, 3)), generator.uniform(-8, 8, (2, m, 4))
    share = np.linspace(0, 1, 30)[:, None, None]
    discs = (start[0] + share * (start[1] - start[0])).astype(np.float32)
    discs[..., 2] = 0.7
    lines = (end[0] + share * (end[1] - end[0])).astype(np.float32)
    n = 3000
    origins, angles = generator.uniform(-8, 8, (n, 2)), generator.uniform(-4, 4, n)
    times, walls = generator.uniform(-0.5, 3.5, n), generator.uniform(0, 10, n).astype(np.float32)
    ranges = walls.copy()
    hit = cast_movers(discs, lines, RATE, origins, angles, times, ranges)
    assert (hit >= 0).mean() > 0.05
    wrong = 0
    for i in range(n):
        distance, which = nearest(discs, lines, origins[i], angles[i], times[i])
        if distance < walls[i]:
            wrong += which != hit[i] or abs(distance - ranges[i]) > 1e-4
        else:
            wrong += hit[i] != -1 or ranges[i] != walls[i]
    assert wrong <= 3  # rays within the rounding of a rim


def test_a_ray_sees_the_mover_where_it_is_at_its_moment() -> None:
    discs = np.array([[[0.0, 0.0, 0.5]], [[10.0, 0.0, 0.5]]], np.float32)  # 10 m in 0.1 s
    nothing = np.zeros((2, 0, 4), np.float32)
    ranges = np.full(2, np.inf, np.float32)
    cast_movers(discs, nothing, RATE, [[5.0, -4.0], [5.0, -4.0]], [np.pi / 2] * 2, [0.05, 0.09], ranges)
    assert ranges[0] == pytest.approx(3.5, abs=1e-5)
    assert np.isinf(ranges[1])


def test_shapes_that_do_not_fit_are_refused() -> None:
    discs, lines = np.zeros((5, 1, 3), np.float32), np.zeros((4, 1, 4), np.float32)
    ranges = np.zeros(1, np.float32)
    with pytest.raises(InputError, match="poses of discs"):
        cast_movers(discs, lines, RATE, [[0.0, 0.0]], [0.0], [0.0], ranges)
    with pytest.raises(InputError):
        cast_movers(discs, lines[:1].repeat(5, 0), RATE, [[0.0, 0.0]], [0.0], [0.0, 1.0], ranges)
