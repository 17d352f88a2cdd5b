"""Registering scans to signed-distance maps and searching for them there: against the twins, and in a room."""

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from tile_pools import (
    CELL,
    COARSE_TRUNCATION,
    MIDDLE,
    REGISTRATION,
    TRUNCATION,
    Pool,
    frames,
    mapped_room,
    moved,
    room_scan,
    thinned,
)
from twins import tsdf

from moteslam.kernels.correlative import MAX_SEARCH_POINTS, SquareScores, search_scans
from moteslam.kernels.gauss_newton import CONVERGED_SHIFT, CONVERGED_TURN
from moteslam.kernels.registration import (
    COST,
    CROSSED,
    FAR,
    FRAME,
    INFORMATION,
    KNOWN,
    LIKELIHOOD,
    OFFSET,
    PRIOR,
    QUERY,
    START,
    RegistrationOptions,
    register_scans,
)
from moteslam.kernels.tiles import CELLS, SIDE, STEPS, WEIGHT_BITS

pytestmark = pytest.mark.usefixtures("taichi")

SD, LOOSER = REGISTRATION["residual"], REGISTRATION["coarse_residual_factor"]
"""Of a residual, and how much larger it is on the coarse level."""
LOOSE = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)  # A prior that is negligible: a metre, a radian


@pytest.fixture(scope="module")
def room() -> Pool:
    """The map of one scan from the middle."""
    return mapped_room()


def register(
    pool: Pool, poses: ArrayLike, points: ArrayLike, *, starts: ArrayLike | None = None, prior: ArrayLike = LOOSE,
    origin: tuple[float, float] = (0.0, 0.0), coarse: bool = True, **changes: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    asked = queries(poses, np.zeros(3) if starts is None else starts, prior)
    options = RegistrationOptions(**{**REGISTRATION, **changes})  # type: ignore[arg-type]
    found = register_scans(pool.tiles, asked, points, origin, options=options, coarse=coarse)
    return found[:, OFFSET], found


def queries(poses: ArrayLike, starts: ArrayLike, prior: ArrayLike) -> NDArray[np.float64]:
    asked = np.empty((len(np.asarray(poses)), QUERY))
    asked[:, FRAME], asked[:, START], asked[:, PRIOR] = frames(poses), starts, prior
    return asked


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (0.4, -0.3, 1.1), (-1.2, 0.8, -2.6)])
def test_known_offsets_are_found_to_a_millimetre(room: Pool, at: tuple[float, float, float]) -> None:
    """From up to 12 cm and 0.06 rad away, all poses in one map."""
    truth = MIDDLE + np.array(at)
    points = thinned(room_scan(at)).points
    wrong = np.random.default_rng(5).uniform((-0.12, -0.12, -0.06), (0.12, 0.12, 0.06), (30, 3))
    poses = np.array([moved(truth, offset) for offset in wrong])
    offsets, fits = register(room, poses, points)
    found = np.array([moved(pose, offset) for pose, offset in zip(poses, offsets, strict=True)])
    assert np.hypot(*(found - truth)[:, :2].T).max() < 1e-3
    assert np.abs(found - truth)[:, 2].max() < 2e-4
    assert (fits[:, KNOWN] > 0.9 * len(points)).all()
    assert (fits[:, LIKELIHOOD] > 0.97 * fits[:, KNOWN]).all()
    assert (fits[:, CROSSED] == 0).all()


