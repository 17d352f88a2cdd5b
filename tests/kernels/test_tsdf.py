"""Thinning scans and integrating them into signed-distance maps, against the twins."""

import numpy as np
import pytest
from tile_pools import CELL, COARSE_TRUNCATION, MIDDLE, OPTIONS, TRUNCATION, Pool, frames, room_scan, thinned
from twins import tsdf

from moteslam.kernels.scans import ThinnedScan, thin_scan
from moteslam.kernels.tiles import STEPS
from moteslam.kernels.tsdf import IntegrationOptions, integrate_scans

pytestmark = pytest.mark.usefixtures("taichi")

POSES = MIDDLE + np.array([(0.0, 0.0, 0.0), (0.13, -0.04, 0.3), (-0.2, 0.11, -2.9)])


def cluttered(seed: int, beams: int = 240) -> np.ndarray:
    """A room with round pillars: jumps, noise, and endpoints that crowd."""
    generator = np.random.default_rng(seed)
    points = room_scan(beams=beams).astype(np.float64)
    for begin in (20, 90, 150):
        points[begin : begin + 14] *= generator.uniform(0.3, 0.6)
    points *= 1 + generator.normal(0, 0.003, (beams, 1))
    return points.astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("spacing", [0.0, 0.02, 0.3])
def test_thinning_equals_the_twin(seed: int, spacing: float) -> None:
    points = cluttered(seed, (0, 1, 2, 240)[seed])
    origin = (0.1, -0.05)
    gaps = {"gap": 0.05, "gap_from_range": 0.01}
    ends_joined = tsdf.ends_joined(points, origin, **gaps)
    thinned_points, joined = tsdf.thin(points, ends_joined, spacing)
    found = thin_scan(points, origin, spacing=spacing, **gaps)
    assert found.joined.tolist() == joined
    np.testing.assert_array_equal(found.points, np.array(thinned_points, np.float32).reshape(-1, 2))
    if seed == 3:
        assert 0 < sum(joined) < len(joined)


def test_endpoints_that_are_just_the_spacing_apart_stay_two() -> None:
    """The nearest float32 below or above makes the difference, whatever way its square is rounded."""
    for length in np.random.default_rng(9).uniform(1e-4, 2.0, 300).astype(np.float32):
        ends, gap = np.array([(0, 0), (length, 0)], np.float32), {"gap": 3.0}
        assert len(thin_scan(ends, (0, 0), spacing=float(length), **gap).points) == 2
        assert len(thin_scan(ends, (0, 0), spacing=float(np.nextafter(length, np.float32(9))), **gap).points) == 1
    for length, left in ((0.0, 2), (1e-30, 2), (1e-18, 1)):
        assert len(thin_scan([(1, 1), (1, 1 if left == 1 else 1.5)], (0, 0), spacing=length, gap=3.0).points) == left
    assert len(thin_scan([(1, 1), (1, 1)], (0, 0), spacing=0.0, gap=3.0).points) == 2


@pytest.mark.parametrize(
    ("spacing", "max_points"), [(0.0, 150), (0.02, 150), (0.02, 60), (0.02, 1), (0.02, 240), (0.7, 10)]
)
def test_a_scan_of_many_points_is_thinned_as_with_the_first_spacing_that_leaves_few_enough(
    spacing: float, max_points: int
) -> None:
    points, max_spacing, within = cluttered(3, 240), 0.5, np.float32(spacing)
    gaps = {"gap": 0.05, "gap_from_range": 0.1}
    ends_joined = tsdf.ends_joined(points, (0, 0), **gaps)
    while True:
        thinned_points, joined = tsdf.thin(points, ends_joined, float(within))
        if len(thinned_points) <= max_points or within >= np.float32(max_spacing):
            break
        within = min(max(within * np.float32(1.2), np.float32(0.001)), np.float32(max_spacing))
    found = thin_scan(points, (0, 0), spacing=spacing, max_spacing=max_spacing, max_points=max_points, **gaps)
    assert found.joined.tolist() == joined
    np.testing.assert_array_equal(found.points, np.array(thinned_points, np.float32))
    assert len(found.points) <= max_points or max_points < 60


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize(
    ("near_weight", "max_weight", "coarse_chord"), [(1, 31, 0.5), (8, 31, 0.0), (8, 10, 0.5), (8, 31, 1.3)]
)
def test_integrated_cells_equal_the_twin_to_a_step(
    level: int, near_weight: int, max_weight: int, coarse_chord: float
) -> None:
    """Weights are equal, distances within one step of 1/1023 truncation.

    An average of both is ``(old w + d g) / (w + g)``. The distances d differ by float32's rounding of places below
    400 cells, some 1e-4 cells or 0.04 steps; old values that differ by a step count for at most 31/32 of one in the
    average, which so differs by less than a step, and rounding makes that one step or none. Where float32 may take
    another decision, within 1e-4 cells of a bound, cells are not compared.
    """
    pool, unit = Pool.empty(), CELL * (1 + level)
    truncation, near = (TRUNCATION, COARSE_TRUNCATION)[level] / unit, OPTIONS["near"] / unit
    twin = tsdf.Tsdf.empty(*pool.words(level=level).shape)
    for seed, pose in enumerate(POSES):
        scan = thinned(cluttered(seed))
        options = {"near_weight": near_weight, "max_weight": max_weight, "coarse_chord": coarse_chord}
        assert pool.add([pose], scan, **options) is not None
        in_cells = frames([pose])[0] * (1, 1, 1 / unit, 1 / unit)
        tsdf.integrate(
            twin, in_cells, scan.points / unit, scan.joined, truncation=truncation, near=near, near_weight=near_weight,
            max_weight=max_weight, chord=(0.0, coarse_chord)[level],
        )  # fmt: skip
    found = pool.tsdf(level=level)
    sure = ~twin.doubtful
    assert sure.mean() > 0.98
    np.testing.assert_array_equal(found.weights[sure], twin.weights[sure])
    apart = np.abs(found.steps - twin.steps)[sure]
    assert apart.max() <= 1
    assert (apart[twin.weights[sure] > 0] == 0).mean() > 0.95
    assert 0.02 < (twin.weights > 0).mean() < 0.9


