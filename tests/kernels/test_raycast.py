"""Ray casting against every segment tried in float64, and the cases where casters leak."""

import numpy as np
import pytest
from twins import rays

from moteslam.kernels.raycast import MAX_BUCKETS, SegmentBuckets, build_buckets, cast_movers, cast_rays

pytestmark = pytest.mark.usefixtures("taichi")

ULP = 2.0**-23


def random_world(seed: int, *, walls: int, extent: float, offset: float = 0.0) -> np.ndarray:
    """Walls of all directions, some along the axes, up to a tenth of the extent long."""
    generator = np.random.default_rng(seed)
    start = generator.uniform(0, extent, (walls, 2)) + offset
    angle = np.where(
        generator.random(walls) < 0.5, np.pi / 2 * generator.integers(0, 4, walls), generator.uniform(0, 7, walls)
    )
    length = generator.uniform(0.01, 0.1, walls)[:, None] * extent
    return np.hstack((start, start + length * np.column_stack((np.cos(angle), np.sin(angle)))))


def assert_equals_the_twin(
    buckets: SegmentBuckets, segments: np.ndarray, origins: np.ndarray, angles: np.ndarray, max_range: float
) -> None:
    ranges, _ = cast_rays(buckets, origins, angles, max_range=max_range)
    expected, sine = rays.cast_rays(segments, origins, angles, max_range=max_range)
    extent = max(np.ptp(segments[:, 0::2]), np.ptp(segments[:, 1::2]))
    hit = np.isfinite(expected) & np.isfinite(ranges)
    # float32: coordinates to half an ulp of the extent, the direction to 2^-24; worse the flatter it meets the wall
    bound = (4 * extent * ULP + max_range * ULP) / np.maximum(sine, 1e-3) + 4 * ULP * max_range
    wrong = np.abs(ranges[hit] - expected[hit]) > bound[hit]
    # a ray within the rounding of a wall's end may see it or not, and so may one whose wall is max_range away
    assert wrong.sum() + (np.isfinite(expected) != np.isfinite(ranges)).sum() <= len(angles) / 1000
    assert hit.mean() > 0.05
    assert (ranges[np.isfinite(ranges)] <= max_range).all()


@pytest.mark.parametrize(("seed", "extent", "offset"), [(0, 20.0, -10.0), (1, 100.0, 0.0), (2, 40.0, -7e5)])
@pytest.mark.parametrize("size", [None, 0.9, 3.0, 200.0])
def test_equals_the_twin(seed: int, extent: float, offset: float, size: float | None) -> None:
    segments = random_world(seed, walls=120, extent=extent, offset=offset)
    generator = np.random.default_rng(seed + 100)
    origins = generator.uniform(-0.2 * extent, 1.2 * extent, (1500, 2)) + offset
    angles = generator.uniform(-10, 10, 1500)
    angles[:40] = np.pi / 2 * generator.integers(-4, 5, 40)
    assert_equals_the_twin(build_buckets(segments, size=size), segments, origins, angles, 0.6 * extent)


def test_surfaces_are_the_segments_that_rays_end_on() -> None:
    segments = random_world(11, walls=90, extent=30.0)
    buckets = build_buckets(segments)
    generator = np.random.default_rng(12)
    origins, angles = generator.uniform(0, 30, (2000, 2)), generator.uniform(-4, 4, 2000)
    ranges, hit = cast_rays(buckets, origins, angles, max_range=20.0)
    np.testing.assert_array_equal(hit >= 0, np.isfinite(ranges))
    seen = hit >= 0
    assert seen.mean() > 0.5
    ends = origins[seen] + ranges[seen, None] * np.column_stack((np.cos(angles[seen]), np.sin(angles[seen])))
    a, along = segments[hit[seen], :2], segments[hit[seen], 2:] - segments[hit[seen], :2]
    share = np.clip(((ends - a) * along).sum(1) / (along**2).sum(1), 0, 1)
    assert np.hypot(*(ends - a - share[:, None] * along).T).max() < 1e-3


def test_far_outside() -> None:
    room = build_buckets([(0, 0, 10, 0), (10, 0, 10, 6)])
    origins = [(-1e6, 3.0), (-1e6, 3.0), (-1e9, 0.0), (-50.0, 3.0)]
    ranges, _ = cast_rays(room, origins, [0, np.pi, 0, 0], max_range=2e6)
    np.testing.assert_allclose(ranges, [1_000_010, np.inf, np.inf, 60])


def test_no_ray_slips_between_walls_that_touch() -> None:
    """A closed ring of 2000 short walls at odd angles: from within, nothing gets out, least of all at the corners."""
    generator = np.random.default_rng(0)
    turn = np.sort(generator.uniform(0, 2 * np.pi, 2000))
    ring = np.column_stack((np.cos(turn), np.sin(turn))) * generator.uniform(20, 30, 2000)[:, None] + (71.3, -12.9)
    segments = np.hstack((ring, np.roll(ring, -1, axis=0)))
    start = np.array((71.0, -13.0)) + generator.uniform(-1, 1, (2000, 2))
    to_corner = np.arctan2(ring[:, 1] - start[:, 1], ring[:, 0] - start[:, 0])
    for size in (None, 1.7):
        buckets = build_buckets(segments, size=size)
        assert np.isfinite(cast_rays(buckets, start, to_corner, max_range=70.0)[0]).all()
        assert np.isfinite(cast_rays(buckets, start, generator.uniform(-4, 4, 2000), max_range=70.0)[0]).all()


def test_a_ray_through_the_corners_of_buckets_and_along_their_sides() -> None:
    buckets = build_buckets([(0, 0, 0, 12), (0, 12, 12, 12), (12, 12, 12, 0), (12, 0, 0, 0)], size=1.0)
    x, y = buckets.corner  # where four buckets meet, and along the side between two
    origins = [(x + 3, y + 3), (x + 3, y + 3), (x + 3, y + 3.5), (x + 3.5, y + 3), (x + 3, y + 3)]
    ranges, _ = cast_rays(buckets, origins, [np.pi / 4, 5 * np.pi / 4, np.pi / 2, 0.0, np.pi], max_range=50.0)
    expected = [np.sqrt(2) * (9 + -x), np.sqrt(2) * (3 + x), 8.5 - y, 8.5 - x, 3 + x]
    np.testing.assert_allclose(ranges, expected, rtol=1e-5)


def test_a_ray_along_a_wall_stops_at_its_end() -> None:
    ranges, _ = cast_rays(
        build_buckets([(2, 1, 5, 1), (0, 0, 0, 2)]), [(1.0, 1.0), (6.0, 1.0)], [0.0, np.pi], max_range=9
    )
    np.testing.assert_allclose(ranges, [1, 1], rtol=1e-6)


def test_a_huge_world_has_few_buckets() -> None:
    buckets = build_buckets([(0, 0, 9e5, 1), (0, 9e5, 1, 9e5)], size=0.5)
    assert buckets.columns * buckets.rows <= MAX_BUCKETS
    assert cast_rays(buckets, [(4.5e5, -20.0)], [np.pi / 2], max_range=50.0)[0][0] == pytest.approx(20.5, abs=0.5)


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
def test_rays_to_movers_equal_the_twins(k: int, m: int) -> None:
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