def away_from_seams(pose: NDArray[np.float64], points: NDArray[np.float32], cell: float = CELL) -> NDArray[np.float32]:
    """The points whose gradient is the same 0.01 cells around: off the lines through the cells' centres."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    cells = (points @ np.array([[c, s], [-s, c]]) + pose[:2]) / cell - 0.5
    return points[(np.abs(cells - np.rint(cells)) > 0.01).all(axis=1)]


def test_information_cost_and_likelihoods_equal_the_twins_finite_differences(room: Pool) -> None:
    """Relative to the trace, 2e-4: float32 residuals of up to 15 standard deviations are good to 1e-4 of one."""
    pose, start = MIDDLE + np.array((0.02, -0.03, 0.4)), np.array((0.015, 0.02, -0.03))
    points = thinned(room_scan((0.0, 0.0, 0.4))).points.copy()
    points[::7] *= 0.93  # known to the coarse level alone
    points[::11] *= 0.5  # known to none
    points = away_from_seams(moved(pose, start), points)
    cells, scale = room.tsdf(), TRUNCATION / SD
    information, _, residuals = tsdf.normal_equations(cells, pose, start, points, cell_size=CELL, scale=scale)
    assert 0.7 * len(points) < len(residuals) < len(points)
    _, (fit,) = register(room, [pose], points, starts=[start], iterations=0)
    np.testing.assert_allclose(
        fit[INFORMATION], information[np.triu_indices(3)], rtol=0, atol=2e-4 * np.trace(information)
    )
    near = tsdf.fit(residuals, len(residuals), unknown=0.0, outlier=8.0, likelihood_width=2.5)
    coarse = []  # over cells the fine level never saw the coarse one counts, in the same standard deviations
    for point in points:
        if tsdf.residual(cells, pose, start, point, cell_size=CELL, scale=scale) is None:
            r = tsdf.residual(room.tsdf(level=1), pose, start, point, cell_size=2 * CELL, scale=COARSE_TRUNCATION / SD)
            coarse += [r] if r is not None else []
    far = tsdf.fit(coarse, len(points) - len(residuals), unknown=2.0, outlier=8.0, likelihood_width=2.5)
    np.testing.assert_allclose(fit[COST : LIKELIHOOD + 1], np.add(near, far), rtol=2e-3)


def test_a_step_on_each_level_solves_the_twins_normal_equations(room: Pool) -> None:
    """The coarse level with ``LOOSER`` times the standard deviation; a prior that weighs as much as the map."""
    pose, start = MIDDLE + np.array((0.02, -0.03, 0.4)), np.array((0.015, 0.02, -0.03))
    prior = np.diag((1e6, 2e6, 4e6))
    noise = np.random.default_rng(2).uniform(0.99, 1.01, (360, 1)).astype(np.float32)  # walls must not lie on seams
    points = room_scan((0.0, 0.0, 0.4)) * noise
    levels = ((1, 2 * CELL, COARSE_TRUNCATION / (LOOSER * SD)), (0, CELL, TRUNCATION / SD))
    while True:  # fewer points lead to other places, where others of them are near a seam
        path, clear = [start], points
        for level, cell, scale in levels:
            clear = away_from_seams(moved(pose, path[-1]), clear, cell)
            cells = room.tsdf(level=level)
            information, pull, _ = tsdf.normal_equations(cells, pose, path[-1], points, cell_size=cell, scale=scale)
            path.append(path[-1] + np.linalg.solve(information + prior, pull - prior @ path[-1]))
        if len(clear) == len(points):
            break
        points = clear
    assert len(points) > 100
    priors = (*prior.diagonal(), 0.0, 0.0, 0.0)
    (offset,), _ = register(room, [pose], points, starts=[start], prior=priors, iterations=1)
    np.testing.assert_allclose(offset, path[-1], rtol=0, atol=1e-5)
    assert np.abs(np.diff(path, axis=0)).max(axis=1).min() > 1e-3
    (offset,), _ = register(room, [pose], points, starts=[path[1]], prior=priors, iterations=1, coarse=False)
    np.testing.assert_allclose(offset, path[-1], rtol=0, atol=1e-5)


@pytest.mark.parametrize("points", [np.empty((0, 2)), np.full((40, 2), 0.5), np.full((3, 2), 900.0)])
def test_the_prior_alone_decides_over_cells_never_seen(room: Pool, points: NDArray[np.float64]) -> None:
    """A scan of nothing, one in the empty middle, and one beyond the tables."""
    prior = (100.0, 25.0, 4.0, 0.3, -0.2, 0.1)
    (offset,), (fit,) = register(room, [MIDDLE], points, starts=[(0.05, 0.0, -0.05)], prior=prior)
    np.testing.assert_allclose(offset, prior[3:], rtol=0, atol=1e-6)
    assert (fit[INFORMATION] == 0).all()
    assert fit[COST] == 2.0 * len(points)
    assert fit[KNOWN] == fit[LIKELIHOOD] == 0
    assert fit[CROSSED] == 0


@pytest.mark.parametrize("origin", [(0.0, 0.0), (0.6, -0.4)])
def test_rays_through_walls_are_counted(room: Pool, origin: tuple[float, float]) -> None:
    pose, start = MIDDLE + np.array((0.3, -0.2, 0.5)), np.array((0.1, 0.0, -0.2))
    inside = room_scan((0.3, -0.2, 0.5))[::5]
    points = np.concatenate((inside, origin + (inside - origin) / 0.75))  # a ray is looked at there, among others
    expected = tsdf.crossed(
        room.tsdf(), moved(pose, start), origin, points, cell_size=CELL, truncation=TRUNCATION, clearance=1.8,
        weight=3, distance=0.4,
    )  # fmt: skip
    _, (fit,) = register(room, [pose], points, starts=[start], origin=origin, iterations=0)
    assert fit[CROSSED] == expected
    assert 5 < expected < len(inside)
    _, (fit,) = register(room, [pose], points, origin=origin)
    assert fit[CROSSED] > 0.8 * len(inside)
    assert register(room, [pose], inside, origin=origin)[1][0, CROSSED] == 0


def test_rays_along_a_wall_that_end_on_it_are_not_counted(room: Pool) -> None:
    along = np.stack((np.linspace(1.0, 3.5, 20), np.full(20, 0.1)), axis=1)  # from 10 cm before the wall
    for ends, expected in ((along, 0), (2 * along, 20)):
        _, (fit,) = register(room, [MIDDLE + np.array((0.0, 2.9, 0.0))], ends, iterations=0)
        assert fit[CROSSED] == expected


@pytest.mark.parametrize("far", [0.2, 0.25, 0.3])
def test_endpoints_off_the_walls_are_counted(room: Pool, far: float) -> None:
    """Of endpoints moved towards the robot those that the coarse level knows to be that far from the walls."""
    points = np.concatenate([thinned(room_scan()).points * share for share in (1.0, 0.95, 0.9, 0.85, 0.5)])
    pose = MIDDLE + np.array((0.013, 0.017, 0.0))  # at which no wall ends up between two cells
    _, (fit,) = register(room, [pose], points, iterations=0, far=far)
    coarse = room.tsdf(level=1)
    ix, iy = np.floor((pose[:2] + points) / (2 * CELL)).astype(int).T
    least = round(far / COARSE_TRUNCATION * STEPS)
    expected = np.count_nonzero((coarse.weights[iy, ix] > 0) & (np.abs(coarse.steps[iy, ix]) >= least))
    assert fit[FAR] == pytest.approx(expected, abs=2)  # of which some lie between two cells
    assert 0 < fit[FAR] < 0.5 * fit[KNOWN]


@pytest.mark.parametrize("theta", [0.0, 0.7])
@pytest.mark.parametrize("iterations", [8, 9])
def test_steps_to_and_fro_end_halfway(theta: float, iterations: int) -> None:
    """A distance of 1 + |x| cells has no root: Newton's steps from +1 lead to -1, and back."""
    pool = Pool.empty(rows=2, columns=3, tiles=7)
    pool.tables[0] = np.arange(6).reshape(2, 3) + 1
    kink, rise = 48, 100
    distances = np.minimum(rise * (1 + np.abs(np.arange(3 * SIDE) - kink)), STEPS)
    for tile in range(6):
        row = distances[tile % 3 * SIDE : (tile % 3 + 1) * SIDE]
        pool.pool.reshape(-1, CELLS)[tile + 1, : SIDE * SIDE] = np.tile(row << WEIGHT_BITS | 9, SIDE)
    pose = np.array((kink + 0.5 + 0.5, SIDE, 0.0)) * CELL + (0.0, 0.0, theta)
    across, along = np.array((np.cos(theta), -np.sin(theta))), np.array((np.sin(theta), np.cos(theta)))  # in its frame
    points = np.linspace(-0.8, 0.8, 9)[:, None] * along
    (offset,), _ = register(pool, [pose], points, iterations=iterations, coarse=False)
    np.testing.assert_allclose(offset, (*(-0.5 * CELL * across), 0.0), rtol=0, atol=1e-4)


