"""The filters in a room small enough to reason about, the paper's a step at a time; and the trajectories of a run."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from refusals import refusal
from slam_rooms import blind, circled_room, run

from moteslam.errors import ConfigError, InputError
from moteslam.kernels.matching import match_poses
from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.slam.config import resolve_config
from moteslam.slam.estimate import LONGEST, Estimate, preview_png
from moteslam.slam.filter.history import History
from moteslam.slam.inputs.step import Step, steps
from moteslam.slam.inputs.synchronise import synchronise
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.online import OnlineSlam, run_slam
from moteslam.slam.paper.config import PaperFilterConfig
from moteslam.slam.paper.filter import PaperFilter
from moteslam.slam.tsdf.particles import Particles

pytestmark = pytest.mark.usefixtures("taichi")


Finished = tuple[Estimate, np.ndarray]
SPARSE = ("particles=20", "update.distance=0.3", "update.rotation=10")


@pytest.fixture(scope="module")
def finished(taichi: None) -> Finished:
    """The paper's filter in a room, with updates 0.3 m apart, and the indices of the scans that it was updated with."""
    session = OnlineSlam.over(circled_room(scans=60)[0], resolve_config("paper", SPARSE), seed=0)
    updates = list(session)
    estimate = session.estimate()
    assert [update.index for update in updates] == list(range(60))
    np.testing.assert_array_equal(estimate.trajectory.poses, [update.pose for update in updates])
    return estimate, np.array([update.index for update in updates if update.updated])


def test_the_final_trajectory_is_one_particles_path_and_the_online_one_is_not(finished: Finished):
    estimate, updates = finished
    assert estimate.particle_paths.shape == (20, len(updates), 3)
    np.testing.assert_array_equal(estimate.particle_stamps, estimate.trajectory.stamps[updates])

    def from_nearest_path(poses: np.ndarray) -> float:
        """How far the poses at the updates are from those of the particle's path that is nearest to them."""
        return float(np.abs(se2.between(estimate.particle_paths, poses[updates])).max(axis=(1, 2)).min())

    assert from_nearest_path(estimate.trajectory_final.poses) < 1e-9
    assert from_nearest_path(estimate.trajectory.poses) > 0.01
    np.testing.assert_allclose(estimate.trajectory_final.poses[updates[-1]], estimate.trajectory.poses[updates[-1]])


def test_between_updates_the_misfit_of_motion_and_path_is_spread_evenly(finished: Finished):
    estimate, updates = finished
    # the paper's filter moves by odometry alone between updates
    odometry, final = estimate.dead_reckoning.poses, estimate.trajectory_final.poses
    off = se2.wrap(np.diff(final[:, 2]) - np.diff(odometry[:, 2]))
    largest = 0.0
    for before, after in pairwise(updates):
        assert after - before > 2
        np.testing.assert_allclose(off[before:after], off[before:after].mean(), atol=1e-9)
        largest = max(largest, abs(off[before:after].sum()))
    assert largest > 0.01


def test_an_estimate_has_the_order_of_the_recording_where_its_stamps_are_wrong(finished: Finished):
    """Each fifth scan has the stamp of three scans before: the same poses, each at its own stamp."""
    recording, _ = circled_room(scans=60)
    poses = finished[0].dead_reckoning.poses
    lidar = replace(recording.lidar, odometry=poses)
    right = run(recording.replace(lidar=lidar), *SPARSE, preset="paper")
    wrong = lidar.stamps.copy()
    wrong[5::5] -= 3.5 * np.diff(lidar.stamps)[0]
    order = np.argsort(wrong)
    shuffled = replace(
        lidar, stamps=wrong[order], ranges=lidar.ranges[order], odometry=poses[order], sequence=order.astype(np.int64)
    )
    found = run(recording.replace(lidar=shuffled), *SPARSE, preset="paper")
    np.testing.assert_array_equal(found.trajectory.stamps, wrong[order])
    for name in ("trajectory", "trajectory_final", "dead_reckoning"):
        np.testing.assert_array_equal(getattr(found, name).poses, getattr(right, name).poses[order])
    np.testing.assert_array_equal(found.diagnostics["updated"], right.diagnostics["updated"][order])
    np.testing.assert_array_equal(found.covariances, right.covariances[order])
    updated = np.flatnonzero(right.diagnostics["updated"])
    np.testing.assert_array_equal(found.particle_stamps, np.sort(wrong[updated]))


