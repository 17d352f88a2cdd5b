"""Weights, schemes and numbers of resampling, the paths that follow from it, and when an update is due."""

import numpy as np
import pytest
from slam_rooms import circled_room

from moteslam.robot import se2
from moteslam.slam.config import resolve_config
from moteslam.slam.filter.history import History
from moteslam.slam.filter.resampling import SCHEMES, Draws, KldConfig, enough_particles, generator_for, particle_number
from moteslam.slam.filter.update_policy import Travelled, UpdateConfig, update_due
from moteslam.slam.filter.weights import Weights
from moteslam.slam.online import OnlineSlam

WEIGHTS = np.array([0.02, 0.31, 0.0, 0.17, 0.5, 0.0])


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("count", [3, 6, 25])
def test_a_particle_is_drawn_in_proportion_to_its_weight(scheme: str, count: int):
    draws = 4000
    counts = np.zeros(len(WEIGHTS))
    for step in range(draws):
        parents = SCHEMES[scheme](WEIGHTS, generator_for(7, step), count)
        assert len(parents) == count
        counts += np.bincount(parents, minlength=len(WEIGHTS))
    # independent draws vary most: five of their standard deviations
    margin = 5 * np.sqrt(draws * count * WEIGHTS * (1 - WEIGHTS))
    assert (np.abs(counts - draws * count * WEIGHTS) <= margin).all()
    assert (counts[WEIGHTS == 0] == 0).all()


@pytest.mark.parametrize(("scheme", "margin"), [("systematic", 1), ("stratified", 2), ("residual", None)])
def test_no_particle_is_drawn_much_too_often_or_seldom(scheme: str, margin: int | None):
    generator = np.random.default_rng(3)
    for step in range(200):
        weights = generator.dirichlet(np.full(40, 0.3))
        parents = SCHEMES[scheme](weights, generator_for(1, step), 60)
        assert (np.diff(parents) >= 0).all()
        counts = np.bincount(parents, minlength=40)
        if margin is None:
            assert (counts >= np.floor(60 * weights)).all()
        else:
            assert (np.abs(counts - 60 * weights) < margin).all()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_same_seed_and_step_give_the_same_parents(scheme: str):
    weights = np.random.default_rng(0).dirichlet(np.ones(200))
    one, two, other_step, other_seed = (
        SCHEMES[scheme](weights, generator_for(*key), 200) for key in ((4, 9), (4, 9), (4, 10), (5, 9))
    )
    np.testing.assert_array_equal(one, two)
    assert (one != other_step).any()
    assert (one != other_seed).any()


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("n", [1, 7, 49, 1000])
def test_equal_weights_keep_every_particle(scheme: str, n: int):
    np.testing.assert_array_equal(SCHEMES[scheme](np.full(n, 1 / n), generator_for(0, 0), n), np.arange(n))


def test_every_purpose_has_random_numbers_of_its_own():
    first = {purpose: generator_for(3, 4, purpose).random(50) for purpose in Draws}
    assert len(np.unique(np.concatenate(list(first.values())))) == 50 * len(Draws)


KLD = KldConfig(enabled=True, least=10)


def number(poses: np.ndarray, most: int = 5000, config: KldConfig = KLD) -> int:
    return particle_number(poses, np.full(len(poses), 1 / len(poses)), config, most, seed=0, step=0)


def test_the_bound_is_the_quantile_of_chi_square():
    from scipy.stats import chi2

    bins = np.array([2, 3, 10, 50, 500])
    np.testing.assert_allclose(
        enough_particles(bins, 0.05, 0.01), chi2.ppf(0.99, bins - 1) / (2 * 0.05), rtol=0.03
    )  # Wilson and Hilferty's approximation is worst for one degree of freedom
    assert enough_particles(np.array(1), 0.05, 0.01) == 0
    assert enough_particles(np.array(10), 0.1, 0.01) == pytest.approx(enough_particles(np.array(10), 0.05, 0.01) / 2)


def test_few_particles_for_one_place_and_many_for_many():
    generator = np.random.default_rng(0)
    near = generator.normal((3.05, 1.05, 0), 0.003, (400, 3))
    wide = generator.uniform((-1, -1, -0.5), (1, 1, 0.5), (400, 3))
    wider = generator.uniform((-3, -3, -1), (3, 3, 1), (5000, 3))
    assert number(near) == KLD.least
    assert number(near) < number(wide) < number(wider)
    assert number(wider, most=800) == 800
    assert number(near, most=4) == 4