def test_it_ends_within_the_bounds_of_where_it_would_go(room: Pool) -> None:
    """By the rate at which the steps get shorter, the last ones are not made; noise makes the rate worse."""
    generator = np.random.default_rng(6)
    points = room_scan((0.0, 0.0, 0.3)) + generator.normal(0, 0.03, (360, 2))
    wrong = generator.uniform((-0.1, -0.1, -0.02), (0.1, 0.1, 0.02), (300, 3))
    poses = MIDDLE + np.array((0.0, 0.0, 0.3)) + wrong
    first, _ = register(room, poses, points, iterations=100, coarse=False)
    offsets = first
    for _ in range(20):
        offsets, _ = register(room, poses, points, starts=offsets, iterations=1, coarse=False)
    left = np.abs(offsets - first)
    assert (left[:, 0] + left[:, 1]).max() < CONVERGED_SHIFT
    assert left[:, 2].max() < CONVERGED_TURN


def test_one_scan_alone_is_a_row_of_many(room: Pool) -> None:
    points, prior = thinned(room_scan((0.2, 0.1, 0.3))).points, (1e3, 2e3, 3e3, 0.01, 0.0, -0.01)
    options, start = RegistrationOptions(**REGISTRATION), (0.02, -0.01, 0.01)  # type: ignore[arg-type]
    asked = queries([moved(MIDDLE, (0.23, 0.08, 0.32))], start, prior)
    alone = register_scans(room.tiles, asked, points, (0.1, 0.0), options=options)
    many = register_scans(room.tiles, np.repeat(asked, 3, axis=0), points, (0.1, 0.0), options=options)
    np.testing.assert_array_equal(many, np.repeat(alone, 3, axis=0))