def test_in_a_preview_the_largest_y_is_on_top_and_walls_stay() -> None:
    """Free space with a wall along its top, and a path along its bottom, in a picture of what is known."""
    rows, columns = 1300, 2600
    log_odds = np.zeros((rows + 100, columns + 100), np.float32)
    log_odds[50:-50, 50:-50] = -9
    log_odds[-51, 50:-50] = 9
    path = np.array([(1.5, 4.5, 0.0), (1.5 + 0.05 * columns, 4.5, 0.0)])
    png = preview_png(Raster(log_odds, 0.05, (-1.0, 2.0, 0.0)), path)
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].astype(int)
    height, width = image.shape[:2]
    assert LONGEST / 2 <= max(height, width) <= LONGEST
    assert width / height == pytest.approx((columns + 20) / (rows + 20), rel=0.05)
    dark, blue = image.max(axis=2) < 60, (abs(image - (0x00, 0x72, 0xB2)) < 40).all(axis=2)
    assert dark[: height // 2, width // 2].any()
    assert not dark[height // 2 :, width // 2].any()
    assert blue[height // 2 :, width // 2].any()
    assert not blue[: height // 2].any()


def test_the_preset_defaults_online_pose_is_the_mean_of_the_best_particles_mode():
    recording, _ = circled_room(scans=40)
    session = OnlineSlam.over(recording, resolve_config("default", ["particles=20"]), seed=0)
    apart = 0.0
    for update in session:
        if update.updated and update.index:
            mean = np.average(np.unwrap(update.poses, axis=0), axis=0, weights=update.weights)
            np.testing.assert_allclose(np.cos(update.pose[2] - mean[2]), 1.0, atol=1e-6)
            np.testing.assert_allclose(update.pose[:2], mean[:2], atol=1e-9)
            apart = max(apart, np.ptp(update.poses[:, 0]))
    assert apart > 1e-3
    particles = Particles(3, TsdfConfig())
    particles.poses = np.array([(1.0, 2.0, 3.1), (1.2, 2.0, -3.1), (9.0, 2.0, 3.1)])
    x, y, turn = particles.mode_mean(0.5, 0.2)
    np.testing.assert_allclose((np.hypot(x, y), turn), (0.1, np.pi - 3.1), atol=1e-9)  # the third is elsewhere


def test_scans_that_see_nothing_leave_the_robot_to_its_odometry():
    estimate = run(blind(circled_room(scans=30)[0], 0.0, np.inf), "particles=30", preset="paper")
    assert np.abs(estimate.trajectory.poses - estimate.dead_reckoning.poses).max() < 0.5
    assert np.isfinite(estimate.trajectory.poses).all()


def test_particles_spread_by_a_share_of_the_odometrys_error():
    dark = blind(circled_room(scans=40)[0], 0.0, np.inf)

    def spread(*settings: str) -> float:
        still = ("proposal.rotation=0", "proposal.rotation_from_rotation=0")
        *_, last = OnlineSlam.over(dark, resolve_config("default", [*still, *settings]), seed=1)
        return float(np.linalg.norm(last.poses[:, :2].std(axis=0)))

    full = spread("proposal.sampled_share=1")
    assert spread("proposal.sampled_share=0.25") == pytest.approx(full / 4, rel=0.2)


def test_an_estimate_before_any_scan_and_a_seed_out_of_bounds_are_refused():
    recording, _ = circled_room(scans=5)
    with pytest.raises(ConfigError, match="no scan was taken in yet"):
        OnlineSlam.over(recording).estimate()
    with pytest.raises(ConfigError, match="seed"):
        OnlineSlam.over(recording, seed=-1)
    with pytest.raises(InputError, match="no lidar scans"):
        OnlineSlam.over(recording.replace(lidar=None))


def config_of(*settings: str) -> PaperFilterConfig:
    return resolve_config("paper", ["particles=20", *settings])


def test_the_reported_score_is_the_best_particles_in_the_map_before_the_scan():
    config = config_of()
    paper = PaperFilter(config, 0)
    updates, unlike_the_first = 0, 0
    for step in steps(synchronise(circled_room(scans=40)[0], config.sync)):
        occupied, origin = paper.grid.occupied.copy(), paper.grid.origin
        result = paper.step(step)
        if not result.updated or not step.index:
            assert result.score == 0
            continue
        cell_size, poses, here = paper.grid.cell_size, paper.history.last, np.zeros(1)
        found = match_poses(occupied, origin, cell_size, poses, step.points, offsets_xy=here, offsets_theta=here)
        scores = found.scores
        # resampled after every update, the weights are equal before each: the best particle is that of the best score
        assert result.score == scores[paper.best_particle] == scores.max()
        updates += 1
        unlike_the_first += result.score != scores[0]
    assert updates > 20
    assert unlike_the_first > updates / 2


def test_a_particles_path_leads_through_the_particle_it_was_drawn_from():
    recording, _ = circled_room(scans=40)
    session = OnlineSlam.over(recording, config_of(), seed=0)
    after_resampling = [update.poses.copy() for update in session if update.resampled]
    assert len(after_resampling) > 20
    paths = session.estimate().particle_paths
    np.testing.assert_array_equal(paths[:, -2], after_resampling[-2])
    ancestors = [len(np.unique(poses, axis=0)) for poses in paths.swapaxes(0, 1)]
    assert ancestors == sorted(ancestors)  # lines merge backwards in time, and never part again
    assert ancestors[1] < len(paths) / 2


def test_the_maps_rays_start_at_the_lidar():
    paper = PaperFilter(config_of(), 0)
    lidar = np.array((1.025, 1.025))  # the middle of a cell
    wall = np.array([(3.025, y) for y in np.linspace(0.925, 1.125, 21)], np.float32)
    paper.step(Step(0, 0.0, 0.0, np.zeros(3), True, wall, lidar))

    def at(*places: tuple[float, float]) -> np.ndarray:
        return paper.occupancy().values_at(np.array(places), outside=0.0)

    assert at((3.025, 1.025)) > 0
    assert (at(*((x, 1.025) for x in (1.225, 1.625, 2.025, 2.425, 2.825))) < 0).all()
    # nothing is known of what lies between the robot's origin and the lidar, or beside the beams
    assert not at((0.025, 0.025), (0.525, 0.175), (0.525, 0.525), (0.725, 1.025), (0.925, 0.325), (1.525, 0.525)).any()


def test_the_weights_of_an_update_are_those_of_its_effective_number_and_a_larger_exponent_sharpens_them():
    """The preset resamples after every update: after that all are equal."""
    recording, _ = circled_room(scans=40)
    median = {}
    for exponent in (1.0, 20.0):
        config = resolve_config("paper", {"particles": 30, "score_exponent": exponent})
        updates = list(OnlineSlam.over(recording, config, seed=0))
        for update in updates:
            assert 1 / np.square(update.weights).sum() == pytest.approx(update.n_eff) or not update.updated
        assert any(np.ptp(update.weights) > 0 for update in updates)
        median[exponent] = np.median([update.n_eff for update in updates if update.updated])
    assert median[1.0] > 25
    assert median[20.0] < 0.8 * median[1.0]


@pytest.mark.parametrize("offsets", ["search.offsets_xy=[0.0]", "search.offsets_theta=[0.0]"])
def test_without_the_search_no_covariance_is_singular(offsets: str):
    recording, _ = circled_room(scans=20)
    estimate = run_slam(recording, resolve_config("paper", ["particles=20", offsets]))
    assert np.linalg.eigvalsh(estimate.covariances).min() > 0


@pytest.mark.parametrize(
    "returned",
    [
        lambda scores: np.log(scores / scores.max()),
        lambda scores: np.exp(1e6 * scores),
        lambda scores: np.exp(-1e6 * scores),
        lambda scores: None,
    ],
    ids=["logarithms", "overflow", "zeros", "nothing"],
)
@pytest.mark.filterwarnings("ignore:.* encountered in")
def test_a_likelihood_that_is_none_is_refused(returned: Callable[[np.ndarray], object]):
    class Mine(PaperFilter):
        def likelihood(self, scores: np.ndarray) -> object:
            return returned(scores)

    with refusal(InputError, "20", field="Mine.likelihood"):
        run_slam(circled_room(scans=10)[0], resolve_config("paper", ["particles=20"]), method=Mine)


class NoFilter:
    def __init__(self, config: object, seed: int) -> None:
        self.poses = np.zeros((1, 3))


class NoResult(PaperFilter):
    def step(self, step: Step) -> object:
        return np.zeros(3)


def spoilt(**changes: object) -> type[PaperFilter]:
    """A filter whose result, or what it keeps, is other than it should be."""

    class Spoilt(PaperFilter):
        def step(self, step: Step) -> object:
            found = super().step(step)
            for name in changes.keys() - found._fields:
                setattr(self, name, changes[name])
            return found._replace(**{name: changes[name] for name in changes.keys() & set(found._fields)})

    return Spoilt


@pytest.mark.parametrize(
    ("method", "field", "told"),
    [
        ("mine", "method", "method=NAME"),
        (NoFilter, "method", "FilterDefaults"),
        (type("Mine", (), {}), "method", "Mine takes other arguments, expected Mine(config, seed)"),
        (NoResult, "NoResult.step", "ndarray, expected a StepResult"),
        (spoilt(pose=np.full(3, np.nan)), "Spoilt.step", "[nan, nan, nan], expected x, y and theta"),
        (spoilt(pose=np.zeros(2)), "Spoilt.step", "[0.0, 0.0], expected x, y and theta"),
        (spoilt(updated=False), "Spoilt.step", "first scan"),
        (spoilt(history=History()), "Spoilt.step", "self.history.append(self.poses)"),
        (spoilt(weights=np.ones(2)), "Spoilt.step", "ndarray, expected Weights"),
        (spoilt(best_particle=None), "Spoilt.step", "best_particle None"),
        (spoilt(resampled=True), "Spoilt.step", "self.history.resampled(parents)"),
        (spoilt(pose=np.full(3, 2.0)), "Spoilt.step", "2.83 m from all of self.history.last"),
    ],
)
def test_a_method_that_is_no_filter_is_refused(method: object, field: str, told: str):
    with refusal(ConfigError, field=field) as caught:
        run_slam(circled_room(scans=5)[0], resolve_config("paper", ["particles=2"]), method=method)
    assert told in caught.value.problem


def test_a_filter_made_of_another_method_than_the_configurations_is_refused():
    with refusal(ConfigError, '"tsdf" has no .*preset paper', field="method"):
        run_slam(circled_room(scans=5)[0], resolve_config("default", ["particles=2"]), method=NoResult)