def test_headings_about_pi_are_near_to_each_other_and_particles_without_weight_do_not_count():
    generator = np.random.default_rng(0)
    about = generator.normal((0.05, 0.05, np.pi), (1e-3, 1e-3, 1e-3), (400, 3))
    about[:, 2] = np.pi - np.mod(np.pi - about[:, 2], 2 * np.pi)
    assert (about[:, 2] < 0).any()
    assert number(about) == KLD.least
    poses = np.vstack((np.full((10, 3), 0.02), generator.uniform(-3, 3, (90, 3))))
    assert particle_number(poses, np.repeat((0.1, 0.0), (10, 90)), KLD, 1000, seed=0, step=0) == KLD.least


@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize(
    ("preset", "scheme", "bin_size"),
    [("default", "systematic", 0.1), ("default", "residual", 0.1), ("paper", "stratified", 0.3)],
)
def test_the_number_falls_where_the_place_is_known(preset: str, scheme: str, bin_size: float):
    recording, true = circled_room(scans=60)
    settings = ["particles=100", "kld.enabled=true", "kld.least=12", "resample_below=1.0", f"resampling={scheme}"]
    settings += [f"kld.bin_size={bin_size}", f"kld.bin_angle={bin_size / 2}"]
    session = OnlineSlam.over(recording, resolve_config(preset, settings), seed=1)
    updates = list(session)
    numbers = [len(update.weights) for update in updates]
    assert numbers[0] == 100
    assert 12 <= numbers[-1] < 60
    assert all(update.poses.shape == (n, 3) for update, n in zip(updates, numbers, strict=True))
    assert all(update.weights.sum() == pytest.approx(1) for update in updates)
    estimate = session.estimate()
    assert len(estimate.trajectory) == len(estimate.trajectory_final) == len(recording.lidar)
    assert estimate.particle_paths.shape[1:] == (sum(update.updated for update in updates), 3)
    assert 12 <= len(estimate.particle_paths) < 60
    assert np.hypot(*(estimate.trajectory_final.poses - true)[:, :2].T).max() < 0.12


def test_times_is_bayes_and_scores_that_are_all_zero_leave_the_weights_as_they_are():
    weights = Weights.uniform(3).times([1, 2, 1]).times([0, 2, 4])
    assert weights.values == pytest.approx([0, 0.5, 0.5])
    assert weights.effective_number == pytest.approx(2)
    assert weights.best == 1
    alone = Weights.uniform(3).times([1, 0, 0])
    assert alone.times([0, 0, 0]) is alone.times([0, 5, 5]) is alone


def test_paths_follow_the_parents_through_a_changing_number():
    history = History()
    history.append(np.arange(12.0).reshape(4, 3))
    history.resampled(np.array([1, 3]))
    history.append(np.arange(6.0).reshape(2, 3) + 20)
    np.testing.assert_array_equal(history.paths(np.arange(2))[..., 0], [[3, 20], [9, 23]])
    history.resampled(np.array([0, 1, 1]))  # without effect on the paths until now
    np.testing.assert_array_equal(history.paths(np.arange(2))[..., 0], [[3, 20], [9, 23]])
    history.append(np.arange(9.0).reshape(3, 3) + 40)
    history.resampled(np.array([2, 2, 2]))
    assert history.particles == 3
    all_, paths = np.arange(3), [[3, 20, 40], [9, 23, 43], [9, 23, 46]]
    np.testing.assert_array_equal(history.paths(all_)[..., 0], paths)
    np.testing.assert_array_equal(history.ancestors(all_), [[1, 0, 0], [3, 1, 1], [3, 1, 2]])
    for first in range(4):
        np.testing.assert_array_equal(history.path(1, first)[:, 0], paths[1][first:])
        np.testing.assert_array_equal(history.ancestors(all_, first), history.ancestors(all_)[:, first:])


