"""Registering scans to TSDFs: what is kept of the odometry, where a scan is looked for, what walls do not bind."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from tile_pools import room_scan, thinned

from moteslam.kernels.gauss_newton import NOISE_RATIO
from moteslam.robot import se2
from moteslam.slam.inputs.lapses import CLOSED, Open
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.mapping.tsdf import TsdfMaps, TsdfView
from moteslam.slam.registration import localisation
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.localisation import (
    NO_SLIP,
    SLIP,
    Localiser,
    Located,
    against,
    match_score,
    nats_for,
    proved,
)
from moteslam.slam.registration.registrar import (
    Registration,
    keep_odometry,
    least_bound_turn,
    less_where_unbound,
    measured_information,
    register,
    residual_variance,
)
from moteslam.slam.registration.search import Window, candidates

Array = NDArray[np.float64]
Pose = tuple[float, float, float]
SPREAD = (0.02, 0.02, 0.02)
HERE = (0.0, 0.0)
ANGLES = np.linspace(0, 2 * np.pi, 100, endpoint=False)
CIRCLE = np.column_stack((np.cos(ANGLES), np.sin(ANGLES)))  # Points 1 m from the robot
CONFIG = RegistrationConfig()
ODOMETRY = np.zeros((1, 3))
UNKNOWN = CONFIG.unknown_cost


def registration(
    offset: ArrayLike = (0.0, 0.0, 0.0),
    information: Array | None = None,
    *,
    costs: float = 0.0,
    known: float = 100.0,
    likelihood: float = 1.0,
    points: Array | None = None,
) -> Registration:
    """One, of endpoints 1 m around the robot unless given."""
    offsets, none, ends = np.array([offset], float), np.zeros(1), CIRCLE if points is None else points
    means = np.array([[*ends.mean(axis=0), np.square(ends).sum(axis=1).mean()]])
    bound = np.zeros((1, 3, 3)) if information is None else information[None]
    return Registration(offsets, bound, none + costs, none + known, none + likelihood, none, offsets, none, means)


def between_walls(heading: float, ratio: float) -> Array:
    """Information between walls at this heading, with ``ratio`` of that across along them."""
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    return np.asarray(turn @ np.diag((ratio * 1e6, 1e6, 1e6)) @ turn.T)


def localiser(**keys: float) -> Localiser:
    return Localiser(TrackingConfig(**keys), RegistrationConfig())  # type: ignore[arg-type]


def kept(found: Registration, **keys: float) -> Registration:
    return keep_odometry(found, np.array(SPREAD), RegistrationConfig(**keys))  # type: ignore[arg-type]


def test_along_bare_walls_the_odometry_is_kept_and_across_them_the_scan() -> None:
    heading = 0.4
    along, across = np.array((np.cos(heading), np.sin(heading))), np.array((-np.sin(heading), np.cos(heading)))
    seen = registration((*(0.03 * along + 0.02 * across), 0.01), between_walls(heading, 0.002))
    result = kept(seen)
    assert abs(result.offsets[0, :2] @ along) < 0.001
    assert result.offsets[0, :2] @ across == pytest.approx(0.02)
    assert result.offsets[0, 2] == pytest.approx(0.01, abs=1e-4)
    assert along @ result.information[0, :2, :2] @ along < 0.02 * 2e3
    assert across @ result.information[0, :2, :2] @ across == pytest.approx(1e6)
    np.testing.assert_array_equal(kept(seen, degenerate=0.0).offsets, seen.offsets)
    informed = registration((0.03, -0.02, 0.01), between_walls(heading, 0.5))  # in all directions
    np.testing.assert_allclose(kept(informed).offsets, informed.offsets, atol=1e-3)


def placed(offset: float, cost: float, known: float) -> Registration:
    """One registration that is this far ahead of the odometry; of 200 points this many are known, at this mean cost."""
    return registration((offset, 0.0, 0.0), costs=cost * known + UNKNOWN * (200 - known), known=known)


def test_the_evidence_is_what_known_endpoints_cost_and_not_how_many_are_known() -> None:
    near, far = placed(0.0, 1.5, 100), placed(0.5, 1.5, 190)
    assert nats_for(far, near, 200, UNKNOWN, 10.0)[0] == pytest.approx(0.0)
    assert nats_for(placed(0.5, 1.0, 190), placed(0.0, 6.0, 100), 200, UNKNOWN, 10.0)[0] == pytest.approx(50.0)


def test_a_place_that_knows_next_to_nothing_and_fits_badly_is_no_refuge() -> None:
    """With a heading that is wrong around a corner nearly all endpoints lie behind walls."""
    right, lost, new = placed(0.5, 1.0, 150), placed(0.0, 8.0, 5), placed(0.0, 1.0, 5)
    assert nats_for(right, lost, 200, UNKNOWN, 10.0)[0] == pytest.approx(7.0 * 0.3 * 150 / 10)
    assert nats_for(right, new, 200, UNKNOWN, 10.0)[0] == pytest.approx(0.0)  # new, and it fits
    known = placed(0.0, 8.0, 60)  # enough: nothing changes
    assert nats_for(right, known, 200, UNKNOWN, 10.0)[0] == pytest.approx(7.0 * 60 / 10)


def test_against_a_place_far_off_speaks_no_more_than_that_odometry_fails_seldom_and_where_it_may_be_then() -> None:
    config = TrackingConfig()
    window = np.array((config.relocation_distance, config.relocation_distance, config.relocation_rotation))
    nats = against(np.array((0.0, 16.0, 1e4, 1e8)), config)
    assert nats[0] == SLIP
    assert nats[1] == pytest.approx(SLIP + 3 * np.log1p(16 / 6))
    np.testing.assert_allclose(nats[2:], SLIP + np.log(np.prod(window / config.basin)))


@pytest.fixture(scope="module")
def room(taichi: None) -> TsdfView:
    """The map of one scan from the middle of a room."""
    maps = TsdfMaps(TsdfConfig())
    maps.integrate(np.zeros((1, 3)), thinned(room_scan(beams=720)))
    return maps.of(0)


def found_from(maps: TsdfView, points: NDArray[np.float32], start: tuple[float, float, float]) -> list[Array]:
    """What registration from there finds, all but free of the odometry, and what is left of that when it is proved."""
    config, wide, here = RegistrationConfig(), np.array((2.0, 2.0, 2.0)), np.zeros((1, 3))
    free = register(maps, here, wide, points, np.zeros(2), np.array([start]), config, means=np.array([start]))
    kept = proved(free, maps, here, np.array(SPREAD), points, np.zeros(2), config, TrackingConfig())
    return [free.offsets[0], kept.offsets[0]]


def test_a_place_back_along_a_bare_corridor_is_not_proved(taichi: None) -> None:
    """Half a metre back the endpoints fit as well, and all of them are known."""
    walls = np.array([(x, y) for y in (-1.0, 1.0) for x in np.sign(y) * np.arange(4.0, -4.0, -0.05)], np.float32)
    maps = TsdfMaps(TsdfConfig())
    maps.integrate(np.zeros((1, 3)), thinned(walls))
    free, kept = found_from(maps.of(0), thinned(walls + np.float32((0.5, 0.0))).points, (-0.5, 0.0, 0.0))
    np.testing.assert_allclose(free, (-0.5, 0.0, 0.0), atol=0.01)
    np.testing.assert_allclose(kept, 0.0, atol=0.01)


def test_walls_that_were_drawn_nearer_to_each_other_are_no_place_along_a_corridor(taichi: None) -> None:
    """A scan of walls 1.9 m apart fits where they were drawn so, 3 m back, and not here: both are two walls."""

    def drawn(x: Array, half: float) -> Array:
        return np.array([(at, side * half) for side in (-1, 1) for at in side * x])

    maps = TsdfMaps(TsdfConfig())
    both = np.vstack((drawn(np.arange(3.0, -1.2, -0.05), 1.0), drawn(np.arange(-1.8, -6.0, -0.05), 0.95)))
    maps.integrate(np.zeros((1, 3)), thinned(both.astype(np.float32)))
    scan = thinned(drawn(np.arange(0.5, -0.5, -0.05), 0.95).astype(np.float32)).points
    free, kept = found_from(maps.of(0), scan, (-3.0, 0.0, 0.0))
    assert free[0] < -2.5
    assert abs(kept[0]) < 0.05


@pytest.mark.parametrize(
    ("evidence", "slip", "taken"),
    [(5.0, 0.5, True), (5.0, 0.0, False), (0.0, 0.5, False)],
)
def test_wheels_that_slipped_may_slip_again_on_less_evidence_but_not_on_none(
    room: TsdfView, monkeypatch: pytest.MonkeyPatch, evidence: float, slip: float, taken: bool
) -> None:
    monkeypatch.setattr(localisation, "nats_for", lambda *_: np.array((evidence,)))
    wider = SPREAD[0] + slip, *SPREAD[1:]
    found, _ = located(room, (0.3, 0.0, 0.0), np.zeros(3), wider, slip=(slip, 0.0, 0.0), measured=True)
    assert (found.fitted.offset[0] > 0.25) == taken


def test_a_registration_that_leaves_its_window_has_found_nothing(
    room: TsdfView, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = localisation.register

    def register(*given: Any, **how: Any) -> Any:
        tried = real(*given, **how)
        if len(tried.offsets) > 1:
            tried.offsets[-1], tried.likelihoods[-1], tried.known[-1] = (5.0, 0.0, 0.0), 1.0, 1e4
        return tried

    monkeypatch.setattr(localisation, "register", register)
    at = np.array((0.3, -0.2, 0.1))
    np.testing.assert_allclose(located(room, at, at + 0.3, (0.3, 0.3, 0.3))[1], at, atol=0.005)


def test_walls_prove_that_the_odometry_failed(room: TsdfView) -> None:
    at = (0.5, -0.3, 0.4)
    free, kept = found_from(room, thinned(room_scan(at)).points, (0.45, -0.25, 0.35))
    np.testing.assert_allclose(free, at, atol=0.005)
    np.testing.assert_array_equal(kept, free)


def located(
    room: TsdfView, at: ArrayLike, predicted: ArrayLike, spread: Pose = SPREAD, *, predictions: Array = ODOMETRY,
    left: Open = CLOSED, noise: float = 0.0, slip: Pose = NO_SLIP, measured: bool = False,
    blind: float = 0.0, **keys: float,
) -> tuple[Located, Array]:  # fmt: skip
    """What is found of a scan taken there, from where the odometry puts it, with an error there; and its pose.

    Its endpoints have so much noise [m].
    """
    start, points = se2.as_pose(np.asarray(predicted)), thinned(room_scan(at)).points
    points = points + np.random.default_rng(4).normal(0, noise, points.shape).astype(np.float32)
    found = localiser(**keys).locate(
        room, start, spread, points, HERE, lambda: predictions, measured=measured, left=left, slip=slip, blind=blind
    )
    return found, np.asarray(se2.compose(np.asarray(predicted, float), found.fitted.offset))


def test_a_scan_near_its_prediction_is_found_without_a_search(room: TsdfView, monkeypatch: pytest.MonkeyPatch) -> None:
    def search(*_: object) -> None:
        raise AssertionError("a search")

    monkeypatch.setattr(localisation, "candidates", search)
    at = (0.3, -0.2, 0.1)
    assert np.abs(located(room, at, np.add(at, (0.03, -0.02, 0.02)))[1] - at).max() < 0.003
    with pytest.raises(AssertionError, match="a search"):
        located(room, at, np.add(at, (0.9, -0.6, 0.8)))


def test_a_scan_is_found_where_the_same_velocity_would_put_it(room: TsdfView) -> None:
    """Odometry that misses 0.9 m and half a radian, and no relocation window to look in."""
    at, stood = (0.7, 0.5, 0.5), (0.0, 0.0, 0.0)
    narrow = {"relocation_distance": 0.0, "relocation_rotation": 0.0}
    predictions = np.stack((np.zeros(3), se2.between(stood, np.array(at) + 0.02)))
    assert np.abs(located(room, at, stood, predictions=predictions, **narrow)[1] - at).max() < 0.005
    assert np.abs(located(room, at, stood, **narrow)[1] - at).max() > 0.1


def test_only_a_robot_that_was_not_seen_for_long_leaps(room: TsdfView) -> None:
    """Odometry that misses 0.9 m and half a radian, with a scan registered shortly before or long ago."""
    at, stood = (0.7, 0.5, 0.5), (0.0, 0.0, 0.0)
    shortly, long_ago = (located(room, at, stood, blind=blind, relocation_after=3.0)[1] for blind in (0.3, 3.5))
    assert np.abs(shortly - at).max() > 0.1
    np.testing.assert_allclose(long_ago, at, atol=0.005)


def test_rays_through_a_surface_lower_the_match_score_and_can_lose_a_scan() -> None:
    """A scan of 100 points that all fit well, of whose rays 40 go through a surface, or none."""
    config = TrackingConfig()
    free, blocked = (match_score(100.0, 0.9, crossed, config) for crossed in (0.0, 40.0))
    assert free - blocked == pytest.approx(40 * config.score_crossing)
    strict = TrackingConfig(score_crossing=3.0)
    scores = [match_score(100.0, 0.9, crossed, strict) for crossed in (0.0, 40.0)]
    assert [localiser().contradicts(score, 100) for score in scores] == [False, True]


def test_places_that_look_alike_are_rivals_by_what_their_offsets_cost(room: TsdfView) -> None:
    """A room looks the same from the other side; seen from a right angle to both, neither is likelier."""
    at = np.array((0.3, -0.2, 0.1))
    other, spread = se2.wrap(at * (-1, -1, 1) + (0.0, 0.0, np.pi)), (0.4, 0.4, 1.5)
    for lean in (0.0, 0.2):
        found, here = located(room, at, (0.0, 0.0, float(at[2]) + np.pi / 2 - lean), spread)
        rivals = found.rivals
        places = se2.compose(here, rivals.offsets)
        expected = other if abs(se2.wrap(here[2] - at[2])) < 1 else at
        assert len(rivals.offsets) == 1
        if not lean:
            np.testing.assert_allclose(np.abs(se2.between(places, expected)), 0.0, atol=0.02)
            assert rivals.log_odds(0.03)[0] == pytest.approx(0.0, abs=0.2)
            continue
        np.testing.assert_allclose(se2.between(here, at), 0.0, atol=0.02)
        near, far = np.pi / 2 - lean, np.pi / 2 + lean
        assert rivals.log_odds(0.03)[0] == pytest.approx((near**2 - far**2) / 2 / spread[2] ** 2, abs=0.2)


def test_a_place_that_looks_like_no_other_has_no_rivals(room: TsdfView) -> None:
    at = np.array((0.3, -0.2, 0.1))
    found, here = located(room, at, at + 0.3, (0.3, 0.3, 0.3))
    np.testing.assert_allclose(se2.between(here, at), 0.0, atol=0.005)
    assert len(found.rivals.offsets) == len(found.rivals.log_odds(0.03)) == 0


@pytest.mark.parametrize(("heading", "noise", "decided"), [(0.6, 0.0, True), (0.6, 0.02, True), (1.5, 0.0, False)])
def test_after_a_lapse_a_scan_decides_where_the_room_looks_the_same_from_no_likely_place(
    room: TsdfView, heading: float, noise: float, decided: bool
) -> None:
    """It looks the same from the other side, which is as likely where the robot may have turned any way.

    Then it begins at one of the two.
    """
    at = np.array((0.3, -0.2, 0.1))
    predicted, left = (0.0, 0.0, 0.1 + (0.0 if decided else np.pi / 2)), Open(1.0, heading, 1.0)
    found, here = located(room, at, predicted, (1.0, 1.0, heading), left=left, noise=noise)
    assert found.decided == decided
    places = [at] if decided else [at, se2.compose(np.array((0.0, 0.0, np.pi)), at)]
    assert min(np.abs(se2.between(here, place)).max() for place in places) < 0.01


def test_after_a_lapse_a_scan_of_a_round_room_leaves_the_robot_where_it_was_predicted(room: TsdfView) -> None:
    angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    points = (0.7 * np.column_stack((np.cos(angles), np.sin(angles)))).astype(np.float32)
    found = localiser().locate(
        room,
        (0.5, 0.0, 0.0),
        (1, 1, 1),
        points,
        HERE,
        lambda: ODOMETRY,
        blind=0.0,
        measured=False,
        left=Open(1.0, 1.0, 1.0),
    )
    assert not found.decided
    assert found.fitted.offset == (0.0, 0.0, 0.0)


def test_a_window_holds_the_places_within_its_deviations_and_few_others():
    """Of a covariance whose place goes with the heading, most of its box is not looked into."""
    by = np.array([[0.5, 0.0, 12.0], [0.0, 0.3, -9.0], [0.0, 0.0, 1.0]])
    covariance = by @ np.diag(np.square((1.0, 1.0, 0.1))) @ by.T
    window = Window.of(covariance, 3.0, 0.1, 0.04)
    rng = np.random.default_rng(2)
    unit = rng.normal(0, 1, (2000, 3))
    unit *= 3 * (rng.uniform(0, 1, 2000) ** (1 / 3) / np.linalg.norm(unit, axis=1))[:, None]
    offsets = unit @ np.linalg.cholesky(covariance).T
    c, s = np.cos(window.along), np.sin(window.along)
    along = offsets[:, :2] @ np.array([[c, -s], [s, c]]) - offsets[:, 2:] * np.array(window.drift)
    assert (np.abs(np.column_stack((along, offsets[:, 2]))) <= window.half + 1e-9).all()
    box = 3 * np.sqrt(covariance.diagonal())
    assert np.prod(window.half) == pytest.approx(27 * np.sqrt(np.linalg.det(covariance)))
    assert window.places < 0.5 * np.prod(2 * box / (0.1, 0.1, 0.04))


def test_a_place_at_the_far_end_of_a_window_is_found():
    """Turned by 0.3 rad and, as far as that goes, two metres off: beyond what is allowed of other headings."""
    maps = TsdfMaps(TsdfConfig())
    maps.integrate(np.zeros((1, 3)), thinned(room_scan()))
    by = np.array([[0.2, 0.0, 5.0], [0.0, 0.05, 5.0], [0.0, 0.0, 1.0]])
    covariance = by @ np.diag(np.square((1.0, 1.0, 0.12))) @ by.T
    window = Window.of(covariance, 3.0, 0.1, 0.04)
    truth = np.array((1.4, 1.6, 0.3))
    predicted = np.asarray(se2.compose((0.5, -1.0, 0.4), se2.between(truth, np.zeros(3))))
    points = se2.transform_points(se2.between((0.5, -1.0, 0.4), np.zeros(3)), room_scan()).astype(np.float32)
    (best,) = candidates(maps.of(0), predicted, np.ones(3), points, window, 1, TrackingConfig())
    assert (np.abs(best - truth) < (0.15, 0.15, 0.03)).all()
    assert np.hypot(*window.half[:2]) < 1.5 < np.hypot(*truth[:2])


def in_a_tank(centre: tuple[float, float], noise: float) -> tuple[Array, Array]:
    """The information of 100 endpoints on a circle of 4 m about a centre, in the robot's frame, with ``noise`` of their
    normals; and the endpoints."""
    points = 4 * CIRCLE + centre
    slopes = np.random.default_rng(1).normal(0, noise, 100)
    normals = 1e2 * (CIRCLE + slopes[:, None] * CIRCLE[:, ::-1] * (-1, 1))
    rows = np.column_stack((normals, normals[:, 1] * points[:, 0] - normals[:, 0] * points[:, 1]))
    return np.asarray(rows.T @ rows), points


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.0])
@pytest.mark.parametrize(("ratio", "likelihood"), [(0.001, 0.9), (0.03, 0.5), (0.5, 0.9)])
def test_along_bare_walls_a_step_is_as_uncertain_as_the_errors_of_the_map_make_it(
    heading: float, ratio: float, likelihood: float
) -> None:
    found = registration(information=between_walls(heading, ratio), likelihood=likelihood)
    measured = measured_information(found, 0, CONFIG, 10.0)
    less = less_where_unbound(measured, found, 0, CONFIG)
    variance = residual_variance(likelihood, CONFIG)
    error = CONFIG.degenerate * variance / ratio
    along = np.array((np.cos(heading), np.sin(heading), 0.0))
    expected = np.linalg.inv(measured) + error**2 * np.outer(along, along)
    np.testing.assert_allclose(np.linalg.inv(less), expected, rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize("centre", [(0.0, 0.0), (-2.0, 1.0)])
def test_in_a_round_room_a_turn_about_its_centre_is_not_measured(centre: tuple[float, float]) -> None:
    information, points = in_a_tank(centre, 0.05)
    found = registration(information=information, likelihood=0.8, points=points)
    less = less_where_unbound(measured_information(found, 0, CONFIG, 10.0), found, 0, CONFIG)
    about = np.array((centre[1], -centre[0], 1.0))
    values, vectors = np.linalg.eigh(less)
    assert abs(values[0]) < 1e-3
    assert abs(vectors[:, 0] @ about) > 0.99 * np.linalg.norm(about)
    assert values[1] > 1e3  # the distances to the wall are

    turned = 0.02 * about + (0.01, -0.01, 0.0)  # the odometry says that it did not turn
    found = registration(turned, information, likelihood=0.8, points=points)
    kept = keep_odometry(found, np.full(3, 0.02), CONFIG)
    np.testing.assert_allclose(kept.offsets[0], (0.01, -0.01, 0.0), atol=2e-3)
    assert np.linalg.eigvalsh(kept.information[0])[0] > -1e-3


def test_a_turn_is_bound_by_what_its_endpoints_know_beside_those_that_bind_all_directions() -> None:
    information, points = in_a_tank((-2.0, 1.0), 0.16)
    means = np.array([[*points.mean(axis=0), np.square(points).sum(axis=1).mean()]])
    (turn,), (bound,) = least_bound_turn(information[None], means, np.ones(1), np.zeros(1), CONFIG)
    moved = turn[:2] + np.column_stack((-points[:, 1], points[:, 0]))
    most = np.trace(information[:2, :2]) * np.square(moved).sum(axis=1).mean()
    assert bound == pytest.approx(2 * turn @ information @ turn / most / NOISE_RATIO - 2)
    assert 0 < bound < 1