def search(
    pool: Pool, pose: ArrayLike, points: ArrayLike, turns: ArrayLike, shifts: NDArray[np.float64], *, blocks: int = 1,
    turn_costs: ArrayLike | None = None, shift_costs: ArrayLike | None = None, near: float = 0.5,
    drift: tuple[float, float] = (0.0, 0.0),
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:  # fmt: skip
    return search_scans(
        pool.tiles, frames([pose])[0], points, turns,
        np.zeros(len(np.asarray(turns))) if turn_costs is None else turn_costs, shifts,
        np.zeros(len(shifts)) if shift_costs is None else shift_costs, blocks=blocks, cell_size=CELL, near=near,
        drift=drift,
    )  # fmt: skip


def lattice(half: int, step: float) -> NDArray[np.float64]:
    ticks = np.arange(-half, half + 1) * step
    return np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 2)


def few(points: NDArray[np.float32], count: int = MAX_SEARCH_POINTS) -> NDArray[np.float32]:
    return points[np.linspace(0, len(points) - 1, count).astype(int)]


@pytest.mark.parametrize("at", [(0.1, -0.2), (-7.9, -7.1), (7.9, 7.1), (0.0, 7.1), (40.0, -3.0)])
def test_search_scores_equal_the_twin(at: tuple[float, float]) -> None:
    """Equal but for points within float32's rounding of a cell's edge: no more than one in all.

    In the middle of the tables, at their edges and beyond, where the edge's cells count.
    """
    generator = np.random.default_rng(3)
    pool = Pool.empty()
    pool.tables[:] = generator.integers(0, 200, pool.tables.shape)
    pool.pool[CELLS:] = generator.integers(-(1 << 15), 1 << 15, len(pool.pool) - CELLS)
    pose, points = MIDDLE + np.array((*at, 0.7)), few(room_scan((0.0, 0.0, 0.7)), 40)
    turns, shifts = np.array((-0.1, 0.0, 0.05)), lattice(3, 0.11)
    expected = tsdf.search(pool.tsdf(level=1), pose, points, turns, shifts, cell_size=2 * CELL, near=int(0.5 * STEPS))
    costs = 7.0 * np.arange(3), 3.0 * np.arange(len(shifts))
    scores, chosen = search(pool, pose, points, turns, shifts, turn_costs=costs[0], shift_costs=costs[1], blocks=7)
    expected = expected - costs[0][:, None] - costs[1]
    blocks = expected.reshape(3, 7, 7)
    best = blocks.argmax(axis=2) + 7 * np.arange(7)
    assert (scores != blocks.max(axis=2)).sum() <= 1
    assert (chosen != best).sum() <= 1
    assert len(np.unique(expected)) > 50


