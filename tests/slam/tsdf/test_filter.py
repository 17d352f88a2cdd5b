"""The TSDF filter a step at a time: weights and score are those of its proposals, the odometry is calibrated."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
from slam_rooms import blind, circled_room, run
from tile_pools import ROOM, room_scan, thinned

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.slam.config import resolve_config
from moteslam.slam.filter.update_policy import Travelled
from moteslam.slam.inputs.config import SyncConfig, ThinningConfig
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.step import steps, thin_some
from moteslam.slam.inputs.synchronise import synchronise
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.registrar import prior_spread
from moteslam.slam.tsdf import filter as tsdf_filter
from moteslam.slam.tsdf import particles as tsdf_particles
from moteslam.slam.tsdf.config import ProposalConfig
from moteslam.slam.tsdf.filter import TsdfFilter
from moteslam.slam.tsdf.motion import MotionSinceUpdate
from moteslam.slam.tsdf.particles import Particles
from moteslam.slam.tsdf.proposal import Proposal, propose

pytestmark = pytest.mark.usefixtures("taichi")


@pytest.fixture
def proposals(monkeypatch: pytest.MonkeyPatch) -> list[Proposal]:
    """Every proposal that a filter makes while the test runs."""
    made: list[Proposal] = []
    propose = tsdf_filter.propose

    def watched(*arguments: Any, **options: Any) -> Proposal:
        made.append(propose(*arguments, **options))
        return made[-1]

    monkeypatch.setattr(tsdf_filter, "propose", watched)
    return made


def test_weights_are_the_product_of_the_proposals_likelihoods_and_the_score_is_the_best_particles(
    proposals: list[Proposal],
):
    config = resolve_config("default", ["particles=12", "resample_below=0"])
    tsdf = TsdfFilter(config, 0)
    product, unlike_the_first = np.zeros(12), 0
    for step in steps(synchronise(circled_room(scans=40)[0], config.sync)):
        made = len(proposals)
        result = tsdf.step(step)
        if len(proposals) == made:
            assert result.score == 0
            continue
        assert len(proposals) == made + 1
        product += proposals[-1].log_likelihood
        np.testing.assert_allclose(tsdf.weights.values, np.exp(product) / np.exp(product).sum(), rtol=1e-9)
        best = int(product.argmax())
        assert tsdf.best_particle == best
        assert result.score == proposals[-1].likelihoods[best]
        unlike_the_first += result.score != proposals[-1].likelihoods[0]
    assert len(proposals) > 15
    assert np.ptp(product) > 0.1
    assert unlike_the_first > 5


def test_where_the_scans_stop_the_odometry_is_followed_as_it_was_calibrated():
    """The gyro turns 3 % too far. Two thirds of the drive calibrate it; then the robot is blind for a third of it."""
    recording, true = circled_room(drift=0.03)
    seen = 80
    dark = blind(recording, 0.1 * seen - 0.01, np.inf)

    def turned_too_far(*settings: str) -> float:
        poses = run(dark, "particles=5", *settings).trajectory.poses
        off = np.diff(poses[seen - 1 :, 2]) - np.diff(true[seen - 1 :, 2])
        return float(se2.wrap(off).sum())

    uncalibrated = turned_too_far("calibration.enabled=false")
    assert uncalibrated == pytest.approx(0.03 * 40 * 2 * np.pi / 60, abs=0.01)
    assert abs(turned_too_far()) < uncalibrated / 4


REGISTRATION = RegistrationConfig()
SINCE = MotionSinceUpdate(travelled=Travelled(distance=0.1, rotation=0.0))
DRIFT = prior_spread(REGISTRATION, 0.1, 0.0)
SCAN = room_scan()  # From the middle of a room of 8 x 6 m


def mapped(points: np.ndarray, poses: np.ndarray) -> Particles:
    """Particles at poses [N, 3], all with one map: a scan of these points from the middle."""
    particles = Particles(len(poses), TsdfConfig())
    particles.start(thinned(points))
    particles.move_to(poses)
    return particles


def second_knows_more(points: np.ndarray, more: np.ndarray) -> Particles:
    """Two particles in the middle, with these points in their maps; in that of the second there are more."""
    particles = mapped(points, np.zeros((2, 3)))
    elsewhere = np.array([(30.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
    for _ in range(8):  # until the map is sure of it
        particles.maps.integrate(elsewhere, thinned(more))
    return particles


def proposed(particles: Particles, **options: float) -> Proposal:
    """The scan of the room, registered and weighed."""
    config = ProposalConfig(**options)  # type: ignore[arg-type]
    return propose(particles, SINCE, thinned(SCAN), np.zeros(2), config, REGISTRATION, TrackingConfig(), measured=True)


@pytest.mark.parametrize("cost", [0.0, 1.0, 4.0])
def test_a_ray_through_a_wall_of_the_map_counts_with_its_cost(cost: float):
    # at 0.6 of the way to the right wall, one of the places where the registration looks along a ray
    wall = np.array([(2.4, y) for y in np.linspace(-1.5, 1.5, 151)])
    behind = (SCAN[:, 0] > 0) & (np.abs(SCAN[:, 1] / SCAN[:, 0]) < 1.5 / 2.4)
    proposal = proposed(second_knows_more(SCAN, wall), crossing_cost=cost)
    np.testing.assert_allclose(proposal.means, 0.0, atol=2e-3)
    free, blocked = proposal.log_likelihood
    assert behind.sum() > 50
    assert free - blocked == pytest.approx(ProposalConfig().evidence_share * cost * behind.sum(), rel=0.1, abs=1e-3)


def test_an_endpoint_where_the_map_is_unknown_counts_with_its_share_of_its_cost():
    right = SCAN[:, 0] > ROOM[0] / 2 - 0.01
    proposal = proposed(second_knows_more(SCAN[~right], SCAN[right]))
    np.testing.assert_allclose(proposal.means, 0.0, atol=2e-3)
    unknown, known = proposal.log_likelihood
    expected = ProposalConfig().evidence_share * REGISTRATION.unknown_cost * right.sum()
    assert known - unknown == pytest.approx(expected, rel=0.1)


def test_a_particle_weighs_less_the_farther_its_scan_fits_from_where_the_odometry_put_it():
    """All fit the same place of the same map; their odometry tells them apart, by a Gaussian within the gate."""
    off = np.array([0.0, 0.01, 0.02, 0.03])
    particles = mapped(SCAN, np.column_stack((off, -off, off / 2)))
    proposal = proposed(particles)
    np.testing.assert_allclose(proposal.means, 0.0, atol=2e-3)
    assert (np.diff(proposal.log_likelihood) < -0.2).all()
    odometry = -np.square(proposal.offsets / DRIFT).sum(axis=1) / 2
    assert odometry[-1] < -4
    without_endpoints = proposed(particles, evidence_share=1e-9).log_likelihood
    np.testing.assert_allclose(without_endpoints, odometry, rtol=1e-3, atol=1e-3)


def test_along_bare_walls_the_updates_of_a_metre_leave_it_to_the_odometry_however_many_they_are():
    """The map's walls are rough, the scan's are those of the map 2 cm on: ten updates pull no more than one."""
    rng = np.random.default_rng(4)
    walls = np.array([(x, y) for y in (-1.0, 1.0) for x in np.sign(y) * np.arange(4.0, -4.0, -0.05)])
    rough = walls + np.column_stack((np.zeros(len(walls)), rng.normal(0, 0.005, len(walls))))
    particles, scan = mapped(rough, np.zeros((1, 3))), thinned(rough + np.array((0.02, 0.0)))

    def pulled(distance: float) -> float:
        since = SINCE._replace(travelled=Travelled(distance, 0.0))
        config = ProposalConfig()
        found = propose(particles, since, scan, np.zeros(2), config, REGISTRATION, TrackingConfig(), measured=True)
        return -float(found.offsets[0, 0])

    assert 10 * pulled(0.1) < pulled(1.0)


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_the_map_begins_with_the_first_scan_that_has_points(value: float):
    recording, true = circled_room()
    lidar = recording.lidar
    ranges = np.array(lidar.ranges)
    ranges[:15] = value
    found = run(recording.replace(lidar=replace(lidar, ranges=ranges)), "particles=3")
    assert (found.diagnostics["state"][1:15] > 0).all()
    assert (found.diagnostics["state"][15:] == 0).all()
    assert found.diagnostics["updated"][:16].tolist() == [True, *[False] * 14, True]
    since = se2.between(found.trajectory.poses[15], found.trajectory.poses[15:])
    assert np.abs(since - se2.between(true[15], true[15:]))[:, :2].max() < 0.03


def test_a_map_is_drawn_anew_from_the_first_scans_of_each_place(monkeypatch: pytest.MonkeyPatch):
    """The later ones were placed by the map that they are in: it creeps with them."""
    inputs = synchronise(circled_room()[0], SyncConfig())
    tsdf, updates = TsdfFilter(resolve_config("default", ["particles=3"]), seed=0), []
    for step in islice(steps(inputs, None, thinning=tsdf.thinning), 40):
        if tsdf.step(step).updated:
            updates.append(step.index)
    path = tsdf.history.path(tsdf.best_particle)
    drawn: list[int] = []

    def watched(scans: Scans, indices: Sequence[int], config: ThinningConfig) -> list[ThinnedScan]:
        drawn.extend(indices)
        return thin_some(scans, indices, config)

    monkeypatch.setattr(tsdf_filter, "thin_some", watched)
    monkeypatch.setattr(tsdf_particles, "ENOUGH", 1)
    tsdf.revise(path, np.array(updates), inputs.scans)
    places = [tuple(np.floor(pose / 0.5)) for pose in path]
    assert drawn == [update for k, update in enumerate(updates) if places[k] not in places[:k]]
    assert 1 < len(drawn) < len(updates)