def test_the_last_step_is_from_the_parent():
    history = History()
    history.append(np.array([[0.0, 0, 0], [5.0, 0, np.pi / 2]]))
    np.testing.assert_array_equal(history.step(1), np.zeros(3))
    history.resampled(np.array([1, 1]))
    history.append(np.array([[5.0, 1.0, np.pi / 2], [5.0, 2.0, np.pi / 2]]))
    np.testing.assert_allclose(history.step(0), [1.0, 0.0, 0.0], atol=1e-12)


def test_log_likelihoods_multiply_as_likelihoods_do_and_far_from_zero_neither_overflow_nor_vanish():
    weights, likelihood = Weights.uniform(4).times([1, 2, 3, 4]), np.array([0.3, 0.1, 0.9, 0.5])
    by_log = weights.times_log(np.log(likelihood))
    np.testing.assert_allclose(by_log.values, weights.times(likelihood).values, rtol=1e-12)
    far = Weights.uniform(3).times_log(np.array([-1e6, -1e6 + np.log(3), -1e9]))
    assert far.values == pytest.approx([0.25, 0.75, 0])
    assert far.times_log(np.full(3, 1e6)).values == pytest.approx(far.values)


POLICY = UpdateConfig(distance=0.1, rotation=0.2, interval=5.0)


@pytest.mark.parametrize(
    ("travelled", "tracked", "due"),
    [
        ((0.09, 0.19, 4.9), None, False),
        ((0.1, 0.0, 0.0), None, True),
        ((0.0, 0.2, 0.0), None, True),
        ((0.0, 0.0, 5.0), None, True),
        ((0.0, 0.0, 0.0), (0.08, 0.08, 0.0), True),
        ((0.0, 0.0, 0.0), (0.0, 0.0, -0.2), True),
        ((0.1, 0.0, 0.0), (0.0, 0.0, 0.0), True),
        ((0.09, 0.19, 0.0), (0.05, 0.0, 0.19), False),
    ],
)
def test_each_of_distance_rotation_and_time_is_enough_by_the_odometry_or_as_tracked(travelled, tracked, due) -> None:
    assert update_due(POLICY, Travelled(*travelled), tracked) is due


def test_of_early_updates_the_ancestors_alone_are_kept():
    rng, history, each, poses = np.random.default_rng(3), History(), np.arange(8), []
    parents = [np.sort(rng.integers(0, 8, 8)) if update % 20 == 19 else each for update in range(600)]
    for update in range(600):
        poses.append(rng.normal(size=(8, 3)))
        history.append(poses[-1])
        if update % 20 == 19:
            history.resampled(parents[update])
    places = [each]
    for update in reversed(range(599)):
        places.insert(0, parents[update][places[0]])
    np.testing.assert_array_equal(history.ancestors(each), np.stack(places, axis=1))
    np.testing.assert_array_equal(
        history.paths(each), np.stack([p[k] for p, k in zip(poses, places, strict=True)], axis=1)
    )
    np.testing.assert_array_equal(history.last, poses[-1])
    arrays = [
        array if array.base is None else array.base for part in history._parts for array in (part.poses, part.room)
    ]
    assert sum({id(array): array.nbytes for array in arrays}.values()) < sum(some.nbytes for some in poses) / 2


def test_of_a_moved_path_every_particle_keeps_its_own_until_they_are_drawn_anew():
    rng, history, each = np.random.default_rng(5), History(), np.arange(8)
    drawn = [np.sort(rng.integers(0, 8, 8)) for _ in range(12)]
    for update, parents in enumerate(drawn):
        history.append(rng.normal(size=(8, 3)))
        if update < 10:
            history.resampled(parents)
    frames, before = rng.normal(size=(8, 3)), history.paths(each)
    history.move(4, frames)
    moved = np.stack([se2.compose(frame, path) for frame, path in zip(frames, before, strict=True)])
    expected = np.concatenate((before[:, :4], moved[:, 4:]), axis=1)
    np.testing.assert_allclose(se2.between(history.paths(each), expected), 0, atol=1e-12)
    for parents in drawn:
        history.resampled(parents)
        history.append(rng.normal(size=(8, 3)))
        expected = np.concatenate((expected[parents], history.last[:, None]), axis=1)
        np.testing.assert_allclose(se2.between(history.paths(each), expected), 0, atol=1e-12)