def test_each_place_of_a_square_scores_as_by_the_twin(room: Pool) -> None:
    """Half as much, but for the half step that each point's is rounded by."""
    points, turns, near, apart = few(room_scan((0.0, 0.0, 0.7)), 40), np.array((-0.1, 0.0, 0.7)), int(0.5 * STEPS), 2
    squares = MIDDLE[:2] + 0.0137 + lattice(2, 0.3071)
    scores = SquareScores.of(room.tiles, apart=apart, cell_size=2 * CELL, near=0.5)
    for place, (x, y) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        shifts = squares + apart * 2 * CELL * np.array((x, y))
        twin = tsdf.search(room.tsdf(level=1), (0, 0, 0), points, turns, shifts, cell_size=2 * CELL, near=near)
        free = np.tile(np.arange(4) == place, (len(squares), 1))
        alone, _ = scores.best_of(points, turns, squares, free, blocks=len(squares))
        off = np.abs(2 * alone - twin - len(points) * (near // 2)) > len(points)
        assert off.sum() <= 1  # a point within float32's rounding of a cell's edge
        best, chosen = scores.best_of(points, turns, squares, free, blocks=5)
        np.testing.assert_array_equal(best, alone.reshape(3, 5, 5).max(axis=2))
        np.testing.assert_array_equal(chosen, 4 * (alone.reshape(3, 5, 5).argmax(axis=2) + 5 * np.arange(5)) + place)
    assert len(np.unique(best)) > 10
    assert scores.best_of(points, turns, squares, np.zeros_like(free), blocks=5)[0].max() == -1


def test_shifts_drift_with_the_turn(room: Pool) -> None:
    """As if each turn were looked for among shifts of its own."""
    shifts, turns, drift = lattice(6, 0.1), np.array((-0.2, 0.1, 0.3)), (2.0, -1.5)
    pose, points = moved(MIDDLE, (0.5, -0.3, 0.2)), few(room_scan())
    scores, chosen = search(room, pose, points, turns, shifts, blocks=13, drift=drift)
    for k, turn in enumerate(turns):
        alone = search(room, pose, points, [turn], shifts + turn * np.array(drift), blocks=13)
        np.testing.assert_array_equal((scores[k], chosen[k]), np.array(alone)[:, 0])
    assert len(np.unique(scores)) > 10


def test_costs_decide_between_places_that_fit_alike(room: Pool) -> None:
    nothing = np.empty((0, 2), np.float32)
    shifts = lattice(2, 0.1)
    costs = 10.0 * np.abs(shifts - 0.1).sum(axis=1)
    scores, chosen = search(room, MIDDLE, nothing, (-0.1, 0.0), shifts, shift_costs=costs, turn_costs=(5, 1e30))
    np.testing.assert_allclose(shifts[chosen.ravel()], [(0.1, 0.1)] * 2)
    assert scores.tolist() == [[-5], [-100_000_000]]
