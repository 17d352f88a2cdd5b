"""Localisation in a known map: the field, the search of the whole map, open hypotheses, and whole runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refusal
from scipy.ndimage import binary_dilation
from slam_rooms import OTHER_ROOM, carried_into_another_room, circled_room, drawn, endpoints, recorded, seen_from

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli.running import about_frame
from moteslam.eval.page.player import playable
from moteslam.eval.results import write_results
from moteslam.eval.scores import number
from moteslam.kernels.correlative import MAX_SEARCH_POINTS
from moteslam.robot import se2
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN, write_map
from moteslam.robot.raster import Raster
from moteslam.robot.recording import OdometryStream, Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.config import resolve_config
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.filter.weights import Weights
from moteslam.slam.known_map import hypotheses, search
from moteslam.slam.known_map.config import KnownMapConfig
from moteslam.slam.known_map.filter import KnownMapFilter
from moteslam.slam.known_map.maps import KnownMaps, MapScale, MapTears, upright
from moteslam.slam.known_map.presence import Presence, not_in_map
from moteslam.slam.known_map.search import Hypotheses, Sight, WholeMapSearch
from moteslam.slam.online import run_slam
from moteslam.slam.tsdf.doubt import ScanFit
from moteslam.slam.tsdf.particles import Particles

CELL = 0.05
CONFIG = KnownMapConfig()
WALLS = [((-3, -1.5), (3, -1.5)), ((3, -1.5), (3, 2.5)), ((3, 2.5), (-3, 2.5)), ((-3, 2.5), (-3, -1.5))]
BOX = [((1.5, -0.8), (2.2, -0.8)), ((1.5, -0.8), (1.5, -0.2))]  # Of `circled_room`


def grown(occupancy: Raster, cells: int) -> Raster:
    """A map whose walls are so many times as thick."""
    values = np.where(
        binary_dilation(occupancy.values == OCCUPIED, np.ones((cells, cells))), OCCUPIED, occupancy.values
    )
    return Raster(values.astype(np.int8), occupancy.cell_size, occupancy.origin)


def sight(points: np.ndarray, silent: np.ndarray | None = None) -> Sight:
    return Sight(np.zeros(3), points, np.zeros(2), np.empty((0, 2), np.float32) if silent is None else silent)


def free_places(maps: KnownMaps) -> np.ndarray:
    """The places [n, 2] that are searched."""
    squares, free = maps.free_squares(search.STEP)
    square, place = np.nonzero(free)
    return squares[square] + search.STEP * np.stack((place % 2, place // 2), axis=1)


def localized(tmp_path: Path, recording: Recording, occupancy: Raster, *settings: str) -> Estimate:
    write_map(tmp_path / "map.pgm", occupancy)
    return run_slam(recording, resolve_config("localize", [f"known_map={tmp_path / 'map.yaml'}", *settings]))


def astray(estimate: Estimate, true: np.ndarray) -> np.ndarray:
    """How far the online poses are from the true ones [n] [m]."""
    return np.hypot(*se2.between(true, estimate.trajectory.poses)[:, :2].T)


def test_the_field_is_the_distance_to_the_middle_of_wall_cells() -> None:
    maps = KnownMaps(drawn(WALLS), CONFIG.tsdf)
    x = np.array((-2.0, -2.975, -2.9, -3.4))
    distance, known = maps.surface.at(x, np.full(4, CELL / 2))
    np.testing.assert_allclose(np.abs(distance), np.abs(x + 2.975), atol=1e-9)
    assert known.tolist() == [True, True, True, False]
    places = free_places(maps)
    assert (np.abs(places[:, 0]) < 2.9).all()
    assert len(places) == pytest.approx(6 * 4 / 0.2**2, rel=0.1)


def test_what_lies_inside_of_a_solid_is_no_surface() -> None:
    occupancy = drawn(WALLS)
    values = occupancy.values.copy()
    values[60:80, 60:80] = OCCUPIED
    surface = KnownMaps(Raster(values, CELL, occupancy.origin), CONFIG.tsdf).surface
    middle = np.array(occupancy.origin[:2]) + 70.5 * CELL
    distance, known = surface.at(*(middle[:, None]))
    assert (abs(distance[0]) > 0.4, known[0]) == (True, False)


@pytest.mark.parametrize("yaw", np.radians((90.0, -125.0)))
def test_a_turned_map_is_read_upright_cell_by_cell_from_corner_to_corner(yaw: float) -> None:
    values = np.random.default_rng(0).choice(np.array((FREE, OCCUPIED, UNKNOWN), np.int8), (12, 30))
    turned, size = Raster(values, CELL, (1.03, -2.02, yaw)), np.array((30, 12)) * CELL
    back = upright(turned)
    y, x = np.indices(back.shape) * CELL + CELL / 2
    centres = np.stack((x, y), axis=-1) + back.origin[:2]
    at = se2.transform_points(se2.inverse(np.array(turned.origin)), centres.reshape(-1, 2)).reshape(centres.shape)
    inside = ((at > 0) & (at < size)).all(axis=-1)
    column, row = np.floor(np.where(inside[..., None], at, 0.0) / CELL).astype(int).transpose(2, 0, 1)
    np.testing.assert_array_equal(back.values, np.where(inside, values[row, column], UNKNOWN))
    assert inside.sum() == pytest.approx(values.size, rel=0.02)  # nothing is cut off
    assert back.origin[2] == 0


@pytest.mark.parametrize("yaw", [np.pi / 2, np.pi, -1.5707963])
def test_a_map_turned_by_quarters_has_each_cell_where_it_was(yaw: float) -> None:
    values = np.random.default_rng(0).choice(np.array((FREE, OCCUPIED, UNKNOWN), np.int8), (12, 30))
    turned = Raster(values, CELL, (1.5 * CELL, -2.02, yaw))
    cells = np.indices(values.shape).reshape(2, -1).T
    back = upright(turned)
    assert sorted(back.shape) == [12, 30]
    np.testing.assert_array_equal(back.values_at(turned.centres(cells), outside=UNKNOWN), values.ravel())


@pytest.mark.parametrize("value", [FREE, OCCUPIED])
def test_a_map_without_walls_or_without_room_is_refused(value: int) -> None:
    with pytest.raises(InputError, match="cell"):
        KnownMaps(Raster(np.full((40, 40), value, np.int8), CELL), CONFIG.tsdf).free_squares(0.2)


@pytest.mark.parametrize("pose", [(-1.7, 1.1, 2.5), (2.2, 1.7, -1.9)])
def test_one_scan_is_found_in_the_whole_map(pose: tuple[float, float, float]) -> None:
    maps = KnownMaps(drawn([*WALLS, *BOX]), CONFIG.tsdf)
    true = np.array(pose)
    found = WholeMapSearch(maps, CONFIG.registration).find(sight(endpoints(true, [*WALLS, *BOX])))
    off = se2.between(true, found.poses[0])
    assert np.hypot(*off[:2]) < CELL
    assert abs(off[2]) < 0.01
    assert found.probabilities[0] > 0.99


def test_the_search_finds_what_an_exhaustive_one_finds() -> None:
    """The first start scores as much as the best place by NumPy, over all places and turns."""
    maps = KnownMaps(drawn([*WALLS, *BOX]), CONFIG.tsdf)
    looked_for = WholeMapSearch(maps, CONFIG.registration)
    points = endpoints(np.array((-1.7, 1.1, 2.5)), [*WALLS, *BOX])[::3][:MAX_SEARCH_POINTS]
    size, reach = 2 * CONFIG.tsdf.cell_size, CONFIG.tsdf.coarse_truncation

    def scores(turn: float, places: np.ndarray) -> np.ndarray:
        c, s = np.cos(turn), np.sin(turn)
        ends = places[:, None] + points @ np.array([[c, s], [-s, c]])
        x, y = ((np.floor(ends[..., k] / size) + 0.5) * size for k in (0, 1))  # the middles of the coarse cells
        distance, known = maps.surface.at(x.ravel(), y.ravel())
        score = np.maximum(search.NEAR - np.minimum(np.abs(distance), reach), -search.NEAR / 2)
        return np.where(known | (np.abs(distance) < reach), score, 0).reshape(x.shape).sum(axis=1)

    best = max(scores(turn, free_places(maps)).max() for turn in looked_for._turns)
    found = looked_for._starts(points)[0]
    assert scores(found[2], found[None, :2])[0] == pytest.approx(best, rel=0.01)  # in whole steps, a cell to and fro


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strain", "short", "words"),
    [
        ((0.0, 0.0, 0.0), 0.03, ()),  # walls are drawn thick
        ((0.0, 0.0, 0.006), 0.0, ()),  # as much as sound maps are bent
        ((0.0, 0.0, 0.0), -0.12, ("12 +-", "nearer on all sides")),
        ((0.016, 0.016, 0.0), 0.0, ("% larger",)),
        ((-0.03, -0.03, 0.0), 0.03, ("% smaller",)),
        ((0.05, 0.0, 0.0), 0.0, ("longer along x", "stretched")),
        ((0.0, 0.0, 0.03), 0.0, ("along 45", "skewed")),
        ((0.0, 0.0, -0.03), 0.0, ("along -45", "skewed")),
    ],
)
def test_a_map_that_the_lidar_finds_strained_is_told(
    strain: tuple[float, float, float], short: float, words: tuple[str, ...]
) -> None:
    (xx, yy, xy), rng = strain, np.random.default_rng(0)
    matrix = np.array(((1 + xx, xy), (xy, 1 + yy)))
    walls = [*OTHER_ROOM, ((0.4, -0.8), (1.1, -0.8)), ((0.4, -0.8), (0.4, -0.2))]
    mapped = [(tuple(matrix @ a), tuple(matrix @ b)) for a, b in walls]
    scale = MapScale(KnownMaps(drawn(mapped, low=(-5, -6), high=(5, 7), cell=0.02), CONFIG.tsdf))
    for turn in np.linspace(0, 2 * np.pi, 41):
        pose = np.array((-0.6 + 1.5 * np.sin(turn), -1.4 + 2.4 * np.cos(turn), 3 * turn))
        points = endpoints(pose, walls) * (1 - short / np.hypot(*endpoints(pose, walls).T))[:, None]
        points[:10] *= 0.5  # people
        pose[:2] = matrix @ pose[:2]
        scale.add(pose + rng.normal(0, 0.02, 3), points, np.zeros(2), 0.5, known=True)
    issue = scale.issue()
    assert [word for word in words if issue is None or word not in issue.message] == []
    assert words or issue is None


@pytest.mark.parametrize("before", [0.4, 0.8])
def test_a_plan_that_lacks_shelves_along_its_walls_is_not_told_to_be_of_another_scale(before: float) -> None:
    shelves = [((3 - before, -1.0), (3 - before, 3.3)), ((1.5 - before, -4.8), (1.5 - before, -1.4))]
    scale = MapScale(KnownMaps(drawn(OTHER_ROOM, low=(-5, -6), high=(5, 7)), CONFIG.tsdf))
    for turn in np.linspace(0, 2 * np.pi, 41):
        pose = np.array((-0.6 + 1.2 * np.sin(turn), -1.4 + 2.4 * np.cos(turn), 3 * turn))
        scale.add(pose, endpoints(pose, [*OTHER_ROOM, *shelves]), np.zeros(2), 0.5, known=True)
    assert scale.issue() is None


def test_scans_of_a_long_drive_are_thinned_and_those_of_a_doubtful_one_left_out() -> None:
    scale = MapScale(KnownMaps(drawn(WALLS), CONFIG.tsdf))
    for step in range(4000):
        known = step >= 1000
        scale.add(np.array((step, 0.0, 0.0)), np.ones((300, 2)), np.zeros(2), 0.1, known=known)
    places = np.array([pose[0] for pose, _, _ in scale._scans])
    assert (len(places) < 256, places[0] >= 1000, places[-1] > 3900) == (True, True, True)
    assert len(scale._scans[0][1]) <= 128


@pytest.mark.parametrize(
    ("aside", "lost", "told"), [(0.4, False, True), (0.4, True, False), (0.1, False, False)], ids=str
)
def test_a_path_that_steps_aside_from_its_odometry_is_told(aside: float, *, lost: bool, told: bool) -> None:
    tears, rng = MapTears(), np.random.default_rng(0)
    for step in range(300):
        pose = np.array((0.1 * step, aside * (step >= 150), 0.0)) + rng.normal(0, 0.01, 3)
        tears.add(float(step), pose, np.array((0.1, 0.0, 0.0)), known=not (lost and 140 < step < 160))
    assert (tears.issue() is not None) == told


def test_a_map_that_is_torn_is_told(tmp_path: Path) -> None:
    """Seen from the robot its odometry steps aside."""
    recording, _ = circled_room(scans=240, drift=0.0)
    poses = recording.lidar.odometry.copy()
    poses[:, 0] += np.clip(np.arange(240) - 150, 0, 10) * 0.04
    torn = recording.replace(lidar=replace(recording.lidar, odometry=poses))
    for each, told in ((recording, False), (torn, True)):
        estimate = localized(tmp_path, each, drawn([*WALLS, *BOX]), "start=[0.0, 0.0, 0.0, 0.1]")
        assert any("torn" in issue.message for issue in estimate.warnings) == told


def test_both_places_of_a_symmetric_room_are_listed() -> None:
    walls = [((-3, -2), (3, -2)), ((3, -2), (3, 2)), ((3, 2), (-3, 2)), ((-3, 2), (-3, -2))]
    maps = KnownMaps(drawn(walls, low=(-3.5, -2.5), high=(3.5, 2.5)), CONFIG.tsdf)
    true = np.array((1.2, 0.7, 0.3))
    found = WholeMapSearch(maps, CONFIG.registration).find(sight(endpoints(true, walls)))
    mirrored = np.array((-1.2, -0.7, 0.3 - np.pi))
    for place in (true, mirrored):
        off = se2.between(place, found.poses[:2])
        assert np.abs(off).min(axis=0).max() < 0.1
    assert found.probabilities[:2].min() > 0.1
    assert found.probabilities[:2].sum() == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("bare", [False, True])
def test_who_sees_bare_walls_is_found_by_what_was_seen_before(*, bare: bool) -> None:
    """A lidar of 3.5 m in a hall of 40 m, 6 m after a niche, if there is one."""
    hall = [((-20, -1.5), (20, -1.5)), ((20, -1.5), (20, 1.5)), ((20, 1.5), (-20, 1.5)), ((-20, 1.5), (-20, -1.5))]
    niche = [] if bare else [((0.5, 0.9), (1.5, 0.9)), ((0.5, 0.9), (0.5, 1.5)), ((1.5, 0.9), (1.5, 1.5))]
    occupancy = drawn([*hall, *niche], low=(-20.5, -2), high=(20.5, 2))
    looked_for = WholeMapSearch(KnownMaps(occupancy, CONFIG.tsdf), CONFIG.registration)
    start = np.array((-1.0, 0.1, 0.0))
    for driven in np.arange(0.0, 9.0, 0.5):
        pose = np.array((driven, 0.0, 0.0))
        ends = endpoints(se2.compose(start, pose), [*hall, *niche])
        latest = Sight(pose, ends[np.hypot(*ends.T) < 3.5], np.zeros(2))
        looked_for.see(latest)
    found = looked_for.find(latest)
    assert found.all_found != bare
    assert (np.abs(se2.between(se2.compose(start, pose), found.poses[0])).max() < search.STEP) != bare


def test_another_room_is_not_in_this_map() -> None:
    maps = KnownMaps(drawn([*WALLS, *BOX]), CONFIG.tsdf)
    other = [((-9, -1), (9, -1)), ((9, -1), (9, 6)), ((9, 6), (-9, 6)), ((-9, 6), (-9, -1))]
    points = endpoints(np.array((0.0, 2.0, 0.3)), other)
    found = WholeMapSearch(maps, CONFIG.registration).find(sight(points))
    assert found.probabilities.sum() < 0.01


def test_rays_that_nothing_answered_do_not_end_at_a_wall() -> None:
    """A lidar of 3 m sees the two bare walls of a corridor that is shut in the middle, and nothing ahead."""
    corridor = [((-9, -1), (9, -1)), ((9, -1), (9, 1)), ((9, 1), (-9, 1)), ((-9, 1), (-9, -1))]
    occupancy = drawn([*corridor, ((0, -1), (0, 1))], low=(-9.5, -1.5), high=(9.5, 1.5))
    looked_for = WholeMapSearch(KnownMaps(occupancy, CONFIG.tsdf), CONFIG.registration)
    ends = endpoints(np.zeros(3), corridor)
    near = np.hypot(*ends.T) < 3
    silent = np.repeat(3 * ends[~near] / np.hypot(*ends[~near].T)[:, None], 8, axis=0)
    silent = search.silent_rays(silent, np.zeros(2), 1.0)
    shares = []
    for rays in (None, silent):
        found = looked_for.find(sight(ends[near], rays))
        before = -found.poses[:, 0] * np.cos(found.poses[:, 2])  # the wall in the middle [m]
        shares.append(found.probabilities[(before > 0.4) & (before < 2.5)].sum() / found.probabilities.sum())
    assert shares[0] > 0.05
    assert shares[1] < 0.3 * shares[0]
    poses, origin = np.array([(-4.0, 0.0, 0.0), (-2.0, 0.0, 0.0)]), np.zeros(2)
    counts = search.passed(looked_for._maps, poses, silent, origin, CONFIG.registration)
    assert counts[0] == 0
    assert counts[1] > 0.1 * len(silent)


def test_silent_rays_are_as_many_as_of_the_endpoints_are_left_and_end_where_surfaces_surely_answer() -> None:
    ends = np.array([(0.1, 30.0), (2.1, 0.0), (0.1, -30.0), (-29.9, 0.0)], np.float32)
    rays = search.silent_rays(ends, np.array((0.1, 0.0)), 0.5) - (0.1, 0.0)
    np.testing.assert_allclose(np.abs(rays).argmax(axis=1), (1, 0))
    assert ((np.abs(rays).max(axis=1) <= search.REACH) & (np.abs(rays).max(axis=1) >= 0.6 * search.REACH)).all()


def some_particles(numbers: list[int], log: list[float]) -> Particles:
    particles = Particles(len(numbers), CONFIG.tsdf)
    particles.history.append(particles.poses)
    particles.maps.resample(np.zeros(len(numbers), np.int64))
    particles.hypotheses = np.array(numbers)
    particles.weights = Weights(np.log(np.exp(log) / np.exp(log).sum()))
    return particles


def test_evidence_within_hypotheses_leaves_their_own_weights() -> None:
    particles = some_particles([0, 0, 1, 1], [0.0, 1.0, -1.0, 0.5])
    _, before = hypotheses.shares(particles)
    particles.weights = particles.weights.times_log(hypotheses.within(particles, np.array((3.0, 0.0, -7.0, 2.0))))
    np.testing.assert_allclose(hypotheses.shares(particles)[1], before)
    assert particles.weights.values[0] > particles.weights.values[1]


def test_every_likely_hypothesis_survives_resampling_with_its_weight() -> None:
    particles = some_particles([0] * 10 + [1] * 10 + [2], [0.0] * 10 + [-1.0] * 10 + [-9.0])
    _, before = hypotheses.shares(particles)
    parents = hypotheses.resample(particles, 40)
    numbers, after = hypotheses.shares(particles)
    assert numbers.tolist() == [0, 1]  # the third has less than a thousandth
    np.testing.assert_allclose(after, before[:2] / before[:2].sum())
    assert len(parents) == len(particles.weights.values) <= 40


def test_the_best_hypothesis_changes_only_for_one_of_twice_its_weight() -> None:
    for log, best in ((0.5, 0), (1.0, 1)):
        particles = some_particles([0, 1], [0.0, log])
        assert hypotheses.best_of(particles, 0) == best


def test_a_place_that_the_scans_contradict_is_given_up() -> None:
    fits, contradicts = ScanFit(1.0, 200, 200, 0, 0), ScanFit(0.2, 200, 200, 80, 30)
    beyond = ScanFit(1.0, 200, 20, 0, 0)  # in a part that the map does not show
    presence = Presence()
    for _ in range(30):
        presence.observe(0.1, fits)
    assert (presence.proved, presence.probability < 0.01) == (True, True)
    for _ in range(30):
        presence.observe(0.1, beyond)
    assert presence._here == pytest.approx(7.0)
    for _ in range(30):
        presence.observe(0.1, contradicts)
    assert presence.probability > 0.5
    through_walls = Presence()
    through_walls.passed = 150.0
    for _ in range(30):
        through_walls.observe(0.1, fits)
    assert through_walls.probability > 0.5


def test_who_was_there_for_long_is_not_elsewhere_because_people_stand_around() -> None:
    fits, crowd = ScanFit(1.0, 200, 200, 0, 0), ScanFit(1.0, 200, 200, 45, 15)
    for metres, stays in ((5, False), (40, True)):
        presence = Presence()
        for _ in range(10 * metres):
            presence.observe(0.1, fits)
        for _ in range(35):
            presence.observe(0.1, crowd)
        assert (presence.probability < 0.01) == stays
    for _ in range(60):
        presence.observe(0.1, crowd)
    assert presence.probability > 0.5


def test_what_stands_before_the_walls_of_a_plan_is_furniture_unless_rays_go_through_them() -> None:
    furnished, elsewhere = ScanFit(0.7, 200, 200, 70, 2), ScanFit(0.7, 200, 200, 50, 20)
    for scan, stays in ((furnished, True), (elsewhere, False)):
        presence = Presence()
        for _ in range(60):
            presence.observe(0.1, scan)
        assert (presence.probability < 0.01, presence.proved) == (stays, stays)


def test_a_robot_is_found_and_tracked_in_a_known_map(tmp_path: Path) -> None:
    recording, true = circled_room(scans=60)
    estimate = localized(tmp_path, recording, drawn([*WALLS, *BOX]))
    assert astray(estimate, true).max() < CELL
    assert (estimate.diagnostics["state"][30:] == LocalisationState.SURE).all()
    np.testing.assert_array_equal(estimate.map.values > 0, drawn([*WALLS, *BOX]).values == OCCUPIED)


def test_a_robot_that_is_searched_for_is_tracked_in_what_it_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nowhere = Hypotheses(np.zeros((1, 3)), np.zeros(1), False, 0.0, KnownMaps(drawn(WALLS), CONFIG.tsdf))
    monkeypatch.setattr(WholeMapSearch, "find", lambda *_: nowhere)
    recording, true = circled_room(scans=60, drift=0.5)
    estimate = localized(tmp_path, recording, drawn([*WALLS, *BOX]))
    assert np.abs(se2.between(true, estimate.trajectory.poses)).max() < CELL
    assert (estimate.diagnostics["state"] == LocalisationState.LOST).all()


def test_who_has_hardly_driven_is_not_said_to_be_elsewhere(tmp_path: Path) -> None:
    estimate = localized(tmp_path, circled_room(scans=8)[0], drawn([*WALLS, *BOX]))
    said = [issue.message for issue in estimate.warnings if issue.code != "no-mount"]
    assert len(said) == 1
    assert "has driven 0.6 m since, too little to prove" in said[0]


def test_a_known_start_needs_no_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(WholeMapSearch, "find", None)
    recording, true = circled_room(scans=30)
    estimate = localized(tmp_path, recording, drawn([*WALLS, *BOX]), "start=[0.1, -0.1, 0.05, 0.2]")
    assert astray(estimate, true)[5:].max() < CELL


def test_a_start_that_is_far_off_is_told(tmp_path: Path) -> None:
    recording, true = circled_room()
    walls = [((x + 20, y), (u + 20, v)) for (x, y), (u, v) in OTHER_ROOM]
    both = drawn([*WALLS, *BOX, *walls], low=(-5, -6), high=(25, 7))
    estimate = localized(tmp_path, recording, both, "start=[20.0, 0.0, 0.0, 0.5]")
    assert astray(estimate, true)[-5:].max() < CELL
    assert any("the start that was given is wrong" in issue.message for issue in estimate.warnings)


@pytest.mark.parametrize(("start", "told"), [("0.5, 0.5, 0, 0.05", 1), ("0, 0, 1.2, 0.3", 1), ("0.3, 0, 0.2, 0.1", 0)])
def test_a_robot_that_is_found_off_its_start_without_a_search_is_told(tmp_path: Path, start: str, told: int) -> None:
    estimate = localized(tmp_path, circled_room()[0], drawn([*WALLS, *BOX]), f"start=[{start}]")
    said = [issue for issue in estimate.warnings if "from the start that was given" in issue.message]
    assert [issue.code for issue in said] == ["searched-for"] * told


@pytest.mark.parametrize("larger", [1.0, 0.97])
def test_a_map_whose_resolution_is_off_is_told(tmp_path: Path, larger: float) -> None:
    recording, _ = circled_room()
    occupancy = drawn([*WALLS, *BOX], cell=0.02)
    x, y, _ = occupancy.origin
    stated = Raster(occupancy.values, 0.02 * larger, (x * larger, y * larger, 0.0))
    estimate = localized(tmp_path, recording, stated, "start=[0.0, 0.0, 0.0, 0.1]")
    assert ("map-scale" in {issue.code for issue in estimate.warnings}) == (larger != 1)


@pytest.mark.parametrize("start", [(), ("start=[0.1, -0.1, 0.05, 0.2]",)])
def test_walls_that_are_drawn_too_thick_are_told_and_taken_thinner(tmp_path: Path, start: tuple[str, ...]) -> None:
    recording, true = circled_room()
    estimate = localized(tmp_path, recording, grown(drawn([*WALLS, *BOX]), 7), *start)
    assert astray(estimate, true)[1:].max() < CELL
    told = [issue.message for issue in estimate.warnings if issue.code == "map-scale"]
    assert [text[:41] for text in told] == ["walls of the map are drawn 30 cm too thic"]


def test_solid_walls_of_a_plan_are_taken_as_drawn(tmp_path: Path) -> None:
    recording, true = circled_room()
    plan = grown(drawn([*WALLS, *BOX]), 7)
    plan.values[drawn([*WALLS, *BOX]).values == FREE] = FREE
    estimate = localized(tmp_path, recording, plan)
    assert astray(estimate, true).max() < CELL
    assert "map-scale" not in {issue.code for issue in estimate.warnings}


def test_a_robot_elsewhere_is_lost_to_the_end_and_told(tmp_path: Path) -> None:
    recording, _ = circled_room(scans=60)
    walls = [((-9, -1), (9, -1)), ((9, -1), (9, 6)), ((9, 6), (-9, 6)), ((-9, 6), (-9, -1))]
    estimate = localized(tmp_path, recording, drawn(walls, low=(-10, -2), high=(10, 7)))
    assert (estimate.diagnostics["state"] == LocalisationState.LOST).all()
    assert "not-in-this-map" in {issue.code for issue in estimate.warnings}
    deviations = np.sqrt(estimate.covariances[-1].diagonal())
    assert (deviations > (3.0, 3.0, 1.5)).all()  # it is anywhere in the map


@pytest.mark.parametrize("cells", [0, 1])
def test_a_map_with_unknown_cells_before_its_walls_is_told_where_nothing_fits(tmp_path: Path, cells: int) -> None:
    drawn_map = drawn([*WALLS, *BOX])
    seam = binary_dilation(drawn_map.values == OCCUPIED, np.ones((2 * cells + 1,) * 2)) & (drawn_map.values == FREE)
    blurred = Raster(np.where(seam, UNKNOWN, drawn_map.values).astype(np.int8), CELL, drawn_map.origin)
    poses = circled_room(drift=0.0)[1]
    elsewhere = recorded(seen_from(poses, OTHER_ROOM), poses)
    (issue,) = (one for one in localized(tmp_path, elsewhere, blurred).warnings if one.code == "not-in-this-map")
    assert ("blurred" in issue.message) == bool(cells)


def test_online_poses_of_a_robot_that_is_lost_are_not_scored(tmp_path: Path) -> None:
    recording, true = circled_room(scans=30)
    found, truth = localized(tmp_path, recording, drawn([*WALLS, *BOX])), Trajectory(recording.lidar.stamps, true)
    poses, state = found.trajectory.poses.copy(), found.diagnostics["state"].copy()
    poses[:10] += 5.0
    state[:10] = LocalisationState.LOST
    lost = replace(found, trajectory=Trajectory(truth.stamps, poses), diagnostics={**found.diagnostics, "state": state})
    figures = write_results(tmp_path / "out", lost, truth)
    assert number(figures, "online.ate") < CELL
    assert figures["localisation"]["compared"]["scans"] <= 20
    errors = np.cumsum(playable(tmp_path / "out")["errors"]["online"])
    assert (errors[:10] < 0).all()  # none
    assert ((errors[10:] >= 0) & (errors[10:] < 1e4 * CELL)).all()
    state[:] = LocalisationState.LOST
    figures = write_results(tmp_path / "out", lost, truth)
    assert number(figures, "online.ate") is number(figures, "final.ate") is None
    assert "errors" not in playable(tmp_path / "out")


def test_a_truth_in_another_frame_than_the_map_is_told(tmp_path: Path) -> None:
    way = np.column_stack((np.arange(20.0), np.sin(np.arange(20.0)), np.zeros(20)))
    truth, path = (Trajectory(np.arange(20.0), poses) for poses in (way, way + np.array((3.0, 0.0, 0.0))))
    known_map = tmp_path / "map.yaml"
    assert not [*about_frame(truth, truth, known_map)]
    (issue,) = about_frame(path, truth, known_map)
    assert "by 3.0 m and 0 degrees: it was found at a wrong place, or" in issue.message
    (tmp_path / "run.json").touch()  # the map that SLAM drew of a run
    (issue,) = about_frame(path, truth, known_map)
    assert "by 3.0 m and 0 degrees: the map of a result has a frame of its own" in issue.message


def test_a_robot_that_is_carried_out_of_the_map_is_lost(tmp_path: Path) -> None:
    estimate = localized(tmp_path, carried_into_another_room(), drawn([*WALLS, *BOX]))
    states = estimate.diagnostics["state"]
    assert (states[30:60] == LocalisationState.SURE).all()
    assert (states[90:] == LocalisationState.LOST).mean() > 0.9


def test_how_far_off_a_robot_is_found_again_is_told(tmp_path: Path) -> None:
    beside = [((x + 20, y), (u + 20, v)) for (x, y), (u, v) in OTHER_ROOM]
    both = drawn([*WALLS, *BOX, *beside], low=(-5, -6), high=(25, 7))
    estimate = localized(tmp_path, carried_into_another_room(), both)
    searched = [issue.message for issue in estimate.warnings if issue.code == "searched-for"]
    assert len(searched) == 1  # not that it was found at the first scan
    assert "found 20.0 m from where the path until then led" in searched[0]
    assert "start" not in searched[0]


def paused(recording: Recording, *, at: int, seconds: float) -> Recording:
    """A recording without scans for a while, in which the odometry says that the robot stood."""
    lidar = recording.lidar
    stamps = lidar.stamps + np.where(np.arange(len(lidar)) < at, 0.0, seconds)
    still = np.arange(stamps[at - 1] + 0.1, stamps[at], 0.1)
    order = np.argsort(every := np.r_[stamps, still])
    path = np.vstack((lidar.odometry, np.repeat(lidar.odometry[at - 1 : at], len(still), axis=0)))
    wheels = OdometryStream(every[order], path[order])
    return recording.replace(lidar=replace(lidar, stamps=stamps, odometry=None), odometry=wheels)


@pytest.mark.parametrize("seconds", [2.0, 20.0])
def test_who_may_have_been_carried_to_a_place_that_looks_alike_is_not_sure(tmp_path: Path, seconds: float) -> None:
    twin = [((x + 20, y), (u + 20, v)) for (x, y), (u, v) in [*WALLS, *BOX]]
    both = drawn([*WALLS, *BOX], twin, low=(-3.5, -2), high=(23.5, 3))
    recording = paused(circled_room(drift=0.0)[0], at=60, seconds=seconds)
    estimate = localized(tmp_path, recording, both, "start=[0, 0, 0, 0.1]")
    may_be_carried = seconds > 3
    states = estimate.diagnostics["state"]
    assert (states[30:60] == LocalisationState.SURE).all()
    assert (states[60:] == (LocalisationState.DOUBTFUL if may_be_carried else LocalisationState.SURE)).all()
    assert any("may have been carried" in issue.message for issue in estimate.warnings) == may_be_carried


def test_who_stood_where_nothing_looks_alike_is_sure_at_once(tmp_path: Path) -> None:
    estimate = localized(tmp_path, paused(circled_room(drift=0.0)[0], at=60, seconds=20.0), drawn([*WALLS, *BOX]))
    assert (estimate.diagnostics["state"][60:] == LocalisationState.SURE).all()


def test_who_was_carried_into_another_room_of_the_map_is_found_there_at_once(tmp_path: Path) -> None:
    beside = [((x + 20, y), (u + 20, v)) for (x, y), (u, v) in OTHER_ROOM]
    both = drawn([*WALLS, *BOX, *beside], low=(-5, -6), high=(25, 7))
    recording = paused(carried_into_another_room(), at=60, seconds=20.0)
    true = circled_room(drift=0.0)[1] + np.outer(np.arange(120) >= 60, (20, 0, 0))
    estimate = localized(tmp_path, recording, both)
    assert astray(estimate, true)[70:].max() < CELL
    final = estimate.trajectory_final.at(recording.lidar.stamps)
    off = np.hypot(*(final.poses - true)[:, :2].T)
    assert np.r_[off[:60], off[70:]].max() < CELL  # in between the path leads there


def test_after_places_that_were_given_up_a_longer_drive_must_prove_the_next() -> None:
    for given_up, metres in ((0, 1.0), (1, 2.0), (3, 4.0)):
        presence, driven = Presence(given_up), 0.0
        while not presence.proved:
            presence.observe(0.1, ScanFit(1.0, 200, 200, 0, 0))
            driven += 0.1
        assert driven == pytest.approx(metres, abs=0.11)


@pytest.mark.parametrize("shift", [0.0, 0.01])
def test_tracking_resolves_a_wall_between_the_cells_of_its_field(tmp_path: Path, shift: float) -> None:
    """A map in cells of 1 cm, and its walls anywhere between the cells of the field."""
    recording, true = circled_room(scans=30)
    occupancy = drawn([*WALLS, *BOX], cell=0.01)
    moved = Raster(occupancy.values, 0.01, (occupancy.origin[0] + shift, occupancy.origin[1] + shift, 0.0))
    estimate = localized(tmp_path, recording, moved, f"start=[{shift}, {shift}, 0.0]")
    errors = estimate.trajectory.poses[5:, :2] - true[5:, :2] - shift
    assert np.abs(errors.mean(axis=0)).max() < 0.015


def test_places_that_were_given_up_one_after_the_other_are_told(tmp_path: Path) -> None:
    write_map(tmp_path / "map.pgm", drawn([*WALLS, *BOX]))
    made = KnownMapFilter(KnownMapConfig(known_map=str(tmp_path / "map.yaml")), 0)
    made._was_sure = True
    for given_up, codes in ((1, set()), (2, {"places-given-up"})):
        made._most_given_up = given_up
        assert {issue.code for issue in made.issues} == codes


def test_who_was_sure_for_a_few_metres_alone_is_not_in_this_map(tmp_path: Path) -> None:
    write_map(tmp_path / "map.pgm", drawn([*WALLS, *BOX]))
    made = KnownMapFilter(KnownMapConfig(known_map=str(tmp_path / "map.yaml")), 0)
    made._losses, made._most_given_up, made._was_sure = [(0.0, 5.0, 0.0), (9.0, None, 0.0)], 2, True
    (issue,) = made.issues
    assert issue.code == "not-in-this-map"
    assert "even the sure ones" in issue.message
    made._was_there = True
    assert {issue.code for issue in made.issues} == {"places-given-up", "searched-for"}


@pytest.mark.parametrize("several", [False, True])
def test_places_that_are_open_to_the_end_are_told(tmp_path: Path, several: bool) -> None:
    write_map(tmp_path / "map.pgm", drawn([*WALLS, *BOX]))
    made = KnownMapFilter(KnownMapConfig(known_map=str(tmp_path / "map.yaml")), 0)
    made._losses, made._was_there, made._search = [(0.0, 0.0, 0.0)], True, None
    made._particles.hypotheses[::2] = several
    assert any("several places fit alike" in issue.message for issue in made.issues) == several


@pytest.mark.parametrize("inverted", [False, True])
def test_a_map_whose_greys_are_inverted_is_told_where_nothing_fits(inverted: bool) -> None:
    occupancy = drawn([*WALLS, *BOX])
    other = {FREE: OCCUPIED, OCCUPIED: FREE}
    values = np.select([occupancy.values == one for one in other], list(other.values()), UNKNOWN).astype(np.int8)
    found = not_in_map(Raster(values, CELL) if inverted else occupancy, was_sure=False)
    assert ("inverted" in found.message) == inverted


def test_a_missing_map_is_refused() -> None:
    with refusal(ConfigError, field="known_map"):
        run_slam(circled_room(scans=5)[0], resolve_config("localize"))