def test_distances_are_positive_inside_the_room_and_exact() -> None:
    """A wall straight ahead: half a step of rounding, and what a chord of 2 cm strays from it, nothing."""
    pool = Pool.empty()
    pool.add([MIDDLE], thinned(room_scan(beams=1440)))
    row = round(MIDDLE[1] / CELL)
    cells = pool.tsdf()
    x = (np.arange(cells.steps.shape[1]) + 0.5) * CELL
    distance = MIDDLE[0] + 4.0 - x
    near = np.abs(distance) < TRUNCATION - 1e-3
    assert (cells.weights[row, near] > 0).all()
    np.testing.assert_allclose(cells.steps[row, near] * TRUNCATION / STEPS, distance[near], rtol=0, atol=1e-4)
    assert not cells.weights[row, np.abs(distance - 2) < 1].any()


def test_the_coarse_level_follows_a_run_of_short_segments_to_its_end() -> None:
    """The end lies between two chords, with the last point or before a gap."""
    corner = [(1.0, 0.02 * k) for k in range(26)] + [(1.0 - 0.02 * k, 0.5) for k in range(1, 26)]
    unit = 2 * CELL
    for last in (2, 26, 27, 33, 50):
        joined = np.ones(51, np.int32)
        joined[last:50] = 0
        pool = Pool.empty()
        pool.add([MIDDLE], ThinnedScan(np.array(corner, np.float32), joined))
        coarse = pool.tsdf(level=1)
        for k in range(last + 1):
            column, row = ((MIDDLE[:2] + corner[k]) / unit).astype(int)
            around = np.s_[row - 1 : row + 2, column - 1 : column + 2]
            assert coarse.weights[around].max() > 0, (last, k)
            nearest = abs(coarse.steps[around])[coarse.weights[around] > 0].min() * COARSE_TRUNCATION / STEPS
            assert nearest < unit * (0.5 + OPTIONS["coarse_chord"] / 2), (last, k)


@pytest.mark.parametrize("count", [0, 1])
def test_scans_of_nothing_and_of_one_endpoint_write_nothing(count: int) -> None:
    scan = thinned(np.ones((count, 2), np.float32))
    assert len(scan.points) == count
    pool = Pool.empty()
    assert pool.add([MIDDLE], scan) == len(pool.free)
    assert not pool.tables.any()


def test_many_scans_at_once_are_written_as_one_after_the_other() -> None:
    offsets = np.random.default_rng(8).uniform((-0.5, -0.5, -3.0), (0.5, 0.5, 3.0), (7, 3))
    scans = [thinned(room_scan(offset)) for offset in offsets]
    scans[3] = ThinnedScan(scans[3].points[:1], scans[3].joined[:1])
    one_by_one, at_once = (Pool.empty().resampled([0, 0], more_tiles=200) for _ in range(2))
    shifts = np.array([(0.0, 0.0, 0.0), (0.3, -0.2, 0.1)])
    for offset, scan in zip(offsets, scans, strict=True):
        one_by_one.add(MIDDLE + shifts + offset, scan)
    places = (MIDDLE + shifts[:, None] + offsets).reshape(-1, 3)
    options = IntegrationOptions(**OPTIONS)  # type: ignore[arg-type]
    assert integrate_scans(at_once.store(), frames(places), scans, options=options)
    np.testing.assert_array_equal(at_once.all_words(), one_by_one.all_words())
    assert (at_once.all_words()[0] != at_once.all_words()[1]).any()


def test_points_that_coincide_write_nothing_wrong() -> None:
    scan = ThinnedScan(np.array([(1, 0), (1, 0), (1, 1)], np.float32), np.array((1, 1, 0), np.int32))
    double, single = Pool.empty(), Pool.empty()
    double.add([MIDDLE], scan)
    single.add([MIDDLE], ThinnedScan(scan.points[1:], scan.joined[1:]))
    np.testing.assert_array_equal(double.all_words(), single.all_words())
